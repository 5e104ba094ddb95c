//! `crumple worst-case`: finds the mildest braking of the leader, or the mildest sensor fault, that makes a controller
//! fail.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::artifacts::ArtifactArgs;
use super::global_options::GlobalOptions;
use super::{CliError, args, progress, value_enums};
use crumple_core::observer::Quiet;
use crumple_search::worst_case::{
    AttackError, AttackObjective, AttackReport, Envelope, MAX_SIMULATIONS, SensorAttackReport,
    attack, attack_sensors, max_sensor_simulations,
};
use crumple_sim::engine::{NamedController, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_store::disk::StagedFiles;

/// Find the mildest braking of the leader, or sensor fault, that makes a controller fail
#[derive(Args)]
#[command(after_long_help = "\
The attack replaces the leader's script: the leader only brakes, within --max-brake and --jerk. The result is the best \
profile that the search finds, in steps of 0.1 s. crumple simulates pulses and ramps, and improves the best of them by \
sequential convex programming along simulated runs. It simulates the result, and prints its margin and the one that \
the last convex program predicted.

--budget ends the search between its rounds of about 30 simulations each. The search always scans pulses and ramps (40 \
for a budget below 400, 112 below 2000, otherwise 864) and, if one collides, makes at most 384 simulations to find \
milder ones. The output states if the budget was exceeded.

--attack sensors searches for the mildest sensor fault instead, with at most 18 581 simulations and without --budget. \
For each kind of fault, crumple simulates sizes from the mildest to a limit, which the output states: the sensor range \
from 199.9 m downwards, other sizes from 0.01 m or 0.01 s (latency: 0.002 s) upwards. It stops earlier if it has found \
both a size that causes a collision and a size that causes unnecessary braking. The latter counts even if the \
controller brakes only because of a vehicle behind. Between each size found, even if only one, and the size before it, \
crumple then simulates nine more. The fault `ghost`, an object that does not exist, is simulated at each of 8 \
instants, 3 gaps and 2 speeds. A printed size causes the failure when it is simulated; a smaller one between the \
simulated sizes may exist. To compare kinds, crumple divides a size by the limit of its kind (for the range: the loss \
of range by the largest loss). The fault with the smallest quotient is the mildest. --out writes the scenario with the \
mildest fault that causes a collision, or else unnecessary braking.

The printed margin is the smallest gap in metres. After a collision with an impact speed of v m/s, it is -v²/10. A \
scenario may have 500 000 vehicle steps, and all simulations together 20 000 million, which takes some minutes.

Examples:
  crumple worst-case paper-1 --controller baseline
  crumple worst-case paper-1 --controller policy --out worst.toml --plot worst.svg
  crumple worst-case paper-2 --controller idm --aim severest --max-brake 6 --format json
  crumple worst-case paper-1 --controller policy --attack sensors")]
pub(super) struct WorstCase {
    /// Built-in scenario (see `crumple list scenarios`) or scenario file
    #[arg(value_name = "SCENARIO")]
    scenario: PathBuf,
    /// Controller of the vehicles under test (see `crumple list controllers`), with settings as in `acc-aeb,ttc_s=2.0`,
    /// a policy file, a network (F.onnx, F.zip of Stable-Baselines3), an FMU (F.fmu), a controller file (F.toml), or a
    /// command after `exec:`
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Part of the scenario that the attack varies
    #[arg(long, value_enum, value_name = "ATTACK", default_value = "braking")]
    attack: AttackKind,
    /// Objective: least ∫a², least peak, or the fastest impact [default: mildest]
    #[arg(long, value_name = "AIM", value_parser = value_enums::one_of(value_enums::AIMS))]
    aim: Option<AttackObjective>,
    /// Maximum braking of the leader in m/s² [default: its limit on this road]
    #[arg(long, value_name = "A", allow_negative_numbers = true, value_parser = args::number)]
    max_brake: Option<f64>,
    /// Maximum jerk of the leader in m/s³ [default: 10]
    #[arg(long, value_name = "J", allow_negative_numbers = true, value_parser = args::number)]
    jerk: Option<f64>,
    /// Maximum number of simulations, 1 to 10 000 000, except for those that are always made (see below) [default:
    /// 3000]
    #[arg(long, value_name = "N", value_parser = args::whole_number::<u32>(1..=u64::from(MAX_SIMULATIONS)))]
    budget: Option<u32>,
    #[command(flatten)]
    finding: ArtifactArgs,
}

/// Object of an attack.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum AttackKind {
    /// The braking of the leader
    Braking,
    /// Faults of the gap sensors
    Sensors,
}

