//! Measures the two-sided shield: closed loops, shares of its set, and times.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- two_sided loops 100000
//! cargo run --release -p crumple-experiments -- two_sided shares high-risk 2000 level=4.5
//! cargo run --release -p crumple-experiments -- two_sided runs high-risk 1000 idm shield2:idm shield2,raise=1:idm
//! cargo run --release -p crumple-experiments -- two_sided avoid high-risk 160
//! cargo run --release -p crumple-experiments -- follower_kinds 7000 followers idm shield2:idm estimator=truth
//! ```
//! `loops` simulates closed loops with reckless controllers, leaders at random or found by a search, and followers of
//! the class, half of them with errors, delay, lag and noise; a second number is the first index. It prints the loops
//! that start in S, collisions, and loops that left S. `shares` prints the share of random scenarios of a space that
//! start in S at the true state, with the settings of a shield. `runs` simulates controllers in a space, with the true
//! state. `avoid` compares states outside S with the escapes that `crumple avoid` finds behind a leader that brakes at
//! its limit from the start. `follower_kinds` prints a table by kind of follower.

mod avoid;

use std::time::Instant;

use rayon::prelude::*;

use crate::ExperimentError;
use crate::closed_loop::TwoSidedLoop;
use crumple::controllers::find_and_try;
use crumple::measure::UsefulnessMeasures;
use crumple::sim::control::{LevelMeter, TwoSidedParams, TwoSidedSettings};
use crumple::sim::engine::{RecordingLevel, Run, RunOptions, Stepper, simulate_batch};
use crumple::sim::observation::EstimatorKind;
use crumple::sim::scenario::Scenario;
use crumple::spaces::{ScenarioSpace, built_in_space};
use rand::SeedableRng;
use rand::rngs::Xoshiro256PlusPlus;

const SEED: u64 = 0x7477_6f73;
const MAX_RUNS: u64 = 10_000_000;
/// Changes of the leader that the search in a closed loop tries.
const CHANGES: usize = 10;

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let [mode, rest @ ..] = arguments else {
        return Err("loops, shares, runs or avoid?".into());
    };
    match mode.as_str() {
        "loops" => loops(rest),
        "shares" => shares(rest),
        "runs" => runs(rest),
        "avoid" => avoid::run(rest),
        other => Err(format!("`{other}` is no kind of measurement").into()),
    }
}

fn parse_count(text: Option<&String>) -> Result<u64, ExperimentError> {
    text.and_then(|text| text.parse().ok())
        .filter(|count| (1..=MAX_RUNS).contains(count))
        .ok_or_else(|| format!("how many runs, from 1 to {MAX_RUNS}?").into())
}

#[derive(Default, Clone)]
struct LoopTotals {
    inside: u64,
    collisions: u64,
    left_set: u64,
    steps: u64,
    replaced: u64,
    searched: u64,
}

impl LoopTotals {
    fn add(mut self, other: &Self) -> Self {
        self.inside += other.inside;
        self.collisions += other.collisions;
        self.left_set += other.left_set;
        self.steps += other.steps;
        self.replaced += other.replaced;
        self.searched += other.searched;
        self
    }

    fn add_run(&mut self, closed_loop: &TwoSidedLoop) -> Option<f64> {
        let result = closed_loop.run();
        if !result.is_in_set {
            return None;
        }
        self.inside += 1;
        self.steps += result.steps as u64;
        self.replaced += result.replaced as u64;
        self.left_set += u64::from(result.left_set);
        self.collisions += u64::from(result.has_collision());
        if result.has_collision() || result.left_set {
            println!("{result:?} {closed_loop:?}");
        }
        Some(result.min_gaps_m[0].min(result.min_gaps_m[1]))
    }
}

fn loops(arguments: &[String]) -> Result<(), ExperimentError> {
    let count = parse_count(arguments.first())?;
    let first = match arguments.get(1) {
        Some(text) => text.parse::<u64>()?,
        None => 0,
    };
    let begin = Instant::now();
    let totals = (first..first.saturating_add(count))
        .into_par_iter()
        .map(closed_loop_totals)
        .reduce(LoopTotals::default, |sum, one| sum.add(&one));
    println!(
        "{} loops start in S ({} of them in a search of the leader), {} steps, {} replaced: {} collisions, {} left S; \
         {:.1} s",
        totals.inside,
        totals.searched,
        totals.steps,
        totals.replaced,
        totals.collisions,
        totals.left_set,
        begin.elapsed().as_secs_f64()
    );
    Ok(())
}

/// Simulates a closed loop at random, and one in ten also with leaders of a hill-climbing search.
fn closed_loop_totals(index: u64) -> LoopTotals {
    let mut totals = LoopTotals::default();
    let mut best = TwoSidedLoop::random(SEED.wrapping_add(index), index.is_multiple_of(2));
    let Some(mut least_m) = totals.add_run(&best) else {
        return totals;
    };
    if index.is_multiple_of(10) {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
        for _ in 0..CHANGES {
            let changed = best.with_changed_leader(&mut random);
            if let Some(min_m) = totals.add_run(&changed) {
                totals.searched += 1;
                if min_m < least_m {
                    (least_m, best) = (min_m, changed);
                }
            }
        }
    }
    totals
}

