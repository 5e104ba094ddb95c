//! `crumple simulate`: simulates scenarios and reports their outcomes.

use std::path::{Path, PathBuf};

use clap::builder::{PathBufValueParser, TypedValueParser};
use clap::{Args, ValueEnum};

use super::global_options::GlobalOptions;
use super::output;
use super::output_format::OutputFormat;
use super::value_enums::AfterCollisionArgs;
use super::{CliError, args, export, feature, value_enums};
use crumple_controllers::Controllers;
use crumple_evidence::describe_followers;
use crumple_measure::{RunEnd, RunFindings, RunReport, RunTotal, SpecificationResult, TotalReport};
use crumple_report::draw::{self, MotionFigure, PanelArrangement, Svg};
use crumple_report::export::to_csv;
use crumple_search::falsify::counterexample::{ExpectedFile, VerdictRecordReader};
use crumple_sim::control::TwoSidedSettings;
use crumple_sim::engine::{
    Impact, NamedController, RecordingLevel, Run, RunOptions, SimulationResult, Trace,
    simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{PlantKind, Scenario, file};
use crumple_store::disk::StagedFiles;

/// Run scenarios and print their outcomes
#[derive(Args)]
#[command(after_long_help = "\
For several scenarios, --plot and --trace write one file each, with the scenario's name before the extension. Text and \
JSON end with totals by kind of collision. With a folder, the text has one line for each scenario, or with --details \
the full text.

A formula of --spec is evaluated as by `crumple falsify`: on a simulation that continues after collisions, whatever \
--after-collision says. Negative robustness means violated.

Braking is unnecessary if it is, for 0.2 s and above 3 m/s, more than 2 m/s² harder than the largest of these \
decelerations within the last 0.5 s: that of the Intelligent Driver Model at the true state, that which avoids the \
leader, and, within a time gap of 3 s, that of the leader. A vehicle falls behind if its leader still drives at the \
end, and if the vehicle then has less than half the leader's speed, or a gap that is larger than the initial gap and \
larger than 20 m plus 6 s times the leader's speed (docs/glossary.md).

crumple simulates a scenario with unnecessary braking again, without the vehicles behind those under test. If this \
second run has neither a collision nor unnecessary braking, a vehicle behind caused the braking, and --expect useful \
accepts the scenario. In scenarios with lane changes all unnecessary braking counts.

A scenario file may have 8 MiB of JSON or 3 MiB of TOML, 1000 vehicles, and 5 million vehicle-steps, whose trace takes \
120 MB of memory (about 300 MB as CSV). A formula may have 4000 tokens, nested 64 deep (docs/stl.md has signals, \
operators and their precedence); a policy file 256 MiB, a network 64 MiB.

Examples:
  crumple simulate paper-1 paper-2 paper-3 --controller baseline --estimator truth
  crumple simulate paper-1 --after-collision continue --plot pile-up.svg
  crumple simulate my-scenario.toml --controller idm --expect useful --format json
  crumple simulate paper-1 --controller idm --spec 'always v1.time_gap_s > 0.3' \\
    --spec 'no collision' --expect satisfied
  crumple simulate paper-1 --spec 'always (v1.gap_m > 2 and v2.gap_m > 2)' --parts \\
    --plot parts.svg")]
pub(super) struct Simulate {
    /// Built-in scenarios (see `crumple list scenarios`), scenario files, or folders of scenario files
    #[arg(required = true, value_name = "SCENARIO")]
    scenarios: Vec<PathBuf>,
    /// Controller of the vehicles under test (see `crumple list controllers`), with settings as in `acc-aeb,ttc_s=2.0`,
    /// a policy file, a network (F.onnx, F.zip of Stable-Baselines3), an FMU (F.fmu), a controller file (F.toml), or a
    /// command after `exec:`
    #[arg(long, value_name = "C", default_value = "baseline", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Estimator of the vehicles under test
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// Seed of all noise instead of the scenario's
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    #[arg(value_parser = args::whole_number::<u64>(0..=i64::MAX as u64))]
    seed: Option<u64>,
    /// Integration step in seconds: the scenario's step divided by a whole number; controllers, sensors and noise keep
    /// the scenario's step
    #[arg(long, value_name = "S", allow_negative_numbers = true, value_parser = parse_seconds)]
    dt: Option<f64>,
    #[command(flatten)]
    after_collision: AfterCollisionArgs,
    /// Plant of all vehicles that a controller drives, instead of the scenario's; scripted vehicles keep their motion
    #[arg(long, value_name = "PLANT", value_parser = value_enums::one_of(value_enums::PLANTS))]
    plant: Option<PlantKind>,
    /// Plot position, speed and gap over time; replaces an existing file
    #[arg(long, value_name = "F.svg|F.png", value_parser = path_ending_in(["svg", "png"]))]
    plot: Option<PathBuf>,
    /// Write the motion as a table, one row per sample and vehicle; replaces an existing file
    #[arg(
        long,
        value_name = "F.csv|F.parquet",
        value_parser = path_ending_in(["csv", "parquet"])
    )]
    trace: Option<PathBuf>,
    /// Evaluate a specification and its robustness: a formula of signal temporal logic, or a name such as
    /// `no collision` (docs/stl.md); may be repeated
    #[arg(long, value_name = "STL")]
    spec: Vec<String>,
    /// Also evaluate each part of the formulas over time; --plot draws the first twelve below the diagrams
    #[arg(long, requires = "spec")]
    parts: bool,
    /// Also compute the level of each vehicle under test over time: the hardest braking of the leader for which a plan
    /// avoids a collision on both sides. SETTINGS describe the assumed follower, as those of `shield2` do
    /// (docs/controllers.md)
    #[arg(long, value_name = "SETTINGS", num_args = 0..=1, require_equals = true, default_missing_value = "")]
    #[arg(value_parser = TwoSidedSettings::parse_for_levels)]
    level: Option<TwoSidedSettings>,
    /// With a folder of scenario files: print the full result of each scenario instead of one line
    #[arg(long)]
    details: bool,
    /// Exit with 1 unless every scenario ends like this
    #[arg(long, value_enum)]
    expect: Option<RunExpectation>,
    /// Output format of results: text, or one JSON object per scenario
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum RunExpectation {
    /// No collision, and every controller answers
    Safe,
    /// Like `safe`; in addition, there is a vehicle under test, none falls behind, and none brakes unnecessarily,
    /// unless a vehicle behind causes the braking
    Useful,
    /// A collision
    Collision,
    /// A collision, or a controller that gives no answer
    Failure,
    /// Every --spec holds
    Satisfied,
    /// Some --spec is violated
    Violated,
}

