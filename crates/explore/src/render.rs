//! Runs of a scenario on the page: verdicts, diagrams, and slider positions.

use crumple_core::quoting::{TerminalLines, TerminalText};
use crumple_measure::{DEFAULT_CLASS_WORDS, LevelMeasures, UnnecessaryBraking};
use crumple_report::draw::{
    self, MotionAxes, MotionFigure, PanelArrangement, draw_motion_on_axes, vehicle_names,
};
use crumple_sim::control::{TestDriverSettings, TestDriverSource, TwoSidedSettings};
use crumple_sim::engine::{
    NamedController, Outcome, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LeadProfile, Scenario};
use maud::{Markup, html};
use serde::Serialize;

use crate::catalog::Catalog;
use crate::error::RequestError;
use crate::request::{RunRequest, gaps_m, parse_test_driver};

const MAX_PAD_CELLS: usize = 60;

#[derive(Debug, Serialize)]
pub(crate) struct RunResponse {
    runs: Vec<RunPanel>,
    /// Diagrams of position, speed, gap, acceleration and time to collision, as SVG.
    figures: String,
    sliders: Sliders,
}

#[derive(Debug, Serialize)]
struct RunPanel {
    controller: String,
    /// `safe`, `collision` or `failed`.
    verdict: &'static str,
    summary: String,
    notes: Vec<String>,
    collision_time_s: Option<f64>,
}

#[derive(Debug, Serialize)]
pub(crate) struct Sliders {
    name: String,
    duration_s: f64,
    friction: f64,
    vehicles: Vec<VehicleSliders>,
    lead: LeadPad,
}

#[derive(Debug, Serialize)]
struct VehicleSliders {
    name: String,
    class: &'static str,
    driver: String,
    /// Gap; none for the first vehicle.
    gap_m: Option<f64>,
    speed_mps: f64,
}

#[derive(Debug, Serialize)]
struct LeadPad {
    cell_s: f64,
    /// Mean acceleration of its script in each cell; none without a script.
    accel_mps2: Option<Vec<f64>>,
    max_brake_mps2: f64,
    max_accel_mps2: f64,
}

pub(crate) fn run_and_render(
    mut request: RunRequest,
    catalog: &Catalog,
) -> Result<RunResponse, RequestError> {
    let scenario = request.take_scenario(catalog)?;
    let controllers = catalog.find_controllers(&request.controllers)?;
    let test_driver = parse_test_driver(request.test_driver.as_deref())?;
    let mut runs = Vec::new();
    let mut panels = Vec::new();
    for controller in &controllers {
        let options = run_options(controller, test_driver.as_ref(), request.estimator);
        let run = Run::new(&scenario, options)
            .map_err(|error| RequestError::invalid("controllers", error))?;
        let result = simulate(&run, RecordingLevel::Trace);
        let mut panel = render_panel(controller, &scenario, &result);
        panel.notes.extend(level_notes(&run, &result));
        panels.push(panel);
        runs.push((*controller, result));
    }
    Ok(RunResponse {
        runs: panels,
        figures: render_figures(&scenario, &runs, request.narrow),
        sliders: Sliders::new(&scenario),
    })
}

/// Returns the options of a run in which a test driver, if there is one, drives with the controller.
fn run_options(
    controller: &NamedController,
    test_driver: Option<&TestDriverSettings>,
    estimator: EstimatorKind,
) -> RunOptions {
    let alone = controller.source.clone();
    let options = match test_driver {
        Some(settings) => RunOptions::new(TestDriverSource {
            controller: alone,
            settings: settings.clone(),
        }),
        None => RunOptions::new(alone),
    };
    options.with_estimator(estimator)
}

fn render_panel(
    controller: &NamedController,
    scenario: &Scenario,
    run: &SimulationResult,
) -> RunPanel {
    RunPanel {
        controller: escape_text(&controller.name),
        verdict: match &run.outcome {
            Outcome::Collision(_) => "collision",
            Outcome::ControllerFailed(_) => "failed",
            Outcome::NoCollision => "safe",
        },
        summary: escape_text(&describe_outcome(scenario, run)),
        notes: run_notes(controller, scenario, run),
        collision_time_s: run.outcome.collision().map(|collision| collision.time_s),
    }
}

fn describe_outcome(scenario: &Scenario, run: &SimulationResult) -> String {
    match &run.outcome {
        Outcome::Collision(collision) => format!("✗ Collision {collision}"),
        Outcome::ControllerFailed(failed) => format!("✗ Controller failed: {failed}"),
        Outcome::NoCollision => {
            let closest = run
                .vehicles
                .iter()
                .filter_map(|vehicle| vehicle.min_gap_m)
                .fold(f64::INFINITY, f64::min);
            let gap = if closest.is_finite() {
                format!(", smallest gap {closest:.2} m")
            } else {
                String::new()
            };
            format!("✓ No collision in {} s{gap}", scenario.spec().duration_s)
        }
    }
}

/// Returns what limits the meaning of a run, and which vehicles under test brake unnecessarily.
fn run_notes(
    controller: &NamedController,
    scenario: &Scenario,
    run: &SimulationResult,
) -> Vec<String> {
    let mut notes = Vec::new();
    if !scenario.has_vehicle_under_test() {
        notes.push("no vehicle is under test: the drivers of the scenario drive".to_owned());
    }
    if !controller.source.is_deterministic() {
        notes.push(
            "the controller declares that it is not deterministic: another run may end differently"
                .to_owned(),
        );
    }
    for vehicle in (0..scenario.vehicles().len()).filter(|&vehicle| scenario.is_under_test(vehicle))
    {
        let braking = run
            .trace
            .as_ref()
            .and_then(|trace| UnnecessaryBraking::from_trace(trace, &run.impacts, vehicle));
        if let Some(braking) = braking.filter(|braking| braking.hardest.is_some()) {
            notes.push(format!(
                "vehicle {vehicle} brakes unnecessarily for {:.2} s",
                braking.time_s
            ));
        }
    }
    notes
}

