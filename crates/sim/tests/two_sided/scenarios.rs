//! Two-sided shields in scenarios: those in which one collided although its first state was in S, and scenarios at
//! random.

use std::path::Path;
use std::sync::Arc;

use crumple_sim::control::{
    BuiltInController, LevelMeter, ShieldKind, TwoSidedFilter, TwoSidedSettings,
};
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, ShieldedSource, Stepper, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{NoDriverFiles, Scenario, file};
use proptest::prelude::*;

fn run_behind_shield(scenario: &Scenario, controller: &str) -> Run {
    let controller = BuiltInController::from_name(controller).unwrap();
    let source = ShieldedSource {
        controller: Arc::new(controller),
        settings: ShieldKind::BothSides(TwoSidedSettings::default()),
    };
    let options = RunOptions::new(source).with_estimator(EstimatorKind::Truth);
    Run::new(scenario, options).unwrap()
}

/// Tests that the filter has a plan at its first step if the meter of levels finds one, and that no collision follows.
/// Returns true if the meter finds a plan.
fn check_from_start(run: &Run) -> Result<bool, TestCaseError> {
    let params = run
        .two_sided_shield(1, &TwoSidedSettings::default())
        .unwrap();
    let first = Stepper::new(run, RecordingLevel::Summary)
        .observe(1)
        .unwrap();
    let mut meter = LevelMeter::new(params);
    meter.observe(&first);
    if !meter.keeps(params.level_mps2) {
        return Ok(false);
    }
    let mut filter = TwoSidedFilter::new(params);
    filter.decide(&first, params.accel_mps2);
    prop_assert!(filter.level_mps2() >= Some(params.level_mps2));
    let result = simulate(run, RecordingLevel::Summary);
    prop_assert_eq!(result.outcome.collision(), None);
    Ok(true)
}

#[test]
fn kept_failures_start_in_s_and_no_longer_collide() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../corpora/two-sided");
    let kept = file::load_all(&folder, &NoDriverFiles).unwrap();
    assert!(kept.len() >= 2);
    for (path, scenario) in kept {
        for controller in ["idm", "full-throttle"] {
            let starts_in_s = check_from_start(&run_behind_shield(&scenario, controller));
            assert!(
                matches!(starts_in_s, Ok(true)),
                "{}: {controller}: {starts_in_s:?}",
                path.display()
            );
        }
    }
}

prop_compose! {
    /// A scenario with gaps from 3 to 160 m, on any road, whose leader brakes fully twice. The follower's reaction
    /// takes whole steps.
    fn scenarios()(
        gaps_m in prop::array::uniform2(3.0..160.0),
        speed_mps in 0.0..35.0_f64,
        faster_mps in prop::array::uniform2(-6.0..6.0),
        friction in 0.1..=1.0,
        reaction_steps in 0..100_u32,
        follower in prop::sample::select(vec!["light", "heavy"]),
        from_s in prop::array::uniform2(0.0..5.0),
        accel_mps2 in -7.5..2.0,
    ) -> String {
        let [gap_m, rear_gap_m]: [f64; 2] = gaps_m;
        let own_m = 1000.0 - 4.5 - gap_m;
        let rear_m = own_m - 4.5 - rear_gap_m;
        let [ahead_mps, rear_mps] = faster_mps.map(|faster_mps: f64| (speed_mps + faster_mps).max(0.0));
        let [first_s, after_s]: [f64; 2] = from_s;
        let second_s = first_s + after_s + 0.01;
        let reaction_s = f64::from(reaction_steps) / 100.0;
        format!("\
version = 1
name = \"random\"
about = \"A scenario at random.\"
duration_s = 30.0
step_s = 0.01
seed = 0
[[vehicles]]
class = \"light\"
position_m = 1000.0
length_m = 4.5
speed_mps = {ahead_mps}
[vehicles.driver.pieces]
from_s = [{first_s:.2}, {second_s:.2}]
accel_mps2 = [{accel_mps2}, -7.5]
[[vehicles]]
class = \"light\"
position_m = {own_m}
length_m = 4.5
speed_mps = {speed_mps}
driver = \"under-test\"
[[vehicles]]
class = \"{follower}\"
position_m = {rear_m}
speed_mps = {rear_mps}
driver = \"baseline\"
reaction_delay_s = {reaction_s}
[environment]
friction = {friction}
")
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(500))]

    #[test]
    fn a_filter_has_a_plan_at_its_first_step_wherever_the_meter_finds_one(text in scenarios()) {
        let scenario = file::from_toml(&text, Path::new("random.toml"), &NoDriverFiles).unwrap();
        check_from_start(&run_behind_shield(&scenario, "full-throttle"))?;
    }
}
