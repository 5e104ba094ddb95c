//! `crumple simulate`: run scenarios and say what happened.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};
use serde::Serialize;

use super::output;
use super::{Failure, choice, subject};
use crumple_report::draw::{self, Layout, MotionFigure, PNG_SCALE};
use crumple_report::export;
use crumple_search::disk::Files;
use crumple_world::measure::{NeedlessBrake, NeedlessBraking, Specification, SpecificationError, Usefulness};
use crumple_world::observation::EstimatorKind;
use crumple_world::quoted::Terminal;
use crumple_world::scenario::{Driver, Scenario};
use crumple_world::sim::{
    AfterContact, Impact, Intervention, NamedController, Outcome, RecordingLevel, Run, RunOptions, Simulated, Trace,
    VehicleSummary, simulate, simulate_batch,
};

/// Run scenarios and say what happened
#[derive(Args)]
#[command(after_long_help = "\
Where several scenarios are given, --plot and --trace write one file each, with the scenario's name before the extension.

A formula of --spec is judged as `crumple falsify` judges it, on a run that goes on after contacts whatever --after-contact says; \
robustness is below 0 where it is violated. `--expect satisfied` wants every specification to hold in every scenario, `--expect \
violated` wants one to be violated in each; `safe` wants no contact and no controller that fails, `collision` a contact. \
`useful` wants what `safe` does and no vehicle under test that brakes without cause: by more than 2 m/s² harder, for 0.2 s, than \
the Intelligent Driver Model would at its true state, than avoiding a contact took, and than the vehicle ahead itself; nor one \
that ends at less than half the speed of a vehicle ahead that drives on.

A scenario file may have 8 MiB of JSON or 3 of TOML, 1000 vehicles, and 5 million vehicles times steps, of which a trace takes 120 MB; a formula 4000 words and \
signs, 64 deep; a policy file 256 MiB, a network 64 MiB.

Examples:
  crumple simulate paper-1 paper-2 paper-3 --controller baseline --estimator truth
  crumple simulate paper-1 --after-contact continue --plot pile-up.svg
  crumple simulate my-scenario.toml --controller idm --expect useful --format json
  crumple simulate paper-1 --controller idm --spec 'always v1.time_gap_s > 0.3' --spec 'no contact' --expect satisfied")]
pub(super) struct Simulate {
    /// Built-in scenarios (see `crumple list scenarios`) or scenario files
    #[arg(required = true, value_name = "SCENARIO")]
    scenarios: Vec<String>,
    /// Controller of the vehicles under test (see `crumple list controllers`), with settings
    /// as in `acc-aeb,ttc_s=2.0`, the file of a policy, a network or a controller, or a command after `exec:`
    #[arg(long, value_name = "C", default_value = "baseline", value_parser = subject::controller)]
    controller: NamedController,
    /// What the vehicles under test look through
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = choice::one_of(choice::ESTIMATORS))]
    estimator: EstimatorKind,
    /// Seed of all noise instead of the scenario's
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    seed: Option<u64>,
    /// Integration step in seconds, a whole fraction of the scenario's; controllers, sensors and noise keep the scenario's
    #[arg(long, value_name = "S", allow_negative_numbers = true)]
    dt: Option<f64>,
    /// What happens when vehicles touch
    #[arg(long, value_name = "AFTER_CONTACT", default_value = "stop", value_parser = choice::one_of(choice::AFTER_CONTACT))]
    after_contact: AfterContact,
    /// Draw position, speed and spacing over time
    #[arg(long, value_name = "F.svg|F.png", value_parser = |path: &str| ending_in(path, ["svg", "png"]))]
    plot: Option<PathBuf>,
    /// Write the motion as a table, one row a sample and vehicle
    #[arg(long, value_name = "F.csv|F.parquet", value_parser = |path: &str| ending_in(path, ["csv", "parquet"]))]
    trace: Option<PathBuf>,
    /// Say whether this holds, and how robustly: `no contact`, or a formula of signal temporal logic; may be repeated
    #[arg(long, value_name = "STL")]
    spec: Vec<String>,
    /// Exit with 1 unless every scenario ends like this
    #[arg(long, value_enum)]
    expect: Option<Expectation>,
    /// How to print results: for a reader, or one JSON object a scenario
    #[arg(long, value_enum, default_value = "text")]
    format: Format,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum Expectation {
    /// No vehicles touch, and no controller fails
    Safe,
    /// The same, and vehicles under test, of which there is one, brake with a cause and are not left behind
    Useful,
    /// Vehicles touch
    Collision,
    /// Every --spec holds
    Satisfied,
    /// Some --spec is violated
    Violated,
}

