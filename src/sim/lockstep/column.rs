//! One vehicle position in all runs of a block: arrays with one entry a run.

use super::block::Lane;
use super::pilots::Pilots;
use crate::estimate::{EgoEstimator, Neighbour, Observation, TrueState};
use crate::sim::actuator::{Actuator, Disturbance, unless_at_rest, within};
use crate::sim::motion::{Motion, advance, needs_care};
use crate::sim::platoon::Platoon;
use crate::sim::recorder::{Tally, summary, ttc_s};
use crate::sim::shielding::interventions;
use crate::sim::{Intervention, VehicleSummary};

/// One vehicle position in all runs.
pub(super) struct Column<'s> {
    pilots: Pilots<'s>,
    /// Empty if everybody sees the truth.
    eyes: Vec<EgoEstimator>,
    actuators: Vec<Actuator>,
    all_immediate: bool,
    /// Empty if nobody is disturbed.
    disturbances: Vec<Option<Disturbance>>,
    max_brake_mps2: Vec<f64>,
    max_accel_mps2: Vec<f64>,
    pub(super) length_m: Vec<f64>,
    pub(super) mass_kg: Vec<f64>,
    pub(super) position_m: Vec<f64>,
    pub(super) speed_mps: Vec<f64>,
    pub(super) acceleration_mps2: Vec<f64>,
    pub(super) next_position_m: Vec<f64>,
    pub(super) next_speed_mps: Vec<f64>,
    pub(super) sticks: Vec<bool>,
    pub(super) min_gap_m: Vec<f64>,
    min_ttc_s: Vec<f64>,
    hardest_brake_mps2: Vec<f64>,
}

impl<'s> Column<'s> {
    pub(super) fn new(lanes: &[Lane<'_, 's>], platoons: &[Platoon], vehicle: usize) -> Self {
        let of = |take: &dyn Fn(&Platoon) -> f64| -> Vec<f64> { platoons.iter().map(take).collect() };
        let actuators: Vec<_> = lanes.iter().map(|lane| lane.run.actuator(vehicle)).collect();
        let eyes: Vec<_> =
            lanes.iter().zip(platoons).filter_map(|(lane, platoon)| lane.run.eyes(vehicle, platoon)).collect();
        let disturbances: Vec<_> = lanes.iter().map(|lane| lane.run.disturbance(vehicle)).collect();
        let nothing = vec![0.0; lanes.len()];
        Self {
            pilots: Pilots::new(lanes.iter().map(|lane| lane.run.pilot(vehicle)).collect()),
            eyes,
            all_immediate: actuators.iter().all(Actuator::is_immediate),
            max_brake_mps2: actuators.iter().map(|actuator| actuator.max_brake_mps2).collect(),
            max_accel_mps2: actuators.iter().map(|actuator| actuator.max_accel_mps2).collect(),
            actuators,
            disturbances: if disturbances.iter().any(Option::is_some) { disturbances } else { Vec::new() },
            length_m: of(&|platoon| platoon.length_m[vehicle]),
            mass_kg: of(&|platoon| platoon.mass_kg[vehicle]),
            position_m: of(&|platoon| platoon.motion[vehicle].position_m),
            speed_mps: of(&|platoon| platoon.motion[vehicle].speed_mps),
            min_gap_m: of(&|platoon| platoon.min_gap_m[vehicle]),
            acceleration_mps2: nothing.clone(),
            next_position_m: nothing.clone(),
            next_speed_mps: nothing.clone(),
            sticks: vec![false; lanes.len()],
            min_ttc_s: vec![Tally::NOTHING_YET.min_ttc_s; lanes.len()],
            hardest_brake_mps2: vec![Tally::NOTHING_YET.max_brake_mps2; lanes.len()],
        }
    }

    pub(super) fn motion(&self, lane: usize) -> Motion {
        Motion {
            position_m: self.position_m[lane],
            speed_mps: self.speed_mps[lane],
            acceleration_mps2: self.acceleration_mps2[lane],
        }
    }

    /// From what is true to the acceleration of the next step.
    pub(super) fn decide(
        &mut self,
        lanes: &[Lane<'_, 's>],
        [front, behind]: [Option<&Self>; 2],
        span_s: [f64; 2],
        decided_mps2: &mut [f64],
    ) {
        let (position_m, speed_mps, acceleration_mps2) = (&self.position_m, &self.speed_mps, &self.acceleration_mps2);
        let length_m = &self.length_m;
        let neighbour = |other: &Self, lane: usize, gap_m: f64| Neighbour {
            gap_m,
            speed_mps: other.speed_mps[lane],
            acceleration_mps2: other.acceleration_mps2[lane],
        };
        let observation = |lane: usize| Observation {
            speed_mps: speed_mps[lane],
            acceleration_mps2: acceleration_mps2[lane],
            ahead: front.map(|front| {
                let gap_m = front.position_m[lane] - front.length_m[lane] - position_m[lane];
                neighbour(front, lane, gap_m)
            }),
            behind: behind.map(|behind| {
                let gap_m = position_m[lane] - length_m[lane] - behind.position_m[lane];
                neighbour(behind, lane, gap_m)
            }),
        };
        if self.eyes.is_empty() {
            self.pilots.command(span_s, speed_mps, observation, decided_mps2);
        } else {
            let eyes = &mut self.eyes;
            let see = |lane: usize| {
                let truth = TrueState { position_m: position_m[lane], observation: observation(lane) };
                eyes[lane].observe(lanes[lane].run.tuning(), &truth)
            };
            self.pilots.command(span_s, speed_mps, see, decided_mps2);
        }
        if self.all_immediate {
            let limits = self.max_brake_mps2.iter().zip(&self.max_accel_mps2);
            for (decided, (&max_brake_mps2, &max_accel_mps2)) in decided_mps2.iter_mut().zip(limits) {
                *decided = within(*decided, max_brake_mps2, max_accel_mps2);
            }
        } else {
            for (decided, actuator) in decided_mps2.iter_mut().zip(&mut self.actuators) {
                *decided = actuator.respond(*decided);
            }
        }
        let speeds_mps = decided_mps2.iter_mut().zip(&self.speed_mps);
        let any_stuck = lanes.iter().any(|lane| !lane.impacts.is_empty());
        if self.disturbances.is_empty() && !any_stuck {
            for (decided, &speed_mps) in speeds_mps {
                *decided = unless_at_rest(*decided, 0.0, speed_mps);
            }
        } else {
            for (lane, (decided, &speed_mps)) in speeds_mps.enumerate() {
                let disturbance = self.disturbances.get_mut(lane).and_then(Option::as_mut);
                let noise_mps2 = disturbance.map_or(0.0, Disturbance::next_mps2);
                let is_stuck = any_stuck && (self.sticks[lane] || behind.is_some_and(|behind| behind.sticks[lane]));
                *decided =
                    if is_stuck { *decided + noise_mps2 } else { unless_at_rest(*decided, noise_mps2, speed_mps) };
            }
        }
    }

