//! State of the replay that conditions read, and the scripts that follow from it.

use super::replay::{EntityMotion, Replay};
use super::storyboard::StoryEvent;
use crumple_sim::scenario::{Brake, BrakeToSpeed, LeadProfile, RecordedSpeeds};

/// Start and end of an element, if they were reached, and whether they depend on a controller.
type ElementTimes = ([Option<f64>; 2], bool);

impl Replay<'_, '_> {
    pub(super) fn speed_mps(&self, entity: usize, time_s: f64) -> f64 {
        self.motion
            .get(entity)
            .map_or(0.0, |motion| motion.plan.at(time_s).speed_mps)
    }

    /// Returns the position of the reference point along the road, in metres.
    pub(super) fn position_m(&self, entity: usize, time_s: f64) -> f64 {
        self.motion
            .get(entity)
            .map_or(0.0, |motion| motion.plan.at(time_s).position_m)
    }

    /// Returns the distance of the front and of the rear bumper from the reference point, in metres.
    pub(super) fn bumpers_m(&self, entity: usize) -> [f64; 2] {
        self.entities
            .get(entity)
            .map_or([0.0; 2], |one| [one.front_m, one.length_m - one.front_m])
    }

    /// Returns the times of an element of the storyboard; `None` if there is no such element.
    pub(super) fn element_times_s(&self, kind: &str, name: &str) -> Option<ElementTimes> {
        if kind == "action" {
            return self.events.iter().find_map(|event| {
                let place = event
                    .actions
                    .iter()
                    .position(|(action, _)| action == name)?;
                Some((
                    [event.start_s, event.action_ends_s.get(place).copied()],
                    event.depends,
                ))
            });
        }
        let level = ["story", "act", "maneuverGroup", "maneuver"]
            .iter()
            .position(|level| *level == kind);
        let is_inside = |event: &&StoryEvent<'_>| match level {
            Some(level) => event
                .parents
                .get(level)
                .is_some_and(|parent| parent == name),
            None => kind == "event" && event.name == name,
        };
        let inside: Vec<_> = self.events.iter().filter(is_inside).collect();
        let start_s = inside
            .iter()
            .filter_map(|event| event.start_s)
            .reduce(f64::min);
        let end_s = inside
            .iter()
            .map(|event| event.end_s())
            .reduce(|a, b| a.zip(b).map(|(a, b)| a.max(b)))
            .flatten();
        (!inside.is_empty()).then(|| ([start_s, end_s], inside.iter().any(|event| event.depends)))
    }

    /// Returns true if the motion of an entity depends on a controller.
    pub(super) fn is_controlled(&self, entity: usize) -> bool {
        self.motion
            .get(entity)
            .is_some_and(|motion| motion.is_controlled)
    }
}

impl EntityMotion<'_> {
    /// Returns the script of a motion from a time on: braking, constant speed, or recorded speeds.
    pub(super) fn script(&self, start_s: f64, stop_s: f64) -> LeadProfile {
        let start = self.plan.at(start_s);
        let later = self
            .plan
            .knots()
            .iter()
            .filter(|knot| knot.time_s > start_s);
        let mut knots: Vec<(f64, f64)> = vec![(0.0, start.speed_mps)];
        for knot in later {
            let time_s = knot.time_s - start_s;
            match knots.as_slice() {
                // Only changes of the slope matter.
                [.., (_, before_mps), (last_s, last_mps)]
                    if before_mps == last_mps && *last_mps == knot.speed_mps =>
                {
                    let last_s = last_s.max(time_s);
                    knots.pop();
                    knots.push((last_s, knot.speed_mps));
                }
                _ => knots.push((time_s, knot.speed_mps)),
            }
            if knot.time_s >= stop_s {
                break;
            }
        }
        let braking = match knots.as_slice() {
            _ if self.is_recorded => None,
            knots if knots.iter().all(|(_, mps)| *mps == start.speed_mps) => {
                return LeadProfile::ConstantSpeed;
            }
            [(from_s, from_mps), (to_s, to_mps)] if to_mps < from_mps => {
                Some((*from_s, *from_mps, *to_s, *to_mps))
            }
            [(_, held_mps), (from_s, from_mps), (to_s, to_mps)]
                if held_mps == from_mps && to_mps < from_mps =>
            {
                Some((*from_s, *from_mps, *to_s, *to_mps))
            }
            _ => None,
        };
        match braking {
            Some((onset_s, from_mps, to_s, 0.0)) => LeadProfile::Brake(Brake {
                onset_s,
                rate_mps2: rounded(from_mps / (to_s - onset_s)),
            }),
            Some((onset_s, from_mps, to_s, final_speed_mps)) => {
                let rate_mps2 = rounded((from_mps - final_speed_mps) / (to_s - onset_s));
                LeadProfile::BrakeToSpeed(BrakeToSpeed {
                    onset_s,
                    rate_mps2,
                    final_speed_mps,
                })
            }
            None => {
                let (time_s, speed_mps) = knots.into_iter().unzip();
                LeadProfile::Recorded(RecordedSpeeds { time_s, speed_mps })
            }
        }
    }
}

/// Removes the rounding errors of a quotient.
fn rounded(value: f64) -> f64 {
    (value * 1e10).round() / 1e10
}
