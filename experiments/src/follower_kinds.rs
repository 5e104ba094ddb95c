//! Compares controllers by kind of follower: collisions, unnecessary braking and comfort in a space that draws the
//! kind, such as `followers` and `everyday`.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- follower_kinds 7000 followers idm predictive road seed=909090
//! ```
//! The arguments are the number of random scenarios, the space (built in, or a file), and controllers, of which the
//! first is the reference.
//! `seed=N` takes other random scenarios, and `estimator=truth` shows the true state to the controllers.
//!
//! Columns: runs of this kind; collisions; those with the leader; collisions that the reference avoids, and collisions
//! of the reference that the controller avoids; unnecessary brakings per hour; drives with braking above 4 m/s² in
//! which the reference needs less than 3 m/s²; drives that fall behind; rms jerk relative to the reference; mean time
//! gap in s.

use std::collections::BTreeMap;
use std::path::Path;

use crate::ExperimentError;
use crumple::measure::UsefulnessMeasures;
use crumple::measure::{EASY_BRAKE_MPS2, HARD_BRAKE_MPS2};
use crumple::sim::engine::{NamedController, RecordingLevel, Run, RunOptions, simulate_batch};
use crumple::sim::observation::EstimatorKind;
use crumple::sim::scenario::Scenario;
use crumple::spaces::{ScenarioSpace, find_space};
use crumple_controllers::{Controllers, find_and_try};

const SEED: u64 = 0x6b69_6e64;
/// Scenarios simulated at once: each keeps its trace.
const BLOCK: u64 = 100;
/// Maximum number of random scenarios: a day's work.
const MAX_RUNS: u64 = 1_000_000;
/// Parameter whose value is the kind of follower.
const KIND_PARAMETER: &str = "follower";

struct Arguments {
    runs: u64,
    space: ScenarioSpace,
    controllers: Vec<NamedController>,
    seed: u64,
    estimator: EstimatorKind,
}

impl Arguments {
    fn parse(arguments: &[String]) -> Result<Self, ExperimentError> {
        let [runs, space, others @ ..] = arguments else {
            return Err("how many runs, and in which space?".into());
        };
        let count: u64 = runs
            .parse()
            .ok()
            .filter(|count| (1..=MAX_RUNS).contains(count))
            .ok_or_else(|| format!("`{runs}` is no number of runs from 1 to {MAX_RUNS}"))?;
        let mut parsed = Self {
            runs: count,
            space: find_space(space, &Controllers::default())?,
            controllers: Vec::new(),
            seed: SEED,
            estimator: EstimatorKind::Kalman,
        };
        for argument in others {
            if let Some(number) = argument.strip_prefix("seed=") {
                parsed.seed = number.parse()?;
            } else if argument == "estimator=truth" {
                parsed.estimator = EstimatorKind::Truth;
            } else {
                let controller = find_and_try(argument, Path::new(""))?;
                parsed.controllers.push(controller);
            }
        }
        if parsed.controllers.is_empty() {
            return Err("which controllers?".into());
        }
        Ok(parsed)
    }
}

/// Returns the kind of follower of random scenario `index` of `space`, or `any` if the space draws none.
pub(crate) fn follower_kind(space: &ScenarioSpace, seed: u64, index: u64) -> String {
    let values = space.values(&space.draw_point(seed, index));
    let parameters = space.coordinate_parameters().zip(values);
    let mut kinds = parameters.filter(|(parameter, _)| parameter.name() == KIND_PARAMETER);
    kinds.next().map_or_else(
        || "any".to_owned(),
        |(parameter, value)| parameter.format_value(value),
    )
}

/// Outcome of one drive.
#[derive(Debug, Clone, Copy, Default)]
struct DriveResult {
    duration_s: f64,
    collides: bool,
    collides_ahead: bool,
    hardest_mps2: f64,
    unnecessary: usize,
    fell_behind: bool,
    rms_jerk_mps3: f64,
    time_gap_s: Option<f64>,
}

#[derive(Debug, Clone, Default)]
struct Totals {
    runs: u64,
    hours: f64,
    collisions: u64,
    leader_collisions: u64,
    only_here: u64,
    only_reference: u64,
    unnecessary: usize,
    hard: u64,
    fell_behind: u64,
    squared_jerk: f64,
    time_gaps: u64,
    time_gap_s: f64,
}