/// Returns the levels of the vehicles under test, with the class of followers for which they hold.
fn level_notes(run: &Run, result: &SimulationResult) -> Vec<String> {
    LevelMeasures::of_vehicles_under_test(run, result, &TwoSidedSettings::default())
        .into_iter()
        .filter_map(|(_, level)| level.ok())
        .map(|level| format!("{}; for {DEFAULT_CLASS_WORDS}", level.describe()))
        .collect()
}

/// Escapes control and bidirectional characters in markup, which names can contain.
pub(crate) fn escape_markup(markup: &Markup) -> String {
    TerminalLines(&markup.0).to_string()
}

/// Escapes invisible characters in foreign text.
pub(crate) fn escape_text(text: &str) -> String {
    TerminalText(text).to_string()
}

fn render_figures(
    scenario: &Scenario,
    runs: &[(&NamedController, SimulationResult)],
    narrow: bool,
) -> String {
    let labels = vehicle_names(scenario);
    let traced: Vec<_> = runs
        .iter()
        .filter_map(|(controller, run)| Some((*controller, run, run.trace.as_ref()?)))
        .collect();
    let axes = MotionAxes::from_traces(traced.iter().map(|(_, _, trace)| *trace));
    let layout = match (narrow, traced.len()) {
        (true, _) => PanelArrangement::Stacked,
        (false, 1) => PanelArrangement::Wide,
        (false, _) => PanelArrangement::Column,
    };
    let markup = html! {
        div.side-by-side data-columns=(if narrow { 1 } else { traced.len().min(2) }) {
            @for (index, (controller, run, trace)) in traced.iter().enumerate() {
                @let prefix = format!("motion-{index}");
                @let figure = MotionFigure {
                    prefix: &prefix, title: &controller.name, labels: &labels, trace, impacts: &run.impacts
                };
                (draw_motion_on_axes(&figure, &axes, layout))
            }
        }
    };
    escape_markup(&markup)
}

/// Renders the diagrams of a run. `scenario` is the original one: in an escape, a script drives the vehicle under test.
pub(crate) fn render_replay(scenario: &Scenario, run: &SimulationResult, title: &str) -> String {
    let Some(trace) = &run.trace else {
        return String::new();
    };
    let labels = vehicle_names(scenario);
    let figure = MotionFigure {
        prefix: "escape",
        title,
        labels: &labels,
        trace,
        impacts: &run.impacts,
    };
    escape_markup(&draw::draw_motion_responsive(&figure))
}

impl Sliders {
    pub(crate) fn new(scenario: &Scenario) -> Self {
        let spec = scenario.spec();
        let gaps_m = gaps_m(spec);
        let names = vehicle_names(scenario);
        let vehicles = spec
            .vehicles
            .iter()
            .enumerate()
            .map(|(index, vehicle)| VehicleSliders {
                name: names.get(index).cloned().unwrap_or_default(),
                class: vehicle.class.name(),
                driver: match &vehicle.driver {
                    Driver::Controller(controller) => controller.to_arg(),
                    driver => driver.name().to_owned(),
                },
                gap_m: index
                    .checked_sub(1)
                    .and_then(|before| gaps_m.get(before).copied()),
                speed_mps: vehicle.speed_mps,
            });
        Self {
            name: spec.name.clone(),
            duration_s: spec.duration_s,
            friction: spec.environment.friction,
            vehicles: vehicles.collect(),
            lead: LeadPad::new(scenario),
        }
    }
}

impl LeadPad {
    fn new(scenario: &Scenario) -> Self {
        let spec = scenario.spec();
        let steps = scenario.steps();
        let cell_steps = steps.div_ceil(MAX_PAD_CELLS).max(1);
        let lead = spec.vehicles.first();
        let script = lead.and_then(|lead| match &lead.driver {
            Driver::Profile(profile) => Some(mean_accelerations(
                profile,
                lead.speed_mps,
                spec.step_s,
                steps,
                cell_steps,
            )),
            _ => None,
        });
        Self {
            cell_s: cell_steps as f64 * spec.step_s,
            accel_mps2: script,
            max_brake_mps2: lead.map_or(0.0, |lead| lead.max_brake_mps2()),
            max_accel_mps2: lead.map_or(0.0, |lead| lead.max_accel_mps2()),
        }
    }
}

/// Returns the mean acceleration that a script commands in each cell.
fn mean_accelerations(
    profile: &LeadProfile,
    mut speed_mps: f64,
    step_s: f64,
    steps: usize,
    cell_steps: usize,
) -> Vec<f64> {
    let mut means = Vec::new();
    for first in (0..steps).step_by(cell_steps) {
        let cell = first..steps.min(first + cell_steps);
        let count = cell.len() as f64;
        let mut sum = 0.0;
        for step in cell {
            let accel_mps2 = profile.acceleration_mps2(
                step as f64 * step_s,
                (step + 1) as f64 * step_s,
                speed_mps,
            );
            sum += accel_mps2;
            speed_mps = (speed_mps + accel_mps2 * step_s).max(0.0);
        }
        means.push((1e6 * sum / count).round() / 1e6 + 0.0);
    }
    means
}
