//! Fuzzing of run folders: only genuine content may be accepted and resumed.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::Path;
use std::sync::OnceLock;

use crumple_controllers::Controllers;
use crumple_core::observer::{Listener, Quiet};
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignProgress};
use crumple_sim::observation::EstimatorKind;
use crumple_spaces::built_in_space;
use crumple_store::run_folder::{FolderExamination, examine};
use crumple_store::study::Study;

type FolderContents = BTreeMap<String, Vec<u8>>;

/// Applies changes that are read from bytes to the genuine folder. A change has these fields:
///
/// | byte | meaning |
/// |---|---|
/// | which | index of the file in the order of names |
/// | how | flip a bit, truncate, replace by the rest, remove, swap with another, append the rest |
/// | where, where | position, or index of the other file |
fn apply_changes(genuine: &FolderContents, bytes: &[u8]) -> FolderContents {
    let mut contents = genuine.clone();
    let names: Vec<&String> = genuine.keys().collect();
    let mut rest = bytes;
    while let [which, how, high, low, behind @ ..] = rest {
        rest = behind;
        let Some(name) = names.get(usize::from(*which) % names.len().max(1)) else {
            break;
        };
        let position = usize::from(u16::from_be_bytes([*high, *low]));
        let Some(file) = contents.get_mut(*name) else {
            continue;
        };
        match how % 6 {
            0 => {
                let length = file.len().max(1);
                if let Some(byte) = file.get_mut(position % length) {
                    *byte ^= 1 << (how / 6 % 8);
                }
            }
            1 => file.truncate(position % (file.len() + 1)),
            2 => {
                *file = behind.to_vec();
                break;
            }
            3 => drop(contents.remove(*name)),
            4 => {
                let source = names.get(position % names.len()).copied();
                if let Some(content) = source.and_then(|source| contents.get(source)).cloned() {
                    contents.insert((*name).clone(), content);
                }
            }
            _ => {
                file.extend_from_slice(behind);
                break;
            }
        }
    }
    contents
}

fn small_campaign() -> Option<Campaign> {
    let space = built_in_space("high-risk")?;
    Some(Campaign {
        estimator: EstimatorKind::Truth,
        seed: 3,
        ..Campaign::new(
            Controllers::default()
                .find("match-leader", Path::new(""))
                .ok()?,
            space,
        )
        .with_method(Method::Uniform)
        .with_budget(6)
    })
}

/// Reads all files below a folder, except the empty lock file.
fn read_folder(folder: &Path) -> io::Result<FolderContents> {
    let mut contents = FolderContents::new();
    let mut open = vec![folder.to_owned()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next)? {
            let path = entry?.path();
            if path.is_dir() {
                open.push(path);
            } else if let Ok(name) = path.strip_prefix(folder)
                && name != Path::new("work.lock")
            {
                contents.insert(name.to_string_lossy().into_owned(), fs::read(&path)?);
            }
        }
    }
    Ok(contents)
}

fn write_folder(folder: &Path, contents: &FolderContents) -> io::Result<()> {
    for (name, bytes) in contents {
        let path = folder.join(name);
        path.parent().map_or(Ok(()), fs::create_dir_all)?;
        fs::write(path, bytes)?;
    }
    Ok(())
}

struct CampaignSnapshots {
    half_done: FolderContents,
    complete: FolderContents,
}

fn campaign_snapshots() -> Option<&'static CampaignSnapshots> {
    static GENUINE: OnceLock<Option<CampaignSnapshots>> = OnceLock::new();
    GENUINE.get_or_init(CampaignSnapshots::record).as_ref()
}

impl CampaignSnapshots {
    /// Runs the campaign, and reads its folder after the first evaluation and at the end.
    fn record() -> Option<Self> {
        let folder = tempfile::tempdir().ok()?;
        let half_done = OnceLock::new();
        let listener = Listener(|progress: &CampaignProgress| {
            if progress.evaluations > 0 {
                half_done.get_or_init(|| read_folder(folder.path()).ok());
            }
        });
        small_campaign()?
            .run(folder.path(), false, &listener)
            .ok()?;
        Some(Self {
            half_done: half_done.into_inner()??,
            complete: read_folder(folder.path()).ok()?,
        })
    }
}

fn is_complete_and_undamaged(folder: &FolderExamination) -> bool {
    folder.is_complete && folder.files.iter().all(|(_, state)| state.is_ok())
}

/// Describes a changed folder that was wrongly accepted, or a genuine one that was refused; `None` if all is well. The
/// first byte selects the complete or the half-done campaign.
///
/// # Errors
/// Errors of the file system, which are not findings.
pub(super) fn find_wrong_acceptance(bytes: &[u8]) -> io::Result<Option<String>> {
    let Some((genuine, campaign)) = campaign_snapshots().zip(small_campaign()) else {
        return Ok(Some("the original campaign cannot run".to_owned()));
    };
    let (base, bytes) = match bytes {
        [first, rest @ ..] if first % 2 == 1 => (&genuine.half_done, rest),
        [_, rest @ ..] => (&genuine.complete, rest),
        [] => (&genuine.complete, bytes),
    };
    let contents = apply_changes(base, bytes);
    let folder = tempfile::tempdir()?;
    write_folder(folder.path(), &contents)?;
    let examined = examine(folder.path());
    let is_accepted = examined.as_ref().is_ok_and(is_complete_and_undamaged);
    if is_accepted != (contents == genuine.complete) {
        return Ok(Some(format!(
            "the examination is wrong about complete and undamaged files: {examined:?}"
        )));
    }
    match campaign.run(folder.path(), true, &Quiet) {
        Ok(_) if read_folder(folder.path())? != genuine.complete => Ok(Some(
            "a campaign resumed from foreign files, with another result".to_owned(),
        )),
        Err(error) if contents == *base => {
            Ok(Some(format!("the original folder is refused: {error}")))
        }
        _ => Ok(None),
    }
}
