//! `crumple export`: scenarios and runs for other simulators.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::global_options::GlobalOptions;
use super::output_format::OutputFormat;
use super::value_enums::AfterCollisionArgs;
use super::{CliError, args, output, value_enums};
use crumple_controllers::Controllers;
use crumple_exchange::openscenario::export::{
    self as openscenario, ExportReport, ExportedController, ExportedScenario, OpenScenario,
};
use crumple_search::falsify::counterexample::VerdictRecordReader;
use crumple_sim::control::{BuiltInController, IntoSource};
use crumple_sim::engine::{NamedController, Outcome, RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};

/// Write scenarios for other simulators: OpenSCENARIO XML 1.2 on an OpenDRIVE road
#[derive(Args)]
#[command(after_long_help = "\
Writes two files for each scenario: NAME.xosc, and the road NAME.xodr to which it refers.

A counterexample of a campaign is simulated with the controller and the estimator that its record states, unless \
--controller names another. crumple looks for the file of the controller in the folder of the counterexample and in \
the current one and, if the record has its hash, in all folders above the counterexample. If the record names a \
program or an FMU, crumple starts it only with --allow-external. `--as trajectories` (the default) simulates the \
scenario and writes the motion of every vehicle: polylines with absolute times, in the mode `position`, within 2 mm \
of the simulation. If the simulation ends with a collision, they end there, too. `--as actions` writes the actions of \
the scripted vehicles with triggers; every other vehicle has a controller, `under-test` or the name of its driver, \
that you supply in the other simulator.

OpenSCENARIO positions refer to the rear axle, which crumple places a fifth of the vehicle's length ahead of the \
rear bumper.

A file may have 1 million vertices (100 MB). For scenarios the limits of `crumple simulate` apply.

Examples:
  crumple export paper-1 --to openscenario --controller policy --out exported
  crumple export my-scenario.toml --to openscenario --as actions --out exported")]
pub(super) struct Export {
    /// Built-in scenarios (see `crumple list scenarios`) or scenario files
    #[arg(required = true, value_name = "SCENARIO")]
    scenarios: Vec<PathBuf>,
    /// Format
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: ExportFormat,
    /// Content of the export
    #[arg(
        long = "as",
        value_enum,
        value_name = "WHAT",
        default_value = "trajectories"
    )]
    what: ExportContent,
    /// Controller of the vehicles under test, for trajectories (see `crumple list controllers`) [default: the one
    /// recorded with a counterexample, `baseline` in built-in scenarios; required in all other scenarios with a vehicle
    /// under test]
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: Option<NamedController>,
    /// Estimator of the vehicles under test [default: the one recorded with a counterexample, otherwise kalman]
    #[arg(long, value_name = "ESTIMATOR", value_parser = value_enums::estimator())]
    estimator: Option<EstimatorKind>,
    #[command(flatten)]
    after_collision: AfterCollisionArgs,
    /// Folder for the files, created if missing; `exported.sha256` lists them. crumple replaces only files that it
    /// wrote there and that have not changed
    #[arg(long, value_name = "FOLDER")]
    out: PathBuf,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Controller and estimator of the vehicles under test.
struct ExportController {
    controller: NamedController,
    estimator: EstimatorKind,
}

