use proptest::prelude::*;

use super::super::{
    AfterCollision, RecordingLevel, Run, RunOptions, SimulationResult, Track, simulate,
};
use crate::control::BuiltInController;
use crate::observation::EstimatorKind;
use crate::scenario::{
    Brake, Driver, LaneChange, LeadProfile, Scenario, ScenarioSpec, VehicleClass, VehicleSpec,
    built_in_scenario,
};

/// Creates a scenario with vehicles on a dry road, without noise.
fn scenario(vehicles: Vec<VehicleSpec>, duration_s: f64) -> Scenario {
    let spec = built_in_scenario("paper-1").unwrap().spec().clone();
    Scenario::new(ScenarioSpec {
        name: "lanes".to_owned(),
        duration_s,
        vehicles,
        ..spec
    })
    .unwrap()
}

fn scripted_vehicle(position_m: f64, speed_mps: f64, profile: LeadProfile) -> VehicleSpec {
    VehicleSpec::new(
        VehicleClass::Light,
        position_m,
        speed_mps,
        Driver::Profile(profile),
    )
}

fn steady_vehicle(position_m: f64, speed_mps: f64) -> VehicleSpec {
    scripted_vehicle(position_m, speed_mps, LeadProfile::ConstantSpeed)
}

fn controlled_vehicle(position_m: f64, speed_mps: f64, controller: &str) -> VehicleSpec {
    let controller = BuiltInController::from_name(controller).unwrap();
    VehicleSpec::new(
        VehicleClass::Light,
        position_m,
        speed_mps,
        Driver::Controller(controller),
    )
}

fn with_entry(vehicle: VehicleSpec, enters: LaneChange) -> VehicleSpec {
    VehicleSpec {
        enters: Some(enters),
        ..vehicle
    }
}

fn with_exit(vehicle: VehicleSpec, leaves: LaneChange) -> VehicleSpec {
    VehicleSpec {
        leaves: Some(leaves),
        ..vehicle
    }
}

fn run(scenario: &Scenario) -> SimulationResult {
    run_with(
        scenario,
        RunOptions::new(BuiltInController::from_name("idm").unwrap()),
    )
}

fn run_with(scenario: &Scenario, options: RunOptions) -> SimulationResult {
    simulate(&Run::new(scenario, options).unwrap(), RecordingLevel::Trace)
}

fn tracks(simulated: &SimulationResult) -> &[Track] {
    &simulated.trace.as_ref().unwrap().vehicles
}

fn brake_profile(onset_s: f64, rate_mps2: f64) -> LeadProfile {
    LeadProfile::Brake(Brake { onset_s, rate_mps2 })
}

#[test]
fn the_time_of_a_lane_change_is_that_of_the_closed_form() {
    // 20 m/s behind 14 m/s, gap 50 m. The gap is 17 m after 5.5 s. The TTC is 2 s when the gap is 12 m, after 38 / 6 s.
    let entered = |enters| {
        let line = vec![
            with_entry(steady_vehicle(52.0, 14.0), enters),
            steady_vehicle(0.0, 20.0),
        ];
        tracks(&run(&scenario(line, 8.0)))[0].in_lane_s[0]
    };
    assert!((entered(LaneChange::Gap(17.0)) - 5.5).abs() < 1e-9);
    assert!((entered(LaneChange::TimeToCollision(2.0)) - 38.0 / 6.0).abs() < 1e-9);
    assert_eq!(entered(LaneChange::At(3.456)), 3.456);
    assert_eq!(entered(LaneChange::At(9.0)), f64::INFINITY);
    // From behind: 26 m/s against 20 m/s is 9 m ahead, bumper to bumper, after (15 + 2 + 9) / 6 s.
    let line = vec![
        with_entry(steady_vehicle(-15.0, 26.0), LaneChange::Gap(9.0)),
        steady_vehicle(0.0, 20.0),
    ];
    assert!((tracks(&run(&scenario(line, 8.0)))[0].in_lane_s[0] - 26.0 / 6.0).abs() < 1e-9);
}

