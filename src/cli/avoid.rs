//! `crumple avoid`: decides whether any driver could have avoided a collision.

use std::fmt::Write;
use std::path::{Path, PathBuf};

use super::global_options::GlobalOptions;
use clap::Args;
use crumple_verify::Certificate;
use serde::Serialize;

use super::artifacts::ArtifactArgs;
use super::output;
use super::{CliError, args};
use crumple_core::quoting::TerminalText;
use crumple_search::confirmation::escape_survives;
use crumple_search::worst_case::{
    AvoidError, AvoidOptions, Avoidance, AvoidanceVerdict, EmergencyBrake, Escape, FoundBy,
    Optimality, UndecidedReason, avoid, certify,
};
use crumple_store::disk::StagedFiles;
use crumple_world::scenario::Scenario;

/// Decide whether a collision was avoidable: find an escape, or prove that none exists
#[derive(Args)]
#[command(after_long_help = "\
The vehicles under test may accelerate and brake freely within their limits and know the future; all other vehicles \
keep their drivers. `avoidable` comes with accelerations, held over steps of --grid, whose replay has no collision \
at the scenario's step and at a tenth of it. The smallest gap is the largest that the search found; a finer grid may \
find a larger one. A separate certificate states that no driver keeps more than the bound. `unavoidable` comes with \
a proof about every possible driver, which the checker of `crumple check` accepted. Every other result is \
`undecided`, with the reason.

Convex programs model a scripted leader and a latched emergency brake behind. If another vehicle has another driver \
(idm, acc-aeb, a policy), crumple simulates some thousands of profiles with that driver in the loop and shows the \
best one.

At most 20 vehicles may be under test, with at most 50 000 vehicles times steps; the largest undecided problem takes \
about two minutes.

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
    /// Write a certificate that no driver keeps a larger gap than the bound, if there is an escape; replaces an
    /// existing file
    #[arg(long, value_name = "F.json")]
    bound_certificate: Option<PathBuf>,
    #[command(flatten)]
    finding: ArtifactArgs,
}

/// Optimality of an escape of the programs.
const LARGEST_GAP: &str = "the largest smallest gap found on this grid, over all trigger times of \
    the follower's emergency brake";

#[derive(Serialize)]
struct AvoidReport<'a> {
    scenario: &'a str,
    verdict: &'static str,
    best_min_gap_m: Option<f64>,
    escape_min_gap_m: Option<f64>,
    min_gap_bound_m: Option<f64>,
    min_gap_bound_is_certified: bool,
    /// Reason why no driver keeps a larger gap: `bound` or `initial-gap`; `best-found` if that is not shown.
    optimality: Option<&'static str>,
    trigger_time_s: Option<f64>,
    /// True if the follower's emergency brake fires in the replay; `None` if a driver behind is unknown.
    emergency_brake_fires: Option<bool>,
    effort_m2ps3: Option<f64>,
    escape_is_best_for: Option<String>,
    /// `programs`, or `closed-loop` if the programs do not model every driver.
    escape_found_by: Option<&'static str>,
    programs: usize,
    simulations: usize,
    /// True if the escape has no collision with the multi-body plant either.
    escape_survives_multi_body: Option<bool>,
    reason: Option<&'a UndecidedReason>,
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
        self.finding
            .print_report(&report(&scenario, &avoidance), describe)
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
            let none = || "no upper bound on the gap of an escape was proved".to_owned();
            stage_certificate(
                path,
                avoidance
                    .bound_certificate
                    .as_deref()
                    .cloned()
                    .ok_or_else(none),
                files,
            )?;
        }
        Ok(())
    }
}

