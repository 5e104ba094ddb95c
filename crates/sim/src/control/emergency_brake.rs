//! An emergency brake whose threshold, delay, rise and detection are settings, for studies and for models of cars.
//!
//! Sources of what the settings describe; the defaults switch all but the first two off:
//! - Threshold that depends on the closing speed: a car that must stop needs a time Δv/(2 b), which grows with the
//!   closing speed Δv (UN R157, 5.2.5.2, has this form); a sensor of limited range gives less time at high ones.
//! - Delay and deceleration: Hutchinson 2015, Traffic Engineering and Control, abstract (impact speed from look-ahead
//!   distance, reaction time and deceleration of the system).
//! - Rate of build-up: UN R157, table 1, states 0.774 g within 0.6 s, 12.65 m/s³, for brakes of a car.
//! - Partial braking before full braking: Mercedes-Benz, PRE-SAFE Brake (technical page): up to 0.4 g from about 1.6 s
//!   before the collision, emergency braking from about 0.6 s.
//! - Standing vehicles that are missed: manuals restrict the detection of standing vehicles (Dacia Sandero 2024,
//!   page 200).
//!
//! Not modelled: braking by the driver, coasting after a warning, lateral position, shape and reflection of the vehicle
//! ahead. A standing vehicle that appears because the vehicle before it leaves the lane counts as seen moving.

use std::collections::VecDeque;

use rand::RngExt;

use super::reaction::{BrakeRamp, whole_steps};
use super::{BuiltIn, Controller, ControllerFailure, Ego};
use crate::observation::{Neighbour, Observation};
use crate::random::{Purpose, stream};
use crate::settings::settings;

/// Speed up to which a vehicle counts as standing, in m/s; estimates of a standing vehicle stay below it.
const STANDING_MPS: f64 = 1.0;
/// Rate of build-up that stands for none.
const NO_JERK_LIMIT_MPS3: f64 = 10_000.0;

settings! {
    /// Settings of the configurable emergency brake; the module documentation has the sources.
    EmergencyBrakeSettings {
        /// Time to collision below which the brake fires, in seconds; 0 never fires.
        ttc_s: 1.4, 0.0..=100.0, 0.0..=4.0;
        /// Deceleration of the brake, in m/s², positive; the vehicle's own limit applies, too.
        brake_mps2: 7.5, 0.0..=30.0, 2.0..=9.0;
        /// Change of that time per m/s of closing speed, in s²/m; 0: the same time at all closing speeds.
        closing_slope_s2_per_m: 0.0, -1.0..=1.0, -0.03..=0.06;
        /// Time from the demand of the brake to its effect, in seconds, rounded to steps.
        delay_s: 0.0, 0.0..=10.0, 0.0..=0.5;
        /// Rate at which braking builds up, in m/s³; 10 000, the default, stands for no limit.
        jerk_mps3: NO_JERK_LIMIT_MPS3, 0.1..=10_000.0, 5.0..=50.0, none NO_JERK_LIMIT_MPS3;
        /// Time to collision below which partial braking begins, in seconds; 0: no partial braking. It counts the
        /// deceleration of the vehicle ahead, until that vehicle stands.
        partial_ttc_s: 0.0, 0.0..=100.0, 0.0..=4.0, none 0.0;
        /// Deceleration of partial braking, in m/s², positive (Mercedes-Benz, PRE-SAFE Brake: around 4 m/s²).
        partial_brake_mps2: 4.0, 0.0..=30.0, 1.0..=6.0;
        /// Share of the runs in which the brake misses every vehicle that it has not seen moving.
        standing_miss_share: 0.0, 0.0..=1.0, 0.0..=0.5;
    }
}

/// A driver that holds its speed, and an emergency brake that holds its braking until the vehicle no longer closes in.
#[derive(Debug, Clone, PartialEq)]
pub struct EmergencyBrake {
    full: HeldBrake,
    partial: HeldBrake,
    detection: StandingVehicleDetection,
    response: BrakeResponse,
}

impl BuiltIn for EmergencyBrake {
    const NAME: &'static str = "emergency-brake";
    const SUMMARY: &'static str = "hold speed; brake at 7.5 m/s² from TTC < 1.4 s until no longer \
        closing in (all numbers are settings)";
    type Settings = EmergencyBrakeSettings;
    type Driver = Self;

