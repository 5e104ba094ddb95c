//! `crumple avoid`: decides whether any driver could have avoided a collision.

use std::path::{Path, PathBuf};

use super::global_options::GlobalOptions;
use clap::Args;
use crumple_verify::Certificate;

use super::artifacts::ArtifactArgs;
use super::output;
use super::{CliError, args};
use crumple_search::worst_case::{
    AvoidError, AvoidOptions, AvoidReport, Avoidance, AvoidanceVerdict, UndecidedReason, avoid,
    certify,
};
use crumple_sim::scenario::Scenario;
use crumple_store::disk::StagedFiles;

/// Decide whether a collision was avoidable: find an escape, or prove that none exists
#[derive(Args)]
#[command(after_long_help = "\
The vehicles under test may accelerate and brake freely within their limits and know the future; all other vehicles \
keep their drivers. `avoidable` comes with an escape: accelerations, held over steps of --grid, whose replay has no \
collision at the scenario's step and at a tenth of it. The search looks for the escape with the largest smallest gap; \
a finer grid may find a larger one. Often, crumple also prints an upper bound of this gap, which no driver exceeds; \
--bound-certificate writes its proof, if there is one. `unavoidable` comes with a proof about every possible driver, \
which the checker of `crumple check` accepted. Every other result is `undecided`, with the reason.

The search and the proof solve convex programs. These model only a scripted leader, and a follower without lag that \
`baseline` drives (it holds its speed, and brakes to standstill once its emergency brake has fired). With any other \
driver (idm, acc-aeb, a policy, or `baseline` with lag), crumple simulates some thousands of acceleration profiles of \
the vehicles under test, with that driver in the loop, and the escape is the best of them, without a certificate. A \
proof of `unavoidable` then concerns the collision with a scripted leader alone.

At most 20 vehicles may be under test. Their number times the scenario's number of steps may be at most 50 000. An \
undecided problem of this size takes about two minutes.

Examples:
  crumple avoid paper-1
  crumple avoid paper-1 --out escape.toml --plot escape.svg
  crumple avoid my-scenario.toml --certificate proof.json --format json")]
pub(super) struct Avoid {
    /// Built-in scenario (see `crumple list scenarios`) or scenario file
    #[arg(value_name = "SCENARIO")]
    scenario: PathBuf,
    /// Hold the accelerations of an escape for S seconds, a multiple of the scenario's step; default about 0.1
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = args::number)]
    grid: Option<f64>,
    /// Write the certificate of the escape or of the proof, for `crumple check`; replaces an existing file
    #[arg(long, value_name = "F.json")]
    certificate: Option<PathBuf>,
    /// If there is an escape, and the printed upper bound of its smallest gap is `proved`, write a certificate of this
    /// bound; replaces an existing file
    #[arg(long, value_name = "F.json")]
    bound_certificate: Option<PathBuf>,
    #[command(flatten)]
    finding: ArtifactArgs,
}

impl Avoid {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let scenario = args::load_scenario(&self.scenario, controllers)?;
        let options = AvoidOptions {
            grid_s: self.grid,
            certify_bound: true,
            ..AvoidOptions::default()
        };
        let avoidance = avoid(&scenario, options).map_err(|error| match error {
            AvoidError::Grid { .. } => CliError::Input(format!("--grid: {error}")),
            other => CliError::at(&self.scenario, other),
        })?;
        if let AvoidanceVerdict::Undecided(reason @ UndecidedReason::Plant) = &avoidance.verdict {
            return Err(CliError::at(&self.scenario, reason));
        }
        let mut files = StagedFiles::default();
        self.stage_certificates(&scenario, &avoidance, &mut files)?;
        match avoidance.verdict.escape() {
            Some(escape) => {
                self.finding
                    .stage(&escape.scenario, "escape", &mut files, || {
                        args::replay(&escape.scenario)
                    })?;
            }
            None => self
                .finding
                .note_nothing_to_write("no escape was found, so there is nothing", quiet),
        }
        files.commit()?;
        let report = AvoidReport::new(&scenario, &avoidance);
        self.finding.print_report(&report, AvoidReport::to_text)
    }

    fn stage_certificates(
        &self,
        scenario: &Scenario,
        avoidance: &Avoidance,
        files: &mut StagedFiles,
    ) -> Result<(), CliError> {
        if let Some(path) = &self.certificate {
            let certificate =
                verdict_certificate(scenario, avoidance).map_err(|reason| reason.to_string());
            stage_certificate(path, certificate, files)?;
        }
        if let Some(path) = &self.bound_certificate {
            let certificate = avoidance
                .bound_certificate
                .as_deref()
                .cloned()
                .ok_or_else(|| "no upper bound on the gap of an escape was proved".to_owned());
            stage_certificate(path, certificate, files)?;
        }
        Ok(())
    }
}

fn verdict_certificate(
    scenario: &Scenario,
    avoidance: &Avoidance,
) -> Result<Certificate, UndecidedReason> {
    match &avoidance.verdict {
        AvoidanceVerdict::Avoidable(escape) => certify(scenario, escape),
        AvoidanceVerdict::Unavoidable(certificate) => Ok((**certificate).clone()),
        AvoidanceVerdict::Undecided(reason) => Err(reason.clone()),
    }
}

fn stage_certificate(
    path: &Path,
    certificate: Result<Certificate, String>,
    files: &mut StagedFiles,
) -> Result<(), CliError> {
    match certificate {
        Ok(certificate) => {
            let text = serde_json::to_string(&certificate).map_err(CliError::input)? + "\n";
            files.stage(&output::resolve_output_path(path)?, text)?;
        }
        // Shown with `--quiet` too: a requested file is missing.
        Err(reason) => output::note(
            &format!(
                "warning: crumple did not write {}, because there is no certificate: {reason}",
                path.display()
            ),
            false,
        ),
    }
    Ok(())
}