impl RunExpectation {
    fn is_met(self, rendered: &RenderedRun) -> bool {
        match self {
            Self::Safe => rendered.is_safe(),
            Self::Useful => rendered.is_safe() && rendered.is_useful,
            Self::Collision => rendered.collided,
            Self::Failure => rendered.collided || !rendered.is_answered(),
            Self::Satisfied => !rendered.findings.violated,
            Self::Violated => rendered.findings.violated,
        }
    }

    fn description(self) -> &'static str {
        match self {
            Self::Safe => "no collision, and answers of every controller",
            Self::Useful => {
                "no collision, answers of every controller, no unnecessary braking and no vehicle that falls behind"
            }
            Self::Collision => "a collision",
            Self::Failure => "a collision or a controller without an answer",
            Self::Satisfied => "every specification to hold",
            Self::Violated => "a violated specification",
        }
    }
}

struct RenderedRun {
    text: String,
    files: Vec<(PathBuf, Vec<u8>)>,
    is_useful: bool,
    collided: bool,
    findings: RunFindings,
}

impl RenderedRun {
    fn is_safe(&self) -> bool {
        self.findings.end == RunEnd::NoCollision
    }

    fn is_answered(&self) -> bool {
        self.findings.end != RunEnd::ControllerFailed
    }
}

