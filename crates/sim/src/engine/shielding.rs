//! Assumptions of a shield in a scenario, and its interventions.

use serde::{Deserialize, Serialize};

use super::Run;
use crate::control::{
    BuiltInController, ErrorBounds, FIRING_TTC_S, FollowerClass, FollowerTrigger, MAX_MARGIN_M,
    MIN_MARGIN_M, MotionBounds, Override, RearErrorBounds, RearVehicleParams, ShieldAssumptions,
    ShieldParams, ShieldRefusal, ShieldSettings, TwoSidedParams, TwoSidedSettings, ViabilityKernel,
};
use crate::observation::EstimatorKind;
use crate::scenario::{Driver, LeadProfile, VehicleSpec};

/// Standard deviations of noise that a shield assumes as a bound; exceeded once in 10⁹ samples.
const NOISE_SIGMAS: f64 = 6.0;
/// Two accelerations that differ by this share differ by rounding only: 6 · 0.05 is more than 0.3.
const ROUNDING_SHARE: f64 = 1e-12;

/// Gap that a two-sided shield keeps on either side, in metres, besides rounding.
const MIN_TWO_SIDED_MARGIN_M: f64 = 0.05;

/// Acceleration of a follower whose brake has not fired, in m/s²: enough to hold a speed. A car that coasts in gear is
/// outside the default class (0.4; UN R157, competent driver).
const DEFAULT_DRIFT_MPS2: f64 = 0.3;

/// Deceleration of a follower that a two-sided shield assumes at least, in m/s².
const MIN_FOLLOWER_BRAKE_MPS2: f64 = 0.01;

/// Time constants of an actuator until it brakes with 95 % of the command.
const RISE_TIME_CONSTANTS: f64 = 3.0;

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
    overrides
        .iter()
        .map(|done| Intervention {
            vehicle,
            from_s: done.first_step as f64 * step_s,
            to_s: (done.last_step + 1) as f64 * step_s,
            outside_kernel: done.outside_kernel,
            rear_conflict: done.rear_conflict,
        })
        .collect()
}

impl ShieldAssumptions for Run {
    fn shield_params(
        &self,
        index: usize,
        settings: &ShieldSettings,
    ) -> Result<ShieldParams, ShieldRefusal> {
        self.check_can_shield(index)?;
        let spec = self.scenario().spec();
        let vehicles = self.scenario().vehicles();
        let own = &vehicles[index];
        let response = own.response();
        let step_s = spec.step_s;
        let brake_mps2 = self.scenario().usable_brake_mps2(index);
        let ahead = self.leader_limits(index, settings, brake_mps2);
        let delay_steps = whole_steps(response.delay_s, step_s) as usize;
        let mut params = ShieldParams {
            step_s,
            brake_mps2,
            accel_mps2: own.max_accel_mps2(),
            noise_mps2: noise_bound_mps2(own),
            ahead_brake_mps2: ahead.brake_mps2,
            delay_steps: delay_steps.min(self.scenario().steps()),
            response_fraction: if response.lag_s > 0.0 {
                -(-step_s / response.lag_s).exp_m1()
            } else {
                1.0
            },
            errors: self.estimation_errors(index, settings, ahead)?,
            behind: vehicles.get(index + 1).map(|behind| RearVehicleParams {
                brake_mps2: self.scenario().usable_brake_mps2(index + 1),
                reaction_s: whole_steps(behind.response().delay_s, step_s) * step_s,
            }),
            margin_m: MIN_MARGIN_M,
        };
        // Without a leader the margin has no effect.
        if let Some(front) = index.checked_sub(1) {
            params.margin_m = self.rounding_margin_m(front, &params)?;
        }
        Ok(params)
    }

