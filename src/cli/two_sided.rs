//! `crumple verify two-sided`: certificates of two-sided shields.

use std::path::PathBuf;

use clap::Args;
use crumple_controllers::Controllers;
use crumple_evidence::{
    CertificateReport, NoTwoSidedCertificate, filter_certificate, initial_state_certificate,
    report_json,
};
use crumple_measure::describe_outside_class;
use crumple_sim::control::{AebSettings, BuiltInController, InvalidSetting, TwoSidedSettings};
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
checker simulates the plan with bounds for all leaders that brake at the level or less, and for all followers of the \
class. With --filter, the certificate covers the two-sided shield (`shield2:`) itself: the checker confirms the \
conditions of a theorem.

Exit code 1 if no plan is found. An actuator with lag is not covered.

Examples:
  crumple verify two-sided paper-1 --settings level=3
  crumple verify two-sided paper-1 --settings level=3,reacts=1 --filter
  crumple check two-sided.json")]
pub(super) struct TwoSidedCommand {
    /// Built-in scenario (see `crumple list scenarios`), or scenario file
    #[arg(value_name = "SCENARIO")]
    scenario: PathBuf,
    /// Settings of the level, the follower's class and errors of observation, as after `shield2`
    #[arg(
        long,
        value_name = "SETTINGS",
        default_value = "",
        hide_default_value = true
    )]
    #[arg(value_parser = parse_claim_settings)]
    settings: TwoSidedSettings,
    /// Certify the shield with the limits of the vehicle instead of a plan for the initial state
    #[arg(long)]
    filter: bool,
    /// File of the certificate; replaces an existing file
    #[arg(long, value_name = "F", default_value = "two-sided.json")]
    certificate: PathBuf,
    /// Output format: text, or a JSON object as in `crumple check`
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Parses settings of the follower's class, without a comma before the first, for the measurement of levels at the true
/// state.
pub(super) fn parse_class_settings(text: &str) -> Result<TwoSidedSettings, InvalidSetting> {
    let settings = parse_claim_settings(text)?;
    if settings.level_mps2.is_some() {
        return Err(InvalidSetting::NoEffect { name: "level" });
    }
    match name_of_error_setting(text) {
        Some(name) => Err(InvalidSetting::NoEffect { name }),
        None => Ok(settings),
    }
}

/// Parses settings of the level, the class and the errors, without a comma before the first, for a certificate.
fn parse_claim_settings(text: &str) -> Result<TwoSidedSettings, InvalidSetting> {
    let comma = if text.is_empty() { "" } else { "," };
    let settings = TwoSidedSettings::parse(&format!("{comma}{text}"))?;
    if settings.raises {
        return Err(InvalidSetting::NoEffect { name: "raise" });
    }
    Ok(settings)
}

/// Returns the first setting of an error of observation.
fn name_of_error_setting(text: &str) -> Option<&'static str> {
    let names = TwoSidedSettings::ERROR_NAMES;
    let given = text
        .split(',')
        .filter_map(|setting| setting.split('=').next());
    given
        .flat_map(|given| names.into_iter().find(|name| *name == given))
        .next()
}

impl TwoSidedCommand {
    /// Notes that the certificate does not cover the driver of the scenario's own follower.
    fn note_driver_outside_class(&self, run: &Run, vehicle: usize, quiet: bool) {
        let params = run.two_sided_shield(vehicle, &self.settings);
        let class = params.ok().and_then(|params| params.follower);
        let driver = class.and_then(|class| run.driver_outside_class(vehicle, &class));
        if let Some(driver) = driver {
            output::note(&describe_outside_class(vehicle + 1, driver), quiet);
        }
    }

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
        self.note_driver_outside_class(&run, vehicle, global.quiet);
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
        let report = CertificateReport::new(path, &certificate, Controllers::default());
        let verdict = accepted_line(&report)?;
        match self.format {
            OutputFormat::Json => output::print(&report_json(&[report]).map_err(CliError::input)?),
            OutputFormat::Text => output::print_coloured(OutputFormat::Text, &verdict),
        }
    }
}
