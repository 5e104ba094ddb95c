//! The folder of scenarios that failed in a suite: those of the last run, and none of an earlier one.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::{Failure, output};
use crumple_search::disk::{self, DiskError, Files};
use crumple_search::suite::{Failed, SuiteResult, Tested};
use crumple_world::digest::sha256;
use crumple_world::scenario::file;

/// Says which files a run wrote into its folder, in the form of `sha256sum`. Its ending keeps it from being read as a scenario.
const LISTING: &str = "failures.sha256";

/// Whether it can be told what an earlier run wrote there.
pub(super) fn is_usable(folder: &Path) -> Result<(), Failure> {
    listed(&folder.join(LISTING)).map(drop)
}

/// Writes the scenario of every point that failed, once, in place of those of the run before. What that did not write, or somebody has
/// edited since, stays, and is named.
pub(super) fn write(result: &SuiteResult, folder: &Path, quiet: bool) -> Result<(), Failure> {
    let path = folder.join(LISTING);
    let before = listed(&path)?;
    fs::create_dir_all(folder).map_err(DiskError::at(folder))?;
    let tested = result.tests().flat_map(|(_, test)| &test.controllers);
    let failed: BTreeMap<String, &Failed> =
        tested.flat_map(Tested::failures).map(|one| (format!("{}.toml", one.scenario_name), one)).collect();
    let (mut files, mut listing) = (Files::default(), String::new());
    for (name, failed) in &failed {
        let text = file::to_toml(&failed.scenario).map_err(Failure::input)?;
        files.stage(&output::place(&folder.join(name))?, &text)?;
        listing += &format!("{}  {name}\n", sha256(&text));
    }
    if !failed.is_empty() {
        files.stage(&path, &listing)?;
    }
    // Gone before the listing is: a run that is interrupted here leaves nothing that no listing knows.
    for (name, digest) in before.iter().filter(|(name, _)| !failed.contains_key(*name)) {
        let stale = folder.join(name);
        let is_as_written = || match disk::read(&stale, file::MOST_BYTES) {
            Ok(found) => found.is_some_and(|bytes| sha256(&bytes) == *digest),
            // Longer than any that was written.
            Err(_) => false,
        };
        if !stale.is_symlink() && is_as_written() {
            disk::remove(&[stale])?;
        }
    }
    if failed.is_empty() && !before.is_empty() {
        disk::remove(&[path])?;
    }
    files.commit()?;
    name_others(folder, &failed.keys().map(String::as_str).collect(), quiet)
}

/// What a listing says, if there is one: names of files, and their SHA-256.
fn listed(path: &Path) -> Result<BTreeMap<String, String>, Failure> {
    if !path.exists() {
        return Ok(BTreeMap::new());
    }
    let text = file::read(path)?;
    let entry = |(index, line): (usize, &str)| {
        // Names are those of scenarios, and lead nowhere else.
        let is_own = |name: &str| name.ends_with(".toml") && Path::new(name).file_name() == Some(name.as_ref());
        let found = line.split_once("  ").filter(|(digest, name)| digest.len() == 64 && is_own(name));
        found.map(|(digest, name)| (name.to_owned(), digest.to_owned())).ok_or_else(|| {
            let problem =
                "is no SHA-256 and the name of a file beside it, as `suite run` writes them: use another --out";
            Failure::Input(format!("{}:{}: {problem}", path.display(), index + 1))
        })
    };
    text.lines().enumerate().map(entry).collect()
}

/// Names the scenario files in a folder that are not of this run.
fn name_others(folder: &Path, own: &BTreeSet<&str>, quiet: bool) -> Result<(), Failure> {
    let entries = fs::read_dir(folder).map_err(DiskError::at(folder))?.flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let others: BTreeSet<String> =
        names.filter(|name| name.ends_with(".toml") && !own.contains(name.as_str())).collect();
    if let Some(first) = others.first() {
        let more = if others.len() > 1 { format!(" and {} more", others.len() - 1) } else { String::new() };
        output::note(&format!("note: {}: {first}{more}: not of this run, and left alone", folder.display()), quiet);
    }
    Ok(())
}