#[test]
fn a_leaving_vehicle_counts_from_its_leader() {
    // A vehicle at 20 m/s leaves 1.5 s before its collision with one that stands, and reveals it to the follower.
    let line = vec![
        steady_vehicle(140.0, 0.0),
        with_exit(steady_vehicle(38.0, 20.0), LaneChange::TimeToCollision(1.5)),
        steady_vehicle(0.0, 20.0),
    ];
    let simulated = run(&scenario(line, 8.0));
    assert!((tracks(&simulated)[1].in_lane_s[1] - 3.5).abs() < 1e-9);
    let collision = simulated.outcome.collision().unwrap();
    assert_eq!(
        (collision.front_vehicle, collision.rear_vehicle),
        (0, 2),
        "no vehicle drives into the one that has left"
    );
    assert!((collision.time_s - 138.0 / 20.0).abs() < 1e-9);
    assert_eq!(simulated.vehicles_involved(), 2);
    let impact = &simulated.impacts[0];
    assert_eq!(
        (impact.beside.as_slice(), impact.delta_v_mps(1)),
        (&[1][..], 0.0)
    );
    let pairs: Vec<_> = simulated
        .trace
        .as_ref()
        .unwrap()
        .pairs(2)
        .iter()
        .map(|pair| pair.front_vehicle)
        .collect();
    assert_eq!(pairs, [1, 0]);
}

#[test]
fn a_vehicle_without_room_stays_in_its_lane() {
    for beside_m in [1.0, 0.0, -1.5] {
        let line = vec![
            with_entry(steady_vehicle(beside_m, 20.0), LaneChange::At(1.0)),
            steady_vehicle(0.0, 20.0),
        ];
        let simulated = run(&scenario(line, 3.0));
        assert_eq!(tracks(&simulated)[0].in_lane_s, [f64::INFINITY; 2]);
        assert!(simulated.outcome.is_safe());
        assert_eq!(simulated.vehicles[1].min_gap_m, None);
    }
}

/// Trace and engine agree: the last vehicle leaves before any motion, and never had a leader.
#[test]
fn leaving_at_the_start_equals_not_being_there() {
    for leaves in [
        LaneChange::At(0.0),
        LaneChange::At(1e-10),
        LaneChange::TimeToCollision(1.4),
    ] {
        let simulated = run(&scenario(
            vec![
                steady_vehicle(12.0, 20.0),
                with_exit(steady_vehicle(0.0, 28.0), leaves),
            ],
            3.0,
        ));
        let trace = simulated.trace.as_ref().unwrap();
        assert_eq!(
            (simulated.vehicles[1].min_gap_m, trace.pairs(1).len()),
            (None, 0),
            "{leaves:?}"
        );
    }
}

#[test]
fn simultaneous_lane_changes_happen_together() {
    // One vehicle stands 100 m ahead. The TTC of the second to it is 1.5 s, that of the faster third to the second is 1
    // s. Without the second the third would stay.
    let line = vec![
        steady_vehicle(134.0, 0.0),
        with_exit(
            steady_vehicle(100.0, 20.0),
            LaneChange::TimeToCollision(2.0),
        ),
        with_exit(steady_vehicle(90.0, 28.0), LaneChange::TimeToCollision(1.2)),
        steady_vehicle(0.0, 20.0),
    ];
    let simulated = run(&scenario(line, 2.0));
    assert_eq!(
        [1, 2].map(|vehicle| tracks(&simulated)[vehicle].in_lane_s[1]),
        [0.0, 0.0]
    );
}

fn without_lanes(mut simulated: SimulationResult) -> SimulationResult {
    for track in simulated
        .trace
        .iter_mut()
        .flat_map(|trace| &mut trace.vehicles)
    {
        track.in_lane_s = Track::THROUGHOUT_S;
    }
    simulated
}

