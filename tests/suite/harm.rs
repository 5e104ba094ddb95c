//! Harm: its count in an assessment, as a search objective, and the space variants with a human.

use crumple_controllers::Controllers;
use crumple_core::interval::RateInterval;
use crumple_core::observer::Quiet;
use crumple_measure::harm_of_pair;
use crumple_report::assessment::{BrakeAfterCollision, HarmConfig};
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, SearchObjective};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate_batch};
use crumple_sim::scenario::NoDriverFiles;
use crumple_sim::scenario::file;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;

use crate::assessments::{config, run};

/// The figures of the report are those of its runs, and a brake that never fires avoids and causes nothing.
#[test]
fn the_count_of_harm_is_that_of_its_runs() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut config = config(&["emergency-brake,ttc_s=0", "emergency-brake", "predictive"]);
    (config.distributions, config.everyday_draws) = (Some(vec!["high-risk-human".to_owned()]), 0);
    let mut harm = HarmConfig::default();
    (harm.emergencies_per_hour, harm.avoid_draws) = (0.1, 3);
    config.harm = Some(harm);
    let report = run(config, folder.path());
    let files = report.files().expect("encodes");
    let (_, csv) = files
        .iter()
        .find(|(name, _)| name == "runs.csv")
        .expect("written");
    let rows: Vec<Vec<&str>> = std::str::from_utf8(csv)
        .expect("text")
        .lines()
        .skip(1)
        .map(|line| line.rsplit(',').collect())
        .collect();
    let groups = &report.results.harm.as_ref().expect("counted").groups;
    assert_eq!(rows.len(), 120);
    let (all, rest) = groups.split_first().expect("a group");
    assert_eq!(
        (all.follower.as_str(), all.drives, all.avoidable[2]),
        ("all", 40, 3)
    );
    assert_eq!(rest.iter().map(|group| group.drives).sum::<u64>(), 40);
    for (controller, rows) in all.controllers.iter().zip(rows.chunks(40)) {
        // From the end of a row: harm, pushed, behind, ahead, activates.
        let count = |column: usize| {
            rows.iter()
                .filter(|row| !["", "0"].contains(&row[column]))
                .count() as u64
        };
        assert_eq!(controller.activations, count(4));
        let ahead = RateInterval::clopper_pearson(count(3), 40, 0.95);
        assert!((controller.ahead_percent.upper.value() - 100.0 * ahead.upper).abs() < 0.011);
        assert!((controller.behind_percent.observed.value() - 2.5 * count(2) as f64).abs() < 1e-9);
        let harm: f64 = rows
            .iter()
            .map(|row| row[0].parse::<f64>().expect("a number"))
            .sum();
        assert!((controller.harm_per_1000.0.value() - 25.0 * harm).abs() < 1e-3);
    }
    let [never, brake, _] = &all.controllers[..] else {
        panic!("three")
    };
    assert_eq!((never.activations, never.avoided, never.caused), (0, 0, 0));
    assert!(brake.activations > 0 && brake.avoided > 0, "{brake:?}");
}

/// A car that never brakes hits its leader as often with both settings. It is hit from behind more often if it then
/// stops, and the same seed gives the same drives.
#[test]
fn a_car_holds_its_brake_or_coasts_after_its_impact() {
    let counts = [BrakeAfterCollision::Hold, BrakeAfterCollision::Coast].map(|after_collision| {
        let folder = tempfile::tempdir().expect("a folder");
        let mut config = config(&["emergency-brake,ttc_s=0"]);
        (config.distributions, config.everyday_draws) =
            (Some(vec!["high-risk-human".to_owned()]), 0);
        let mut harm = HarmConfig::default();
        (harm.emergencies_per_hour, harm.after_collision) = (0.1, after_collision);
        config.harm = Some(harm);
        let report = run(config, folder.path());
        let all = &report.results.harm.as_ref().expect("counted").groups[0].controllers[0];
        [all.ahead_percent, all.behind_percent].map(|share| share.observed.value())
    });
    let [[held_ahead, held_behind], [coasting_ahead, coasting_behind]] = counts;
    assert!(held_behind > coasting_behind, "{counts:?}");
    assert!((held_ahead - coasting_ahead).abs() < 1e-9, "{counts:?}");
}

/// In `high-risk` followers hit a car under test. The most harmful collision is that of a fast lorry.
#[test]
fn a_search_for_harm_finds_a_fast_lorry() {
    let folder = tempfile::tempdir().expect("a folder");
    let space = built_in_space("high-risk").expect("built in");
    let controller = Controllers::default()
        .find("baseline", folder.path())
        .expect("built in");
    let campaign = Campaign::new(controller, space)
        .with_method(Method::CmaEs)
        .with_objective(SearchObjective::Harm)
        .with_budget(300);
    let results = folder.path().join("harm");
    let summary = campaign.run(&results, false, &Quiet).expect("runs");
    let harms = summary.counterexamples.iter().map(|counterexample| {
        let scenario =
            file::load(&results.join(&counterexample.file), &NoDriverFiles).expect("written");
        let mass_kg =
            |vehicle: Option<usize>| scenario.vehicles()[vehicle.expect("a collision")].mass_kg();
        let masses_kg = [
            mass_kg(counterexample.front_vehicle.map(as_index)),
            mass_kg(counterexample.rear_vehicle.map(as_index)),
        ];
        (
            harm_of_pair(
                counterexample.impact_speed_mps.expect("a collision"),
                masses_kg,
            ),
            masses_kg[1],
        )
    });
    let (harm, rear_kg) = harms.max_by(|a, b| a.0.total_cmp(&b.0)).expect("a failure");
    assert!(harm > 0.15 && rear_kg > 5000.0, "{harm} {rear_kg}");
}

fn as_index(vehicle: u32) -> usize {
    vehicle as usize
}

/// A human follows a car-following model in everyday traffic without a collision, also from other drivers' gaps.
#[test]
fn a_human_behind_idm_collides_in_no_everyday_traffic() {
    let space = built_in_space("traffic-human").expect("built in");
    let options = RunOptions::new(crumple_sim::control::BuiltInController::Idm(
        Default::default(),
    ));
    let runs: Vec<_> = (0..200)
        .map(|index| {
            Run::new(&space.draw(3, index).expect("valid"), options.clone()).expect("valid")
        })
        .collect();
    let safe = simulate_batch(&runs, RecordingLevel::Summary, |_, result| {
        result.outcome.is_safe()
    });
    assert_eq!(safe.iter().filter(|&&safe| !safe).count(), 0);
}