fn parse_seconds(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(seconds) if seconds > 0.0 && seconds.is_finite() => Ok(seconds),
        Ok(_) => Err("must be a positive number of seconds".to_owned()),
        Err(_) => Err("must be a number of seconds".to_owned()),
    }
}

impl Simulate {
    pub(super) fn run(mut self, global: GlobalOptions) -> Result<(), CliError> {
        let quiet = global.quiet;
        let has_folder = self.scenarios.iter().any(|path| is_folder(path));
        self.scenarios = list_scenario_files(self.scenarios)?;
        self.check_spec_expectation()?;
        let scenarios = self.load_scenarios(global)?;
        if let Some(scenario) = scenarios.first() {
            self.spec
                .iter()
                .try_for_each(|text| args::parse_specification(text, scenario, quiet).map(drop))?;
        }
        self.note_other_controllers(quiet);
        let runs = self.runs(&scenarios)?;
        note_unused_controller(&scenarios, quiet);
        let many = runs.len() > 1;
        let is_brief = has_folder && !self.details;
        // Unnecessary braking is computed from the trace.
        let results = simulate_batch(&runs, RecordingLevel::Trace, |index, simulated| {
            self.render(&runs[index], &simulated, many, is_brief)
        });
        let results = results.into_iter().collect::<Result<Vec<_>, _>>()?;
        args::ensure_trusted()?;
        let mut files = StagedFiles::default();
        for (path, contents) in results.iter().flat_map(|result| &result.files) {
            files.stage(&output::resolve_output_path(path)?, contents)?;
        }
        files.commit()?;
        let mut text: String = results.iter().map(|result| result.text.as_str()).collect();
        text += &self.total(&results, has_folder)?;
        let printed = output::print_coloured(self.format, &text);
        CliError::verdict_first(self.check_expectation(&runs, &results), printed)
    }

    fn check_spec_expectation(&self) -> Result<(), CliError> {
        let is_about_spec = matches!(
            self.expect,
            Some(RunExpectation::Satisfied | RunExpectation::Violated)
        );
        if self.spec.is_empty() && is_about_spec {
            return Err(CliError::Input(
                "--expect: `satisfied` and `violated` need a --spec".to_owned(),
            ));
        }
        Ok(())
    }

    fn load_scenarios(&self, global: GlobalOptions) -> Result<Vec<Scenario>, CliError> {
        // Without any scenario, the error names the file.
        let skips_records = !self.scenarios.iter().all(|path| is_verdict_record(path));
        self.scenarios
            .iter()
            .filter(|path| !skips_records || !is_verdict_record(path))
            .map(|path| self.load_scenario(path, global.controllers))
            .collect()
    }

    fn runs(&self, scenarios: &[Scenario]) -> Result<Vec<Run>, CliError> {
        let options = self.run_options();
        scenarios
            .iter()
            .map(|scenario| {
                Run::new(scenario, options.clone())
                    .map_err(|error| CliError::Input(format!("{}: {error}", scenario.spec().name)))
            })
            .collect()
    }

    /// Returns the total of several runs, or of a folder; empty for one run.
    fn total(&self, results: &[RenderedRun], has_folder: bool) -> Result<String, CliError> {
        if !has_folder && results.len() < 2 {
            return Ok(String::new());
        }
        let findings: Vec<_> = results.iter().map(|result| result.findings).collect();
        let mut total = RunTotal::new(&findings, !self.spec.is_empty());
        if let Some(plant) = self.plant {
            // Whether a run without an answer would have had a collision later is unknown.
            let decided = results
                .iter()
                .filter(|result| result.collided || result.is_answered());
            total = total.with_plant(plant, decided.map(|result| result.collided));
        }
        match self.format {
            OutputFormat::Text => Ok(total.to_text(&self.controller.name, self.estimator.name())),
            OutputFormat::Json => {
                Ok(serde_json::to_string(&TotalReport { total }).map_err(CliError::input)? + "\n")
            }
        }
    }

