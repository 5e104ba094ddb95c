//! Fast path of [`Stepper::drive`] for two to four vehicles without lane changes or possible collisions.
//!
//! RL drives a thousand runs for ten steps each in turn. Here the motions stay in registers for all of these steps,
//! which takes a third to a fifth of the time. Minimum gaps belong to summaries and are not updated.

use std::ops::ControlFlow;

use super::super::motion::may_collide;
use super::super::run::VehicleController;
use super::super::{FailedController, Motion};
use super::{StepView, Stepper, VehicleLoop};
use crate::control::{Controller, ControllerFailure};
use crate::estimate::TrueState;
use crate::observation::{Neighbour, Observation};

/// Reason why the fast path ended.
pub(super) enum FallbackReason {
    /// All steps are done.
    Finished,
    /// The next step needs the general path, and commands are not computed yet.
    CommandsPending,
    /// The next step needs the general path, and commands are computed.
    CommandsReady,
}

/// Bodies of a lane without lane changes.
struct ShortLine<const N: usize> {
    motion: [Motion; N],
    length_m: [f64; N],
}

impl<const N: usize> ShortLine<N> {
    #[inline]
    fn gap_m(&self, rear: usize) -> Option<f64> {
        let front = rear.checked_sub(1)?;
        Some(
            self.motion.get(front)?.position_m
                - self.length_m.get(front)?
                - self.motion.get(rear)?.position_m,
        )
    }

    #[inline]
    fn true_state(&self, index: usize) -> TrueState {
        let own = self.motion[index];
        TrueState {
            position_m: own.position_m,
            observation: Observation {
                speed_mps: own.speed_mps,
                acceleration_mps2: own.acceleration_mps2,
                ahead: self.neighbour(index.checked_sub(1), self.gap_m(index)),
                behind: self.neighbour(Some(index + 1), self.gap_m(index + 1)),
            },
        }
    }

    /// Returns the state of a leader or follower, if there is one.
    #[inline]
    fn neighbour(&self, index: Option<usize>, gap_m: Option<f64>) -> Option<Neighbour> {
        let Motion {
            speed_mps,
            acceleration_mps2,
            ..
        } = *self.motion.get(index?)?;
        Some(Neighbour {
            gap_m: gap_m?,
            speed_mps,
            acceleration_mps2,
        })
    }

    /// Returns the command of a vehicle for this step, in m/s². `external`, if given, maps its observation to it.
    #[inline(always)]
    fn command_mps2(
        &self,
        index: usize,
        vehicle: &mut VehicleLoop,
        span_s: [f64; 2],
        external: Option<&mut impl FnMut(&Observation) -> f64>,
    ) -> Result<f64, ControllerFailure> {
        let VehicleLoop {
            driver,
            estimator,
            observation,
            command_mps2,
            ..
        } = vehicle;
        // An estimator must be fed at every step; a profile needs no observation.
        if let (None, Some(estimator)) = (&observation, estimator) {
            *observation = Some(estimator.observe(&self.true_state(index)));
        }
        let estimate = observation.as_ref();
        let has_estimate = estimate.is_some();
        let observe = || match estimate {
            Some(estimate) => *estimate,
            None => self.true_state(index).observation,
        };
        let command = match (external, command_mps2.take(), driver) {
            (Some(external), ..) => Ok(external(&observe())),
            (None, Some(command_mps2), _) => Ok(command_mps2),
            (None, None, VehicleController::Profile(profile)) => {
                let speed_mps = self.motion[index].speed_mps;
                Ok(profile.acceleration_mps2(span_s[0], span_s[1], speed_mps))
            }
            (None, None, VehicleController::Controller(controller)) => {
                if has_estimate {
                    controller.perceive(&self.true_state(index).observation);
                }
                controller.decide(&observe())
            }
        };
        if has_estimate {
            *observation = None;
        }
        command
    }

