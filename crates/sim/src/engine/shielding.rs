//! Assumptions of a shield in a scenario, and its interventions.

use serde::{Deserialize, Serialize};

use super::Run;
use crate::control::{
    ErrorBounds, MAX_MARGIN_M, MIN_MARGIN_M, MotionBounds, Override, RearVehicleParams,
    ShieldAssumptions, ShieldParams, ShieldRefusal, ShieldSettings, ViabilityKernel,
};
use crate::observation::EstimatorKind;
use crate::scenario::{Driver, LeadProfile, VehicleSpec};

/// Standard deviations of noise that a shield assumes as a bound; exceeded once in 10⁹ samples.
const NOISE_SIGMAS: f64 = 6.0;

/// A period in which a shield braked instead of the controller's command.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Intervention {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// Start, in seconds.
    pub from_s: f64,
    /// End, in seconds: the end of a step, which a collision may have cut short.
    pub to_s: f64,
    /// True if the state was outside the kernel: a collision could no longer be excluded.
    pub outside_kernel: bool,
    /// True if the follower could not avoid the braking vehicle: no command was safe for both.
    pub rear_conflict: bool,
}

/// Returns the interventions of a shield; none for other controllers.
pub(super) fn interventions(
    overrides: &[Override],
    vehicle: usize,
    step_s: f64,
) -> Vec<Intervention> {
    let intervention = |done: &Override| Intervention {
        vehicle,
        from_s: done.first_step as f64 * step_s,
        to_s: (done.last_step + 1) as f64 * step_s,
        outside_kernel: done.outside_kernel,
        rear_conflict: done.rear_conflict,
    };
    overrides.iter().map(intervention).collect()
}

impl ShieldAssumptions for Run {
    fn shield_params(
        &self,
        index: usize,
        settings: &ShieldSettings,
    ) -> Result<ShieldParams, ShieldRefusal> {
        let spec = self.scenario().spec();
        let vehicles = self.scenario().vehicles();
        let own = &vehicles[index];
        let step_s = spec.step_s;
        let whole_steps = |time_s: f64| (time_s / step_s).round();
        let (brake_mps2, noise_mps2) = (
            self.scenario().usable_brake_mps2(index),
            noise_bound_mps2(own),
        );
        if !self.scenario().keeps_lanes() {
            return Err(ShieldRefusal::LaneChanges);
        }
        if !self.scenario().has_only_point_masses() {
            return Err(ShieldRefusal::Plant);
        }
        let response = own.response();
        if response.is_only_simulated {
            return Err(ShieldRefusal::JerkLimit);
        }
        if noise_mps2 >= brake_mps2 {
            return Err(ShieldRefusal::Noise { brake_mps2 });
        }
        let ahead = index.checked_sub(1).and_then(|front| vehicles.get(front));
        let dry_mps2 = settings
            .ahead_brake_mps2
            .or(ahead.map(VehicleSpec::max_brake_mps2))
            .unwrap_or(brake_mps2);
        let ahead_brake_mps2 =
            dry_mps2 * spec.environment.friction + ahead.map_or(0.0, noise_bound_mps2);
        let ahead_accel_mps2 = ahead.map_or(0.0, |ahead| {
            ahead.max_accel_mps2() + noise_bound_mps2(ahead)
        });
        let accel_mps2 = own.max_accel_mps2();
        if spec.sensors.faults.is_any() && self.options().estimator == EstimatorKind::Kalman {
            return Err(ShieldRefusal::SensorFaults);
        }
        let errors = match (settings.errors, self.options().estimator) {
            (Some(errors), _) => errors,
            (None, EstimatorKind::Truth) => ErrorBounds::default(),
            (None, EstimatorKind::Kalman) if spec.sensors.dropout > 0.0 => {
                return Err(ShieldRefusal::Dropout);
            }
            (None, EstimatorKind::Kalman) => {
                let spans_mps2 = [
                    brake_mps2 + accel_mps2 + 2.0 * noise_mps2,
                    ahead_brake_mps2 + ahead_accel_mps2,
                ];
                let [gap_m, speed_mps, ahead_speed_mps] =
                    self.tuning().worst_errors(spans_mps2, NOISE_SIGMAS);
                ErrorBounds {
                    gap_m,
                    speed_mps,
                    ahead_speed_mps,
                }
            }
        };
        let delay_steps = (whole_steps(response.delay_s) as usize).min(self.scenario().steps());
        let mut frame = ShieldParams {
            step_s,
            brake_mps2,
            accel_mps2,
            noise_mps2,
            ahead_brake_mps2,
            delay_steps,
            response_fraction: if response.lag_s > 0.0 {
                -(-step_s / response.lag_s).exp_m1()
            } else {
                1.0
            },
            errors,
            behind: vehicles.get(index + 1).map(|behind| RearVehicleParams {
                brake_mps2: self.scenario().usable_brake_mps2(index + 1),
                reaction_s: whole_steps(behind.response().delay_s) * step_s,
            }),
            margin_m: MIN_MARGIN_M,
        };
        // Without a leader the margin has no effect.
        if let Some(front) = index.checked_sub(1) {
            let travel = self.motion_bounds(front, &frame);
            frame.margin_m = travel.margin_m(&frame);
            if frame.margin_m > MAX_MARGIN_M || frame.margin_m.is_nan() {
                let (half_m, position_m) = (0.5 * frame.margin_m, travel.position_m);
                return Err(ShieldRefusal::Rounding {
                    rounding_m: half_m,
                    position_m,
                    max_margin_m: MAX_MARGIN_M,
                });
            }
        }
        Ok(frame)
    }
}

