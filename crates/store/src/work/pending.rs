//! Changes on their way.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::state::FileState;
use crate::disk::{self, DiskError};

/// A change that was announced.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Pending {
    /// The file `unfinished`, beside the manifest, is to be in the place of `name`.
    Place { unfinished: String, name: String },
    /// It is to go, and was this before.
    Remove { name: String, was: FileState },
}

impl Pending {
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Place { name, .. } | Self::Remove { name, .. } => name,
        }
    }

    /// Whether all that it names lies in its folder.
    pub(super) fn is_within(&self) -> bool {
        match self {
            Self::Place { unfinished, name } => {
                is_within(name) && !unfinished.contains('/') && disk::is_unfinished(Path::new(unfinished))
            }
            Self::Remove { name, .. } => is_within(name),
        }
    }
}

/// Makes changes, without looking at what they find, and brings them to the disk.
pub(super) fn make(folder: &Path, changes: &[&Pending]) -> Result<(), DiskError> {
    let (mut parents, mut gone) = (BTreeSet::new(), Vec::new());
    for change in changes {
        let path = folder.join(change.name());
        match change {
            Pending::Place { unfinished, .. } => {
                parents.extend(path.parent().map(Path::to_owned));
                // Where both are names of one file, neither is moved.
                gone.push(folder.join(unfinished));
            }
            Pending::Remove { .. } => gone.push(path),
        }
    }
    // Nothing that is moved may be gone from where it was before it is where it goes: each folder reaches the disk by itself.
    parents.iter().try_for_each(|parent| disk::make_folder(parent))?;
    for change in changes {
        if let Pending::Place { unfinished, name } = change {
            let path = folder.join(name);
            fs::rename(folder.join(unfinished), &path).map_err(DiskError::at(&path))?;
        }
    }
    parents.remove(folder);
    parents.par_iter().try_for_each(|parent| disk::sync_folder(parent))?;
    disk::remove(&gone)?;
    disk::sync_folder(folder)
}

/// Whether a name is that of a file in the folder, or in one of its own.
pub(super) fn is_within(name: &str) -> bool {
    Path::new(name).components().all(|part| matches!(part, Component::Normal(_)))
}