    /// Moves all vehicles by `dt_s`, unless they may collide.
    #[inline]
    fn advance_collision_free(&mut self, decided_mps2: [f64; N], dt_s: f64) -> bool {
        let mut now = self.motion;
        for (motion, acceleration_mps2) in now.iter_mut().zip(decided_mps2) {
            motion.acceleration_mps2 = acceleration_mps2;
        }
        let mut end = now;
        for motion in &mut end {
            *motion = motion.after(dt_s);
        }
        for rear in 1..N {
            let gap_m = now[rear - 1].position_m - self.length_m[rear - 1] - now[rear].position_m;
            if may_collide(gap_m, [now[rear].speed_mps, end[rear].speed_mps], dt_s) {
                return false;
            }
        }
        self.motion = end;
        true
    }
}

impl Stepper {
    /// Drives `N` vehicles as [`drive`](Self::drive) does, up to step `last`, while the fast path suffices.
    pub(super) fn drive_short_line<const N: usize>(
        &mut self,
        index: usize,
        last: usize,
        command: &mut impl FnMut(&Observation) -> f64,
        after: &mut impl FnMut(&StepView<'_>) -> ControlFlow<()>,
    ) -> FallbackReason {
        if !self.fits_fast_path() {
            return FallbackReason::CommandsPending;
        }
        let Some(mut line) = self.short_line::<N>() else {
            return FallbackReason::CommandsPending;
        };
        let time_grid = self.time_grid;
        let reason = loop {
            let Some(decided_mps2) = self.decide_short_line(&line, index, command) else {
                break FallbackReason::CommandsPending;
            };
            if self.failed.is_some() || !line.advance_collision_free(decided_mps2, time_grid.dt_s) {
                self.next_acceleration_mps2.copy_from_slice(&decided_mps2);
                break FallbackReason::CommandsReady;
            }
            self.step += 1;
            self.ended = self.step == time_grid.steps;
            let gap_m = line.gap_m(index);
            let view = StepView {
                motion: &line.motion,
                gap_m,
                has_collided: false,
                has_ended: self.ended,
            };
            if after(&view).is_break() || self.step == last || self.ended {
                break FallbackReason::Finished;
            }
        };
        self.platoon.motion.copy_from_slice(&line.motion);
        reason
    }

    /// True if nothing observes the steps, no vehicle changes lanes and no collision has occurred.
    fn fits_fast_path(&self) -> bool {
        let is_consulted = self.loops.iter().any(|vehicle| vehicle.consulted.is_some());
        let is_watched = self.trace.is_some() || !self.extremes.is_empty() || is_consulted;
        !is_watched
            && self.time_grid.substeps == 1
            && self.impacts.is_empty()
            && self.platoon.lane.is_constant()
    }

    /// Returns the accelerations of all vehicles in this step, in m/s²; `None` unless there are `N` vehicles.
    ///
    /// `command` commands vehicle `commanded`. A controller that fails leaves its failure in `self.failed`.
    // Inlined, so that the motions of the line stay in registers.
    #[inline(always)]
    fn decide_short_line<const N: usize>(
        &mut self,
        line: &ShortLine<N>,
        commanded: usize,
        command: &mut impl FnMut(&Observation) -> f64,
    ) -> Option<[f64; N]> {
        let span_s = self.span_s();
        let loops = <&mut [VehicleLoop; N]>::try_from(&mut *self.loops).ok()?;
        let mut decided_mps2 = [0.0; N];
        for (index, (vehicle, decided_mps2)) in loops.iter_mut().zip(&mut decided_mps2).enumerate()
        {
            let external = (index == commanded).then_some(&mut *command);
            let speed_mps = line.motion[index].speed_mps;
            match line.command_mps2(index, vehicle, span_s, external) {
                Ok(command_mps2) => *decided_mps2 = vehicle.actuate(command_mps2, speed_mps, false),
                Err(failure) => {
                    self.failed.get_or_insert(FailedController {
                        time_s: span_s[0],
                        vehicle: index,
                        failure,
                    });
                }
            }
        }
        Some(decided_mps2)
    }

    fn short_line<const N: usize>(&self) -> Option<ShortLine<N>> {
        Some(ShortLine {
            motion: self.platoon.motion.as_slice().try_into().ok()?,
            length_m: self.platoon.length_m.as_slice().try_into().ok()?,
        })
    }
}