impl Expectation {
    fn is_met(self, rendered: &Rendered) -> bool {
        match self {
            Self::Safe => rendered.is_safe,
            Self::Useful => rendered.is_safe && rendered.is_useful,
            Self::Collision => rendered.collided,
            Self::Satisfied => !rendered.violated,
            Self::Violated => rendered.violated,
        }
    }

    fn in_words(self) -> &'static str {
        match self {
            Self::Safe => "no collision",
            Self::Useful => "no collision, no braking without cause and nobody left behind",
            Self::Collision => "a collision",
            Self::Satisfied => "every specification to hold",
            Self::Violated => "a violated specification",
        }
    }
}

/// How results are printed.
#[derive(Clone, Copy, PartialEq, ValueEnum)]
pub(super) enum Format {
    /// For a reader
    Text,
    /// For a program
    Json,
}

/// One line of `--format json`.
#[derive(Serialize)]
struct Report<'a> {
    scenario: &'a str,
    controller: &'a str,
    estimator: &'static str,
    dt_s: f64,
    seed: u64,
    /// The controller says of itself that another run may end otherwise.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    nondeterministic: bool,
    outcome: Outcome,
    vehicles: &'a [VehicleSummary],
    impacts: &'a [Impact],
    vehicles_involved: usize,
    #[serde(skip_serializing_if = "<[Intervention]>::is_empty")]
    interventions: &'a [Intervention],
    /// One entry a vehicle under test.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    braking_without_cause: Vec<BrakingWithoutCause>,
    /// Vehicles under test that end far slower than the one ahead drives on.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    left_behind: Vec<usize>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    specifications: Vec<Judged>,
}

/// Braking without cause of a vehicle.
#[derive(Serialize)]
struct BrakingWithoutCause {
    vehicle: usize,
    #[serde(flatten)]
    braking: NeedlessBraking,
}

/// What a specification says of a scenario.
#[derive(Serialize)]
struct Judged {
    specification: String,
    satisfied: bool,
    /// Below 0 if and only if it does not hold.
    #[serde(with = "crumple_search::falsify::non_finite")]
    robustness: f64,
}

/// What becomes of one run.
struct Rendered {
    text: String,
    files: Vec<(PathBuf, Vec<u8>)>,
    is_safe: bool,
    is_useful: bool,
    collided: bool,
    violated: bool,
}