    fn acts_at_random(settings: &EmergencyBrakeSettings) -> bool {
        settings.standing_miss_share > 0.0
    }

    fn start(settings: &EmergencyBrakeSettings, ego: &Ego, seed: u64) -> Self {
        Self {
            full: HeldBrake::new(settings.ttc_s, settings.brake_mps2)
                .with_closing_slope(settings.closing_slope_s2_per_m),
            partial: HeldBrake::new(settings.partial_ttc_s, settings.partial_brake_mps2)
                .counting_deceleration(),
            detection: StandingVehicleDetection::new(settings.standing_miss_share, ego, seed),
            response: BrakeResponse::new(settings.delay_s, settings.jerk_mps3, ego),
        }
    }
}

impl Controller for EmergencyBrake {
    #[inline]
    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let detected = Observation {
            ahead: observation
                .ahead
                .filter(|ahead| self.detection.detects(ahead)),
            ..*observation
        };
        let partial_mps2 = self.partial.demand_mps2(&detected).unwrap_or(0.0);
        let demand_mps2 = self.full.demand_mps2(&detected).unwrap_or(partial_mps2);
        Ok(-self.response.step(demand_mps2))
    }
}

/// Detection of standing vehicles, which some runs miss.
#[derive(Debug, Clone, PartialEq)]
struct StandingVehicleDetection {
    misses_standing: bool,
    has_seen_motion: bool,
}

impl StandingVehicleDetection {
    fn new(miss_share: f64, ego: &Ego, seed: u64) -> Self {
        let draw = || {
            stream(seed, Purpose::MissedDetection, ego.vehicle as u64).random::<f64>() < miss_share
        };
        Self {
            misses_standing: miss_share > 0.0 && draw(),
            has_seen_motion: false,
        }
    }

    #[inline]
    fn detects(&mut self, ahead: &Neighbour) -> bool {
        self.has_seen_motion |= ahead.speed_mps > STANDING_MPS;
        self.has_seen_motion || !self.misses_standing
    }
}

/// Conversion of the demanded deceleration to the commanded one: a dead time, and a limited rise. Braking ends at once
/// after the dead time.
#[derive(Debug, Clone, PartialEq)]
struct BrakeResponse {
    pending_mps2: VecDeque<f64>,
    ramp: Option<BrakeRamp>,
}

impl BrakeResponse {
    fn new(delay_s: f64, jerk_mps3: f64, ego: &Ego) -> Self {
        let delay_steps = whole_steps(delay_s, ego.step_s) as usize;
        Self {
            pending_mps2: VecDeque::from(vec![0.0; delay_steps]),
            ramp: (jerk_mps3 < NO_JERK_LIMIT_MPS3)
                .then(|| BrakeRamp::new(0.0, jerk_mps3, ego.step_s)),
        }
    }

    /// Returns the braking of the next step for its demand, both in m/s², positive.
    #[inline]
    fn step(&mut self, demand_mps2: f64) -> f64 {
        let due_mps2 = if self.pending_mps2.is_empty() {
            demand_mps2
        } else {
            self.pending_mps2.push_back(demand_mps2);
            self.pending_mps2.pop_front().unwrap_or(demand_mps2)
        };
        match &mut self.ramp {
            Some(ramp) => ramp.step_towards(due_mps2),
            None => due_mps2,
        }
    }
}

/// An emergency brake that fires below a time to collision, and holds its braking while the vehicle closes in.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct HeldBrake {
    ttc_s: f64,
    /// Change of that time per m/s of closing speed.
    closing_slope_s2_per_m: f64,
    brake_mps2: f64,
    counts_deceleration: bool,
    is_braking: bool,
}

impl HeldBrake {
    /// Creates a brake with one threshold for all closing speeds; 0 never fires.
    pub(super) fn new(ttc_s: f64, brake_mps2: f64) -> Self {
        Self {
            ttc_s,
            closing_slope_s2_per_m: 0.0,
            brake_mps2,
            counts_deceleration: false,
            is_braking: false,
        }
    }

    /// Also fires at a collision that the present deceleration of the vehicle ahead would cause within the threshold.
    fn counting_deceleration(self) -> Self {
        Self {
            counts_deceleration: true,
            ..self
        }
    }

