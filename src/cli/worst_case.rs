//! `crumple worst-case`: finds the mildest braking of the leader that makes a controller collide.

use std::fmt::Write;

use clap::{Args, value_parser};
use serde::Serialize;

use super::artifacts::ArtifactArgs;
use super::{CliError, args, value_enums};
use crumple_core::observer::Quiet;
use crumple_core::quoting::TerminalText;
use crumple_search::worst_case::{AttackError, AttackMethod, AttackObjective, AttackReport, Envelope, attack};
use crumple_store::disk::StagedFiles;
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::{NamedController, Outcome, RecordingLevel, Run, RunOptions, simulate};

/// Find the mildest braking of the leader that causes a collision, or the worst impact
#[derive(Args)]
#[command(after_long_help = "\
The attack replaces the leader's script: braking only, within --max-brake and --jerk. For the baseline that observes \
the true state, without noise, the answer is exact on a grid of 0.1 s, by enumeration of the times at which its \
brake fires; with the filter, that profile is widened until it collides. For any other controller the result is the \
best profile found: crumple simulates pulses and ramps and improves the best of them by sequential convex \
programming along rollouts. crumple simulates the profile before it reports it, with the prediction of the last \
program.

--budget ends the search between its rounds of about 30 simulations each. The exact method always makes one \
simulation for each step of the scenario and one for each part of the enumeration (at most 1500). The other method \
always scans pulses and ramps (40 for a budget below 400, 112 below 2000, otherwise 864) and, if one collides, makes \
at most 144 simulations to find milder ones. If the budget is exceeded, the output says so.

A margin is the smallest gap or, after a collision at v m/s, minus v²/10. A scenario may have 500 000 vehicles times \
steps, and all simulations together 20 000 million, which takes some minutes.

Examples:
  crumple worst-case paper-1 --controller baseline
  crumple worst-case paper-1 --controller policy --out worst.toml --plot worst.svg
  crumple worst-case paper-2 --controller idm --aim severest --max-brake 6 --format json")]
pub(super) struct WorstCase {
    /// Built-in scenario (see `crumple list scenarios`) or scenario file
    #[arg(value_name = "SCENARIO")]
    scenario: String,
    /// Controller of the vehicles under test (see `crumple list controllers`), with settings as in `acc-aeb,ttc_s=2.0`,
    /// a policy file, a network (F.onnx, F.zip of Stable-Baselines3), a controller file (F.toml), or a command after
    /// `exec:`
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Objective: least ∫a², least peak, or the fastest impact
    #[arg(long, value_name = "AIM", default_value = "mildest", value_parser = value_enums::one_of(value_enums::AIMS))]
    aim: AttackObjective,
    /// Maximum braking of the leader in m/s² [default: its limit on this road]
    #[arg(long, value_name = "A", allow_negative_numbers = true)]
    max_brake: Option<f64>,
    /// Maximum jerk of the leader in m/s³
    #[arg(long, value_name = "J", default_value_t = Envelope::DEFAULT_JERK_MPS3, allow_negative_numbers = true)]
    jerk: f64,
    /// Maximum number of simulations, 1 to 10 000 000, except for those that are always made (see below)
    #[arg(long, value_name = "N", default_value_t = 3000, value_parser = value_parser!(u32).range(1..=10_000_000))]
    budget: u32,
    #[command(flatten)]
    finding: ArtifactArgs,
}

