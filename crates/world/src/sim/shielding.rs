//! What a shield may take for granted in a scenario, and what it did.

use serde::{Deserialize, Serialize};

use super::{ControllerKind, Run};
use crate::control::{AnyController, Behind, ErrorBounds, Frame, MARGIN_M, Override, ShieldSettings};
use crate::observation::EstimatorKind;
use crate::scenario::VehicleSpec;

/// Standard deviations of noise that a shield counts on: exceeded once in 10⁹ draws.
const DEVIATIONS: f64 = 6.0;

/// A controller behind a shield.
#[derive(Clone)]
pub struct Shielded {
    /// What drives as long as the shield lets it.
    pub controller: ControllerKind,
    /// What the user set.
    pub settings: ShieldSettings,
}

/// Why a shield cannot vouch for a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ShieldRefusal {
    /// Full braking cannot be had at a known rate.
    #[error("it has a jerk limit, which the kernel does not cover")]
    Jerk,
    /// Noise on the own acceleration may cancel the brake.
    #[error("noise on its acceleration may take away all of its brake, {brake_mps2} m/s² on this road")]
    Noise {
        /// What it can brake at, in m/s².
        brake_mps2: f64,
    },
    /// The Kalman filter's error has no bound when measurements may be lost.
    #[error(
        "its sensors lose measurements, so the error of what it sees has no bound: give bounds, as in `shield,gap-error=0.5,speed-error=0.5,ahead-speed-error=1:policy`"
    )]
    Dropout,
}

/// A time in which a shield braked instead of doing what its controller wanted.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Intervention {
    /// Index of the vehicle.
    pub vehicle: usize,
    /// From when, in seconds.
    pub from_s: f64,
    /// Until when, in seconds; the end of a step that a contact may have cut short.
    pub to_s: f64,
    /// Whether the state was outside the kernel meanwhile: contact could then no longer be ruled out.
    pub outside_kernel: bool,
    /// Whether the vehicle behind could not avoid the braking vehicle meanwhile: no action suited both.
    pub rear_conflict: bool,
}

/// What shields did for one vehicle.
pub(super) fn interventions(controller: &AnyController, vehicle: usize, step_s: f64) -> Vec<Intervention> {
    let AnyController::Shielded(shield) = controller else { return Vec::new() };
    let told = |done: &Override| Intervention {
        vehicle,
        from_s: done.first_step as f64 * step_s,
        to_s: (done.last_step + 1) as f64 * step_s,
        outside_kernel: done.outside_kernel,
        rear_conflict: done.rear_conflict,
    };
    shield.overrides().iter().map(told).collect()
}

impl Run<'_> {
    /// What a shield of vehicle `index` may take for granted.
    ///
    /// # Errors
    /// [`ShieldRefusal`] if that is not enough.
    pub(super) fn frame(&self, index: usize, settings: &ShieldSettings) -> Result<Frame, ShieldRefusal> {
        let spec = self.scenario().spec();
        let vehicles = self.scenario().vehicles();
        let own = &vehicles[index];
        let step_s = spec.step_s;
        let whole_steps = |time_s: f64| (time_s / step_s).round();
        let (brake_mps2, noise_mps2) = (self.scenario().usable_brake_mps2(index), noise_of(own));
        if own.jerk_limit_mps3.is_some() {
            return Err(ShieldRefusal::Jerk);
        }
        if noise_mps2 >= brake_mps2 {
            return Err(ShieldRefusal::Noise { brake_mps2 });
        }
        let ahead = index.checked_sub(1).and_then(|front| vehicles.get(front));
        let dry_mps2 = settings.ahead_brake_mps2.or(ahead.map(VehicleSpec::max_brake_mps2)).unwrap_or(brake_mps2);
        let ahead_brake_mps2 = dry_mps2 * spec.environment.friction + ahead.map_or(0.0, noise_of);
        let ahead_accel_mps2 = ahead.map_or(0.0, |ahead| ahead.max_accel_mps2() + noise_of(ahead));
        let accel_mps2 = own.max_accel_mps2();
        let errors = match (settings.errors, self.options().estimator) {
            (Some(errors), _) => errors,
            (None, EstimatorKind::Truth) => ErrorBounds::default(),
            (None, EstimatorKind::Kalman) if spec.sensors.dropout > 0.0 => return Err(ShieldRefusal::Dropout),
            (None, EstimatorKind::Kalman) => {
                let spans_mps2 = [brake_mps2 + accel_mps2 + 2.0 * noise_mps2, ahead_brake_mps2 + ahead_accel_mps2];
                let [gap_m, speed_mps, ahead_speed_mps] = self.tuning().worst_errors(spans_mps2, DEVIATIONS);
                ErrorBounds { gap_m, speed_mps, ahead_speed_mps }
            }
        };
        let delay_steps =
            (whole_steps(own.reaction_delay_s + own.actuator_delay_s) as usize).min(self.scenario().steps());
        Ok(Frame {
            step_s,
            brake_mps2,
            accel_mps2,
            noise_mps2,
            ahead_brake_mps2,
            delay_steps,
            share: if own.actuator_lag_s > 0.0 { -(-step_s / own.actuator_lag_s).exp_m1() } else { 1.0 },
            errors,
            behind: vehicles.get(index + 1).map(|behind| Behind {
                brake_mps2: self.scenario().usable_brake_mps2(index + 1),
                reaction_s: whole_steps(behind.reaction_delay_s + behind.actuator_delay_s) * step_s,
            }),
            margin_m: MARGIN_M,
        })
    }
}

fn noise_of(vehicle: &VehicleSpec) -> f64 {
    DEVIATIONS * vehicle.acceleration_noise_mps2
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::ControllerSpec;
    use crate::scenario::built_in;
    use crate::sim::RunOptions;

    /// Seeing late and acting late are one thing, one's own as well as that of the vehicle behind.
    #[test]
    fn delays_add_up() {
        let frame = |reaction_delay_s: f64, actuator_delay_s: f64| {
            let late = built_in("paper-1").unwrap().edited(|spec| {
                for vehicle in &mut spec.vehicles[1..] {
                    (vehicle.reaction_delay_s, vehicle.actuator_delay_s) = (reaction_delay_s, actuator_delay_s);
                }
            });
            let late = late.unwrap();
            let run = Run::new(&late, RunOptions::new(ControllerSpec::MatchLeader(Default::default()))).unwrap();
            run.frame(1, &ShieldSettings::default()).unwrap()
        };
        let frames = [(0.3, 0.1), (0.1, 0.3), (0.4, 0.0), (0.0, 0.4)].map(|(seeing, acting)| frame(seeing, acting));
        assert!(frames.iter().all(|other| *other == frames[0]), "{frames:?}");
        assert_eq!((frames[0].delay_steps, frames[0].behind.map(|behind| behind.reaction_s)), (40, Some(0.4)));
    }
}
