use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{
    AfterCollision, RecordingLevel, Run, RunOptions, SimulationResult, simulate,
};
use crumple_sim::scenario::{
    Brake, Driver, LaneChange, LeadProfile, Scenario, VehicleClass, VehicleSpec, built_in_scenario,
};
use proptest::prelude::*;

use crate::{InducedBraking, LeadMeasures};

fn braking_vehicle(position_m: f64, speed_mps: f64, onset_s: f64, rate_mps2: f64) -> VehicleSpec {
    let profile = LeadProfile::Brake(Brake { onset_s, rate_mps2 });
    VehicleSpec::new(
        VehicleClass::Light,
        position_m,
        speed_mps,
        Driver::Profile(profile),
    )
}

/// Simulates vehicles on a dry road for 8 s; `None` if one leaves before it enters.
fn simulate_line(vehicles: Vec<VehicleSpec>, after: AfterCollision) -> Option<SimulationResult> {
    let paper = built_in_scenario("paper-1").unwrap().spec().clone();
    let mut spec = paper;
    spec.duration_s = 8.0;
    spec.vehicles = vehicles;
    let idm = BuiltInController::from_name("idm").unwrap();
    let options = RunOptions::new(idm).with_after_collision(after);
    let run = Run::new(&Scenario::new(spec).ok()?, options).unwrap();
    Some(simulate(&run, RecordingLevel::Trace))
}

/// The last vehicle leaves before any motion, and never had a leader.
#[test]
fn a_vehicle_that_leaves_at_the_start_has_no_measures_towards_a_leader() {
    for leaves in [
        LaneChange::At(0.0),
        LaneChange::At(1e-10),
        LaneChange::TimeToCollision(1.4),
    ] {
        let mut last = braking_vehicle(0.0, 28.0, 9.0, 0.0);
        last.leaves = Some(leaves);
        let line = vec![braking_vehicle(12.0, 20.0, 9.0, 0.0), last];
        let simulated = simulate_line(line, AfterCollision::Stop).unwrap();
        let trace = simulated.trace.as_ref().unwrap();
        let measures = LeadMeasures::from_trace(trace, &simulated.impacts, 1);
        assert_eq!(measures, None, "{leaves:?}");
    }
}

fn any_lane_change() -> impl Strategy<Value = LaneChange> {
    crumple_cases::any_lane_change(LaneChange::At, LaneChange::Gap, LaneChange::TimeToCollision)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Measures of the trace equal those of the engine for all lane changes.
    #[test]
    fn measures_of_lane_changes_equal_those_of_the_engine(
        enters in any_lane_change(), leaves in prop::option::of(any_lane_change()), place_m in -20.0..60.0_f64,
        speed_mps in 10.0..30.0_f64, brakes_mps2 in prop::array::uniform3(0.0..7.0_f64), goes_on in any::<bool>(),
    ) {
        let mut cutter = braking_vehicle(place_m, speed_mps, 2.0, brakes_mps2[1]);
        (cutter.enters, cutter.leaves) = (Some(enters), leaves);
        let line = vec![
            braking_vehicle(50.0, 20.0, 1.5, brakes_mps2[0]),
            cutter,
            braking_vehicle(0.0, 20.0, 2.5, brakes_mps2[2]),
            braking_vehicle(-12.0, 20.0, 3.0, 6.0),
        ];
        let after = if goes_on { AfterCollision::Continue } else { AfterCollision::Stop };
        let Some(simulated) = simulate_line(line, after) else {
            return Err(TestCaseError::reject("leaves before it enters"));
        };
        let trace = simulated.trace.as_ref().unwrap();
        for (index, summary) in simulated.vehicles.iter().enumerate() {
            let ahead = LeadMeasures::from_trace(trace, &simulated.impacts, index);
            let measured_m = ahead.and_then(|ahead| ahead.min_gap_m).unwrap_or(f64::INFINITY);
            let summary_m = summary.min_gap_m.unwrap_or(f64::INFINITY);
            let is_close = summary_m == measured_m || (summary_m - measured_m).abs() < 1e-6;
            prop_assert!(is_close, "vehicle {index}: {summary_m} m, {measured_m} m");
            let induced = InducedBraking::from_trace(trace, &simulated.impacts, index);
            prop_assert!(induced.is_none_or(|induced| induced.peak_brake_mps2 < Some(31.0)));
        }
    }
}