    /// Where the vehicle is after `dt_s` if nobody touches it.
    pub(super) fn step(&mut self, dt_s: f64) {
        let now = self.position_m.iter().zip(&self.speed_mps).zip(&self.acceleration_mps2);
        let next = self.next_position_m.iter_mut().zip(&mut self.next_speed_mps).zip(&mut self.hardest_brake_mps2);
        for (((&x, &v), &a), ((next_x, next_v), hardest)) in now.zip(next) {
            (*next_x, *next_v) = advance(x, v, a, dt_s);
            *hardest = hardest.max(-a);
        }
    }

    /// Takes in the gap at the end of the step, where the step needs no care.
    pub(super) fn see_gap(&mut self, front: &Self, care: &[bool]) {
        let n = self.min_gap_m.len();
        let (front_m, length_m, rear_m) =
            (&front.next_position_m[..n], &front.length_m[..n], &self.next_position_m[..n]);
        for lane in 0..n {
            let gap_m = front_m[lane] - length_m[lane] - rear_m[lane];
            let smallest_m = self.min_gap_m[lane].min(gap_m);
            self.min_gap_m[lane] = if care[lane] { self.min_gap_m[lane] } else { smallest_m };
        }
    }

    pub(super) fn see_ttc(&mut self, front: &Self) {
        let n = self.min_ttc_s.len();
        let (front_m, length_m, rear_m) = (&front.position_m[..n], &front.length_m[..n], &self.position_m[..n]);
        let (front_mps, rear_mps) = (&front.speed_mps[..n], &self.speed_mps[..n]);
        for lane in 0..n {
            let gap_m = front_m[lane] - length_m[lane] - rear_m[lane];
            let ttc_s = ttc_s(gap_m, rear_mps[lane] - front_mps[lane]);
            self.min_ttc_s[lane] = self.min_ttc_s[lane].min(ttc_s);
        }
    }

    /// What a shield of this vehicle, number `vehicle` of the line, did in a run.
    pub(super) fn interventions(&self, lane: usize, vehicle: usize, step_s: f64) -> Vec<Intervention> {
        self.pilots.shielded(lane).map_or_else(Vec::new, |controller| interventions(controller, vehicle, step_s))
    }

    /// Takes a run out of the column.
    pub(super) fn finish(&mut self, lane: usize) -> VehicleSummary {
        self.pilots.swap_remove(lane);
        self.actuators.swap_remove(lane);
        if !self.eyes.is_empty() {
            self.eyes.swap_remove(lane);
        }
        if !self.disturbances.is_empty() {
            self.disturbances.swap_remove(lane);
        }
        self.sticks.swap_remove(lane);
        for array in [
            &mut self.max_brake_mps2,
            &mut self.max_accel_mps2,
            &mut self.length_m,
            &mut self.mass_kg,
            &mut self.position_m,
            &mut self.acceleration_mps2,
            &mut self.next_position_m,
            &mut self.next_speed_mps,
        ] {
            array.swap_remove(lane);
        }
        let tally = Tally {
            min_ttc_s: self.min_ttc_s.swap_remove(lane),
            max_brake_mps2: self.hardest_brake_mps2.swap_remove(lane),
        };
        summary(self.min_gap_m.swap_remove(lane), tally, self.speed_mps.swap_remove(lane))
    }
}

/// Marks the runs in which two vehicles may touch, or are closest, inside the step.
pub(super) fn screen(front: &Column<'_>, rear: &Column<'_>, dt_s: f64, care: &mut [bool]) {
    let n = care.len();
    let (front_m, length_m, rear_m) = (&front.position_m[..n], &front.length_m[..n], &rear.position_m[..n]);
    let (front_mps, rear_mps) = (&front.speed_mps[..n], &rear.speed_mps[..n]);
    let (front_end_mps, rear_end_mps) = (&front.next_speed_mps[..n], &rear.next_speed_mps[..n]);
    for lane in 0..n {
        let gap_m = front_m[lane] - length_m[lane] - rear_m[lane];
        let rear_both = [rear_mps[lane], rear_end_mps[lane]];
        let closing_mps = [rear_both[0] - front_mps[lane], rear_both[1] - front_end_mps[lane]];
        care[lane] |= needs_care(gap_m, rear_both, closing_mps, dt_s);
    }
}
