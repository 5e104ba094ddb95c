//! The engine to read: one run, step by step.
//!
//! The lockstep engine means exactly the same and agrees with this one to the last bit.

use super::actuator::{Actuator, Disturbance, unless_at_rest};
use super::platoon::Platoon;
use super::recorder::{Tally, finished, summary, ttc_s};
use super::run::{Pilot, truth};
use super::{AfterContact, Keep, Run, Simulated, Trace};
use crate::control::Controller;
use crate::estimate::{EgoEstimator, TrueState};

/// Runs a scenario.
#[must_use]
pub fn simulate(run: &Run<'_>, keep: Keep) -> Simulated {
    let mut platoon = run.platoon();
    let mut seats: Vec<Seat<'_>> = (0..platoon.motion.len()).map(|index| Seat::new(run, index, &platoon)).collect();
    let mut tallies = vec![Tally::NOTHING_YET; seats.len()];
    let mut trace = Trace::begin(keep, &platoon, run.scenario().steps() * run.substeps() + 1);
    let mut impacts = Vec::new();
    see_ttc(&mut tallies, &platoon);
    'run: for step in 0..run.scenario().steps() {
        let span_s = [run.time_s(step, 0), run.time_s(step + 1, 0)];
        // Everybody decides on the state at the start of the step; only then does anybody move.
        let decided: Vec<f64> = seats
            .iter_mut()
            .enumerate()
            .map(|(index, seat)| seat.decide(&truth(&platoon, index), run, span_s, platoon.is_stuck(index)))
            .collect();
        for (motion, acceleration_mps2) in platoon.motion.iter_mut().zip(decided) {
            motion.acceleration_mps2 = acceleration_mps2;
        }
        platoon.share_acceleration();
        for substep in 0..run.substeps() {
            let from_s = run.time_s(step, substep);
            if let Some(trace) = &mut trace {
                trace.sample(from_s, platoon.motion.iter().copied());
            }
            for (tally, motion) in tallies.iter_mut().zip(&platoon.motion) {
                tally.max_brake_mps2 = tally.max_brake_mps2.max(-motion.acceleration_mps2);
            }
            let after_contact = run.options().after_contact;
            let done_s = platoon.advance(from_s, run.dt_s(), after_contact, &mut impacts);
            see_ttc(&mut tallies, &platoon);
            if after_contact == AfterContact::Stop && !impacts.is_empty() {
                if let Some(trace) = &mut trace {
                    trace.sample(from_s + done_s, platoon.motion.iter().copied());
                }
                break 'run;
            }
        }
    }
    if let Some(trace) = &mut trace
        && (impacts.is_empty() || run.options().after_contact == AfterContact::Continue)
    {
        trace.sample(run.time_s(run.scenario().steps(), 0), platoon.motion.iter().copied());
    }
    let vehicles = platoon.min_gap_m.iter().zip(tallies).zip(&platoon.motion);
    let vehicles = vehicles.map(|((&min_gap_m, tally), motion)| summary(min_gap_m, tally, motion.speed_mps)).collect();
    finished(impacts, vehicles, trace)
}

fn see_ttc(tallies: &mut [Tally], platoon: &Platoon) {
    for (rear, tally) in tallies.iter_mut().enumerate().skip(1) {
        let closing_mps = platoon.motion[rear].speed_mps - platoon.motion[rear - 1].speed_mps;
        tally.min_ttc_s = tally.min_ttc_s.min(ttc_s(platoon.gap_m(rear), closing_mps));
    }
}

/// The driver's seat of one vehicle: from what is true to the acceleration the vehicle has.
struct Seat<'s> {
    pilot: Pilot<'s>,
    eyes: Option<EgoEstimator>,
    actuator: Actuator,
    disturbance: Option<Disturbance>,
}

impl<'s> Seat<'s> {
    fn new(run: &Run<'s>, index: usize, platoon: &Platoon) -> Self {
        Self {
            pilot: run.pilot(index),
            eyes: run.eyes(index, platoon),
            actuator: run.actuator(index),
            disturbance: run.disturbance(index),
        }
    }

    fn decide(&mut self, truth: &TrueState, run: &Run<'_>, [from_s, to_s]: [f64; 2], is_stuck: bool) -> f64 {
        let seen = match &mut self.eyes {
            Some(eyes) => eyes.observe(run.tuning(), truth),
            None => truth.observation,
        };
        let speed_mps = truth.observation.speed_mps;
        let command_mps2 = match &mut self.pilot {
            Pilot::Profile(profile) => profile.acceleration_mps2(from_s, to_s, speed_mps),
            Pilot::Controller(controller) => controller.act(&seen),
        };
        let acceleration_mps2 = self.actuator.respond(command_mps2);
        let noise_mps2 = self.disturbance.as_mut().map_or(0.0, Disturbance::next_mps2);
        if is_stuck { acceleration_mps2 + noise_mps2 } else { unless_at_rest(acceleration_mps2, noise_mps2, speed_mps) }
    }
}
