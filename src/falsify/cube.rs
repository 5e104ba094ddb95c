//! The set a search moves in.

use std::ops::Range;

/// The unit cube, with its coordinates in blocks: a block of one is a number by itself, a longer one a piecewise constant
/// signal, piece after piece in time.
///
/// Methods that know signals may propose fewer pieces, which refine to all of them; to others it is just a cube.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Cube {
    blocks: Vec<Range<usize>>,
}

/// A cube without coordinates, or with a block without any.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a search needs at least one coordinate, and at least one in each block")]
pub struct EmptyBlock;

impl Cube {
    /// A cube of blocks with these numbers of coordinates.
    ///
    /// # Errors
    /// [`EmptyBlock`] if there is none or one is zero.
    pub fn new(lengths: impl IntoIterator<Item = usize>) -> Result<Self, EmptyBlock> {
        let mut blocks = Vec::new();
        let mut start = 0;
        for length in lengths {
            if length == 0 {
                return Err(EmptyBlock);
            }
            blocks.push(start..start + length);
            start += length;
        }
        if blocks.is_empty() { Err(EmptyBlock) } else { Ok(Self { blocks }) }
    }

    /// The number of coordinates, at least one.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.end)
    }

    /// The coordinates of each block.
    #[must_use]
    pub fn blocks(&self) -> &[Range<usize>] {
        &self.blocks
    }
}
