//! Check of scripted leaders against a limit of free braking.

use crumple_sim::scenario::{Driver, LeadProfile, RecordedSpeeds, VehicleSpec};
use crumple_verify::Interval;

/// Reason why a profile exceeds the limits of a claim.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ScriptBeyondLimit {
    /// A controller drives the leader.
    #[error("its leader is not scripted")]
    NotScripted,
    /// The profile accelerates.
    #[error(
        "its leader's script `{script}` accelerates at {mps2} m/s², and the statement's leader never speeds up"
    )]
    SpeedsUp {
        /// Kind of the profile.
        script: &'static str,
        /// Largest acceleration, in m/s².
        mps2: f64,
    },
    /// The profile brakes too hard.
    #[error(
        "its leader's script `{script}` brakes at {mps2} m/s², and the statement's leader at {limit_mps2} m/s² at most"
    )]
    BrakesHarder {
        /// Kind of the profile.
        script: &'static str,
        /// Largest deceleration, in m/s², positive.
        mps2: f64,
        /// Limit of the statement, in m/s².
        limit_mps2: f64,
    },
    /// The recording starts at another speed than the vehicle.
    #[error(
        "its leader has an initial speed of {speed_mps} m/s, and its recording of {recorded_mps} m/s"
    )]
    OtherSpeed {
        /// Speed of the vehicle, in m/s.
        speed_mps: f64,
        /// Recorded speed, in m/s.
        recorded_mps: f64,
    },
}

/// Checks that the acceleration of a scripted leader is always between -`limit_mps2` and 0. The acceleration of a step
/// is the mean of the profile within the step. Its rounding in the simulator is far below the allowance of 10⁻⁹ m and
/// m/s of every reach tube.
pub(super) fn check_script_limits(
    leader: &VehicleSpec,
    limit_mps2: f64,
    horizon_s: f64,
) -> Result<(), ScriptBeyondLimit> {
    let Driver::Profile(profile) = &leader.driver else {
        return Err(ScriptBeyondLimit::NotScripted);
    };
    let [lowest, highest] = match profile {
        LeadProfile::Recorded(recorded) => {
            check_recorded_speed(leader.speed_mps, recorded)?;
            slopes_mps2(recorded, horizon_s)
        }
        LeadProfile::Pieces(pieces) => {
            let pieces = pieces
                .from_s
                .iter()
                .zip(&pieces.accel_mps2)
                .take_while(|(from_s, _)| **from_s <= horizon_s);
            hull(pieces.map(|(_, &mps2)| [mps2; 2]))
        }
        LeadProfile::ConstantSpeed
        | LeadProfile::Brake(_)
        | LeadProfile::RampBrake(_)
        | LeadProfile::BrakeToSpeed(_) => profile.acceleration_range_mps2(),
    };
    let script = profile.name();
    if highest > 0.0 {
        Err(ScriptBeyondLimit::SpeedsUp {
            script,
            mps2: highest,
        })
    } else if -lowest <= limit_mps2 {
        Ok(())
    } else {
        Err(ScriptBeyondLimit::BrakesHarder {
            script,
            mps2: -lowest,
            limit_mps2,
        })
    }
}

fn check_recorded_speed(
    speed_mps: f64,
    recorded: &RecordedSpeeds,
) -> Result<(), ScriptBeyondLimit> {
    let recorded_mps = recorded.speed_at_mps(0.0);
    if speed_mps == recorded_mps {
        return Ok(());
    }
    Err(ScriptBeyondLimit::OtherSpeed {
        speed_mps,
        recorded_mps,
    })
}

