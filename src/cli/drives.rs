//! Recorded drives as a domain, for `verify rate --drives` and `falsify --drives`.

use std::path::Path;

use super::output_format::OutputFormat;
use super::{CliError, args, output, progress};
use crumple_controllers::Controllers;
use crumple_evidence::drives::{DriveSet, DriveSetError};
use crumple_evidence::{DriveReport, DriveSearch};
use crumple_sim::engine::{NamedController, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::file;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};

/// File that lists the files of a search on drives.
const LISTING_FILE: &str = "drives.sha256";

/// A controller on the drives of a folder.
pub(super) struct DriveCommand<'a> {
    pub(super) folder: &'a Path,
    pub(super) controller: NamedController,
    pub(super) estimator: EstimatorKind,
    pub(super) format: OutputFormat,
    pub(super) quiet: bool,
}

/// Loads the folder of `--drives`.
pub(super) fn load_drives(folder: &Path, controllers: Controllers) -> Result<DriveSet, CliError> {
    DriveSet::load(folder, &controllers).map_err(|error| match error {
        DriveSetError::File(error) => error.into(),
        other => CliError::about("--drives", other),
    })
}

impl DriveCommand<'_> {
    fn options(&self) -> RunOptions {
        RunOptions::new(self.controller.source.clone()).with_estimator(self.estimator)
    }

    /// Counts failures, with their rates.
    pub(super) fn count(&self, controllers: Controllers) -> Result<(), CliError> {
        let drives = load_drives(self.folder, controllers)?;
        let bar = progress::run_bar("driving", drives.max_run_count(), self.quiet);
        let runs = progress::show(&bar, |observer| drives.run(&self.options(), observer));
        let report = DriveReport::new(
            &self.controller.name,
            &runs.map_err(CliError::input)?,
            &drives,
        );
        args::ensure_trusted()?;
        output::print_result(self.format, &report, || report.to_text())
    }

    /// Searches for failures, and writes the failed drives and the report to a folder.
    pub(super) fn search(
        &self,
        controllers: Controllers,
        spec: &str,
        out: &Path,
    ) -> Result<DriveSearch, CliError> {
        let drives = load_drives(self.folder, controllers)?;
        let specification = DriveSearch::parse_specification(spec, &drives)
            .map_err(|error| CliError::about("--spec", error))?;
        args::note_warning(&specification, self.quiet);
        let folder = OutputFolder::with_listing(out, LISTING_FILE)?;
        let bar = progress::run_bar("driving", drives.max_run_count(), self.quiet);
        let subject = (self.controller.name.as_str(), self.options());
        let report = progress::show(&bar, |observer| {
            DriveSearch::run(&drives, subject, (spec, &specification), observer)
        });
        let report = report.map_err(CliError::input)?;
        args::ensure_trusted()?;
        folder.write(&files(&report, &drives)?, EarlierFiles::Replace)?;
        output::note(
            &format!("wrote {} (drives.json, failed drives)", out.display()),
            self.quiet,
        );
        Ok(report)
    }
}

/// Returns the report and the failed drives, with their names in the folder.
fn files(report: &DriveSearch, drives: &DriveSet) -> Result<Vec<(String, Vec<u8>)>, CliError> {
    let json = serde_json::to_string_pretty(report).map_err(CliError::input)? + "\n";
    let mut files = vec![("drives.json".to_owned(), json.into_bytes())];
    for (failure, number) in report.failures.iter().zip(1..) {
        let Some(drive) = drives.drives().get(failure.index) else {
            continue;
        };
        let text = file::to_toml(&drive.scenario).map_err(CliError::input)?;
        let stem = drive.path.file_stem().unwrap_or_default();
        let name = format!(
            "counterexamples/{number:03}-{}.toml",
            stem.to_string_lossy()
        );
        files.push((name, text.into_bytes()));
    }
    Ok(files)
}
