//! The cells of a failure map, and a row of them as a short text.

use serde::{Deserialize, Serialize};

/// The result of one controller in one scenario.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum MapCell {
    /// No collision.
    NoContact,
    /// A collision that another driver would have avoided.
    Avoidable,
    /// A collision that no driver avoids; the checker has accepted the proof.
    Unavoidable,
    /// A collision of undecided avoidability.
    Undecided,
}

impl MapCell {
    /// All kinds, in the order of legends and tables.
    pub const ALL: [Self; 4] = [Self::NoContact, Self::Avoidable, Self::Unavoidable, Self::Undecided];

    #[must_use]
    pub(crate) fn letter(self) -> char {
        match self {
            Self::NoContact => '.',
            Self::Avoidable => 'x',
            Self::Unavoidable => '#',
            Self::Undecided => '?',
        }
    }

    /// Returns the label for legends and tables.
    #[must_use]
    pub fn label(self) -> &'static str {
        match self {
            Self::NoContact => "no collision",
            Self::Avoidable => "avoidable collision",
            Self::Unavoidable => "unavoidable collision",
            Self::Undecided => "undecided collision",
        }
    }
}

/// A row of cells from left to right; in the evidence a text of one letter per cell.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "String", into = "String")]
pub struct MapRow(pub Vec<MapCell>);

/// An error: a letter that stands for no cell.
#[derive(Debug, thiserror::Error)]
#[error("`{0}` is no cell of a failure map; use one of . x # ?")]
pub struct UnknownCell(char);

impl From<MapRow> for String {
    fn from(row: MapRow) -> Self {
        row.0.into_iter().map(MapCell::letter).collect()
    }
}

impl TryFrom<String> for MapRow {
    type Error = UnknownCell;

    fn try_from(letters: String) -> Result<Self, UnknownCell> {
        let cell =
            |letter: char| MapCell::ALL.into_iter().find(|cell| cell.letter() == letter).ok_or(UnknownCell(letter));
        letters.chars().map(cell).collect::<Result<_, _>>().map(Self)
    }
}
