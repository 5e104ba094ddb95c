//! A leader that slows down briefly and recovers, ahead of a line of vehicles.

use super::{
    Driver, InvalidField, LeadProfile, PiecewiseAcceleration, Scenario, ScenarioSpec, VehicleClass,
    VehicleSpec,
};

/// Start of the leader's dip in [`speed_dip`], in seconds; the line first settles to its time gaps.
pub const SPEED_DIP_ONSET_S: f64 = 60.0;
/// Speed of the leader: 72 km/h.
const SPEED_MPS: f64 = 20.0;
/// Initial excess speed of the followers, so that a cruise control closes up to its time gap.
const CLOSING_MPS: f64 = 2.0;
/// Dip from the onset on: 2 m/s² for 2 s, which takes 4 m/s off; then back at 1 m/s².
const DIP: [(f64, f64); 3] = [(0.0, -2.0), (2.0, 1.0), (6.0, 0.0)];
/// Duration, in seconds; the dip reaches the last of many vehicles.
const DURATION_S: f64 = 120.0;

/// Creates a leader that slows down from 20 m/s to 16 m/s and recovers, and `followers` cars under test behind it. They
/// start `time_gap_s` seconds apart and slightly faster, and settle to their own time gaps before the dip.
///
/// # Errors
/// [`InvalidField`] for no followers, too many, or a time gap that leaves no room.
pub fn speed_dip(followers: usize, time_gap_s: f64) -> Result<Scenario, InvalidField> {
    let class = VehicleClass::Light;
    let pieces = PiecewiseAcceleration {
        from_s: DIP
            .iter()
            .map(|(after_s, _)| SPEED_DIP_ONSET_S + after_s)
            .collect(),
        accel_mps2: DIP.iter().map(|&(_, accel_mps2)| accel_mps2).collect(),
    };
    let spacing_m = class.length_m() + time_gap_s * SPEED_MPS;
    let leader = VehicleSpec::new(
        class,
        0.0,
        SPEED_MPS,
        Driver::Profile(LeadProfile::Pieces(pieces)),
    );
    let behind = (1..=followers).map(|index| {
        VehicleSpec::new(
            class,
            -spacing_m * index as f64,
            SPEED_MPS + CLOSING_MPS,
            Driver::UnderTest,
        )
    });
    let name = format!("speed-dip-{followers}");
    Scenario::new(ScenarioSpec {
        about:
            "A leader slows down a little and recovers: does the disturbance grow along the line?"
                .to_owned(),
        ..ScenarioSpec::new(
            name,
            DURATION_S,
            std::iter::once(leader).chain(behind).collect(),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::BuiltInController;
    use crate::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crate::observation::EstimatorKind;

    #[test]
    fn the_dip_lowers_the_speed_of_the_leader_by_four_metres_per_second() {
        let scenario = speed_dip(5, 1.5).unwrap();
        assert!(
            (1..=5).all(|index| scenario.is_under_test(index)
                && scenario.initial_gap_m(index) == Some(30.0))
        );
        let acc = BuiltInController::from_name("acc-aeb").unwrap();
        let run = Run::new(
            &scenario,
            RunOptions::new(acc).with_estimator(EstimatorKind::Truth),
        )
        .unwrap();
        let trace = simulate(&run, RecordingLevel::Trace).trace.unwrap();
        let leader = &trace.vehicles[0].speed_mps;
        let slowest_mps = leader.iter().copied().fold(f64::INFINITY, f64::min);
        assert!((slowest_mps - 16.0).abs() < 1e-9 && (leader.last().unwrap() - 20.0).abs() < 1e-9);
        assert!(
            speed_dip(0, 1.5).is_err()
                && speed_dip(5, 0.0).is_err()
                && speed_dip(5, f64::NAN).is_err()
        );
    }
}
