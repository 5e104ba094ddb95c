//! Collisions by plant and by sensor fault: the tables of `reports/plants-and-sensors.md`.
//!
//! `plants_and_sensors RUNS CONTROLLER...` simulates the same RUNS random scenarios of `high-risk` with each
//! controller, plant and fault, and prints shares of collisions with exact 95 % intervals in percent. Then it prints
//! the collisions in the paper's scenarios with each plant. Controllers observe through the Kalman filter.

use crumple_controllers::Controllers;
use std::path::Path;

use crumple::sim::engine::{
    AfterCollision, NamedController, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};
use crumple::sim::scenario::{GhostObject, PlantKind, Scenario, SensorFaults, built_in_scenario};
use crumple::spaces::{ScenarioSpace, built_in_space};
use crumple_core::interval::RateInterval;

use crate::ExperimentError;

const SEED: u64 = 55;
const BLOCK: u64 = 1000;
const PLANTS: [PlantKind; 2] = [PlantKind::PointMass, PlantKind::MultiBody];

/// Plant and sensor faults of a row of the table.
struct SensorCondition {
    name: &'static str,
    plant: PlantKind,
    faults: SensorFaults,
}

fn conditions() -> Vec<SensorCondition> {
    let no_fault = SensorCondition {
        name: "no fault",
        plant: PlantKind::PointMass,
        faults: SensorFaults::default(),
    };
    let multi_body = SensorCondition {
        name: "multi-body",
        plant: PlantKind::MultiBody,
        faults: SensorFaults::default(),
    };
    let faulty = sensor_faults().map(|(name, faults)| SensorCondition {
        name,
        plant: PlantKind::PointMass,
        faults,
    });
    [no_fault, multi_body].into_iter().chain(faulty).collect()
}

fn sensor_faults() -> [(&'static str, SensorFaults); 7] {
    let none = SensorFaults::default;
    let ghost = GhostObject {
        onset_s: 1.0,
        duration_s: 0.5,
        gap_m: 10.0,
        speed_mps: 0.0,
    };
    [
        (
            "latency 0.2 s",
            SensorFaults {
                latency_s: 0.2,
                ..none()
            },
        ),
        (
            "gap bias +1 m",
            SensorFaults {
                gap_bias_m: 1.0,
                ..none()
            },
        ),
        (
            "resolution 1 m",
            SensorFaults {
                gap_resolution_m: 1.0,
                ..none()
            },
        ),
        (
            "outages: 0.5 per s, 0.5 s",
            SensorFaults {
                outage_rate_per_s: 0.5,
                outage_length_s: 0.5,
                ..none()
            },
        ),
        (
            "range 10 m",
            SensorFaults {
                range_m: Some(10.0),
                ..none()
            },
        ),
        (
            "range 10 m, detection after 0.5 s",
            SensorFaults {
                range_m: Some(10.0),
                detection_delay_s: 0.5,
                ..none()
            },
        ),
        (
            "ghost: standing, 10 m ahead, from 1 s for 0.5 s",
            SensorFaults {
                ghost: Some(ghost),
                ..none()
            },
        ),
    ]
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let [runs, controllers @ ..] = arguments else {
        return Err("the number of runs is missing".into());
    };
    let runs = runs
        .parse()
        .map_err(|_| format!("`{runs}` is no number of runs"))?;
    let controllers = controllers
        .iter()
        .map(|name| Controllers::default().find(name, Path::new("")))
        .collect::<Result<Vec<_>, _>>()?;
    let space = built_in_space("high-risk").ok_or("no such space")?;
    let names: Vec<_> = controllers
        .iter()
        .map(|controller| controller.name.as_str())
        .collect();
    println!(
        "| condition | {} | ranking |\n|---|{}---|",
        names.join(" | "),
        "---|".repeat(names.len())
    );
    for condition in conditions() {
        let counts = controllers
            .iter()
            .map(|controller| count_collisions(&space, controller, &condition, runs))
            .collect::<Result<Vec<_>, _>>()?;
        print_counts(condition.name, &counts, &names, runs);
    }
    PLANTS
        .into_iter()
        .try_for_each(|plant| print_paper_collisions(plant, &controllers, &names))
}

/// Prints the shares of collisions under a condition, and the controllers with the safest first.
fn print_counts(condition: &str, counts: &[u64], names: &[&str], runs: u64) {
    let cells: Vec<String> = counts
        .iter()
        .map(|&count| {
            let interval = RateInterval::clopper_pearson(count, runs, 0.95);
            let [share, low, high] = [count as f64 / runs as f64, interval.lower, interval.upper]
                .map(|share| 100.0 * share);
            format!("{share:.2} ({low:.2} to {high:.2})")
        })
        .collect();
    let mut ranking: Vec<_> = counts.iter().zip(names).collect();
    ranking.sort();
    let ranking: Vec<_> = ranking.into_iter().map(|(_, name)| *name).collect();
    println!(
        "| {condition} | {} | {} |",
        cells.join(" | "),
        ranking.join(", ")
    );
}

/// Prints the collisions in the scenarios of the paper with a plant.
fn print_paper_collisions(
    plant: PlantKind,
    controllers: &[NamedController],
    names: &[&str],
) -> Result<(), ExperimentError> {
    println!(
        "\n| {} | {} |\n|---|{}",
        plant.name(),
        names.join(" | "),
        "---|".repeat(names.len())
    );
    for name in ["paper-1", "paper-2", "paper-3"] {
        let scenario = built_in_scenario(name)
            .ok_or("no such scenario")?
            .with_plant(plant)?;
        let cells = controllers
            .iter()
            .map(|controller| describe_impacts(&scenario, controller))
            .collect::<Result<Vec<_>, _>>()?;
        println!("| {name} | {} |", cells.join(" | "));
    }
    Ok(())
}

fn count_collisions(
    space: &ScenarioSpace,
    controller: &NamedController,
    condition: &SensorCondition,
    runs: u64,
) -> Result<u64, ExperimentError> {
    let mut count = 0;
    for from in (0..runs).step_by(BLOCK as usize) {
        let block = (from..runs.min(from + BLOCK))
            .map(|index| {
                let scenario = space.draw(SEED, index)?.with_plant(condition.plant)?;
                let faulty =
                    scenario.edited(|spec| spec.sensors.faults = condition.faults.clone())?;
                let options = RunOptions::new(controller.source.clone());
                Ok(Run::new(&faulty, options)?)
            })
            .collect::<Result<Vec<_>, ExperimentError>>()?;
        let failed = simulate_batch(&block, RecordingLevel::Summary, |_, simulated| {
            !simulated.outcome.is_safe()
        });
        count += failed.into_iter().filter(|failed| *failed).count() as u64;
    }
    Ok(count)
}

fn describe_impacts(
    scenario: &Scenario,
    controller: &NamedController,
) -> Result<String, ExperimentError> {
    let options =
        RunOptions::new(controller.source.clone()).with_after_collision(AfterCollision::Continue);
    let simulated = simulate(&Run::new(scenario, options)?, RecordingLevel::Summary);
    let impacts = simulated.impacts.iter().map(|impact| {
        let collision = &impact.collision;
        format!(
            "{} hits {} at {:.2} s, {:.1} m/s",
            collision.rear_vehicle,
            collision.front_vehicle,
            collision.time_s,
            collision.impact_speed_mps
        )
    });
    let impacts: Vec<_> = impacts.collect();
    Ok(if impacts.is_empty() {
        "no collision".to_owned()
    } else {
        impacts.join("; ")
    })
}