const DEFAULT_BUDGET: u32 = 3000;

impl WorstCase {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        match self.attack {
            AttackKind::Braking => self.attack_by_braking(global),
            AttackKind::Sensors => self.attack_sensors(global),
        }
    }

    fn attack_sensors(&self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        self.check_options_of_sensors()?;
        let scenario = args::load_scenario(&self.scenario, controllers)?;
        if !scenario.has_vehicle_under_test() {
            return Err(CliError::at(&self.scenario, "no vehicle is under test"));
        }
        let options =
            RunOptions::new(self.controller.source.clone()).with_estimator(self.estimator);
        let bar = progress::run_bar("searching", max_sensor_simulations(), quiet);
        let result = progress::show(&bar, |observer| {
            attack_sensors(&scenario, &options, observer)
        })
        .map_err(|error| CliError::at(&self.scenario, error))?;
        self.controller.ensure_trusted()?;
        let name = &scenario.spec().name;
        let report = SensorAttackReport::new(name, &self.controller.name, &result);
        match report.mildest() {
            Some(fault) => {
                let faulty = scenario.edited(|spec| {
                    spec.name =
                        format!("{}-fault", spec.name.chars().take(190).collect::<String>());
                    spec.sensors.faults = fault.faults.clone();
                });
                self.write_finding(&faulty.map_err(CliError::input)?, options)?;
            }
            None => self
                .finding
                .note_nothing_to_write("no fault was found, so there is nothing", quiet),
        }
        self.finding
            .print_report(&report, SensorAttackReport::to_text)
    }

    /// Refuses options that do not apply to an attack on the sensors.
    fn check_options_of_sensors(&self) -> Result<(), CliError> {
        let given = [
            ("--aim", self.aim.is_some()),
            ("--max-brake", self.max_brake.is_some()),
            ("--jerk", self.jerk.is_some()),
            ("--budget", self.budget.is_some()),
        ];
        if let Some((option, _)) = given.iter().find(|(_, is_given)| *is_given) {
            return Err(CliError::Input(format!(
                "{option}: belongs to `--attack braking`, not to `sensors`"
            )));
        }
        if self.estimator == EstimatorKind::Truth {
            return Err(CliError::Input(
                "--estimator: `truth` ignores faults of sensors, so use `kalman`".to_owned(),
            ));
        }
        Ok(())
    }

    /// Writes the files of a scenario that the attack found.
    fn write_finding(&self, scenario: &Scenario, options: RunOptions) -> Result<(), CliError> {
        let mut files = StagedFiles::default();
        self.finding
            .stage(scenario, &self.controller.name, &mut files, || {
                Ok(simulate(
                    &Run::new(scenario, options)?,
                    RecordingLevel::Trace,
                ))
            })?;
        Ok(files.commit()?)
    }

    fn attack_by_braking(&self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let jerk_mps3 = self.jerk.unwrap_or(Envelope::DEFAULT_JERK_MPS3);
        if jerk_mps3.is_nan() || jerk_mps3 <= 0.0 {
            return Err(CliError::Input(format!(
                "--jerk: must be above 0, found {jerk_mps3}"
            )));
        }
        let aim = self.aim.unwrap_or(AttackObjective::Mildest);
        let budget = self.budget.unwrap_or(DEFAULT_BUDGET) as usize;
        let scenario = args::load_scenario(&self.scenario, controllers)?;
        let envelope = Envelope {
            max_brake_mps2: self
                .max_brake
                .unwrap_or(Envelope::from_scenario(&scenario).max_brake_mps2),
            jerk_mps3,
        };
        let options =
            RunOptions::new(self.controller.source.clone()).with_estimator(self.estimator);
        let result = attack(&scenario, &options, aim, envelope, budget, &Quiet);
        let result = result.map_err(|error| {
            let option = match error {
                AttackError::EmptyEnvelope { .. } => Path::new("--max-brake"),
                AttackError::TooManySimulations { .. } => Path::new("--budget"),
                _ => &self.scenario,
            };
            CliError::at(option, error)
        })?;
        self.controller.ensure_trusted()?;
        match &result.attack {
            Some(attack) => self.write_finding(&attack.scenario, options)?,
            None => self
                .finding
                .note_nothing_to_write("no collision was found, so there is nothing", quiet),
        }
        let name = &scenario.spec().name;
        let report =
            AttackReport::new(name, &self.controller, self.estimator, aim, budget, &result);
        self.finding.print_report(&report, AttackReport::to_text)
    }
}
