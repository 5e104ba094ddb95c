//! Output of `avoid` and `worst-case`: the scenario file, the plot and the report.

use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::CliError;
use super::output;
use super::output_format::OutputFormat;
use super::simulate;
use crumple_sim::engine::SimulationResult;
use crumple_sim::scenario::{Scenario, file};
use crumple_store::disk::StagedFiles;

/// Output options.
#[derive(Args)]
pub(super) struct ArtifactArgs {
    /// Write the scenario with the escape (`avoid`), or with the braking or fault that was found (`worst-case`), for
    /// `crumple simulate`; replaces an existing file
    #[arg(long, value_name = "F.toml")]
    out: Option<PathBuf>,
    /// Plot the same scenario; replaces an existing file
    #[arg(
        long,
        value_name = "F.svg|F.png",
        value_parser = simulate::path_ending_in(["svg", "png"])
    )]
    plot: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl ArtifactArgs {
    /// Stages the requested files: the scenario, and a plot of the result of `replay`.
    pub(super) fn stage(
        &self,
        scenario: &Scenario,
        driver: &str,
        files: &mut StagedFiles,
        replay: impl FnOnce() -> Result<SimulationResult, CliError>,
    ) -> Result<(), CliError> {
        if let Some(path) = &self.out {
            let text = file::to_toml(scenario).map_err(CliError::input)?;
            files.stage(&output::resolve_output_path(path)?, text.as_bytes())?;
        }
        if let Some(path) = &self.plot {
            let run = replay()?;
            if let Some(trace) = &run.trace {
                let figure =
                    simulate::render_motion_figure(path, scenario, driver, trace, &run.impacts)?;
                files.stage(&output::resolve_output_path(path)?, &figure)?;
            }
        }
        Ok(())
    }

    /// Notes that there is nothing to write, if a file was requested.
    pub(super) fn note_nothing_to_write(&self, why: &str, quiet: bool) {
        if self.out.is_some() || self.plot.is_some() {
            output::note(&format!("note: {why} to write or plot"), quiet);
        }
    }

    pub(super) fn print_report<R: Serialize>(
        &self,
        report: &R,
        describe: impl FnOnce(&R) -> String,
    ) -> Result<(), CliError> {
        output::print_result(self.format, report, || describe(report))
    }
}
