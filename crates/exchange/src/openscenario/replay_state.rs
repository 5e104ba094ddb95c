//! State of the replay that conditions read, and the scripts that follow from it.

use super::place::PlaceSources;
use super::replay::{EntityMotion, Replay};
use super::road::LanePlace;
use crumple_sim::scenario::{Brake, BrakeToSpeed, LeadProfile, RecordedSpeeds};

impl Replay<'_, '_> {
    pub(super) fn speed_mps(&self, entity: usize, time_s: f64) -> f64 {
        self.motion
            .get(entity)
            .map_or(0.0, |motion| motion.plan.at(time_s).speed_mps)
    }

    /// Returns the speed along the lane, in m/s.
    pub(super) fn along_mps(&self, entity: usize, time_s: f64) -> f64 {
        let motion = self.motion.get(entity);
        match motion.and_then(|motion| motion.crosses_at_m) {
            Some(_) => 0.0,
            None => self.speed_mps(entity, time_s),
        }
    }

    /// Returns the distance that an entity has driven or walked since a fixed time, in metres.
    pub(super) fn driven_m(&self, entity: usize, time_s: f64) -> f64 {
        let motion = self.motion.get(entity);
        motion.map_or(0.0, |motion| motion.plan.at(time_s).position_m)
    }

    /// Returns the position of the reference point in the direction of travel, in metres.
    pub(super) fn position_m(&self, entity: usize, time_s: f64) -> f64 {
        self.motion
            .get(entity)
            .map_or(0.0, |motion| motion.position_m(time_s))
    }

    /// Returns the position of the reference point in the direction of the road, in metres.
    pub(super) fn road_m(&self, entity: usize, time_s: f64) -> f64 {
        self.direction(entity) * self.position_m(entity, time_s)
    }

    /// Returns the position to the left of the road's direction, in metres.
    pub(super) fn lateral_m(&self, entity: usize, time_s: f64) -> f64 {
        self.motion
            .get(entity)
            .map_or(0.0, |motion| motion.lateral.at(time_s, &motion.plan))
    }

    /// Returns 1 for an entity that travels in the direction of the road, otherwise -1.
    pub(super) fn direction(&self, entity: usize) -> f64 {
        self.motion
            .get(entity)
            .map_or(1.0, |motion| motion.direction)
    }

    /// Returns the places of all entities.
    pub(super) fn places(&self, time_s: f64) -> Vec<Option<LanePlace>> {
        (0..self.motion.len())
            .map(|entity| {
                Some(LanePlace {
                    road: self.road_id.clone(),
                    road_m: self.road_m(entity, time_s),
                    lateral_m: self.lateral_m(entity, time_s),
                    direction: self.direction(entity),
                })
            })
            .collect()
    }

    /// Returns what positions may refer to.
    pub(super) fn place_sources(&self) -> PlaceSources<'_> {
        PlaceSources {
            entities: self.entities,
            roads: self.roads,
            files: self.files,
            work: self.work,
        }
    }

    /// Returns true if the reference point is beyond an end of the road.
    pub(super) fn is_beyond_road(&self, entity: usize, time_s: f64) -> bool {
        !self.road.contains_m(self.road_m(entity, time_s))
    }

    /// Returns the distance of the front and of the rear bumper from the reference point, in metres.
    pub(super) fn bumpers_m(&self, entity: usize) -> [f64; 2] {
        self.entities.get(entity).map_or([0.0; 2], |body| {
            [body.front_m, body.length_m - body.front_m]
        })
    }

    /// Returns true if the motion of an entity depends on a controller, which is active.
    pub(super) fn is_controlled(&self, entity: usize) -> bool {
        self.motion
            .get(entity)
            .is_some_and(EntityMotion::has_active_controller)
    }
}

impl EntityMotion<'_> {
    /// Returns the script of a motion from a time on: braking, constant speed, or recorded speeds.
    pub(super) fn script(&self, start_s: f64, stop_s: f64) -> LeadProfile {
        if self.crosses_at_m.is_some() {
            return LeadProfile::ConstantSpeed;
        }
        let knots = self.speeds_after(start_s, stop_s);
        if self.is_recorded {
            return recorded_speeds(&knots);
        }
        let [start, ..] = knots.as_slice() else {
            return LeadProfile::ConstantSpeed;
        };
        match knots.as_slice() {
            knots if knots.iter().all(|knot| knot.speed_mps == start.speed_mps) => {
                LeadProfile::ConstantSpeed
            }
            [from, to] if to.speed_mps < from.speed_mps => braking(from, to),
            [constant, from, to]
                if constant.speed_mps == from.speed_mps && to.speed_mps < from.speed_mps =>
            {
                braking(from, to)
            }
            knots => recorded_speeds(knots),
        }
    }

    /// Returns the speeds from `start_s` on at which the slope changes, until the first after `stop_s`.
    fn speeds_after(&self, start_s: f64, stop_s: f64) -> Vec<TimedSpeed> {
        let mut speeds = vec![TimedSpeed {
            time_s: 0.0,
            speed_mps: self.plan.at(start_s).speed_mps,
        }];
        let knots = self.plan.knots().iter();
        for knot in knots.filter(|knot| knot.time_s > start_s) {
            let mut speed = TimedSpeed {
                time_s: knot.time_s - start_s,
                speed_mps: knot.speed_mps,
            };
            if let [.., before, last] = speeds.as_slice()
                && before.speed_mps == last.speed_mps
                && last.speed_mps == speed.speed_mps
            {
                speed.time_s = last.time_s.max(speed.time_s);
                speeds.pop();
            }
            speeds.push(speed);
            if knot.time_s >= stop_s {
                break;
            }
        }
        speeds
    }
}

/// A speed at a time of a script.
struct TimedSpeed {
    time_s: f64,
    speed_mps: f64,
}

/// Returns the script that brakes at a constant rate from one speed to a lower one.
fn braking(from: &TimedSpeed, to: &TimedSpeed) -> LeadProfile {
    let onset_s = from.time_s;
    let rate_mps2 = rounded((from.speed_mps - to.speed_mps) / (to.time_s - onset_s));
    if to.speed_mps == 0.0 {
        LeadProfile::Brake(Brake { onset_s, rate_mps2 })
    } else {
        LeadProfile::BrakeToSpeed(BrakeToSpeed {
            onset_s,
            rate_mps2,
            final_speed_mps: to.speed_mps,
        })
    }
}

fn recorded_speeds(speeds: &[TimedSpeed]) -> LeadProfile {
    LeadProfile::Recorded(RecordedSpeeds {
        time_s: speeds.iter().map(|speed| speed.time_s).collect(),
        speed_mps: speeds.iter().map(|speed| speed.speed_mps).collect(),
    })
}

/// Removes the rounding errors of a quotient.
fn rounded(value: f64) -> f64 {
    (value * 1e10).round() / 1e10
}