#[test]
fn entering_at_the_start_equals_being_in_the_lane() {
    for spec in BuiltInController::all() {
        for estimator in EstimatorKind::ALL {
            let paper = built_in_scenario("paper-1").unwrap();
            let entering = paper
                .edited(|spec| spec.vehicles[0].enters = Some(LaneChange::At(0.0)))
                .unwrap();
            let options = || RunOptions::new(spec.clone()).with_estimator(estimator);
            if let Ok(run) = Run::new(&entering, options()) {
                let there = simulate(&Run::new(&paper, options()).unwrap(), RecordingLevel::Trace);
                assert_eq!(
                    without_lanes(simulate(&run, RecordingLevel::Trace)),
                    there,
                    "{}",
                    spec.name()
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// The gap needed at entry for full braking after a reaction time is Δv τ + Δv² / (2 b).
    #[test]
    fn the_gap_needed_after_a_cut_in_is_that_of_the_closed_form(
        gap_m in 5.0..60.0_f64, closing_mps in 1.0..15.0_f64, reaction_s in 0.0..1.5_f64, brake_mps2 in 2.0..7.0_f64,
    ) {
        // The braking begins at the start of a step, because the acceleration of a profile is averaged over each step.
        // The entry may be at any time inside a step.
        let (onset_s, enters_s) = (2.5, 2.5 - reaction_s);
        let start_m = gap_m + closing_mps * enters_s;
        let line = vec![
            with_entry(steady_vehicle(start_m + 2.0, 30.0 - closing_mps), LaneChange::At(enters_s)),
            scripted_vehicle(0.0, 30.0, brake_profile(onset_s, brake_mps2)),
        ];
        let simulated = run(&scenario(line, 12.0));
        let needed_m = closing_mps * reaction_s + closing_mps * closing_mps / (2.0 * brake_mps2);
        prop_assume!((gap_m - needed_m).abs() > 1e-6);
        prop_assert_eq!(simulated.outcome.is_safe(), gap_m > needed_m);
        if gap_m > needed_m {
            prop_assert!((simulated.vehicles[1].min_gap_m.unwrap() - (gap_m - needed_m)).abs() < 1e-9);
        }
    }

    /// A vehicle that enters or leaves far away has no effect on others.
    #[test]
    fn a_lane_change_far_away_changes_nothing(
        time_s in 0.0..5.0_f64, leaves in any::<bool>(), brake_mps2 in 1.0..7.0_f64,
    ) {
        let line = |far: Option<VehicleSpec>| {
            let ahead = scripted_vehicle(40.0, 20.0, brake_profile(2.0, brake_mps2));
            let near = [ahead, controlled_vehicle(10.0, 20.0, "idm"), controlled_vehicle(-20.0, 20.0, "acc-aeb")];
            scenario(far.into_iter().chain(near).collect(), 6.0)
        };
        let change = LaneChange::At(time_s);
        let far = steady_vehicle(1e6, 20.0);
        let far = if leaves { with_exit(far, change) } else { with_entry(far, change) };
        let (with, without) = (run(&line(Some(far))), run(&line(None)));
        prop_assert_eq!(&tracks(&with)[1..], tracks(&without));
    }

    /// A vehicle that leaves and its twin that enters at the same instant are one vehicle for all others.
    #[test]
    fn replacing_a_vehicle_by_an_equal_one_changes_nothing_behind(
        time_s in prop_oneof![Just(0.0), 0.0..5.0_f64], ahead_m in 5.0..60.0_f64, speed_mps in 10.0..30.0_f64,
        brakes_mps2 in prop::array::uniform2(0.0..7.0_f64), waits in any_lane_change(), enters in any::<bool>(),
    ) {
        let twin = || scripted_vehicle(ahead_m, speed_mps, brake_profile(1.5, brakes_mps2[0]));
        let line = |twins: Vec<VehicleSpec>| {
            let mut waiting = scripted_vehicle(0.0, 20.0, brake_profile(2.5, brakes_mps2[1]));
            *(if enters { &mut waiting.enters } else { &mut waiting.leaves }) = Some(waits);
            let rest = [waiting, controlled_vehicle(-30.0, 20.0, "idm"), controlled_vehicle(-60.0, 20.0, "acc-aeb")];
            scenario([steady_vehicle(500.0, 20.0)].into_iter().chain(twins).chain(rest).collect(), 8.0)
        };
        let change = LaneChange::At(time_s);
        let both = vec![with_exit(twin(), change), with_entry(twin(), change)];
        let single = run(&line(vec![twin()]));
        let successive = run(&line(both));
        prop_assert_eq!(&tracks(&successive)[3..], &tracks(&single)[2..]);
    }

    /// A vehicle that leaves behind controllers that observe only their leader has no effect on them.
    #[test]
    fn a_vehicle_that_leaves_changes_nothing_ahead(time_s in 0.0..5.0_f64, brake_mps2 in 1.0..7.0_f64) {
        let line = |last: VehicleSpec| {
            let ahead = scripted_vehicle(40.0, 20.0, brake_profile(1.0, brake_mps2));
            scenario(vec![ahead, controlled_vehicle(10.0, 20.0, "idm"), last], 6.0)
        };
        let last = || steady_vehicle(-100.0, 20.0);
        let (stays, leaves) = (run(&line(last())), run(&line(with_exit(last(), LaneChange::At(time_s)))));
        prop_assert_eq!(&tracks(&stays)[..2], &tracks(&leaves)[..2]);
    }

    /// Results do not depend on the integration step.
    #[test]
    fn lane_changes_do_not_depend_on_the_step(
        enters in any_lane_change(), leaves in prop::option::of(any_lane_change()), place_m in -20.0..60.0_f64,
        speed_mps in 10.0..30.0_f64, brakes_mps2 in prop::array::uniform3(0.0..7.0_f64), goes_on in any::<bool>(),
    ) {
        let mut cutter = scripted_vehicle(place_m, speed_mps, brake_profile(2.0, brakes_mps2[1]));
        (cutter.enters, cutter.leaves) = (Some(enters), leaves);
        let line = vec![
            scripted_vehicle(50.0, 20.0, brake_profile(1.5, brakes_mps2[0])),
            cutter,
            scripted_vehicle(0.0, 20.0, brake_profile(2.5, brakes_mps2[2])),
            scripted_vehicle(-12.0, 20.0, brake_profile(3.0, 6.0)),
        ];
        let spec = built_in_scenario("paper-1").unwrap().spec().clone();
        let Ok(scenario) = Scenario::new(ScenarioSpec { duration_s: 8.0, vehicles: line, ..spec }) else {
            return Err(TestCaseError::reject("leaves before it enters"));
        };
        let after = if goes_on { AfterCollision::Continue } else { AfterCollision::Stop };
        let options = || RunOptions::new(BuiltInController::from_name("idm").unwrap()).with_after_collision(after);
        let (coarse, fine) = (run_with(&scenario, options()), run_with(&scenario, options().with_dt_s(0.002)));
        let close = |a: f64, b: f64| a == b || (a - b).abs() < 1e-6;
        prop_assert_eq!(coarse.impacts.len(), fine.impacts.len());
        for (coarse, fine) in coarse.impacts.iter().zip(&fine.impacts) {
            prop_assert!(close(coarse.collision.time_s, fine.collision.time_s), "{coarse:?} {fine:?}");
            prop_assert_eq!(&coarse.beside, &fine.beside);
        }
        for (coarse, fine) in tracks(&coarse).iter().zip(tracks(&fine)) {
            let [a, b] = [coarse.in_lane_s, fine.in_lane_s];
            prop_assert!(close(a[0], b[0]) && close(a[1], b[1]), "{a:?} {b:?}");
        }
        for (coarse, fine) in coarse.vehicles.iter().zip(&fine.vehicles) {
            let gaps_m = [coarse.min_gap_m, fine.min_gap_m].map(|gap_m| gap_m.unwrap_or(f64::INFINITY));
            prop_assert!(close(gaps_m[0], gaps_m[1]), "{gaps_m:?}");
        }
    }
}

fn any_lane_change() -> impl Strategy<Value = LaneChange> {
    crumple_cases::any_lane_change(LaneChange::At, LaneChange::Gap, LaneChange::TimeToCollision)
}