/// Returns the smallest and largest slope of recorded speeds, including 0, rounded outward, in m/s².
fn slopes_mps2(recorded: &RecordedSpeeds, horizon_s: f64) -> [f64; 2] {
    let samples: Vec<[f64; 2]> = recorded
        .time_s
        .iter()
        .zip(&recorded.speed_mps)
        .map(|(&t, &v)| [t, v])
        .collect();
    let pairs = samples
        .iter()
        .zip(samples.iter().skip(1))
        .take_while(|([from_s, _], _)| *from_s <= horizon_s);
    hull(pairs.map(|(from, to)| {
        let [duration_s, change_mps] = [0, 1].map(|column| difference(to[column], from[column]));
        let slope_mps2 = change_mps.low() / duration_s.low();
        let is_exact = [duration_s, change_mps]
            .iter()
            .all(|range| range.low() == range.high())
            && slope_mps2.mul_add(duration_s.low(), -change_mps.low()) == 0.0;
        let slope = if is_exact {
            Interval::point(slope_mps2)
        } else {
            change_mps.over(duration_s)
        };
        [slope.low(), slope.high()]
    }))
}

/// Returns a difference, rounded outward unless it is exact by Knuth's error of the sum of two numbers.
fn difference(to: f64, from: f64) -> Interval {
    let nearest = to - from;
    let virtually = nearest - to;
    let error = (to - (nearest - virtually)) + (-from - virtually);
    if error == 0.0 {
        Interval::point(nearest)
    } else {
        Interval::point(to) - Interval::point(from)
    }
}

