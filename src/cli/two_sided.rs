//! `crumple verify two-sided`: certificates of two-sided shields.

use std::path::PathBuf;

use clap::Args;
use crumple_controllers::Controllers;
use crumple_evidence::{
    CertificateReport, NoTwoSidedCertificate, ScenarioFollower, filter_certificate,
    initial_state_certificate, report_json,
};
use crumple_sim::control::{AebSettings, BuiltInController, TwoSidedSettings};
use crumple_sim::engine::{Run, RunOptions};
use crumple_sim::observation::EstimatorKind;
use crumple_store::disk::StagedFiles;

use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::verify::accepted_line;
use super::{CliError, args, output};

/// Certify that a vehicle avoids its leader and is not hit by its follower
#[derive(Args)]
#[command(after_long_help = "\
The certificate states the class of followers that it covers, how hard the leader may brake (the level), the true \
initial state of the first vehicle under test, and a plan of its commands. It says nothing about other followers. The \
checker follows the plan to standstill. At each step it bounds the motions of all leaders that brake at the level or \
less, and of all followers of the class. With --filter, the certificate covers the two-sided shield (`shield2:`) \
itself: the checker confirms the conditions of a theorem.

Exit code 1 if no plan is found. An actuator with lag is not covered.

Examples:
  crumple verify two-sided paper-1 --settings level=3
  crumple verify two-sided paper-1 --settings level=3,reacts=1 --filter
  crumple check two-sided.json")]
pub(super) struct TwoSidedCommand {
    /// Built-in scenario (see `crumple list scenarios`), or scenario file
    #[arg(value_name = "SCENARIO")]
    scenario: PathBuf,
    /// Level, class of followers and errors of observation, as the settings of `shield2` (docs/controllers.md), such as
    /// level=3,reacts=1
    #[arg(
        long,
        value_name = "SETTINGS",
        default_value = "",
        hide_default_value = true
    )]
    #[arg(value_parser = TwoSidedSettings::parse_for_certificate)]
    settings: TwoSidedSettings,
    /// Certify the two-sided shield itself, for the limits of this vehicle; without this option, crumple certifies a
    /// plan from the initial state
    #[arg(long)]
    filter: bool,
    /// File of the certificate; replaces an existing file
    #[arg(long, value_name = "F", default_value = "two-sided.json")]
    certificate: PathBuf,
    /// Output format: text, or a JSON object as in `crumple check`
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl TwoSidedCommand {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let scenario = args::load_scenario(&self.scenario, global.controllers)?;
        let at_scenario = |problem: &dyn std::fmt::Display| CliError::at(&self.scenario, problem);
        let vehicles = scenario.vehicles().len();
        let vehicle = (0..vehicles)
            .find(|&vehicle| scenario.is_under_test(vehicle))
            .ok_or_else(|| at_scenario(&"no vehicle is under test"))?;
        // The claim is about the initial state: the controller has no effect.
        let controller = BuiltInController::Baseline(AebSettings::default());
        let options = RunOptions::new(controller).with_estimator(EstimatorKind::Truth);
        let run = Run::new(&scenario, options).map_err(|error| at_scenario(&error))?;
        let follower = ScenarioFollower::of_vehicle(&run, vehicle, &self.settings);
        if let Some(note) = follower
            .as_ref()
            .and_then(|follower| follower.note(vehicle + 1))
        {
            output::note(&note, global.quiet);
        }
        let certificate = if self.filter {
            run.two_sided_shield(vehicle, &self.settings)
                .map_err(NoTwoSidedCertificate::from)
                .and_then(|params| filter_certificate(&params))
        } else {
            initial_state_certificate(&run, vehicle, &self.settings)
        };
        let certificate = certificate.map_err(|reason| match reason {
            NoTwoSidedCertificate::NoPlan { .. } | NoTwoSidedCertificate::Rejected(_) => {
                CliError::Unmet(format!("{}: {reason}", self.scenario.display()))
            }
            other => at_scenario(&other),
        })?;
        let mut files = StagedFiles::default();
        let text = serde_json::to_string(&certificate).map_err(CliError::input)? + "\n";
        files.stage(&output::resolve_output_path(&self.certificate)?, text)?;
        files.commit()?;
        let path = self.certificate.display().to_string();
        let report = CertificateReport::new(path, &certificate, Controllers::default())
            .with_follower(follower);
        let verdict = accepted_line(&report)?;
        match self.format {
            OutputFormat::Json => output::print(&report_json(&[report]).map_err(CliError::input)?),
            OutputFormat::Text => output::print_coloured(OutputFormat::Text, &verdict),
        }
    }
}
