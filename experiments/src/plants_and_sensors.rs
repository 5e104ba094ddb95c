//! Collisions by plant and by sensor fault: the tables of `reports/plants-and-sensors.md`.
//!
//! `plants_and_sensors RUNS CONTROLLER...` simulates the same RUNS random scenarios of `high-risk` with each
//! controller, plant and fault, and prints shares of collisions with exact 95 % intervals in percent. Then it prints
//! the collisions in the paper's scenarios with each plant. Controllers observe through the Kalman filter.

use crumple_controllers::Controllers;
use std::path::Path;

use crumple::spaces::{ScenarioSpace, built_in_space};
use crumple::world::scenario::{GhostObject, PlantKind, Scenario, SensorFaults, built_in_scenario};
use crumple::world::sim::{
    AfterContact, NamedController, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};
use crumple_core::interval::RateInterval;

use crate::ExperimentError;

const SEED: u64 = 55;
const BLOCK: u64 = 1000;
const PLANTS: [PlantKind; 2] = [PlantKind::PointMass, PlantKind::MultiBody];

type Condition = (&'static str, PlantKind, SensorFaults);

fn conditions() -> Vec<Condition> {
    let none = SensorFaults::default;
    let ghost = GhostObject {
        onset_s: 1.0,
        duration_s: 0.5,
        gap_m: 10.0,
        speed_mps: 0.0,
    };
    let faults = [
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
    ];
    let plants = [
        ("no fault", PLANTS[0], none()),
        ("multi-body", PLANTS[1], none()),
    ];
    plants
        .into_iter()
        .chain(faults.map(|(name, faults)| (name, PLANTS[0], faults)))
        .collect()
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let (runs, controllers) = arguments
        .split_first()
        .ok_or("the number of runs is missing")?;
    let runs = runs
        .parse()
        .map_err(|_| format!("`{runs}` is no number of runs"))?;
    let find = |name: &String| Controllers::default().find(name, Path::new(""));
    let controllers = controllers
        .iter()
        .map(find)
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
            .map(|controller| count_collisions(&space, controller, &condition, runs));
        let counts = counts.collect::<Result<Vec<_>, _>>()?;
        let cells = counts.iter().map(|&count| {
            let interval = RateInterval::clopper_pearson(count, runs, 0.95);
            let [share, low, high] = [count as f64 / runs as f64, interval.lower, interval.upper]
                .map(|share| 100.0 * share);
            format!("{share:.2} ({low:.2} to {high:.2})")
        });
        let cells: Vec<_> = cells.collect();
        let mut ranking: Vec<_> = counts.iter().zip(&names).collect();
        ranking.sort();
        let ranking: Vec<_> = ranking.into_iter().map(|(_, name)| *name).collect();
        println!(
            "| {} | {} | {} |",
            condition.0,
            cells.join(" | "),
            ranking.join(", ")
        );
    }
    for plant in PLANTS {
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
                .map(|controller| describe_impacts(&scenario, controller));
            println!(
                "| {name} | {} |",
                cells.collect::<Result<Vec<_>, _>>()?.join(" | ")
            );
        }
    }
    Ok(())
}

fn count_collisions(
    space: &ScenarioSpace,
    controller: &NamedController,
    (_, plant, faults): &Condition,
    runs: u64,
) -> Result<u64, ExperimentError> {
    let mut count = 0;
    for from in (0..runs).step_by(BLOCK as usize) {
        let prepare = |index| -> Result<Run, ExperimentError> {
            let scenario = space.draw(SEED, index)?.with_plant(*plant)?;
            let faulty = scenario.edited(|spec| spec.sensors.faults = faults.clone())?;
            Ok(Run::new(
                &faulty,
                RunOptions::new(controller.source.clone()),
            )?)
        };
        let block = (from..runs.min(from + BLOCK))
            .map(prepare)
            .collect::<Result<Vec<_>, _>>()?;
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
        RunOptions::new(controller.source.clone()).with_after_contact(AfterContact::Continue);
    let simulated = simulate(&Run::new(scenario, options)?, RecordingLevel::Summary);
    let impacts = simulated.impacts.iter().map(|impact| {
        let contact = &impact.contact;
        format!(
            "{} hits {} at {:.2} s, {:.1} m/s",
            contact.rear_vehicle, contact.front_vehicle, contact.time_s, contact.impact_speed_mps
        )
    });
    let impacts: Vec<_> = impacts.collect();
    Ok(if impacts.is_empty() {
        "no collision".to_owned()
    } else {
        impacts.join("; ")
    })
}
