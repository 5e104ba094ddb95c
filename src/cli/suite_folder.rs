//! Folder of the scenarios that failed in the last run of a suite.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::{CliError, output};
use crumple_sim::scenario::file;
use crumple_store::disk::DiskError;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};
use crumple_suites::{ControllerResult, SuiteResult};

/// Opens the folder, and reads the listing of an earlier run. Its extension keeps it from being read as a scenario.
pub(super) fn open(folder: &Path) -> Result<OutputFolder, CliError> {
    Ok(OutputFolder::with_listing(folder, "failures.sha256")?)
}

/// Writes the scenario of every failed point once, replaces those of the previous run, and lists the files that stay.
pub(super) fn write(result: &SuiteResult, folder: &Path, quiet: bool) -> Result<(), CliError> {
    let tested = result.tests().flat_map(|(_, test)| &test.controllers);
    let failed = tested
        .flat_map(ControllerResult::failures)
        .filter_map(|point| Some((point, point.scenario.as_ref()?)))
        .map(|(point, scenario)| {
            let text = file::to_toml(scenario).map_err(CliError::input)?;
            Ok((format!("{}.toml", point.scenario_name), text.into_bytes()))
        })
        .collect::<Result<BTreeMap<_, _>, CliError>>()?;
    let failed: Vec<_> = failed.into_iter().collect();
    open(folder)?.write(&failed, EarlierFiles::Replace)?;
    note_other_files(
        folder,
        &failed.iter().map(|(name, _)| name.as_str()).collect(),
        quiet,
    )
}

/// Notes the scenario files in a folder that are not of this run.
fn note_other_files(folder: &Path, own: &BTreeSet<&str>, quiet: bool) -> Result<(), CliError> {
    let entries = fs::read_dir(folder)
        .map_err(DiskError::at(folder))?
        .flatten();
    let names = entries.map(|entry| entry.file_name().to_string_lossy().into_owned());
    let others: BTreeSet<String> = names
        .filter(|name| name.ends_with(".toml") && !own.contains(name.as_str()))
        .collect();
    if let Some(first) = others.first() {
        let more = if others.len() > 1 {
            format!(" and {} more", others.len() - 1)
        } else {
            String::new()
        };
        output::note(
            &format!(
                "note: {}: {first}{more}: not written by this run, and unchanged",
                folder.display()
            ),
            quiet,
        );
    }
    Ok(())
}
