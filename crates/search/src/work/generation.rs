//! What was there before, kept until the work is finished.

use std::path::{Path, PathBuf};

use super::examine::examined;
use super::lock::Lock;
use super::manifest::Manifest;
use super::state::FileState;
use super::{MANIFEST, WorkError};
use crate::disk::{self, DiskError};
use crumple_world::quoted::{ShellWord, is_hidden};

/// The folder of the generation before.
pub(super) const PREVIOUS: &str = "previous";

/// Where a file is kept as it was before.
pub(super) fn before(name: &str) -> String {
    format!("{PREVIOUS}/{name}")
}

/// Whether a file is one of the generation before.
pub(super) fn is_of_it(name: &str) -> bool {
    name.strip_prefix(PREVIOUS).is_some_and(|rest| rest.starts_with('/'))
}

/// Where the second copy of the manifest is.
pub(super) fn manifest_in(folder: &Path) -> PathBuf {
    folder.join(PREVIOUS).join(MANIFEST)
}

/// Nothing is left of a generation that nobody needs any more.
pub(super) fn forget(folder: &Path) -> Result<(), DiskError> {
    disk::remove_folder(&folder.join(PREVIOUS))
}

/// Whether something is damaged and there is a way back.
pub(super) fn can_be_restored(folder: &Path) -> bool {
    plan(folder).is_ok_and(|plan| plan.is_some())
}

/// The error, and the way back where there is one.
pub(super) fn hinted(folder: &Path, error: WorkError) -> WorkError {
    match error {
        WorkError::Damaged { path, problem } if can_be_restored(folder) => {
            let folder = folder.to_string_lossy();
            // What does not show as itself cannot be copied.
            let way = match folder.chars().any(is_hidden) {
                true => "`crumple fsck --restore` goes back to what was kept before it".to_owned(),
                false => {
                    format!("`crumple fsck --restore -- {}` goes back to what was kept before it", ShellWord(&folder))
                }
            };
            WorkError::Damaged { path, problem: format!("{problem}; {way}") }
        }
        other => other,
    }
}

/// What was put back.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Restored {
    /// What was damaged.
    pub damaged: Vec<String>,
    /// What is as it was before, for the same work to be done again from there: all that was kept, so that it fits together.
    pub restored: Vec<String>,
}

/// How to go back.
struct Plan {
    manifest: Manifest,
    damaged: Vec<String>,
    /// Name and contents.
    files: Vec<(String, Vec<u8>)>,
}

/// How to go back; none if nothing is damaged.
fn plan(folder: &Path) -> Result<Option<Plan>, WorkError> {
    let path = folder.join(MANIFEST);
    let (manifest, is_damaged) = match Manifest::read(&path) {
        Ok(Some(manifest)) => (manifest, false),
        missing_or_damaged => match Manifest::read(&manifest_in(folder))? {
            Some(second) => (second, true),
            None => {
                missing_or_damaged?;
                return Err(WorkError::missing(&path));
            }
        },
    };
    let found = examined(folder, &manifest)?.files;
    let mut damaged: Vec<String> =
        found.iter().filter(|(_, state)| state.is_err()).map(|(name, _)| name.clone()).collect();
    let is_current = damaged.iter().any(|name| !is_of_it(name));
    // All that was kept before is put back, so that it fits together; if only that is damaged, it is made again of what there is.
    let sources = manifest.names().into_iter().filter_map(|kept| {
        let name = kept.strip_prefix(PREVIOUS)?.strip_prefix('/')?.to_owned();
        let is_needed = is_current || damaged.contains(&kept);
        is_needed.then_some(if is_current { (kept, name) } else { (name, kept) })
    });
    let mut files = Vec::new();
    for (from, to) in sources {
        let path = folder.join(&from);
        let bytes = manifest.contents(folder, &from).map_err(|error| match error {
            WorkError::Damaged { path, problem } => lost(&path, &problem),
            other => other,
        })?;
        manifest.check(&from, bytes.as_deref()).map_err(|problem| lost(&path, &problem))?;
        files.extend(bytes.map(|bytes| (to, bytes)));
    }
    let is_kept = |name: &String| files.iter().any(|(to, _)| to == name);
    if let Some((name, Err(problem))) = found.iter().find(|(name, state)| state.is_err() && !is_kept(name)) {
        return Err(lost(&folder.join(name), problem));
    }
    damaged.extend(is_damaged.then(|| MANIFEST.to_owned()));
    Ok((!damaged.is_empty()).then_some(Plan { manifest, damaged, files }))
}

/// Something damaged of which nothing was kept.
fn lost(path: &Path, problem: &str) -> WorkError {
    WorkError::damaged(path, format!("{problem}, and nothing is kept to go back to: begin anew in another --out"))
}

/// Goes back to what was kept before, where something is damaged; none if nothing is.
///
/// # Errors
/// [`WorkError`] if the folder is in use or cannot be written, or something is damaged of which nothing was kept.
pub fn restore(folder: &Path) -> Result<Option<Restored>, WorkError> {
    let Some(_lock) = Lock::of(folder)? else {
        return Err(WorkError::InUse { folder: folder.to_owned(), kind: "work".to_owned() });
    };
    let Some(Plan { mut manifest, damaged, files }) = plan(folder)? else { return Ok(None) };
    for ((name, bytes), unfinished) in files.iter().zip(manifest.unfinished_names()) {
        disk::write(&folder.join(&unfinished), bytes)?;
        manifest.place(name, unfinished, FileState::of(bytes));
    }
    manifest.write(folder)?;
    manifest.complete(folder)?;
    manifest.write(folder)?;
    Ok(Some(Restored { damaged, restored: files.into_iter().map(|(name, _)| name).collect() }))
}