    /// Renders all output of one run, so that its trace can be dropped.
    fn render(
        &self,
        run: &Run,
        simulated: &SimulationResult,
        is_one_of_many: bool,
        is_brief: bool,
    ) -> Result<RenderedRun, CliError> {
        let report = self.report(run, simulated)?;
        let text = match self.format {
            OutputFormat::Json => serde_json::to_string(&report).map_err(CliError::input)? + "\n",
            OutputFormat::Text if is_brief => report.to_line(),
            OutputFormat::Text => report.to_text(),
        };
        let mut files = Vec::new();
        if let Some(trace) = &simulated.trace {
            let name = is_one_of_many.then_some(run.scenario().spec().name.as_str());
            if let Some(path) = &self.plot {
                let figure = self.draw_run(run, trace, simulated, &report);
                files.push((
                    path_for_scenario(path, name),
                    feature::encode_figure(path, &figure)?,
                ));
            }
            if let Some(path) = &self.trace {
                let table = match extension(path) {
                    Some("csv") => to_csv(trace, &report.levels).map_err(CliError::input),
                    _ => feature::encode_parquet(trace, &report.levels),
                };
                files.push((path_for_scenario(path, name), table?));
            }
        }
        Ok(RenderedRun {
            text,
            files,
            is_useful: report.is_useful(),
            collided: !simulated.impacts.is_empty(),
            findings: RunFindings::new(&report),
        })
    }

    /// Draws the motion, and the robustness of the specifications if there are any.
    fn draw_run(
        &self,
        run: &Run,
        trace: &Trace,
        simulated: &SimulationResult,
        report: &RunReport,
    ) -> Svg {
        let figure = draw_motion(
            run.scenario(),
            &self.controller.name,
            trace,
            &simulated.impacts,
        );
        let parts: Vec<_> = report
            .specifications
            .iter()
            .flat_map(|evaluated| &evaluated.parts)
            .map(|report| report.part.clone())
            .collect();
        let figure = if parts.is_empty() {
            figure
        } else {
            draw::add_robustness("motion", &figure, &parts, run.dt_s())
        };
        if report.levels.is_empty() {
            figure
        } else {
            draw::add_levels("motion", &figure, &report.levels)
        }
    }

    /// Notes which scenario files are recorded with other controllers than the present one.
    fn note_other_controllers(&self, quiet: bool) {
        let mut records = VerdictRecordReader::default();
        for path in self
            .scenarios
            .iter()
            .filter(|path| args::find_built_in_scenario(path).is_none())
        {
            // Ignore records that cannot be read.
            let Ok(Some(recorded)) = records.find(path) else {
                continue;
            };
            let others: Vec<_> = recorded
                .by_controller()
                .iter()
                .map(|verdict| verdict.controller.as_str())
                .collect();
            if !others.contains(&self.controller.name.as_str()) {
                output::note(
                    &format!(
                        "note: {} was recorded with `{}`, but is simulated with `{}`",
                        path.display(),
                        others.join("` and `"),
                        self.controller.name
                    ),
                    quiet,
                );
            }
        }
    }

    fn load_scenario(&self, path: &Path, controllers: Controllers) -> Result<Scenario, CliError> {
        let scenario = args::load_scenario(path, controllers)?;
        let scenario = match self.seed {
            None => scenario,
            Some(seed) => scenario
                .edited(|spec| spec.seed = seed)
                .map_err(|e| CliError::Input(format!("--seed: {e}")))?,
        };
        match self.plant {
            None => Ok(scenario),
            Some(plant) => scenario
                .with_plant(plant)
                .map_err(|error| CliError::Input(format!("--plant: {error}"))),
        }
    }

    fn run_options(&self) -> RunOptions {
        let options = RunOptions::new(self.controller.source.clone())
            .with_estimator(self.estimator)
            .with_after_collision(self.after_collision.behaviour);
        match self.dt {
            None => options,
            Some(dt_s) => options.with_dt_s(dt_s),
        }
    }

