use super::super::{GhostObject, RecordedMotion, Scenario, built_in_scenario};

fn field_of(change: impl FnOnce(&mut super::ScenarioSpec)) -> String {
    let paper_1 = built_in_scenario("paper-1").expect("built in");
    paper_1.edited(change).expect_err("must be refused").field
}

#[test]
fn each_invalid_value_is_rejected_with_its_field() {
    assert_eq!(field_of(|s| s.duration_s = 99_999.0), "duration_s");
    assert_eq!(field_of(|s| s.step_s = f64::NAN), "step_s");
    assert_eq!(field_of(|s| s.seed = u64::MAX), "seed");
    assert_eq!(
        field_of(|s| s.sensors.faults.latency_s = -0.1),
        "sensors.faults.latency_s"
    );
    assert_eq!(
        field_of(|s| s.sensors.faults.outage_rate_per_s = 1.0),
        "sensors.faults.outage_length_s"
    );
    let near = GhostObject {
        onset_s: 0.0,
        duration_s: 1.0,
        gap_m: 0.0,
        speed_mps: 0.0,
    };
    assert_eq!(
        field_of(|s| s.sensors.faults.ghost = Some(near)),
        "sensors.faults.ghost.gap_m"
    );
    assert_eq!(field_of(|s| s.vehicles.truncate(1)), "vehicles");
}

#[test]
fn a_scenario_within_rounding_of_whole_steps_is_accepted() {
    let paper_1 = built_in_scenario("paper-1").expect("built in");
    let third = paper_1
        .edited(|s| s.duration_s = 0.1 + 0.2)
        .expect("0.30000000000000004 s is 30 steps");
    assert_eq!(Scenario::steps(&third), 30);
}

#[test]
fn recorded_motion_has_equal_lists_within_their_ranges() {
    let with = |interval_s: f64, gap_m: &[f64], speed_mps: &[f64]| {
        let motion = RecordedMotion {
            interval_s,
            gap_m: gap_m.to_vec(),
            speed_mps: speed_mps.to_vec(),
        };
        let paper_1 = built_in_scenario("paper-1").expect("built in");
        paper_1.edited(|s| s.vehicles[1].recorded = Some(Box::new(motion)))
    };
    assert!(with(0.1, &[30.0, 31.0], &[20.0, 20.0]).is_ok());
    let refused = |interval_s, gap_m: &[f64], speed_mps: &[f64]| {
        with(interval_s, gap_m, speed_mps)
            .expect_err("refused")
            .field
    };
    assert_eq!(
        refused(0.0, &[1.0], &[1.0]),
        "vehicles[1].recorded.interval_s"
    );
    assert_eq!(refused(0.1, &[], &[]), "vehicles[1].recorded.gap_m");
    assert_eq!(refused(0.1, &[1.0], &[]), "vehicles[1].recorded.speed_mps");
    assert_eq!(
        refused(0.1, &[-1.0], &[1.0]),
        "vehicles[1].recorded.gap_m[0]"
    );
    assert_eq!(
        refused(0.1, &[1.0, 1.0], &[1.0, 101.0]),
        "vehicles[1].recorded.speed_mps[1]"
    );
}