    fn with_closing_slope(self, closing_slope_s2_per_m: f64) -> Self {
        Self {
            closing_slope_s2_per_m,
            ..self
        }
    }

    /// Returns the demanded braking, in m/s², positive; `None` while the brake is released.
    #[inline]
    pub(super) fn demand_mps2(&mut self, observation: &Observation) -> Option<f64> {
        if self.ttc_s == 0.0 {
            return None;
        }
        self.is_braking = observation.ahead.is_some_and(|ahead| {
            self.fires(&ahead, observation.speed_mps)
                || self.is_braking && observation.speed_mps > ahead.speed_mps
        });
        self.is_braking.then_some(self.brake_mps2)
    }

    /// True if time to collision is below its threshold θ, computed as gap - θ Δv < 0, which also holds for overlapping
    /// vehicles. A deceleration that counts shortens the gap further.
    #[inline]
    fn fires(&self, ahead: &Neighbour, speed_mps: f64) -> bool {
        let closing_mps = speed_mps - ahead.speed_mps;
        let threshold_s = (self.ttc_s + self.closing_slope_s2_per_m * closing_mps).max(0.0);
        let lost_m = if self.counts_deceleration {
            distance_lost_m(ahead, threshold_s)
        } else {
            0.0
        };
        ahead.gap_m - threshold_s * closing_mps - lost_m < 0.0
    }
}