impl Totals {
    fn add(&mut self, drive: &DriveResult, reference: &DriveResult) {
        self.runs += 1;
        self.hours += drive.duration_s / 3600.0;
        self.collisions += u64::from(drive.collides);
        self.leader_collisions += u64::from(drive.collides_ahead);
        self.only_here += u64::from(drive.collides && !reference.collides);
        self.only_reference += u64::from(!drive.collides && reference.collides);
        self.unnecessary += drive.unnecessary;
        self.hard += u64::from(
            drive.hardest_mps2 > HARD_BRAKE_MPS2 && reference.hardest_mps2 < EASY_BRAKE_MPS2,
        );
        self.fell_behind += u64::from(drive.fell_behind);
        self.squared_jerk += drive.rms_jerk_mps3.powi(2);
        self.time_gaps += u64::from(drive.time_gap_s.is_some());
        self.time_gap_s += drive.time_gap_s.unwrap_or(0.0);
    }

    fn print(&self, kind: &str, controller: &str, reference: &Self) {
        println!(
            "| {kind} | {controller} | {} | {} | {} | {} | {} | {:.2} | {} | {} | {:.2} | {:.2} |",
            self.runs,
            self.collisions,
            self.leader_collisions,
            self.only_here,
            self.only_reference,
            self.unnecessary as f64 / self.hours,
            self.hard,
            self.fell_behind,
            (self.squared_jerk / reference.squared_jerk).sqrt(),
            self.time_gap_s / self.time_gaps.max(1) as f64,
        );
    }
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let arguments = Arguments::parse(arguments)?;
    let mut totals: BTreeMap<(String, usize), Totals> = BTreeMap::new();
    for from in (0..arguments.runs).step_by(BLOCK as usize) {
        let indices = from..arguments.runs.min(from + BLOCK);
        let scenarios = indices
            .clone()
            .map(|index| arguments.space.draw(arguments.seed, index))
            .collect::<Result<Vec<_>, _>>()?;
        let drives = arguments
            .controllers
            .iter()
            .map(|controller| drive_all(&scenarios, controller, arguments.estimator))
            .collect::<Result<Vec<_>, _>>()?;
        for (position, index) in indices.enumerate() {
            let kind = follower_kind(&arguments.space, arguments.seed, index);
            for kind in [kind, "all".to_owned()] {
                for (number, of_controller) in drives.iter().enumerate() {
                    let reference = &drives[0][position];
                    let total = totals.entry((kind.clone(), number)).or_default();
                    total.add(&of_controller[position], reference);
                }
            }
        }
    }
    println!(
        "| follower | controller | runs | collisions | with the leader | only here | only reference | \
         unnecessary per hour | hard | fell behind | rms jerk | time gap s |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for ((kind, number), total) in &totals {
        let reference = &totals[&(kind.clone(), 0)];
        total.print(kind, &arguments.controllers[*number].name, reference);
    }
    Ok(())
}

/// Simulates scenarios with a controller.
fn drive_all(
    scenarios: &[Scenario],
    controller: &NamedController,
    estimator: EstimatorKind,
) -> Result<Vec<DriveResult>, ExperimentError> {
    let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
    let runs = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
        let mut drive = DriveResult {
            collides: result.outcome.collision().is_some(),
            collides_ahead: result
                .outcome
                .collision()
                .is_some_and(|collision| collision.front_vehicle == 0),
            hardest_mps2: result.vehicles[1].max_brake_mps2,
            ..DriveResult::default()
        };
        let Some(trace) = result.trace.as_ref() else {
            return drive;
        };
        drive.duration_s = trace.time_s.last().copied().unwrap_or(0.0);
        if let Some(measures) = UsefulnessMeasures::from_trace(trace, &result.impacts, 1) {
            drive.unnecessary = measures.unnecessary.count;
            drive.rms_jerk_mps3 = measures.rms_jerk_mps3.unwrap_or(0.0);
            drive.fell_behind = measures
                .following
                .is_some_and(|following| following.fell_behind);
            drive.time_gap_s = measures
                .following
                .and_then(|following| following.mean_time_gap_s);
        }
        drive
    }))
}
