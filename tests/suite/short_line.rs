//! The fast path of the stepper has the results of single steps to the last bit.

use std::ops::ControlFlow;

use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    AfterCollision, Motion, RecordingLevel, Run, RunOptions, StepView, Stepper,
};
use crumple_sim::observation::{EstimatorKind, Observation};
use crumple_sim::scenario::{LaneChange, built_in_scenario, built_in_scenario_names};
use crumple_spaces::{BUILT_IN_SPACES, built_in_space};

/// Command of an external driver: depends on most of the observation and causes some collisions.
fn test_command_mps2(seen: &Observation) -> f64 {
    let ahead = seen.ahead.map_or(0.0, |ahead| {
        0.4 * (ahead.speed_mps - seen.speed_mps) + 0.02 * ahead.gap_m
    });
    ahead - 0.3
        + seen
            .behind
            .map_or(0.0, |behind| 0.1 * behind.acceleration_mps2)
}

/// Returns every step and the result, driven `together` steps at a time, or by single calls of `step`.
fn drive_and_record(
    run: &Run,
    together: usize,
    keep: Option<RecordingLevel>,
) -> (Vec<(Vec<Motion>, String)>, String) {
    let index = 1.min(run.scenario().vehicles().len() - 1);
    let mut stepper = keep.map_or_else(
        || Stepper::without_summaries(run),
        |keep| Stepper::new(run, keep),
    );
    let mut moments = Vec::new();
    let mut note = |now: &StepView<'_>| {
        let StepView {
            motion,
            gap_m,
            has_collided: has_touched,
            has_ended,
        } = *now;
        let collided = if has_touched { "touched" } else { "apart" };
        moments.push((motion.to_vec(), format!("{gap_m:?} {collided} {has_ended}")));
        if moments.len() % 37 == 0 {
            ControlFlow::Break(())
        } else {
            ControlFlow::Continue(())
        }
    };
    while !stepper.has_ended() {
        if together > 0 {
            stepper.drive(index, together, test_command_mps2, &mut note);
            continue;
        }
        if let Some(seen) = stepper.observe(index) {
            stepper.command(index, test_command_mps2(&seen));
        }
        stepper.step();
        let motion = stepper.motion().to_vec();
        let now = StepView {
            motion: &motion,
            gap_m: stepper.gap_m(index),
            has_collided: stepper.has_collided(),
            has_ended: stepper.has_ended(),
        };
        let _ = note(&now);
    }
    (moments, format!("{:?}", stepper.finish()))
}

/// Steps of the fast path are bit-identical to single steps: through and after collisions, with and without
/// filters, for any number of vehicles, with lane changes, and in all built-in spaces.
#[test]
fn steps_together_are_steps_alone() {
    let draws = BUILT_IN_SPACES.into_iter().flat_map(|(name, ..)| {
        let space = built_in_space(name).unwrap();
        (0..4).map(move |index| space.draw(11, index).unwrap())
    });
    let others = built_in_scenario_names().into_iter().flat_map(|(name, _)| {
        let paper = built_in_scenario(name).unwrap();
        let leaves = paper
            .edited(|spec| spec.vehicles[0].leaves = Some(LaneChange::At(2.0)))
            .unwrap();
        [paper, leaves]
    });
    let mut collided = 0;
    for (number, scenario) in draws.chain(others).enumerate() {
        for estimator in EstimatorKind::ALL {
            let after = if number % 2 == 0 {
                AfterCollision::Continue
            } else {
                AfterCollision::Stop
            };
            let options = RunOptions::new(BuiltInController::from_name("idm").unwrap());
            let run = Run::new(
                &scenario,
                options
                    .with_estimator(estimator)
                    .with_after_collision(after),
            )
            .unwrap();
            let name = &scenario.spec().name;
            let alone = drive_and_record(&run, 0, None);
            for together in [1, 10, 1000] {
                assert_eq!(
                    drive_and_record(&run, together, None),
                    alone,
                    "{name} {together}"
                );
            }
            assert_eq!(
                drive_and_record(&run, 10, Some(RecordingLevel::Trace)).0,
                alone.0,
                "{name}"
            );
            collided += usize::from(alone.0.iter().any(|(_, of)| of.contains("touched")));
        }
    }
    assert!(collided > 20, "{collided}");
}