fn hull(ranges: impl Iterator<Item = [f64; 2]>) -> [f64; 2] {
    ranges.fold([0.0, 0.0], |[low, high]: [f64; 2], range| {
        [low.min(range[0]), high.max(range[1])]
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::{
        Brake, BrakeToSpeed, PiecewiseAcceleration, RampBrake, VehicleClass,
    };

    const HORIZON_S: f64 = 10.0;
    const SPEED_MPS: f64 = 20.0;

    fn check_profile(profile: LeadProfile) -> Result<(), ScriptBeyondLimit> {
        check_script_limits(
            &VehicleSpec::new(
                VehicleClass::Light,
                50.0,
                SPEED_MPS,
                Driver::Profile(profile),
            ),
            3.0,
            HORIZON_S,
        )
    }

    fn pieces(from_s: &[f64], accel_mps2: &[f64]) -> LeadProfile {
        LeadProfile::Pieces(PiecewiseAcceleration {
            from_s: from_s.to_vec(),
            accel_mps2: accel_mps2.to_vec(),
        })
    }

    fn recorded(time_s: &[f64], speed_mps: &[f64]) -> LeadProfile {
        LeadProfile::Recorded(RecordedSpeeds {
            time_s: time_s.to_vec(),
            speed_mps: speed_mps.to_vec(),
        })
    }

    fn allowed_profiles() -> Vec<LeadProfile> {
        let (onset_s, rate_mps2) = (1.004, 3.0);
        vec![
            LeadProfile::ConstantSpeed,
            LeadProfile::Brake(Brake { onset_s, rate_mps2 }),
            LeadProfile::RampBrake(RampBrake {
                onset_s,
                rate_mps2,
                ramp_s: 0.3,
                release_s: 0.25,
            }),
            LeadProfile::RampBrake(RampBrake {
                onset_s,
                rate_mps2,
                ramp_s: 0.0,
                release_s: 0.0,
            }),
            LeadProfile::BrakeToSpeed(BrakeToSpeed {
                onset_s,
                rate_mps2,
                final_speed_mps: 7.0,
            }),
            LeadProfile::BrakeToSpeed(BrakeToSpeed {
                onset_s,
                rate_mps2,
                final_speed_mps: 30.0,
            }),
            pieces(&[], &[]),
            pieces(&[0.5, 1.003, 2.0, 4.0], &[-3.0, 0.0, -1.0, -3.0]),
            pieces(&[0.5, 10.001], &[-3.0, 3.0]),
            recorded(&[0.5, 2.5, 4.0, 5.0], &[20.0, 14.0, 14.0, 13.0]),
            recorded(&[0.0, 0.1, 0.2], &[20.0, 19.75, 19.75]),
            recorded(&[0.0, 9.0, 10.001, 10.002], &[20.0, 20.0, 20.0, 5.0]),
        ]
    }

    #[test]
    fn scripts_within_a_limit_brake_at_most_as_hard_in_each_step() {
        for profile in allowed_profiles() {
            assert_eq!(check_profile(profile.clone()), Ok(()), "{profile:?}");
            let mut speed_mps = SPEED_MPS;
            for step in 0..1000 {
                let [from_s, to_s] = [step, step + 1].map(|step| f64::from(step) * 0.01);
                let mps2 = profile.acceleration_mps2(from_s, to_s, speed_mps);
                assert!(
                    (-3.0 - 1e-9..=1e-9).contains(&mps2) || speed_mps == 0.0,
                    "{profile:?} at {from_s} s: {mps2}"
                );
                speed_mps = (speed_mps + mps2 * 0.01).max(0.0);
            }
        }
    }

    #[test]
    fn scripts_beyond_a_limit_are_refused_with_their_reason() {
        let harder = 3.0_f64.next_up();
        let brakes = |script, mps2| {
            Err(ScriptBeyondLimit::BrakesHarder {
                script,
                mps2,
                limit_mps2: 3.0,
            })
        };
        let speeds_up = |script, mps2| Err(ScriptBeyondLimit::SpeedsUp { script, mps2 });
        let brake = Brake {
            onset_s: 1.0,
            rate_mps2: harder,
        };
        let ramp = RampBrake {
            onset_s: 1.0,
            rate_mps2: 3.5,
            ramp_s: 1.0,
            release_s: 0.0,
        };
        let to_speed = BrakeToSpeed {
            onset_s: 0.0,
            rate_mps2: 4.0,
            final_speed_mps: 19.0,
        };
        for (profile, refused) in [
            (LeadProfile::Brake(brake), brakes("brake", harder)),
            (LeadProfile::RampBrake(ramp), brakes("ramp-brake", 3.5)),
            (
                LeadProfile::BrakeToSpeed(to_speed),
                brakes("brake-to-speed", 4.0),
            ),
            (
                pieces(&[0.0, 1.0, 2.0], &[-1.0, -3.1, -1.0]),
                brakes("pieces", 3.1),
            ),
            (
                pieces(&[0.0, 9.999], &[-3.0, 1e-3]),
                speeds_up("pieces", 1e-3),
            ),
            (
                recorded(&[0.0, 1.0, 1.5], &[20.0, 17.0, 15.0]),
                brakes("recorded", 4.0),
            ),
            (
                recorded(&[0.0, 1.0, 1.5], &[20.0, 17.0, 17.5]),
                speeds_up("recorded", 1.0),
            ),
            (
                recorded(&[0.0, 1.0], &[19.0, 19.0]),
                Err(ScriptBeyondLimit::OtherSpeed {
                    speed_mps: 20.0,
                    recorded_mps: 19.0,
                }),
            ),
        ] {
            assert_eq!(check_profile(profile.clone()), refused, "{profile:?}");
        }
        // As 64-bit numbers, 20 - 19.7 in 0.1 s is more than 3 m/s².
        let rounded = check_profile(recorded(&[0.0, 0.1], &[20.0, 19.7]));
        assert!(
            matches!(rounded, Err(ScriptBeyondLimit::BrakesHarder { mps2, .. }) if mps2 > 3.0 && mps2 < 3.000_001)
        );
        let driven = VehicleSpec::new(VehicleClass::Light, 50.0, SPEED_MPS, Driver::UnderTest);
        assert_eq!(
            check_script_limits(&driven, 3.0, HORIZON_S),
            Err(ScriptBeyondLimit::NotScripted)
        );
        assert!(
            check_script_limits(
                &VehicleSpec {
                    driver: Driver::Profile(allowed_profiles().remove(1)),
                    ..driven
                },
                f64::NAN,
                HORIZON_S
            )
            .is_err()
        );
    }
}