    fn report<'a>(
        &'a self,
        run: &'a Run,
        result: &'a SimulationResult,
    ) -> Result<RunReport<'a>, CliError> {
        let specifications = SpecificationResult::evaluate_all(
            &self.spec,
            run.scenario(),
            &self.run_options(),
            self.parts,
        )
        .map_err(|error| CliError::Input(format!("--spec: {error}")))?;
        let report = RunReport::new(run, &self.controller, result)
            .with_plant(self.plant)
            .with_specifications(specifications)
            .with_cause_of_braking(run)
            .map_err(CliError::input)?;
        Ok(match &self.level {
            Some(settings) => report.with_levels(run, result, settings, describe_followers),
            None => report,
        })
    }

    fn check_expectation(&self, runs: &[Run], results: &[RenderedRun]) -> Result<(), CliError> {
        let Some(expected) = self.expect else {
            return Ok(());
        };
        let otherwise = runs
            .iter()
            .zip(results)
            .filter(|(_, result)| !expected.is_met(result));
        let otherwise: Vec<_> = otherwise
            .map(|(run, _)| run.scenario().spec().name.as_str())
            .collect();
        if otherwise.is_empty() {
            return Ok(());
        }
        Err(CliError::Unmet(format!(
            "expected {} in {}",
            expected.description(),
            otherwise.join(", ")
        )))
    }
}

fn is_folder(path: &Path) -> bool {
    args::find_built_in_scenario(path).is_none() && path.is_dir()
}

/// Replaces each folder by its scenario files, in order of their names.
fn list_scenario_files(paths: Vec<PathBuf>) -> Result<Vec<PathBuf>, CliError> {
    let mut files = Vec::new();
    for path in paths {
        if !is_folder(&path) {
            files.push(path);
            continue;
        }
        let listed = file::list(&path)?;
        if listed.is_empty() {
            return Err(CliError::at(&path, "the folder has no scenario file"));
        }
        files.extend(listed);
    }
    Ok(files)
}

/// Renders the diagrams of a run, in the format of the file's extension.
pub(super) fn render_motion_figure(
    path: &Path,
    scenario: &Scenario,
    controller: &str,
    trace: &Trace,
    impacts: &[Impact],
) -> Result<Vec<u8>, CliError> {
    feature::encode_figure(path, &draw_motion(scenario, controller, trace, impacts))
}

fn draw_motion(scenario: &Scenario, controller: &str, trace: &Trace, impacts: &[Impact]) -> Svg {
    let title = format!("{}, {controller}", scenario.spec().name);
    let labels = draw::vehicle_names(scenario);
    let figure = MotionFigure {
        prefix: "motion",
        title: &title,
        labels: &labels,
        trace,
        impacts,
    };
    draw::draw_motion(&figure, PanelArrangement::Wide)
}

/// Parses a path with one of two extensions, in a format that this build writes.
pub(super) fn path_ending_in(
    extensions: [&'static str; 2],
) -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(move |path| {
        let [first, second] = extensions;
        match extension(&path) {
            Some(extension) if extensions.contains(&extension) => {
                feature::require_format(extension).map(|()| path)
            }
            _ => Err(format!("must end in .{first} or .{second}")),
        }
    })
}

/// Returns true for recorded verdicts, which `*.toml` matches in folders of version 0.1.0.
fn is_verdict_record(path: &Path) -> bool {
    path.ends_with(file::LEGACY_EXPECTED_FILE_NAME) && ExpectedFile::load(path).is_ok()
}

fn note_unused_controller(scenarios: &[Scenario], quiet: bool) {
    for scenario in scenarios
        .iter()
        .filter(|scenario| !scenario.has_vehicle_under_test())
    {
        let name = &scenario.spec().name;
        output::note(
            &format!("note: {name} has no vehicle under test, so no controller is tested"),
            quiet,
        );
    }
}

fn extension(path: &Path) -> Option<&str> {
    path.extension()?.to_str()
}

/// Inserts a scenario's name before the extension of `path`.
fn path_for_scenario(path: &Path, name: Option<&str>) -> PathBuf {
    let (Some(name), Some(stem), Some(extension)) = (name, path.file_stem(), extension(path))
    else {
        return path.to_owned();
    };
    let plain = export::plain_file_name(name);
    path.with_file_name(format!("{}-{plain}.{extension}", stem.to_string_lossy()))
}
