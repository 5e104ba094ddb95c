//! Conversion of commanded accelerations to those of the vehicle.

use std::collections::VecDeque;

use super::multi_body::{MultiBody, brake_delay_s};
use crate::control::clamp_command;
use crate::random::{NoiseStream, Purpose};
use crate::scenario::Scenario;

/// Limits, delays and lag of a vehicle, in steps of the scenario, independent of the integration step.
#[derive(Debug, Clone)]
pub(super) struct Actuator {
    pub(super) max_brake_mps2: f64,
    pub(super) max_accel_mps2: f64,
    /// `None` for a vehicle that responds at once and fully.
    dynamics: Option<Box<ActuatorDynamics>>,
}

#[derive(Debug, Clone)]
struct ActuatorDynamics {
    pending_mps2: VecDeque<f64>,
    /// Share of the difference to the command that a step covers: 1 - exp(-step / lag).
    response_fraction: f64,
    /// Maximum change of acceleration per step, in m/s²; infinite without a jerk limit.
    max_change_mps2: f64,
    response_mps2: f64,
    /// Plant and step in seconds; `None` for a point mass.
    multi_body: Option<(MultiBody, f64)>,
}

impl Actuator {
    /// Creates the actuator of vehicle `index`.
    ///
    /// Reaction delay and actuator delay are added: late observation and late action are equivalent.
    pub(super) fn new(scenario: &Scenario, index: usize) -> Self {
        let vehicle = &scenario.vehicles()[index];
        let step_s = scenario.spec().step_s;
        let body = vehicle.multi_body();
        let delay_s = vehicle.response().delay_s + body.map_or(0.0, brake_delay_s);
        let delay_steps = (delay_s / step_s).round() as usize;
        // Commands that are still pending at the end of the scenario need no space.
        let delay_steps = delay_steps.min(scenario.steps());
        let lag_s = vehicle.actuator_lag_s;
        let is_sluggish =
            delay_steps > 0 || !vehicle.response().is_full_at_once() || body.is_some();
        let friction = scenario.spec().environment.friction;
        let sluggish = is_sluggish.then(|| {
            Box::new(ActuatorDynamics {
                pending_mps2: VecDeque::from(vec![0.0; delay_steps]),
                response_fraction: if lag_s > 0.0 {
                    -(-step_s / lag_s).exp_m1()
                } else {
                    1.0
                },
                max_change_mps2: vehicle
                    .jerk_limit_mps3
                    .map_or(f64::INFINITY, |jerk| jerk * step_s),
                response_mps2: 0.0,
                multi_body: body
                    .map(|body| (MultiBody::new(body, friction, vehicle.speed_mps), step_s)),
            })
        });
        Self {
            // The tyres of a multi-body vehicle limit its braking on a slippery road.
            max_brake_mps2: match body {
                None => scenario.usable_brake_mps2(index),
                Some(_) => vehicle.max_brake_mps2(),
            },
            max_accel_mps2: vehicle.max_accel_mps2(),
            dynamics: sluggish,
        }
    }

    pub(super) fn is_immediate(&self) -> bool {
        self.dynamics.is_none()
    }

    #[inline]
    pub(super) fn respond(&mut self, command_mps2: f64, speed_mps: f64) -> f64 {
        match &mut self.dynamics {
            None => clamp_command(command_mps2, self.max_brake_mps2, self.max_accel_mps2),
            Some(sluggish) => {
                sluggish.pending_mps2.push_back(command_mps2);
                let due_mps2 = sluggish.pending_mps2.pop_front().unwrap_or(command_mps2);
                let target_mps2 = clamp_command(due_mps2, self.max_brake_mps2, self.max_accel_mps2);
                let change = sluggish.response_fraction * (target_mps2 - sluggish.response_mps2);
                sluggish.response_mps2 +=
                    change.clamp(-sluggish.max_change_mps2, sluggish.max_change_mps2);
                match &mut sluggish.multi_body {
                    None => sluggish.response_mps2,
                    Some((plant, step_s)) => {
                        plant.respond(sluggish.response_mps2, speed_mps, *step_s)
                    }
                }
            }
        }
    }
}

/// Adds noise to an acceleration, with two exceptions at standstill. A vehicle that does not command motion is held by
/// its brakes. For a vehicle that commands motion, noise cannot make the acceleration negative.
///
/// Not for vehicles that are locked together; their motion depends on their summed forces.
#[inline]
pub(super) fn add_noise_unless_at_rest(
    acceleration_mps2: f64,
    noise_mps2: f64,
    speed_mps: f64,
) -> f64 {
    let disturbed_mps2 = acceleration_mps2 + noise_mps2;
    if speed_mps == 0.0 && (acceleration_mps2 <= 0.0 || disturbed_mps2 < 0.0) {
        0.0
    } else {
        disturbed_mps2
    }
}

#[derive(Debug, Clone)]
pub(super) struct Disturbance {
    noise: NoiseStream,
    deviation_mps2: f64,
}

impl Disturbance {
    /// Creates the noise of vehicle `index`; `None` for a vehicle without noise.
    pub(super) fn new(scenario: &Scenario, index: usize) -> Option<Self> {
        let deviation_mps2 = scenario.vehicles()[index].acceleration_noise_mps2;
        (deviation_mps2 > 0.0).then(|| Self {
            noise: NoiseStream::from_shares(
                scenario.spec().seed,
                scenario.noise_shares(),
                Purpose::AccelerationNoise,
                index as u64,
            ),
            deviation_mps2,
        })
    }

    #[inline]
    pub(super) fn next_mps2(&mut self) -> f64 {
        self.deviation_mps2 * self.noise.normal()
    }

    /// Returns the noise of the next `N` steps, in m/s².
    #[inline]
    pub(super) fn next_n_mps2<const N: usize>(&mut self) -> [f64; N] {
        self.noise
            .normals()
            .map(|normal| self.deviation_mps2 * normal)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenario::{VehicleSpec, built_in_scenario};

    fn actuator(change: impl FnOnce(&mut VehicleSpec)) -> Actuator {
        let scenario = built_in_scenario("paper-1")
            .unwrap()
            .edited(|spec| change(&mut spec.vehicles[1]))
            .unwrap();
        Actuator::new(&scenario, 1)
    }

    #[test]
    fn commands_are_cut_to_the_limits_and_nan_is_nothing() {
        let mut actuator = actuator(|_| {});
        let responses = [-20.0, 20.0, f64::NAN, f64::NEG_INFINITY]
            .map(|command| actuator.respond(command, 10.0));
        assert_eq!(responses, [-7.5, 3.0, 0.0, -7.5]);
    }

    #[test]
    fn reaction_and_actuator_delays_add_up() {
        let mut actuator = actuator(|v| (v.reaction_delay_s, v.actuator_delay_s) = (0.02, 0.01));
        let responses =
            [-1.0, -2.0, -3.0, -4.0, -5.0].map(|command| actuator.respond(command, 10.0));
        assert_eq!(responses, [0.0, 0.0, 0.0, -1.0, -2.0]);
    }

    #[test]
    fn lag_covers_63_percent_in_one_time_constant_and_jerk_is_limited() {
        let mut lagging = actuator(|v| v.actuator_lag_s = 0.2);
        let after = (0..20).map(|_| lagging.respond(-5.0, 10.0)).last().unwrap();
        assert!(
            (after + 5.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-12,
            "{after}"
        );
        let mut limited = actuator(|v| v.jerk_limit_mps3 = Some(10.0));
        let after = (0..5).map(|_| limited.respond(-5.0, 10.0)).last().unwrap();
        assert!((after + 0.5).abs() < 1e-12, "{after}");
    }
}
