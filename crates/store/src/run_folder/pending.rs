//! Announced changes of a run folder.

use std::collections::BTreeSet;
use std::fs;
use std::path::{Component, Path};

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::state::FileState;
use crate::disk::{self, DiskError};

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum PendingChange {
    /// The file `unfinished`, beside the manifest, will replace `name`.
    Place { unfinished: String, name: String },
    /// The file will be removed; `old_state` was its state.
    #[serde(alias = "was")]
    Remove {
        name: String,
        #[serde(alias = "was")]
        old_state: FileState,
    },
}

impl PendingChange {
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Place { name, .. } | Self::Remove { name, .. } => name,
        }
    }

    pub(super) fn is_inside_folder(&self) -> bool {
        match self {
            Self::Place { unfinished, name } => {
                is_inside_folder(name)
                    && !unfinished.contains('/')
                    && disk::is_unfinished(Path::new(unfinished))
            }
            Self::Remove { name, .. } => is_inside_folder(name),
        }
    }
}

/// Applies changes, without a check of the existing files, and syncs them to disk.
pub(super) fn apply(folder: &Path, changes: &[&PendingChange]) -> Result<(), DiskError> {
    let mut parents = BTreeSet::new();
    let mut gone = Vec::new();
    for change in changes {
        let path = folder.join(change.name());
        match change {
            PendingChange::Place { unfinished, .. } => {
                parents.extend(path.parent().map(Path::to_owned));
                // Also remove the temporary name: a rename between two hard links of one file leaves both names.
                gone.push(folder.join(unfinished));
            }
            PendingChange::Remove { .. } => gone.push(path),
        }
    }
    // Sync the new names before the old names are removed: each folder reaches the disk separately.
    parents
        .iter()
        .try_for_each(|parent| disk::make_folder(parent))?;
    for change in changes {
        if let PendingChange::Place { unfinished, name } = change {
            let path = folder.join(name);
            fs::rename(folder.join(unfinished), &path).map_err(DiskError::at(&path))?;
        }
    }
    parents.remove(folder);
    parents
        .par_iter()
        .try_for_each(|parent| disk::sync_folder(parent))?;
    disk::remove(&gone)?;
    disk::sync_folder(folder)
}

pub(super) fn is_inside_folder(name: &str) -> bool {
    Path::new(name)
        .components()
        .all(|part| matches!(part, Component::Normal(_)))
}

#[cfg(test)]
mod tests {
    use super::PendingChange;

    #[test]
    fn removals_announced_by_earlier_versions_are_read() {
        let state = r#"{"whole":{"bytes":3,"sha256":"00"}}"#;
        let read = |tag: &str, field: &str| {
            serde_json::from_str::<PendingChange>(&format!(
                r#"{{"{tag}":{{"name":"a","{field}":{state}}}}}"#
            ))
            .unwrap()
        };
        let present = read("remove", "old_state");
        assert_eq!(present, read("remove", "was"));
        assert_eq!(present, read("was", "old_state"));
        let written = serde_json::to_string(&present).unwrap();
        assert_eq!(
            written,
            format!(r#"{{"remove":{{"name":"a","old_state":{state}}}}}"#)
        );
    }
}
