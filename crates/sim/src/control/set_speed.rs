//! Limits of the own speed of controllers that follow: a set speed, or the speed of the leader.

use crate::observation::Observation;

/// Set speed that stands for none, in m/s: the largest initial speed of a vehicle.
pub(super) const NO_SET_SPEED_MPS: f64 = 100.0;
/// Speed difference to the leader up to which a controller without a set speed accelerates, in m/s. Without this limit
/// it would reach any speed behind a leader far ahead, from which it could no longer brake in time.
pub(super) const CATCH_UP_MPS: f64 = 2.0;

/// True if the setting is a set speed.
#[inline]
pub(super) fn is_set(set_speed_mps: f64) -> bool {
    set_speed_mps < NO_SET_SPEED_MPS
}

/// Returns the largest acceleration that the own speed allows, in m/s². `gain_per_s` is the acceleration per m/s below
/// the limit.
///
/// With a set speed u it is k (u - v), which brakes above u. Without one it never brakes: it is k (w + c - v), at least
/// 0, behind a leader at w, with c = [`CATCH_UP_MPS`], and 0 without a leader: the vehicle holds its speed.
#[inline]
pub(super) fn max_accel_mps2(
    set_speed_mps: f64,
    gain_per_s: f64,
    observation: &Observation,
) -> f64 {
    if is_set(set_speed_mps) {
        return gain_per_s * (set_speed_mps - observation.speed_mps);
    }
    let Some(ahead) = observation.ahead else {
        return 0.0;
    };
    let closes_gap_mps2 = gain_per_s * (ahead.speed_mps + CATCH_UP_MPS - observation.speed_mps);
    if closes_gap_mps2 > 0.0 {
        closes_gap_mps2
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::leader_observation;
    use super::*;
    use crate::control::BuiltInController;
    use crate::engine::{RecordingLevel, Run, RunOptions, SimulationResult, Trace, simulate};
    use crate::observation::EstimatorKind;
    use crate::scenario::{
        Driver, LeadProfile, PiecewiseAcceleration, RecordedSpeeds, Scenario, ScenarioSpec,
        VehicleClass, VehicleSpec,
    };

    /// Simulates both controllers behind a leader. `settings` begins with a comma.
    fn drive(
        gap_m: f64,
        [own_mps, leader_mps]: [f64; 2],
        leader: &LeadProfile,
        seconds: f64,
        settings: &str,
    ) -> [(SimulationResult, Trace); 2] {
        let driver = Driver::Profile(leader.clone());
        let ahead = VehicleSpec::new(VehicleClass::Light, 0.0, leader_mps, driver);
        let rear_m = -ahead.length_m() - gap_m;
        let vehicles = vec![
            ahead,
            VehicleSpec::new(VehicleClass::Light, rear_m, own_mps, Driver::UnderTest),
        ];
        let scenario =
            Scenario::new(ScenarioSpec::new("drive".to_owned(), seconds, vehicles)).unwrap();
        ["acc-aeb", "openpilot"].map(|name| {
            let spec = BuiltInController::parse(&format!("{name}{settings}"))
                .unwrap()
                .unwrap();
            let run = Run::new(
                &scenario,
                RunOptions::new(spec).with_estimator(EstimatorKind::Truth),
            )
            .unwrap();
            let mut result = simulate(&run, RecordingLevel::Trace);
            let trace = result.trace.take().unwrap();
            assert!(result.outcome.is_safe(), "{name}: {:?}", result.outcome);
            (result, trace)
        })
    }

    fn last(values: &[f64]) -> f64 {
        *values.last().unwrap()
    }

    #[test]
    fn acceleration_is_limited_by_the_set_speed_or_the_speed_of_the_leader() {
        let behind = |speed_mps, ahead_mps| leader_observation(speed_mps, 50.0, ahead_mps, 0.0);
        let alone = Observation {
            ahead: None,
            ..behind(20.0, 0.0)
        };
        assert_eq!(max_accel_mps2(25.0, 0.5, &alone), 2.5);
        assert_eq!(max_accel_mps2(15.0, 0.5, &behind(20.0, 30.0)), -2.5);
        assert_eq!(
            max_accel_mps2(NO_SET_SPEED_MPS, 0.5, &alone),
            0.0,
            "holds its speed on an empty road"
        );
        assert_eq!(
            max_accel_mps2(NO_SET_SPEED_MPS, 0.5, &behind(20.0, 20.0)),
            1.0
        );
        assert_eq!(
            max_accel_mps2(NO_SET_SPEED_MPS, 0.5, &behind(25.0, 20.0)),
            0.0
        );
        assert_eq!(
            max_accel_mps2(NO_SET_SPEED_MPS, 0.5, &behind(40.0, 20.0)),
            0.0,
            "does not brake"
        );
    }

    /// From a standing start, and behind a leader that becomes faster.
    #[test]
    fn acc_aeb_and_openpilot_follow_an_accelerating_leader() {
        let green = RecordedSpeeds {
            time_s: vec![0.0, 10.0, 30.0],
            speed_mps: vec![0.0, 15.0, 15.0],
        };
        for (_, trace) in drive(
            5.5,
            [0.0, 0.0],
            &LeadProfile::Recorded(green.clone()),
            30.0,
            "",
        ) {
            let ego = &trace.vehicles[1];
            let moved_m = last(&ego.position_m) - ego.position_m[0];
            assert!(moved_m > 330.0, "{moved_m}");
            assert!(
                (last(&ego.speed_mps) - 15.0).abs() < 1.5,
                "{}",
                last(&ego.speed_mps)
            );
        }
        for (_, trace) in drive(
            5.5,
            [0.0, 0.0],
            &LeadProfile::Recorded(green),
            30.0,
            ",set_speed_mps=8",
        ) {
            let fastest_mps = trace.vehicles[1]
                .speed_mps
                .iter()
                .copied()
                .fold(0.0, f64::max);
            assert!((7.5..=8.0).contains(&fastest_mps), "{fastest_mps}");
        }
        let pieces = PiecewiseAcceleration {
            from_s: vec![5.0, 20.0],
            accel_mps2: vec![1.0, 0.0],
        };
        for (_, trace) in drive(40.0, [15.0, 15.0], &LeadProfile::Pieces(pieces), 80.0, "") {
            assert!((last(&trace.vehicles[1].speed_mps) - 30.0).abs() < 0.1);
            assert!(trace.gaps_m(1).last().unwrap().unwrap() < 52.0);
        }
    }

    /// The gap closes gently, however large it is, and a standing vehicle is no reason to accelerate.
    #[test]
    fn a_gap_without_limit_closes_without_hard_braking() {
        for gap_m in [50.0, 200.0, 1000.0] {
            let seconds = 60.0 + gap_m;
            for (result, trace) in drive(
                gap_m,
                [25.0, 25.0],
                &LeadProfile::ConstantSpeed,
                seconds,
                "",
            ) {
                assert!(
                    result.vehicles[1].max_brake_mps2 < 2.5,
                    "{gap_m}: {}",
                    result.vehicles[1].max_brake_mps2
                );
                let final_m = trace.gaps_m(1).last().unwrap().unwrap();
                assert!((20.0..45.0).contains(&final_m), "{gap_m}: {final_m}");
            }
        }
        for (_, trace) in drive(500.0, [25.0, 0.0], &LeadProfile::ConstantSpeed, 60.0, "") {
            let ego = &trace.vehicles[1];
            assert!(
                ego.speed_mps.iter().all(|&speed_mps| speed_mps <= 25.0)
                    && last(&ego.speed_mps) < 0.1
            );
        }
    }
}