impl ExportController {
    fn describe(&self) -> ExportedController<'_> {
        ExportedController {
            name: &self.controller.name,
            estimator: self.estimator,
        }
    }
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum ExportFormat {
    /// ASAM OpenSCENARIO XML 1.2, with OpenDRIVE 1.7
    #[value(name = "openscenario")]
    OpenScenario,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum ExportContent {
    /// Motion of every vehicle
    Trajectories,
    /// Actions of the scripted vehicles
    Actions,
}

impl Export {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let ExportFormat::OpenScenario = self.to;
        self.check_options()?;
        let folder = OutputFolder::with_listing(&self.out, "exported.sha256")?;
        let mut files = Vec::new();
        let mut report = ExportReport::default();
        let mut names = Vec::new();
        for path in &self.scenarios {
            let scenario = args::load_scenario(path, controllers)?;
            let name = file_stem(&scenario.spec().name);
            if names.contains(&name) {
                let problem = "would overwrite the file of another scenario of this command: use a separate --out for \
                               each";
                return Err(CliError::at(path, format!("{name}.xosc {problem}")));
            }
            let road = format!("{name}.xodr");
            let driven = self.controller_setup(path, &scenario, controllers)?;
            let documents = self.export(&scenario, driven.as_ref(), &road, quiet)?;
            let storyboard = format!("{name}.xosc");
            report.scenarios.push(ExportedScenario::new(
                &scenario,
                &documents,
                [&self.out.join(&storyboard), &self.out.join(&road)],
                driven.as_ref().map(ExportController::describe),
            ));
            files.extend([(storyboard, documents.scenario), (road, documents.road)]);
            names.push(name);
        }
        folder.write(&files, EarlierFiles::Keep)?;
        output::print_result(self.format, &report, || report.to_text())
    }

    fn check_options(&self) -> Result<(), CliError> {
        if self.what == ExportContent::Actions && self.controller.is_some() {
            let problem = "--controller: applies only to `--as trajectories`; with `--as actions`, supply the \
                           controller in the other simulator";
            return Err(CliError::Input(problem.to_owned()));
        }
        if self.what == ExportContent::Actions && self.estimator.is_some() {
            let problem = "--estimator: applies only to `--as trajectories`";
            return Err(CliError::Input(problem.to_owned()));
        }
        Ok(())
    }

    /// Returns the controller of the vehicles under test: the one that the user names, or else that of the
    /// counterexample. `None` if no vehicle is under test, or the user supplies the controller in the other simulator.
    fn controller_setup(
        &self,
        path: &Path,
        scenario: &Scenario,
        controllers: Controllers,
    ) -> Result<Option<ExportController>, CliError> {
        if self.what == ExportContent::Actions || !scenario.has_vehicle_under_test() {
            return Ok(None);
        }
        let mut setup = if let Some(controller) = &self.controller {
            ExportController {
                controller: controller.clone(),
                estimator: EstimatorKind::default(),
            }
        } else if args::find_built_in_scenario(path).is_some() {
            ExportController {
                controller: controllers
                    .find("baseline", Path::new(""))
                    .map_err(CliError::from_cause)?,
                estimator: EstimatorKind::default(),
            }
        } else {
            recorded_controller(path, controllers)?
        };
        setup.estimator = self.estimator.unwrap_or(setup.estimator);
        Ok(Some(setup))
    }

    fn export(
        &self,
        scenario: &Scenario,
        driven: Option<&ExportController>,
        road: &str,
        quiet: bool,
    ) -> Result<OpenScenario, CliError> {
        let name = &scenario.spec().name;
        if self.what == ExportContent::Actions {
            return openscenario::export_actions(scenario, road)
                .map_err(|error| scenario_error(name, error));
        }
        let controller = driven.map_or_else(
            || BuiltInController::Baseline(Default::default()).into_source(),
            |driven| driven.controller.source.clone(),
        );
        let options = RunOptions::new(controller)
            .with_estimator(driven.map_or_else(EstimatorKind::default, |driven| driven.estimator))
            .with_after_collision(self.after_collision.behaviour);
        let run = Run::new(scenario, options).map_err(|error| scenario_error(name, error))?;
        let simulated = simulate(&run, RecordingLevel::Trace);
        if let Outcome::ControllerFailed(why) = &simulated.outcome {
            output::note(
                &format!("note: {name} ends at the failure of the controller: {why}"),
                quiet,
            );
        }
        let trace = simulated
            .trace
            .ok_or_else(|| scenario_error(name, "no motion was recorded"))?;
        let controller = driven.map(|driven| driven.controller.name.as_str());
        openscenario::export_trajectories(scenario, &trace, controller, road)
            .map_err(|error| scenario_error(name, error))
    }
}

fn scenario_error(name: &str, problem: impl std::fmt::Display) -> CliError {
    CliError::Input(format!("{name}: {problem}"))
}

/// Returns the only controller that the record of a counterexample names.
fn recorded_controller(
    path: &Path,
    controllers: Controllers,
) -> Result<ExportController, CliError> {
    let mut records = VerdictRecordReader::default();
    let Some(recorded) = records.find(path)? else {
        let problem =
            "no record states the controller of this scenario: choose one with --controller";
        return Err(CliError::at(path, problem));
    };
    let [verdict] = recorded.by_controller()[..] else {
        let names: Vec<_> = recorded
            .by_controller()
            .iter()
            .map(|verdict| format!("`{}`", verdict.controller))
            .collect();
        let problem = format!(
            "the scenario is recorded with several controllers ({}): choose one with --controller",
            names.join(" and ")
        );
        return Err(CliError::at(path, problem));
    };
    let controller = recorded
        .find_controller(verdict, controllers)
        .map_err(|error| {
            let problem = format!(
                "the record names the controller `{}`: {error}",
                verdict.controller
            );
            CliError::at(
                path,
                format!("{problem}; choose another one with --controller"),
            )
        })?;
    Ok(ExportController {
        controller,
        estimator: verdict.estimator,
    })
}

/// Returns a scenario's name with a hyphen in place of each character that a file name should not have.
pub(super) fn plain_file_name(name: &str) -> String {
    name.chars()
        .map(|c| {
            if c.is_alphanumeric() || "-_.".contains(c) {
                c
            } else {
                '-'
            }
        })
        .collect()
}

/// Returns a file name of at most 60 characters for a scenario's name. Longer names lose characters in the middle,
/// because the end distinguishes the variations of one file.
pub(super) fn file_stem(name: &str) -> String {
    let plain: Vec<char> = plain_file_name(name).chars().collect();
    match plain.len() {
        0..=60 => plain.into_iter().collect(),
        count => plain[..40].iter().chain(&plain[count - 20..]).collect(),
    }
}