/// Returns the distance by which a vehicle that keeps its deceleration falls behind one that keeps its speed, in m.
fn distance_lost_m(vehicle: &Neighbour, time_s: f64) -> f64 {
    let deceleration_mps2 = (-vehicle.acceleration_mps2).max(0.0);
    let speed_mps = vehicle.speed_mps.max(0.0);
    if deceleration_mps2 * time_s <= speed_mps {
        0.5 * deceleration_mps2 * time_s * time_s
    } else {
        speed_mps * time_s - speed_mps * speed_mps / (2.0 * deceleration_mps2)
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, command_behind, leader_observation, stopping_distance_m};
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn brakes_at_its_level_until_the_gap_stops_closing() {
        let settings = EmergencyBrakeSettings {
            ttc_s: 2.0,
            brake_mps2: 4.0,
            ..EmergencyBrakeSettings::default()
        };
        let mut driver = EmergencyBrake::start(&settings, &EGO, 0);
        assert_eq!(
            command_behind(&mut driver, 20.0, 20.0, 10.0, 0.0),
            0.0,
            "TTC is exactly 2 s"
        );
        assert_eq!(command_behind(&mut driver, 20.0, 19.99, 10.0, 0.0), -4.0);
        assert_eq!(
            command_behind(&mut driver, 10.1, 50.0, 10.0, 0.0),
            -4.0,
            "still closing in"
        );
        assert_eq!(
            command_behind(&mut driver, 10.0, 50.0, 10.0, 0.0),
            0.0,
            "released"
        );
        let mut never = EmergencyBrake::start(
            &EmergencyBrakeSettings {
                ttc_s: 0.0,
                ..settings
            },
            &EGO,
            0,
        );
        assert_eq!(command_behind(&mut never, 20.0, 0.0, 0.0, 0.0), 0.0);
    }

    #[test]
    fn partial_braking_precedes_full_braking() {
        let settings = EmergencyBrakeSettings {
            partial_ttc_s: 2.0,
            partial_brake_mps2: 3.0,
            ..EmergencyBrakeSettings::default()
        };
        let mut driver = EmergencyBrake::start(&settings, &EGO, 0);
        let commands = [2.1, 1.9, 1.3, 1.9]
            .map(|ttc_s| command_behind(&mut driver, 20.0, 10.0 * ttc_s, 10.0, 0.0));
        assert_eq!(commands, [0.0, -3.0, -7.5, -7.5]);
    }

    /// Closed form: a leader at 10 m/s that brakes at d stands after 10/d s, 50/d m further.
    #[test]
    fn partial_braking_counts_the_deceleration_of_the_leader_until_it_stands() {
        let settings = EmergencyBrakeSettings {
            ttc_s: 0.1,
            partial_ttc_s: 2.0,
            ..EmergencyBrakeSettings::default()
        };
        for (deceleration_mps2, first_gap_m) in [(0.0, 4.0), (3.0, 4.0 + 6.0), (8.0, 24.0 - 6.25)] {
            let command = |gap_m| {
                let mut driver = EmergencyBrake::start(&settings, &EGO, 0);
                command_behind(&mut driver, 12.0, gap_m, 10.0, -deceleration_mps2)
            };
            assert_eq!(command(first_gap_m + 1e-9), 0.0, "{deceleration_mps2}");
            assert_eq!(command(first_gap_m - 1e-9), -4.0, "{deceleration_mps2}");
        }
    }

    /// Of 4000 runs, the stated share misses a standing vehicle, and none one that has moved.
    #[test]
    fn misses_its_share_of_standing_vehicles_only() {
        let settings = EmergencyBrakeSettings {
            standing_miss_share: 0.27,
            ..EmergencyBrakeSettings::default()
        };
        let brakes = |seed, first_speed_mps| {
            let mut driver = EmergencyBrake::start(&settings, &EGO, seed);
            command_behind(&mut driver, 20.0, 200.0, first_speed_mps, 0.0);
            command_behind(&mut driver, 20.0, 10.0, 0.0, 0.0) < 0.0
        };
        let missed = (0..4000).filter(|&seed| !brakes(seed, 0.0)).count();
        // Four standard deviations of a binomial count.
        assert!((missed as f64 - 1080.0).abs() < 4.0 * 28.1, "{missed}");
        assert!((0..4000).all(|seed| brakes(seed, 5.0)));
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// A new brake fires if gap / closing speed < `ttc_s` + slope times closing speed.
        #[test]
        fn fires_below_its_threshold(
            ttc_s in 0.1..4.0,
            closing_slope_s2_per_m in -0.1..0.1,
            ahead_mps in 0.0..20.0,
            closing_mps in 0.1..40.0,
            gap_m in 0.0..200.0,
        ) {
            let speed_mps = ahead_mps + closing_mps;
            let threshold_s: f64 = ttc_s + closing_slope_s2_per_m * closing_mps;
            let ttc_found_s: f64 = gap_m / closing_mps;
            prop_assume!((ttc_found_s - threshold_s).abs() > 1e-9);
            let settings = EmergencyBrakeSettings {
                ttc_s,
                closing_slope_s2_per_m,
                ..EmergencyBrakeSettings::default()
            };
            let mut driver = EmergencyBrake::start(&settings, &EGO, 0);
            let command = command_behind(&mut driver, speed_mps, gap_m, ahead_mps, 0.0);
            prop_assert_eq!(command < 0.0, ttc_found_s < threshold_s);
        }

        /// Closed form of the stopping distance: v τ, then a ramp of jerk j up to b, then v₁²/(2 b).
        #[test]
        fn stops_within_the_distance_of_its_closed_form(
            v in 10.0..40.0,
            delay_steps in 0_u8..60,
            jerk_mps3 in 8.0..60.0,
            brake_mps2 in 3.0..10.0,
        ) {
            let delay_s = f64::from(delay_steps) * EGO.step_s;
            let settings = EmergencyBrakeSettings {
                brake_mps2,
                delay_s,
                jerk_mps3,
                ..EmergencyBrakeSettings::default()
            };
            let driver = EmergencyBrake::start(&settings, &EGO, 0);
            let found_m = stopping_distance_m(driver, v, |speed_mps| {
                leader_observation(speed_mps, 0.0, 0.0, 0.0)
            });
            let rise_s: f64 = brake_mps2 / jerk_mps3;
            let v1: f64 = v - 0.5 * jerk_mps3 * rise_s * rise_s;
            let ramp_m = v * rise_s - jerk_mps3 * rise_s.powi(3) / 6.0;
            let expected_m = v * delay_s + ramp_m + v1 * v1 / (2.0 * brake_mps2);
            // Steps hold the mean of the ramp: j dt³/12 for each, and at most j dt² dt for the one in which it ends.
            let tolerance_m = jerk_mps3 * EGO.step_s.powi(2) * (rise_s / 12.0 + EGO.step_s);
            prop_assert!((found_m - expected_m).abs() <= tolerance_m, "{} against {}", found_m, expected_m);
        }
    }
}