    fn two_sided_params(
        &self,
        index: usize,
        settings: &TwoSidedSettings,
    ) -> Result<TwoSidedParams, ShieldRefusal> {
        let ahead_only = self.shield_params(
            index,
            &ShieldSettings {
                ahead_brake_mps2: settings.level_mps2,
                errors: settings.errors.map(|(errors, _)| errors),
            },
        )?;
        let follower = self.follower_class(index, settings);
        let step_s = ahead_only.step_s;
        if let Some(FollowerTrigger::TimeToCollision(ttc_s)) = follower.map(|class| class.trigger)
            && ttc_s < 2.0 * step_s
        {
            return Err(ShieldRefusal::ShortTtc { ttc_s, step_s });
        }
        Ok(TwoSidedParams {
            step_s,
            brake_mps2: ahead_only.brake_mps2,
            accel_mps2: ahead_only.accel_mps2,
            noise_mps2: ahead_only.noise_mps2,
            delay_steps: ahead_only.delay_steps,
            response_fraction: ahead_only.response_fraction,
            level_mps2: ahead_only.ahead_brake_mps2,
            errors: ahead_only.errors,
            rear_errors: self.rear_estimation_errors(index, settings),
            follower,
            margin_m: MIN_TWO_SIDED_MARGIN_M + 2.0 * ahead_only.margin_m,
            raises: settings.raises,
        })
    }
}

/// Largest braking and acceleration that a shield assumes of the leader, in m/s²; both positive, with noise.
#[derive(Clone, Copy)]
struct LeaderLimits {
    brake_mps2: f64,
    accel_mps2: f64,
}

impl Run {
    /// Returns the assumptions of a two-sided shield of vehicle `index` with these settings. `Driver::UnderTest` is not
    /// required.
    ///
    /// # Errors
    /// [`ShieldRefusal`] if a shield gives no guarantee for the vehicle.
    pub fn two_sided_shield(
        &self,
        index: usize,
        settings: &TwoSidedSettings,
    ) -> Result<TwoSidedParams, ShieldRefusal> {
        self.two_sided_params(index, settings)
    }