/// Parses a space, a number of scenarios, and settings of the shield.
fn parse_scenarios(
    arguments: &[String],
) -> Result<(ScenarioSpace, u64, TwoSidedSettings), ExperimentError> {
    let [space, count, settings @ ..] = arguments else {
        return Err("which space, and how many scenarios?".into());
    };
    let settings: String = settings.iter().map(|text| format!(",{text}")).collect();
    Ok((
        built_in_space(space).ok_or("no such space")?,
        parse_count(Some(count))?,
        TwoSidedSettings::parse(&settings)?,
    ))
}

fn shares(arguments: &[String]) -> Result<(), ExperimentError> {
    let (space, count, settings) = parse_scenarios(arguments)?;
    let begin = Instant::now();
    let inside = (0..count)
        .into_par_iter()
        .map(|index| -> Result<bool, ExperimentError> {
            let scenario = space.draw(SEED, index)?;
            starts_inside(&scenario, &settings)
        })
        .collect::<Result<Vec<_>, _>>()?;
    let inside = inside.iter().filter(|&&inside| inside).count();
    println!(
        "{inside} of {count} start in S: {:.1} %; {:.1} s",
        100.0 * inside as f64 / count as f64,
        begin.elapsed().as_secs_f64()
    );
    Ok(())
}

fn starts_inside(
    scenario: &Scenario,
    settings: &TwoSidedSettings,
) -> Result<bool, ExperimentError> {
    let (params, mut meter) = start(scenario, settings)?;
    Ok(meter.keeps(params.level_mps2))
}

/// Returns the parameters of a shield of a scenario, and a meter that has observed the initial state.
fn start(
    scenario: &Scenario,
    settings: &TwoSidedSettings,
) -> Result<(TwoSidedParams, LevelMeter), ExperimentError> {
    let idm = find_and_try("idm", std::path::Path::new(""))?;
    let options = RunOptions::new(idm.source).with_estimator(EstimatorKind::Truth);
    let run = Run::new(scenario, options)?;
    let params = run.two_sided_shield(1, settings)?;
    let mut stepper = Stepper::new(&run, RecordingLevel::Summary);
    let observation = stepper.observe(1).ok_or("no observation")?;
    let mut meter = LevelMeter::new(params);
    meter.observe(&observation);
    Ok((params, meter))
}

fn runs(arguments: &[String]) -> Result<(), ExperimentError> {
    let [space, count, controllers @ ..] = arguments else {
        return Err("which space, how many scenarios, and which controllers?".into());
    };
    let count = parse_count(Some(count))?;
    let space = built_in_space(space).ok_or("no such space")?;
    let scenarios = (0..count)
        .map(|index| space.draw(SEED, index))
        .collect::<Result<Vec<_>, _>>()?;
    println!(
        "| controller | collisions | with the leader | runs with interventions | interventions an hour | rms jerk |"
    );
    println!("|---|---|---|---|---|---|");
    for name in controllers {
        let controller = find_and_try(name, std::path::Path::new(""))?;
        let options = RunOptions::new(controller.source).with_estimator(EstimatorKind::Truth);
        let mut sums = [0.0_f64; 5];
        let mut hours = 0.0;
        for block in scenarios.chunks(100) {
            let runs = block
                .iter()
                .map(|scenario| Run::new(scenario, options.clone()))
                .collect::<Result<Vec<_>, _>>()?;
            let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
                let collision = result.outcome.collision();
                let jerk = result.trace.as_ref().and_then(|trace| {
                    UsefulnessMeasures::from_trace(trace, &result.impacts, 1)?.rms_jerk_mps3
                });
                [
                    f64::from(collision.is_some()),
                    f64::from(collision.is_some_and(|collision| collision.front_vehicle == 0)),
                    f64::from(!result.interventions.is_empty()),
                    result.interventions.len() as f64,
                    jerk.unwrap_or(0.0).powi(2),
                ]
            });
            for result in results {
                sums.iter_mut()
                    .zip(result)
                    .for_each(|(sum, one)| *sum += one);
            }
            hours += block
                .iter()
                .map(|scenario| scenario.spec().duration_s / 3600.0)
                .sum::<f64>();
        }
        let percent = 100.0 / count as f64;
        println!(
            "| {name} | {:.2} % | {:.2} % | {:.1} % | {:.1} | {:.3} |",
            percent * sums[0],
            percent * sums[1],
            percent * sums[2],
            sums[3] / hours,
            (sums[4] / count as f64).sqrt(),
        );
    }
    Ok(())
}