fn report<'a>(scenario: &'a Scenario, avoidance: &'a Avoidance) -> AvoidReport<'a> {
    let escape = avoidance.verdict.escape();
    let reason = match &avoidance.verdict {
        AvoidanceVerdict::Undecided(reason) => Some(reason),
        AvoidanceVerdict::Avoidable(_) | AvoidanceVerdict::Unavoidable(_) => None,
    };
    AvoidReport {
        scenario: &scenario.spec().name,
        verdict: avoidance.verdict.name(),
        best_min_gap_m: avoidance.best_min_gap_m,
        escape_min_gap_m: escape.map(|escape| escape.min_gap_m),
        min_gap_bound_m: avoidance.min_gap_bound_m,
        min_gap_bound_is_certified: avoidance.bound_certificate.is_some(),
        optimality: escape.map(|_| avoidance.optimality.name()),
        trigger_time_s: escape.and_then(Escape::trigger_time_s),
        emergency_brake_fires: escape.and_then(|escape| match escape.emergency_brake {
            EmergencyBrake::Fires { .. } => Some(true),
            EmergencyBrake::NeverFires => Some(false),
            _ => None,
        }),
        effort_m2ps3: escape.map(Escape::effort_m2ps3),
        escape_is_best_for: escape.map(|escape| match escape.found_by {
            FoundBy::Programs => LARGEST_GAP.to_owned(),
            FoundBy::ClosedLoop { simulations } => format!(
                "the largest smallest gap with the drivers of all other vehicles in the loop, best of \
                     {simulations} simulated profiles"
            ),
        }),
        escape_found_by: escape.map(|escape| escape.found_by.name()),
        programs: avoidance.programs,
        simulations: escape.map_or(0, |escape| match escape.found_by {
            FoundBy::Programs => 0,
            FoundBy::ClosedLoop { simulations } => simulations,
        }),
        escape_survives_multi_body: escape.and_then(|escape| escape_survives(scenario, &escape.acceleration_mps2)),
        reason,
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

fn describe(report: &AvoidReport<'_>) -> String {
    let AvoidReport {
        scenario,
        verdict,
        escape_min_gap_m,
        min_gap_bound_m,
        programs,
        reason,
        ..
    } = report;
    let mut text = format!("{}: {verdict}\n", TerminalText(scenario));
    if let Some(gap_m) = escape_min_gap_m {
        let optimality = match report.optimality {
            Some(name) if name == Optimality::BestFound.name() => ", best found",
            Some(name) if name == Optimality::InitialGap.name() => {
                ", optimal: equals the initial gap"
            }
            _ => ", optimal: equals the bound",
        };
        let _ = writeln!(
            text,
            "  smallest gap of the escape {:.2} m{optimality}",
            (100.0 * gap_m).floor() / 100.0
        );
    }
    if let Some(bound_m) = min_gap_bound_m {
        let _ = writeln!(
            text,
            "  no driver keeps more than {:.2} m, {}",
            (100.0 * bound_m).ceil() / 100.0,
            if report.min_gap_bound_is_certified {
                "proved"
            } else {
                "computed, without a certificate"
            }
        );
    }
    match (report.trigger_time_s, report.emergency_brake_fires) {
        (Some(time_s), _) => {
            let _ = writeln!(
                text,
                "  the follower's emergency brake fires at {time_s:.2} s"
            );
        }
        (None, Some(false)) => text.push_str("  no emergency brake behind fires\n"),
        (None, _) => {}
    }
    if let (Some(best_for), Some(effort)) = (&report.escape_is_best_for, report.effort_m2ps3) {
        let _ = writeln!(text, "  ∫a² of the escape {effort:.1} m²/s³: {best_for}");
    }
    if let Some(survives) = report.escape_survives_multi_body {
        let replay = if survives {
            "no collision either"
        } else {
            "a COLLISION: it depends on the point mass"
        };
        let _ = writeln!(
            text,
            "  with the multi-body plant, this escape has {replay}"
        );
    }
    if let Some(reason) = reason {
        let _ = writeln!(text, "  {reason}");
    }
    let _ = writeln!(text, "  {programs} convex programs");
    text
}
