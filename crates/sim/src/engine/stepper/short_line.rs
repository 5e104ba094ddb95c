//! Fast path of [`Stepper::drive`] for two to four vehicles without lane changes or possible collisions.
//!
//! RL drives a thousand runs for ten steps each in turn. Here the motions stay in registers for all of these steps,
//! which takes a third to a fifth of the time. Minimum gaps belong to summaries and are not updated.

use std::ops::ControlFlow;

use super::super::motion::may_collide;
use super::super::run::VehicleController;
use super::super::{FailedController, Motion};
use super::{StepView, Stepper, VehicleLoop};
use crate::control::Controller;
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
        let neighbour = |other: Option<usize>, gap_m: Option<f64>| {
            let Motion {
                speed_mps,
                acceleration_mps2,
                ..
            } = *self.motion.get(other?)?;
            Some(Neighbour {
                gap_m: gap_m?,
                speed_mps,
                acceleration_mps2,
            })
        };
        TrueState {
            position_m: own.position_m,
            observation: Observation {
                speed_mps: own.speed_mps,
                acceleration_mps2: own.acceleration_mps2,
                ahead: neighbour(index.checked_sub(1), self.gap_m(index)),
                behind: neighbour(Some(index + 1), self.gap_m(index + 1)),
            },
        }
    }

    /// Moves all vehicles by `dt_s`, unless they may collide.
    #[inline]
    fn advance_contact_free(&mut self, decided_mps2: [f64; N], dt_s: f64) -> bool {
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
        let is_consulted = self.loops.iter().any(|vehicle| vehicle.consulted.is_some());
        let is_watched = self.trace.is_some() || !self.extremes.is_empty() || is_consulted;
        if is_watched
            || self.time_grid.substeps != 1
            || !self.impacts.is_empty()
            || !self.platoon.lane.is_constant()
        {
            return FallbackReason::CommandsPending;
        }
        let Some(mut line) = self.short_line::<N>() else {
            return FallbackReason::CommandsPending;
        };
        let pace = self.time_grid;
        let pause = loop {
            let span_s = self.span_s();
            let Ok(loops) = <&mut [VehicleLoop; N]>::try_from(&mut *self.loops) else {
                break FallbackReason::CommandsPending;
            };
            let mut decided_mps2 = [0.0; N];
            for (vehicle, (one, decided_mps2)) in
                loops.iter_mut().zip(&mut decided_mps2).enumerate()
            {
                let VehicleLoop {
                    driver,
                    estimator,
                    observation: seen,
                    command_mps2,
                    ..
                } = one;
                // An estimator must be fed at every step; a profile needs no observation.
                if let (None, Some(estimator)) = (&seen, estimator) {
                    *seen = Some(estimator.observe(&line.true_state(vehicle)));
                }
                let looked = seen.as_ref();
                let has_looked = looked.is_some();
                let look = || match looked {
                    Some(seen) => *seen,
                    None => line.true_state(vehicle).observation,
                };
                let speed_mps = line.motion[vehicle].speed_mps;
                let decided = match (command_mps2.take(), driver) {
                    _ if vehicle == index => Ok(command(&look())),
                    (Some(command_mps2), _) => Ok(command_mps2),
                    (None, VehicleController::Profile(profile)) => {
                        Ok(profile.acceleration_mps2(span_s[0], span_s[1], speed_mps))
                    }
                    (None, VehicleController::Controller(controller)) => controller.decide(&look()),
                };
                if has_looked {
                    *seen = None;
                }
                match decided {
                    Ok(command_mps2) => *decided_mps2 = one.actuate(command_mps2, speed_mps, false),
                    Err(failure) => {
                        let failed = FailedController {
                            time_s: span_s[0],
                            vehicle,
                            failure,
                        };
                        self.failed.get_or_insert(failed);
                    }
                }
            }
            if self.failed.is_some() || !line.advance_contact_free(decided_mps2, pace.dt_s) {
                self.next_acceleration_mps2.copy_from_slice(&decided_mps2);
                break FallbackReason::CommandsReady;
            }
            self.step += 1;
            self.ended = self.step == pace.steps;
            let gap_m = line.gap_m(index);
            let moment = StepView {
                motion: &line.motion,
                gap_m,
                has_collided: false,
                has_ended: self.ended,
            };
            if after(&moment).is_break() || self.step == last || self.ended {
                break FallbackReason::Finished;
            }
        };
        self.platoon.motion.copy_from_slice(&line.motion);
        pause
    }

    fn short_line<const N: usize>(&self) -> Option<ShortLine<N>> {
        Some(ShortLine {
            motion: self.platoon.motion.as_slice().try_into().ok()?,
            length_m: self.platoon.length_m.as_slice().try_into().ok()?,
        })
    }
}
