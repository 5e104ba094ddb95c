use super::*;

/// Returns the speeds at step boundaries for a vehicle that starts at `speed_mps`.
fn drive(profile: &LeadProfile, mut speed_mps: f64, step_s: f64, steps: usize) -> Vec<f64> {
    let mut speeds = vec![speed_mps];
    for k in 0..steps {
        let acceleration =
            profile.acceleration_mps2(k as f64 * step_s, (k + 1) as f64 * step_s, speed_mps);
        speed_mps = (speed_mps + acceleration * step_s).max(0.0);
        speeds.push(speed_mps);
    }
    speeds
}

#[test]
fn the_constant_acceleration_equals_that_of_each_step() {
    let profiles = [
        LeadProfile::ConstantSpeed,
        LeadProfile::Brake(Brake {
            onset_s: 1.004,
            rate_mps2: 3.0,
        }),
        LeadProfile::Brake(Brake {
            onset_s: 0.0,
            rate_mps2: 3.0,
        }),
        LeadProfile::Pieces(PiecewiseAcceleration {
            from_s: vec![0.5, 1.0, 1.003, 2.0],
            accel_mps2: vec![-1.0, 0.5, -0.0, -3.0],
        }),
        LeadProfile::Pieces(PiecewiseAcceleration {
            from_s: vec![],
            accel_mps2: vec![],
        }),
    ];
    for profile in profiles {
        let mut steps_held = 0;
        for from in 0..300 {
            let [constant_mps2, until_s] = profile
                .constant_acceleration_span(f64::from(from) * 0.01)
                .unwrap();
            // All later steps that end in time, not only the next.
            for step in from..300 {
                let [from_s, to_s] = [step, step + 1].map(|step| f64::from(step) * 0.01);
                if to_s <= until_s {
                    let found_mps2 = profile.acceleration_mps2(from_s, to_s, 20.0);
                    assert_eq!(constant_mps2.to_bits(), found_mps2.to_bits(), "{profile:?}");
                    steps_held += 1;
                }
            }
        }
        assert!(steps_held > 10_000, "{profile:?}: {steps_held}");
    }
}

#[test]
fn an_onset_inside_a_step_brakes_for_the_rest_of_the_step() {
    let profile = LeadProfile::Brake(Brake {
        onset_s: 1.004,
        rate_mps2: 3.0,
    });
    assert_eq!(profile.acceleration_mps2(0.99, 1.0, 25.0), 0.0);
    assert!((profile.acceleration_mps2(1.0, 1.01, 25.0) + 3.0 * 0.6).abs() < 1e-9);
    assert_eq!(profile.acceleration_mps2(1.01, 1.02, 25.0), -3.0);
}

#[test]
fn ramp_braking_builds_up_linearly_and_is_released_before_standstill() {
    let profile = LeadProfile::RampBrake(RampBrake {
        onset_s: 1.0,
        rate_mps2: 4.905,
        ramp_s: 1.5,
        release_s: 0.25,
    });
    let speeds = drive(&profile, 22.0, 0.01, 1000);
    let at = |t: f64| speeds[(t / 0.01).round() as usize];
    assert!((at(1.0) - 22.0).abs() < 1e-9);
    assert!(
        (at(2.5) - (22.0 - 0.5 * 4.905 * 1.5)).abs() < 1e-9,
        "linear build-up loses half of rate times time"
    );
    assert!(
        (at(3.0) - (at(2.5) - 4.905 * 0.5)).abs() < 1e-9,
        "then the full rate"
    );
    let stop = speeds
        .iter()
        .position(|&v| v == 0.0)
        .expect("comes to rest");
    // Full rate until 0.25 s before standstill, when rate * 0.25 / 2 is left.
    let full_until = (at(2.5) - 4.905 * 0.125) / 4.905;
    assert!((stop as f64 * 0.01 - (2.5 + full_until + 0.25)).abs() <= 0.011);
}

#[test]
fn braking_to_two_kilometres_an_hour_ends_there() {
    let final_speed_mps = 2.0 / 3.6;
    let profile = LeadProfile::BrakeToSpeed(BrakeToSpeed {
        onset_s: 0.0,
        rate_mps2: 5.0,
        final_speed_mps,
    });
    let speeds = drive(&profile, 20.0, 0.01, 600);
    assert!((speeds[100] - 15.0).abs() < 1e-9);
    assert!((speeds.last().unwrap() - final_speed_mps).abs() < 1e-12);
}

#[test]
fn a_piecewise_acceleration_is_averaged_over_a_step_with_changes() {
    let pieces = PiecewiseAcceleration {
        from_s: vec![0.0, 0.104, 0.107],
        accel_mps2: vec![1.0, -2.0, 4.0],
    };
    let profile = LeadProfile::Pieces(pieces);
    assert_eq!(profile.acceleration_mps2(0.09, 0.1, 1.0), 1.0);
    let mean = profile.acceleration_mps2(0.1, 0.11, 1.0);
    assert!(
        (mean - (0.4 * 1.0 + 0.3 * -2.0 + 0.3 * 4.0)).abs() < 1e-9,
        "{mean}"
    );
    assert_eq!(profile.acceleration_mps2(5.0, 5.01, 1.0), 4.0);
}

#[test]
fn recorded_speeds_are_followed_and_held() {
    let recorded = RecordedSpeeds {
        time_s: vec![0.0, 0.1, 0.2],
        speed_mps: vec![10.0, 11.0, 9.0],
    };
    let speeds = drive(&LeadProfile::Recorded(recorded), 10.0, 0.01, 40);
    assert!((speeds[5] - 10.5).abs() < 1e-9);
    assert!((speeds[20] - 9.0).abs() < 1e-9);
    assert!((speeds[40] - 9.0).abs() < 1e-9);
}
