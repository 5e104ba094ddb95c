//! Random drivers.

use crumple::scenario::{
    AccAebSettings, AebSettings, Brake, BrakeToSpeed, ConstantBrakeSettings, ControllerSpec, Driver, IdmSettings,
    LeadProfile, Pieces, RampBrake, Recorded,
};
use proptest::prelude::*;

/// What sort of driver sits in a seat.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Kind {
    UnderTest,
    /// A profile, by its place in [`any_profile`].
    Profile(usize),
    /// A controller, by its place in [`any_controller`].
    Controller(usize),
}

/// Any sort of driver.
pub(crate) fn kind() -> impl Strategy<Value = Kind> {
    prop_oneof![
        2 => Just(Kind::UnderTest),
        2 => (0..6_usize).prop_map(Kind::Profile),
        2 => (0..6_usize).prop_map(Kind::Controller),
    ]
}

/// Any driver of a sort.
pub(crate) fn driver_of(kind: Kind) -> BoxedStrategy<Driver> {
    match kind {
        Kind::UnderTest => Just(Driver::UnderTest).boxed(),
        Kind::Profile(index) => any_profile(index).prop_map(Driver::Profile).boxed(),
        Kind::Controller(index) => any_controller(index).prop_map(Driver::Controller).boxed(),
    }
}

/// The `index`-th sort of lead profile, with onsets in the first 3 s and never more than 9 m/s² of braking.
pub(crate) fn any_profile(index: usize) -> BoxedStrategy<LeadProfile> {
    let (onset_s, rate_mps2) = (0.0..3.0_f64, 0.0..9.0_f64);
    match index {
        0 => Just(LeadProfile::ConstantSpeed).boxed(),
        1 => (onset_s, rate_mps2)
            .prop_map(|(onset_s, rate_mps2)| LeadProfile::Brake(Brake { onset_s, rate_mps2 }))
            .boxed(),
        2 => (onset_s, rate_mps2, 0.0..2.0_f64, prop_oneof![Just(0.0), 0.0..1.0_f64])
            .prop_map(|(onset_s, rate_mps2, ramp_s, release_s)| {
                LeadProfile::RampBrake(RampBrake { onset_s, rate_mps2, ramp_s, release_s })
            })
            .boxed(),
        3 => (onset_s, rate_mps2, 0.0..30.0_f64)
            .prop_map(|(onset_s, rate_mps2, final_speed_mps)| {
                LeadProfile::BrakeToSpeed(BrakeToSpeed { onset_s, rate_mps2, final_speed_mps })
            })
            .boxed(),
        4 => series(-9.0..4.0)
            .prop_map(|(from_s, accel_mps2)| LeadProfile::Pieces(Pieces { from_s, accel_mps2 }))
            .boxed(),
        _ => series(0.0..40.0)
            .prop_map(|(time_s, speed_mps)| LeadProfile::Recorded(Recorded { time_s, speed_mps }))
            .boxed(),
    }
}

/// Increasing times, and a value at each.
fn series(value: std::ops::Range<f64>) -> impl Strategy<Value = (Vec<f64>, Vec<f64>)> {
    prop::collection::vec((0.001..1.0_f64, value), 1..6).prop_map(|entries| {
        let times = entries.iter().scan(0.0, |time, (later, _)| {
            *time += later;
            Some(*time)
        });
        (times.collect(), entries.iter().map(|(_, value)| *value).collect())
    })
}

/// The `index`-th built-in controller, with any sensible settings.
pub(crate) fn any_controller(index: usize) -> BoxedStrategy<ControllerSpec> {
    let ttc_s = 0.0..4.0_f64;
    match index {
        0 => ttc_s.prop_map(|ttc_s| ControllerSpec::Baseline(AebSettings { ttc_s })).boxed(),
        1 => ttc_s.prop_map(|ttc_s| ControllerSpec::BaselineUnlatched(AebSettings { ttc_s })).boxed(),
        2 => Just(ControllerSpec::MatchLeader).boxed(),
        3 => (0.0..9.0_f64, 0.0..4.0_f64, 0.0..1.0_f64)
            .prop_map(|(rate_mps2, trigger_mps2, delay_s)| {
                ControllerSpec::ConstantBrake(ConstantBrakeSettings { rate_mps2, trigger_mps2, delay_s })
            })
            .boxed(),
        4 => (5.0..45.0_f64, 0.0..3.0_f64, 0.0..5.0_f64, 0.1..4.0_f64, 0.1..4.0_f64)
            .prop_map(|(desired_speed_mps, time_headway_s, standstill_gap_m, accel_mps2, comfortable_brake_mps2)| {
                ControllerSpec::Idm(IdmSettings {
                    desired_speed_mps,
                    time_headway_s,
                    standstill_gap_m,
                    accel_mps2,
                    comfortable_brake_mps2,
                })
            })
            .boxed(),
        _ => ((0.0..3.0_f64, 0.0..5.0_f64, 0.0..1.0_f64, 0.0..2.0_f64), (0.0..5.0_f64, 0.0..3.0_f64, ttc_s))
            .prop_map(|((time_headway_s, standstill_gap_m, gap_gain_per_s2, speed_gain_per_s), rest)| {
                let (comfort_brake_mps2, comfort_accel_mps2, ttc_s) = rest;
                ControllerSpec::AccAeb(AccAebSettings {
                    time_headway_s,
                    standstill_gap_m,
                    gap_gain_per_s2,
                    speed_gain_per_s,
                    comfort_brake_mps2,
                    comfort_accel_mps2,
                    ttc_s,
                })
            })
            .boxed(),
    }
}