impl Run {
    /// Returns bounds of the motion of vehicle `front` and its follower in this run, without collisions.
    ///
    /// No vehicle overtakes, so the first vehicle bounds all positions. For a vehicle (speed v, brake b) in the kernel
    /// with its leader (speed w, brake c), the difference of their stopping distances v²/2b - w²/2c is at most the gap,
    /// and the gap is at most the length of the road that the run can cover. This bounds v.
    fn motion_bounds(&self, front: usize, frame: &ShieldParams) -> MotionBounds {
        let spec = self.scenario().spec();
        let vehicles = self.scenario().vehicles();
        let fastest_mps = |vehicle: &VehicleSpec| {
            let accel_mps2 = match &vehicle.driver {
                // To follow a recording, a vehicle may use any acceleration within its limits.
                Driver::Profile(profile) if !matches!(profile, LeadProfile::Recorded(_)) => {
                    profile.acceleration_range_mps2()[1].min(vehicle.max_accel_mps2())
                }
                _ => vehicle.max_accel_mps2(),
            };
            vehicle.speed_mps + (accel_mps2 + noise_bound_mps2(vehicle)) * spec.duration_s
        };
        let (first, ahead, own) = (&vehicles[0], &vehicles[front], &vehicles[front + 1]);
        // Distance of a step, and the length of a vehicle.
        let spare_m = (100.0 + 60.0 * frame.step_s) * frame.step_s + ahead.length_m();
        let farthest_m = first.position_m + fastest_mps(first) * spec.duration_s + spare_m;
        let ahead_mps = fastest_mps(ahead);
        let ViabilityKernel {
            own_brake_mps2,
            ahead_brake_mps2,
        } = frame.kernel();
        let road_m = farthest_m - own.position_m;
        let in_kernel_mps = (2.0 * own_brake_mps2 * road_m
            + own_brake_mps2 / ahead_brake_mps2 * ahead_mps * ahead_mps)
            .sqrt();
        let own_mps = fastest_mps(own).min(in_kernel_mps);
        MotionBounds {
            position_m: farthest_m.abs().max((own.position_m - spare_m).abs()),
            speed_mps: own_mps.max(ahead_mps),
            ahead_accel_mps2: ahead.max_accel_mps2() + noise_bound_mps2(ahead),
            steps: self.scenario().steps().saturating_mul(self.substeps()),
            substeps: self.substeps(),
        }
    }
}

fn noise_bound_mps2(vehicle: &VehicleSpec) -> f64 {
    NOISE_SIGMAS * vehicle.acceleration_noise_mps2
}

#[cfg(test)]
mod tests;