    /// Returns the name of the driver of the follower of vehicle `index`, unless that is known to be of the class: a
    /// `baseline` that fires at the class's time to collision, with the limits of the class or better. Before it fires,
    /// only noise changes its speed.
    #[must_use]
    pub fn driver_outside_class(
        &self,
        index: usize,
        class: &FollowerClass,
    ) -> Option<&'static str> {
        let follower = self.scenario().vehicles().get(index + 1)?;
        let driver = &follower.driver;
        let limits = self.follower_class(index, &TwoSidedSettings::default())?;
        let fires_as_stated = match (driver, class.trigger) {
            (
                Driver::Controller(BuiltInController::Baseline(settings)),
                FollowerTrigger::TimeToCollision(ttc_s),
            ) => settings.ttc_s == ttc_s,
            _ => false,
        };
        let is_within_limits = limits.reaction_s <= class.reaction_s
            && limits.brake_mps2 >= class.brake_mps2
            && noise_bound_mps2(follower) <= class.drift_mps2 * (1.0 + ROUNDING_SHARE);
        (!fires_as_stated || !is_within_limits).then(|| driver.name())
    }

    /// Checks that the kernel models this run for a shield of vehicle `index`.
    fn check_can_shield(&self, index: usize) -> Result<(), ShieldRefusal> {
        let scenario = self.scenario();
        let own = &scenario.vehicles()[index];
        let brake_mps2 = scenario.usable_brake_mps2(index);
        if !scenario.keeps_lanes() {
            return Err(ShieldRefusal::LaneChanges);
        }
        if !scenario.has_only_point_masses() {
            return Err(ShieldRefusal::Plant);
        }
        if own.response().is_only_simulated {
            return Err(ShieldRefusal::JerkLimit);
        }
        if noise_bound_mps2(own) >= brake_mps2 {
            return Err(ShieldRefusal::Noise { brake_mps2 });
        }
        let sensors = &scenario.spec().sensors;
        if sensors.faults.is_any() && self.options().estimator == EstimatorKind::Kalman {
            return Err(ShieldRefusal::SensorFaults);
        }
        Ok(())
    }

    /// Returns the assumptions about the leader of vehicle `index`. Without leader or setting it brakes like the ego
    /// vehicle.
    fn leader_limits(
        &self,
        index: usize,
        settings: &ShieldSettings,
        own_brake_mps2: f64,
    ) -> LeaderLimits {
        let spec = self.scenario().spec();
        let ahead = index
            .checked_sub(1)
            .and_then(|front| self.scenario().vehicles().get(front));
        let dry_mps2 = settings
            .ahead_brake_mps2
            .or(ahead.map(VehicleSpec::max_brake_mps2))
            .unwrap_or(own_brake_mps2);
        LeaderLimits {
            brake_mps2: dry_mps2 * spec.environment.friction + ahead.map_or(0.0, noise_bound_mps2),
            accel_mps2: ahead.map_or(0.0, |ahead| {
                ahead.max_accel_mps2() + noise_bound_mps2(ahead)
            }),
        }
    }

    /// Returns the errors of the observation of vehicle `index`: those of the settings, or bounds for the estimator.
    fn estimation_errors(
        &self,
        index: usize,
        settings: &ShieldSettings,
        ahead: LeaderLimits,
    ) -> Result<ErrorBounds, ShieldRefusal> {
        match (settings.errors, self.options().estimator) {
            (Some(errors), _) => Ok(errors),
            (None, EstimatorKind::Truth) => Ok(ErrorBounds::default()),
            (None, EstimatorKind::Kalman) if self.scenario().spec().sensors.dropout > 0.0 => {
                Err(ShieldRefusal::Dropout)
            }
            (None, EstimatorKind::Kalman) => {
                let own = &self.scenario().vehicles()[index];
                let spans_mps2 = [
                    self.scenario().usable_brake_mps2(index)
                        + own.max_accel_mps2()
                        + 2.0 * noise_bound_mps2(own),
                    ahead.brake_mps2 + ahead.accel_mps2,
                ];
                let [gap_m, speed_mps, ahead_speed_mps] =
                    self.tuning().worst_errors(spans_mps2, NOISE_SIGMAS);
                Ok(ErrorBounds {
                    gap_m,
                    speed_mps,
                    ahead_speed_mps,
                })
            }
        }
    }

    /// Returns the class of the follower of vehicle `index`, if there is one: the settings, and for the rest its limits
    /// in the scenario.
    fn follower_class(&self, index: usize, settings: &TwoSidedSettings) -> Option<FollowerClass> {
        let behind = self.scenario().vehicles().get(index + 1)?;
        let spec = self.scenario().spec();
        let response = behind.response();
        let delay_s = whole_steps(response.delay_s, spec.step_s) * spec.step_s;
        // After three time constants, an actuator with lag brakes with 95 % of the command.
        let lag_s = RISE_TIME_CONSTANTS * response.lag_s;
        let reached = if response.lag_s > 0.0 {
            1.0 - (-RISE_TIME_CONSTANTS).exp()
        } else {
            1.0
        };
        let brake_mps2 = match settings.behind_brake_mps2 {
            Some(dry_mps2) => dry_mps2 * spec.environment.friction,
            None => {
                reached * self.scenario().usable_brake_mps2(index + 1) - noise_bound_mps2(behind)
            }
        };
        // With a limit of its jerk, the brake has built up after this time.
        let build_up_s = behind.jerk_limit_mps3.map_or(0.0, |jerk_mps3| {
            self.scenario().usable_brake_mps2(index + 1) / jerk_mps3
        });
        let (trigger, reaction_s) = match settings.reacts_s {
            Some(reaction_s) => (FollowerTrigger::LeaderBrakes, reaction_s),
            None => (
                FollowerTrigger::TimeToCollision(settings.ttc_s.unwrap_or(FIRING_TTC_S)),
                settings.reaction_s.unwrap_or(delay_s + lag_s + build_up_s),
            ),
        };
        Some(FollowerClass {
            trigger,
            reaction_s,
            brake_mps2: brake_mps2.max(MIN_FOLLOWER_BRAKE_MPS2),
            drift_mps2: settings.drift_mps2.unwrap_or(DEFAULT_DRIFT_MPS2),
        })
    }

    /// Returns the errors of the follower's observation: those of the settings, or bounds for the estimator.
    fn rear_estimation_errors(&self, index: usize, settings: &TwoSidedSettings) -> RearErrorBounds {
        if index + 1 >= self.scenario().vehicles().len() {
            return RearErrorBounds::default();
        }
        match (settings.errors, self.options().estimator) {
            (Some((_, rear)), _) => rear,
            (None, EstimatorKind::Truth) => RearErrorBounds::default(),
            (None, EstimatorKind::Kalman) => {
                let spans_mps2 = [index, index + 1].map(|vehicle| {
                    let spec = &self.scenario().vehicles()[vehicle];
                    self.scenario().usable_brake_mps2(vehicle)
                        + spec.max_accel_mps2()
                        + 2.0 * noise_bound_mps2(spec)
                });
                let [gap_m, _, speed_mps] = self.tuning().worst_errors(spans_mps2, NOISE_SIGMAS);
                RearErrorBounds { gap_m, speed_mps }
            }
        }
    }

    /// Returns the margin that covers rounding errors of vehicle `front` and its follower, in metres.
    fn rounding_margin_m(&self, front: usize, params: &ShieldParams) -> Result<f64, ShieldRefusal> {
        let bounds = self.motion_bounds(front, params);
        let margin_m = bounds.margin_m(params);
        if margin_m > MAX_MARGIN_M || margin_m.is_nan() {
            return Err(ShieldRefusal::Rounding {
                rounding_m: 0.5 * margin_m,
                position_m: bounds.position_m,
                max_margin_m: MAX_MARGIN_M,
            });
        }
        Ok(margin_m)
    }

    /// Returns bounds of the motion of vehicle `front` and its follower in this run, without collisions.
    ///
    /// No vehicle overtakes, so the first vehicle bounds all positions. For a vehicle (speed v, brake b) in the kernel
    /// with its leader (speed w, brake c), the difference of their stopping distances v²/2b - w²/2c is at most the gap,
    /// and the gap is at most the length of the road that the run can cover. This bounds v.
    fn motion_bounds(&self, front: usize, params: &ShieldParams) -> MotionBounds {
        let duration_s = self.scenario().spec().duration_s;
        let vehicles = self.scenario().vehicles();
        let first = &vehicles[0];
        let ahead = &vehicles[front];
        let own = &vehicles[front + 1];
        // Distance of a step, and the length of a vehicle.
        let spare_m = (100.0 + 60.0 * params.step_s) * params.step_s + ahead.length_m();
        let farthest_m = first.position_m + max_speed_mps(first, duration_s) * duration_s + spare_m;
        let ahead_mps = max_speed_mps(ahead, duration_s);
        let ViabilityKernel {
            own_brake_mps2,
            ahead_brake_mps2,
        } = params.kernel();
        let road_m = farthest_m - own.position_m;
        let in_kernel_mps = (2.0 * own_brake_mps2 * road_m
            + own_brake_mps2 / ahead_brake_mps2 * ahead_mps * ahead_mps)
            .sqrt();
        let own_mps = max_speed_mps(own, duration_s).min(in_kernel_mps);
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

/// Rounds a time to a number of steps.
fn whole_steps(time_s: f64, step_s: f64) -> f64 {
    (time_s / step_s).round()
}

/// Returns a bound of the speed of a vehicle within `duration_s`, in m/s.
fn max_speed_mps(vehicle: &VehicleSpec, duration_s: f64) -> f64 {
    let accel_mps2 = match &vehicle.driver {
        // To follow a recording, a vehicle may use any acceleration within its limits.
        Driver::Profile(profile) if !matches!(profile, LeadProfile::Recorded(_)) => {
            profile.acceleration_range_mps2()[1].min(vehicle.max_accel_mps2())
        }
        _ => vehicle.max_accel_mps2(),
    };
    vehicle.speed_mps + (accel_mps2 + noise_bound_mps2(vehicle)) * duration_s
}

#[cfg(test)]
mod tests;
