use super::*;
use crate::control::{AebSettings, AnyController, BuiltInController, Ego};
use crate::engine::{RunOptions, simulate};
use crate::scenario::PaperDistribution;

#[test]
fn commands_from_outside_equal_the_same_controller_inside() {
    let spec = BuiltInController::BaselineUnlatched(AebSettings::default());
    for index in 0..20 {
        let scenario = PaperDistribution { seed: 5 }.draw(index).unwrap();
        let run = Run::new(&scenario, RunOptions::new(spec.clone())).unwrap();
        let inside = simulate(&run, RecordingLevel::Trace);
        let vehicle = &scenario.vehicles()[1];
        let ego = Ego {
            vehicle: 1,
            max_brake_mps2: vehicle.max_brake_mps2(),
            max_accel_mps2: 3.0,
            length_m: 2.0,
            step_s: 0.01,
        };
        let mut controller = AnyController::from_spec(&spec, &ego, 0);
        let mut stepper = Stepper::new(&run, RecordingLevel::Trace);
        while !stepper.has_ended() {
            let observation = stepper.observe(1).unwrap();
            assert_eq!(
                stepper.observe(1),
                Some(observation),
                "looking twice sees the same"
            );
            stepper.command(1, controller.decide(&observation).unwrap());
            stepper.step();
        }
        assert_eq!(stepper.finish(), inside);
    }
}

#[test]
fn a_stepper_without_summaries_has_the_same_results() {
    let spec = BuiltInController::BaselineUnlatched(AebSettings::default());
    for index in 0..20 {
        let scenario = PaperDistribution { seed: 5 }.draw(index).unwrap();
        let run = Run::new(&scenario, RunOptions::new(spec.clone())).unwrap();
        let mut stepper = Stepper::without_summaries(&run);
        while !stepper.has_ended() {
            stepper.step();
        }
        let with = simulate(&run, RecordingLevel::Summary);
        assert_eq!(
            stepper.finish(),
            SimulationResult {
                vehicles: Vec::new(),
                ..with
            }
        );
    }
}
