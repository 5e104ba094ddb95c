//! Valid maps, and those that are built in.

use std::path::Path;

use super::RecordingMapSpec;
use super::check::{check, is_same_name};
use crumple_core::field_error::FieldError;
use crumple_core::text_file::{FileError, parse_toml, read_at_most};

const MAX_MAP_BYTES: u64 = 64 << 10;

/// A valid map.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordingMap {
    spec: RecordingMapSpec,
}

impl RecordingMap {
    /// Reads a map.
    ///
    /// # Errors
    /// [`FileError`] for a file that cannot be read, has more than 64 KiB, or is invalid, with line and field.
    pub fn load(path: &Path) -> Result<Self, FileError> {
        Self::from_toml(&read_at_most(path, MAX_MAP_BYTES)?, path)
    }

    /// Reads a map from TOML text; `path` only names it in errors.
    ///
    /// # Errors
    /// [`FileError`] for text that is not a valid map.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, FileError> {
        let mut spec: RecordingMapSpec = parse_toml(text, path)?;
        if let (Some(dbc), Some(folder)) = (&mut spec.dbc, path.parent()) {
            *dbc = folder.join(&*dbc);
        }
        Self::new(spec).map_err(|FieldError { field, problem }| {
            FileError::from_field(path, text, &field, problem)
        })
    }

    /// Checks a map. The error names the first invalid field.
    pub(in crate::recording) fn new(spec: RecordingMapSpec) -> Result<Self, FieldError> {
        check(&spec)?;
        Ok(Self { spec })
    }

    /// Returns the content of the map.
    #[must_use]
    pub fn spec(&self) -> &RecordingMapSpec {
        &self.spec
    }

    /// Returns the built-in map with a name; `None` for any other name.
    ///
    /// # Errors
    /// [`FileError`] never, since tests read every built-in map.
    pub fn built_in(name: &str) -> Option<Result<Self, FileError>> {
        BUILT_IN_MAPS
            .iter()
            .find(|(built_in, _)| *built_in == name)
            .map(|(name, text)| Self::from_toml(text, Path::new(name)))
    }

    /// Returns the name of the built-in map whose columns are all among `names`.
    pub(in crate::recording) fn recognise<'n>(
        names: impl Iterator<Item = &'n str> + Clone,
    ) -> Option<&'static str> {
        let mut maps = BUILT_IN_MAPS.iter();
        maps.find(|(_, text)| {
            Self::from_toml(text, Path::new("")).is_ok_and(|map| {
                map.spec
                    .columns()
                    .iter()
                    .all(|(_, column)| names.clone().any(|name| is_same_name(name, column)))
            })
        })
        .map(|(name, _)| *name)
    }
}

/// Name and text of every built-in map.
pub const BUILT_IN_MAPS: [(&str, &str); 5] = [
    ("openacc", include_str!("../built_in/openacc.toml")),
    (
        "car-following",
        include_str!("../built_in/car-following.toml"),
    ),
    ("highd", include_str!("../built_in/highd.toml")),
    ("ngsim", include_str!("../built_in/ngsim.toml")),
    ("sumo-fcd", include_str!("../built_in/sumo-fcd.toml")),
];