impl Simulate {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        if self.spec.is_empty() && matches!(self.expect, Some(Expectation::Satisfied | Expectation::Violated)) {
            return Err(Failure::Input("--expect: `satisfied` and `violated` need a --spec".to_owned()));
        }
        let scenarios = self.scenarios.iter().map(|name| self.scenario(name)).collect::<Result<Vec<_>, _>>()?;
        let options = self.options();
        let runs = scenarios
            .iter()
            .map(|scenario| {
                Run::new(scenario, options.clone())
                    .map_err(|error| Failure::Input(format!("{}: {error}", scenario.spec().name)))
            })
            .collect::<Result<Vec<_>, _>>()?;
        for scenario in scenarios.iter().filter(|scenario| !scenario.has_vehicle_under_test()) {
            let name = &scenario.spec().name;
            output::note(&format!("note: {name} has no vehicle under test, so --controller drives nobody"), quiet);
        }
        let many = runs.len() > 1;
        // Braking without cause shows in the motion alone.
        let results = simulate_batch(&runs, RecordingLevel::Trace, |index, simulated| {
            self.render(&runs[index], &simulated, many)
        });
        let results = results.into_iter().collect::<Result<Vec<_>, _>>()?;
        let mut files = Files::default();
        for (path, contents) in results.iter().flat_map(|result| &result.files) {
            files.stage(&output::place(path)?, contents)?;
        }
        files.commit()?;
        let printed = output::print(&results.iter().map(|result| result.text.as_str()).collect::<String>());
        Failure::gate_first(self.check_expectation(&runs, &results), printed)
    }

    /// Everything to print and write of one run, so that its trace need not be kept.
    fn render(&self, run: &Run<'_>, simulated: &Simulated, is_one_of_many: bool) -> Result<Rendered, Failure> {
        let report = self.report(run, simulated)?;
        let violated = report.specifications.iter().any(|judged| !judged.satisfied);
        let judged = &report.braking_without_cause;
        let brakes_with_cause = !judged.is_empty() && judged.iter().all(|one| one.braking.is_none());
        let is_useful = brakes_with_cause && report.left_behind.is_empty();
        let text = match self.format {
            Format::Json => serde_json::to_string(&report).map_err(Failure::input)? + "\n",
            Format::Text => describe(&report, run.scenario()),
        };
        let mut files = Vec::new();
        if let Some(trace) = &simulated.trace {
            let name = is_one_of_many.then_some(run.scenario().spec().name.as_str());
            if let Some(path) = &self.plot {
                files.push((
                    named(path, name),
                    picture(path, run.scenario(), &self.controller.name, trace, &simulated.impacts)?,
                ));
            }
            if let Some(path) = &self.trace {
                let is_csv = extension(path) == Some("csv");
                let table = if is_csv { export::csv(trace) } else { export::parquet(trace) };
                files.push((named(path, name), table.map_err(Failure::input)?));
            }
        }
        Ok(Rendered {
            text,
            files,
            is_safe: simulated.outcome.is_safe(),
            is_useful,
            collided: !simulated.impacts.is_empty(),
            violated,
        })
    }

    fn scenario(&self, name: &str) -> Result<Scenario, Failure> {
        let scenario = subject::scenario(name)?;
        match self.seed {
            None => Ok(scenario),
            Some(seed) => scenario.edited(|spec| spec.seed = seed).map_err(|e| Failure::Input(format!("--seed: {e}"))),
        }
    }

    fn options(&self) -> RunOptions {
        let options = RunOptions::new(self.controller.kind.clone())
            .with_estimator(self.estimator)
            .with_after_contact(self.after_contact);
        match self.dt {
            None => options,
            Some(dt_s) => options.with_dt_s(dt_s),
        }
    }

    fn report<'a>(&'a self, run: &Run<'a>, result: &'a Simulated) -> Result<Report<'a>, Failure> {
        let scenario = run.scenario();
        let spec = scenario.spec();
        Ok(Report {
            scenario: &spec.name,
            controller: &self.controller.name,
            estimator: self.estimator.name(),
            dt_s: run.dt_s(),
            seed: spec.seed,
            nondeterministic: !self.controller.kind.is_deterministic(),
            outcome: result.outcome.clone(),
            vehicles: &result.vehicles,
            impacts: &result.impacts,
            vehicles_involved: result.vehicles_involved(),
            interventions: &result.interventions,
            braking_without_cause: braking_without_cause(scenario, result),
            left_behind: left_behind(scenario, result),
            specifications: self.judge(scenario).map_err(|error| Failure::Input(format!("--spec: {error}")))?,
        })
    }

    /// What each specification says; those that need the same kind of run share one.
    fn judge(&self, scenario: &Scenario) -> Result<Vec<Judged>, SpecificationError> {
        let mut runs: Vec<(Run<'_>, RecordingLevel, Simulated)> = Vec::new();
        let judge = |text: &String| {
            let specification = Specification::parse(text, scenario)?;
            let (keep, after_contact) = (specification.keep(), specification.after_contact());
            let known = |(run, kept, _): &_| (*kept, Run::options(run).after_contact) == (keep, after_contact);
            let index = match runs.iter().position(known) {
                Some(index) => index,
                None => {
                    let run = Run::new(scenario, self.options().with_after_contact(after_contact))?;
                    let result = simulate(&run, keep);
                    runs.push((run, keep, result));
                    runs.len() - 1
                }
            };
            let verdict = specification.judge(&runs[index].0, &runs[index].2)?;
            let (satisfied, robustness) = (!verdict.is_violation(), verdict.robustness);
            Ok(Judged { specification: specification.to_string(), satisfied, robustness })
        };
        self.spec.iter().map(judge).collect()
    }

    fn check_expectation(&self, runs: &[Run<'_>], results: &[Rendered]) -> Result<(), Failure> {
        let Some(expected) = self.expect else { return Ok(()) };
        let otherwise: Vec<_> = runs
            .iter()
            .zip(results)
            .filter(|(_, result)| !expected.is_met(result))
            .map(|(run, _)| run.scenario().spec().name.as_str())
            .collect();
        if otherwise.is_empty() {
            return Ok(());
        }
        Err(Failure::Gate(format!("expected {} in {}", expected.in_words(), otherwise.join(", "))))
    }
}

/// The three diagrams of a run, as the file's extension says.
pub(super) fn picture(
    path: &Path,
    scenario: &Scenario,
    controller: &str,
    trace: &Trace,
    impacts: &[Impact],
) -> Result<Vec<u8>, Failure> {
    let title = format!("{}, {controller}", scenario.spec().name);
    let labels = draw::vehicle_names(scenario);
    let figure = MotionFigure { prefix: "motion", title: &title, labels: &labels, trace, impacts };
    let picture = draw::motion(&figure, Layout::Wide);
    match extension(path) {
        Some("png") => picture.to_png(PNG_SCALE).map_err(Failure::input),
        _ => Ok(picture.document().into_bytes()),
    }
}

/// A path that ends in one of two extensions, for clap.
pub(super) fn ending_in(path: &str, extensions: [&str; 2]) -> Result<PathBuf, String> {
    let [one, other] = extensions;
    let known = extension(Path::new(path)).is_some_and(|found| extensions.contains(&found));
    if known { Ok(PathBuf::from(path)) } else { Err(format!("must end in .{one} or .{other}")) }
}

fn extension(path: &Path) -> Option<&str> {
    path.extension()?.to_str()
}

/// `path` with a scenario's name before its extension.
fn named(path: &Path, name: Option<&str>) -> PathBuf {
    let (Some(name), Some(stem), Some(extension)) = (name, path.file_stem(), extension(path)) else {
        return path.to_owned();
    };
    let plain: String = name.chars().map(|c| if c.is_alphanumeric() || "-_.".contains(c) { c } else { '-' }).collect();
    path.with_file_name(format!("{}-{plain}.{extension}", stem.to_string_lossy()))
}

/// The report for a reader.
fn describe(report: &Report<'_>, scenario: &Scenario) -> String {
    let mut text = String::new();
    let Report { scenario: name, controller, estimator, dt_s, seed, .. } = report;
    let mut line = |line: String| {
        text += &format!("{}\n", Terminal(line.trim_end()));
    };
    line(format!("{name}: {controller}, estimator {estimator}, dt {dt_s} s, seed {seed}"));
    if report.nondeterministic {
        line("  the controller says that it is not deterministic: another run may end otherwise".to_owned());
    }
    match &report.outcome {
        Outcome::ControllerFailed(failed) => line(format!("  CONTROLLER FAILED: {failed}")),
        _ if report.impacts.is_empty() => line("  no collision".to_owned()),
        _ => {}
    }
    for (index, impact) in report.impacts.iter().enumerate() {
        let contact = impact.contact;
        line(format!(
            "  {} at {:.2} s: vehicle {} hits vehicle {} at {:.1} m/s ({:.1} against {:.1} m/s)",
            if index == 0 { "COLLISION" } else { "then     " },
            contact.time_s,
            contact.rear_vehicle,
            contact.front_vehicle,
            contact.impact_speed_mps,
            contact.rear_speed_mps,
            contact.front_speed_mps
        ));
    }
    if report.impacts.len() > 1 {
        line(format!("  {} of {} vehicles involved", report.vehicles_involved, report.vehicles.len()));
    }
    for BrakingWithoutCause { vehicle, braking } in &report.braking_without_cause {
        if let Some(NeedlessBrake { time_s, brake_mps2, caused_mps2 }) = braking.hardest {
            line(format!(
                "  vehicle {vehicle} brakes without cause for {:.2} s, hardest at {time_s:.2} s: {brake_mps2:.1} m/s² where \
                 {caused_mps2:.1} had a cause",
                braking.time_s
            ));
        }
    }
    for vehicle in &report.left_behind {
        line(format!("  vehicle {vehicle} is left behind by the one ahead"));
    }
    for Judged { specification, satisfied, robustness } in &report.specifications {
        let verdict = if *satisfied { "holds" } else { "VIOLATED" };
        line(format!("  {verdict}, robustness {robustness:.3}: {specification}"));
    }
    for index in 0..report.vehicles.len() {
        if let Some(said) = shield_line(report.interventions, index) {
            line(said);
        }
    }
    line(format!(
        "  {:>3}  {:<6} {:<20} {:>11} {:>11} {:>15}  {}",
        "#", "class", "driver", "min gap m", "min TTC s", "max brake m/s²", "at the end"
    ));
    for (index, (summary, vehicle)) in report.vehicles.iter().zip(scenario.vehicles()).enumerate() {
        let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        let driver = match &vehicle.driver {
            Driver::UnderTest => (*controller).to_owned(),
            Driver::Controller(spec) => spec.words(),
            Driver::Profile(profile) => profile.name().to_owned(),
            Driver::File(file) => Path::new(file.path()).file_name().unwrap_or_default().to_string_lossy().into_owned(),
        };
        line(format!(
            "  {index:>3}  {:<6} {driver:<20} {:>11} {:>11} {:>15}  {}",
            vehicle.class.name(),
            number(summary.min_gap_m),
            number(summary.min_ttc_s),
            number(Some(summary.max_brake_mps2)),
            if summary.stopped { "standing" } else { "moving" }
        ));
    }
    text
}

/// How the vehicles under test brake without cause, front to rear.
fn braking_without_cause(scenario: &Scenario, result: &Simulated) -> Vec<BrakingWithoutCause> {
    let Some(trace) = &result.trace else { return Vec::new() };
    let under_test = (0..trace.vehicles.len()).filter(|&vehicle| scenario.is_under_test(vehicle));
    let of = |vehicle| {
        let braking = NeedlessBraking::of(trace, &result.impacts, vehicle)?;
        Some(BrakingWithoutCause { vehicle, braking })
    };
    under_test.filter_map(of).collect()
}

/// The vehicles under test that are left behind, front to rear.
fn left_behind(scenario: &Scenario, result: &Simulated) -> Vec<usize> {
    let Some(trace) = &result.trace else { return Vec::new() };
    let is_left = |vehicle: &usize| {
        let found = Usefulness::of(trace, &result.impacts, *vehicle).and_then(|useful| useful.following);
        scenario.is_under_test(*vehicle) && found.is_some_and(|following| following.left_behind)
    };
    (0..trace.vehicles.len()).filter(is_left).collect()
}

/// What the shield of a vehicle did, in a line; none if it did nothing.
fn shield_line(interventions: &[Intervention], vehicle: usize) -> Option<String> {
    let own = || interventions.iter().filter(move |one| one.vehicle == vehicle);
    let first_s = own().next()?.from_s;
    let braked_s: f64 = own().map(|one| one.to_s - one.from_s).sum();
    let times = match own().count() {
        1 => "once".to_owned(),
        n => format!("{n} times"),
    };
    let outside = if own().any(|one| one.outside_kernel) { "; nothing could be promised any more" } else { "" };
    let rear = if own().any(|one| one.rear_conflict) { "; the vehicle behind could not avoid it" } else { "" };
    Some(format!(
        "  the shield of vehicle {vehicle} braked {times}, {braked_s:.2} s in all, first at {first_s:.2} s{outside}{rear}"
    ))
}