impl WorstCase {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        if self.jerk.is_nan() || self.jerk <= 0.0 {
            return Err(CliError::Input(format!("--jerk: must be above 0, found {}", self.jerk)));
        }
        let scenario = args::load_scenario(&self.scenario)?;
        let envelope = Envelope {
            max_brake_mps2: self.max_brake.unwrap_or(Envelope::from_scenario(&scenario).max_brake_mps2),
            jerk_mps3: self.jerk,
        };
        let options = RunOptions::new(self.controller.kind.clone()).with_estimator(self.estimator);
        let result = attack(&scenario, &options, self.aim, envelope, self.budget as usize, &Quiet);
        let result = result.map_err(|error| {
            let place = match error {
                AttackError::EmptyEnvelope { .. } => "--max-brake",
                AttackError::TooManySimulations { .. } => "--budget",
                _ => &self.scenario,
            };
            CliError::Input(format!("{place}: {error}"))
        })?;
        self.controller.ensure_trusted()?;
        let mut files = StagedFiles::default();
        match &result.attack {
            Some(attack) => {
                let replay = || Ok(simulate(&Run::new(&attack.scenario, options)?, RecordingLevel::Trace));
                self.finding.stage(&attack.scenario, &self.controller.name, &mut files, replay)?;
            }
            None => self.finding.note_nothing_to_write("no collision was found, so there is nothing", quiet),
        }
        files.commit()?;
        let name = &scenario.spec().name;
        let report = AttackReport::new(name, &self.controller, self.estimator, self.aim, &result);
        let is_over_budget = report.evaluations > self.budget as usize;
        let over_budget_because = is_over_budget.then_some(OVER_BUDGET_REASON);
        self.finding.print_report(
            &WorstCaseReport { report, budget: self.budget, is_over_budget, over_budget_because },
            describe,
        )
    }
}

const OVER_BUDGET_REASON: &str = "the method completes its round and always runs its first and last simulations";

#[derive(Serialize)]
struct WorstCaseReport {
    #[serde(flatten)]
    report: AttackReport,
    budget: u32,
    is_over_budget: bool,
    over_budget_because: Option<&'static str>,
}

fn describe(hunted: &WorstCaseReport) -> String {
    let mut text = describe_report(&hunted.report);
    if let Some(why) = hunted.over_budget_because {
        let _ = writeln!(text, "  more simulations than --budget {}: {why}", hunted.budget);
    }
    text
}

fn describe_report(report: &AttackReport) -> String {
    let AttackReport { scenario, controller, estimator, aim, .. } = report;
    let mut text = format!("{}: {}, estimator {estimator}, {aim}\n", TerminalText(scenario), TerminalText(controller));
    if report.nondeterministic {
        text += "  the controller declares that it is not deterministic: another attack may give another result\n";
    }
    let (Some(effort), Some(peak)) = (report.effort_m2ps3, report.peak_brake_mps2) else {
        let AttackReport { evaluations, programs, .. } = report;
        return text + &format!("  no collision found in {evaluations} simulations and {programs} convex programs\n");
    };
    if let Some(Outcome::ControllerFailed(failed)) = &report.outcome {
        let _ = writeln!(text, "  CONTROLLER FAILED and gave no valid command: {failed}");
    }
    if let Some(Outcome::Collision(contact)) = &report.outcome {
        let _ = writeln!(
            text,
            "  COLLISION at {:.2} s: vehicle {} hits vehicle {} at {:.1} m/s",
            contact.time_s, contact.rear_vehicle, contact.front_vehicle, contact.impact_speed_mps
        );
    }
    let _ = writeln!(text, "  braking of the leader: ∫a² {effort:.3} m²/s³, peak {peak:.2} m/s²");
    if let (Some(predicted), Some(margin)) = (report.predicted_margin_m, report.margin_m) {
        let _ = writeln!(text, "  margin {margin:.3} m; the last program predicted {predicted:.3} m");
    }
    let AttackReport { evaluations, programs, .. } = report;
    let Some(method) = report.method else {
        let _ = writeln!(text, "  found in {evaluations} simulations and {programs} convex programs");
        return text;
    };
    let method = match method {
        AttackMethod::Exact => "exact on this grid",
        AttackMethod::Widened => {
            "best found, close to the optimum on this grid; the noise and the filter are not exact"
        }
        AttackMethod::Sequential => "best found",
    };
    let _ = writeln!(text, "  {method}; {evaluations} simulations, {programs} convex programs");
    text
}
