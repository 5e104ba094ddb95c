//! A block of runs that step together.

use super::pilots::Pilots;
use crate::estimate::{EgoEstimator, Neighbour, Observation, TrueState};
use crate::sim::actuator::{Actuator, Disturbance, unless_at_rest, within};
use crate::sim::motion::{Motion, advance, needs_care};
use crate::sim::platoon::Platoon;
use crate::sim::recorder::{Tally, finished, summary, ttc_s};
use crate::sim::{AfterContact, Impact, Keep, Run, Simulated, Trace};

/// Runs of one shape. Arrays hold one entry a run; a finished run's place is taken by the last one's.
pub(super) struct Block<'a, 's> {
    lanes: Vec<Lane<'a, 's>>,
    columns: Vec<Column<'s>>,
    /// Acceleration decided for the next step, one array a vehicle.
    decided_mps2: Vec<Vec<f64>>,
    /// Runs whose current step needs the exact treatment.
    care: Vec<bool>,
}

/// What belongs to one run.
struct Lane<'a, 's> {
    index: usize,
    run: &'a Run<'s>,
    impacts: Vec<Impact>,
    trace: Option<Trace>,
}

/// One vehicle position in all runs.
struct Column<'s> {
    pilots: Pilots<'s>,
    /// Empty if everybody sees the truth.
    eyes: Vec<EgoEstimator>,
    actuators: Vec<Actuator>,
    all_immediate: bool,
    /// Empty if nobody is disturbed.
    disturbances: Vec<Option<Disturbance>>,
    max_brake_mps2: Vec<f64>,
    max_accel_mps2: Vec<f64>,
    length_m: Vec<f64>,
    mass_kg: Vec<f64>,
    position_m: Vec<f64>,
    speed_mps: Vec<f64>,
    acceleration_mps2: Vec<f64>,
    next_position_m: Vec<f64>,
    next_speed_mps: Vec<f64>,
    sticks: Vec<bool>,
    min_gap_m: Vec<f64>,
    min_ttc_s: Vec<f64>,
    hardest_brake_mps2: Vec<f64>,
}

impl<'a, 's> Block<'a, 's> {
    pub(super) fn new(runs: &'a [Run<'s>], members: &[usize], keep: Keep) -> Self {
        let platoons: Vec<Platoon> = members.iter().map(|&index| runs[index].platoon()).collect();
        let lanes: Vec<_> = members
            .iter()
            .zip(&platoons)
            .map(|(&index, platoon)| {
                let run = &runs[index];
                let trace = Trace::begin(keep, platoon, run.scenario().steps() * run.substeps() + 1);
                Lane { index, run, impacts: Vec::new(), trace }
            })
            .collect();
        let vehicles = platoons.first().map_or(0, |platoon| platoon.motion.len());
        let columns = (0..vehicles).map(|vehicle| Column::new(&lanes, &platoons, vehicle)).collect();
        let mut block = Self {
            care: vec![false; lanes.len()],
            decided_mps2: vec![vec![0.0; lanes.len()]; vehicles],
            lanes,
            columns,
        };
        block.see_ttc();
        block
    }

    /// Runs everybody to the end and hands over each result with the index of its run.
    pub(super) fn run(mut self, mut done: impl FnMut(usize, Simulated)) {
        let Some(first) = self.lanes.first().map(|lane| lane.run) else { return };
        let mut step = 0;
        while !self.lanes.is_empty() {
            for lane in (0..self.lanes.len()).rev() {
                if self.lanes[lane].run.scenario().steps() == step {
                    self.sample(lane, first.time_s(step, 0));
                    self.finish(lane, &mut done);
                }
            }
            if self.lanes.is_empty() {
                return;
            }
            self.decide([first.time_s(step, 0), first.time_s(step + 1, 0)]);
            for substep in 0..first.substeps() {
                self.advance(first.time_s(step, substep), first.dt_s(), &mut done);
            }
            step += 1;
        }
    }

    /// Everybody decides on the state at the start of the step.
    fn decide(&mut self, span_s: [f64; 2]) {
        for (vehicle, decided_mps2) in self.decided_mps2.iter_mut().enumerate() {
            let (front, rest) = self.columns.split_at_mut(vehicle);
            if let [own, behind @ ..] = rest {
                own.decide(&self.lanes, [front.last(), behind.first()], span_s, decided_mps2);
            }
        }
        for (column, decided_mps2) in self.columns.iter_mut().zip(&mut self.decided_mps2) {
            std::mem::swap(&mut column.acceleration_mps2, decided_mps2);
        }
        for lane in 0..self.lanes.len() {
            if !self.lanes[lane].impacts.is_empty() {
                let mut platoon = self.gather(lane);
                platoon.share_acceleration();
                self.scatter(lane, &platoon);
            }
        }
    }

    /// Everybody moves by one integration step.
    fn advance(&mut self, from_s: f64, dt_s: f64, done: &mut impl FnMut(usize, Simulated)) {
        for lane in 0..self.lanes.len() {
            if self.lanes[lane].trace.is_some() {
                self.sample(lane, from_s);
            }
            self.care[lane] = !self.lanes[lane].impacts.is_empty();
        }
        for column in &mut self.columns {
            column.step(dt_s);
        }
        for pair in self.columns.windows(2) {
            if let [front, rear] = pair {
                screen(front, rear, dt_s, &mut self.care);
            }
        }
        for rear in 1..self.columns.len() {
            let (front, rear) = self.columns.split_at_mut(rear);
            if let ([.., front], [rear, ..]) = (front, rear) {
                rear.see_gap(front, &self.care);
            }
        }
        let mut ended_s = Vec::new();
        for lane in 0..self.lanes.len() {
            if self.care[lane] {
                let mut platoon = self.gather(lane);
                let Lane { run, impacts, .. } = &mut self.lanes[lane];
                let after_contact = run.options().after_contact;
                let done_s = platoon.advance(from_s, dt_s, after_contact, impacts);
                if after_contact == AfterContact::Stop && !impacts.is_empty() {
                    ended_s.push((lane, from_s + done_s));
                }
                self.scatter(lane, &platoon);
                for (column, motion) in self.columns.iter_mut().zip(&platoon.motion) {
                    column.next_position_m[lane] = motion.position_m;
                    column.next_speed_mps[lane] = motion.speed_mps;
                }
            }
        }
        for column in &mut self.columns {
            std::mem::swap(&mut column.position_m, &mut column.next_position_m);
            std::mem::swap(&mut column.speed_mps, &mut column.next_speed_mps);
        }
        self.see_ttc();
        for (lane, time_s) in ended_s.into_iter().rev() {
            self.sample(lane, time_s);
            self.finish(lane, done);
        }
    }

    fn see_ttc(&mut self) {
        for rear in 1..self.columns.len() {
            let (front, rear) = self.columns.split_at_mut(rear);
            if let ([.., front], [rear, ..]) = (front, rear) {
                rear.see_ttc(front);
            }
        }
    }

    fn sample(&mut self, lane: usize, time_s: f64) {
        let columns = &self.columns;
        if let Some(trace) = &mut self.lanes[lane].trace {
            trace.sample(time_s, columns.iter().map(|column| column.motion(lane)));
        }
    }

    /// Takes a run out of the block.
    fn finish(&mut self, lane: usize, done: &mut impl FnMut(usize, Simulated)) {
        let Lane { index, impacts, trace, .. } = self.lanes.swap_remove(lane);
        self.care.swap_remove(lane);
        for decided_mps2 in &mut self.decided_mps2 {
            decided_mps2.swap_remove(lane);
        }
        let vehicles = self.columns.iter_mut().map(|column| column.finish(lane)).collect();
        done(index, finished(impacts, vehicles, trace));
    }

    /// One run as a platoon, for the exact treatment.
    fn gather(&self, lane: usize) -> Platoon {
        Platoon {
            motion: self.columns.iter().map(|column| column.motion(lane)).collect(),
            length_m: self.columns.iter().map(|column| column.length_m[lane]).collect(),
            mass_kg: self.columns.iter().map(|column| column.mass_kg[lane]).collect(),
            sticks: self.columns.iter().map(|column| column.sticks[lane]).collect(),
            min_gap_m: self.columns.iter().map(|column| column.min_gap_m[lane]).collect(),
        }
    }

    /// Writes back what the exact treatment changes, apart from positions and speeds.
    fn scatter(&mut self, lane: usize, platoon: &Platoon) {
        for (vehicle, column) in self.columns.iter_mut().enumerate() {
            column.acceleration_mps2[lane] = platoon.motion[vehicle].acceleration_mps2;
            column.sticks[lane] = platoon.sticks[vehicle];
            column.min_gap_m[lane] = platoon.min_gap_m[vehicle];
        }
    }
}

impl<'s> Column<'s> {
    fn new(lanes: &[Lane<'_, 's>], platoons: &[Platoon], vehicle: usize) -> Self {
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

    fn motion(&self, lane: usize) -> Motion {
        Motion {
            position_m: self.position_m[lane],
            speed_mps: self.speed_mps[lane],
            acceleration_mps2: self.acceleration_mps2[lane],
        }
    }

    /// From what is true to the acceleration of the next step.
    fn decide(
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
    fn step(&mut self, dt_s: f64) {
        let now = self.position_m.iter().zip(&self.speed_mps).zip(&self.acceleration_mps2);
        let next = self.next_position_m.iter_mut().zip(&mut self.next_speed_mps).zip(&mut self.hardest_brake_mps2);
        for (((&x, &v), &a), ((next_x, next_v), hardest)) in now.zip(next) {
            (*next_x, *next_v) = advance(x, v, a, dt_s);
            *hardest = hardest.max(-a);
        }
    }

    /// Takes in the gap at the end of the step, where the step needs no care.
    fn see_gap(&mut self, front: &Self, care: &[bool]) {
        let n = self.min_gap_m.len();
        let (front_m, length_m, rear_m) =
            (&front.next_position_m[..n], &front.length_m[..n], &self.next_position_m[..n]);
        for lane in 0..n {
            let gap_m = front_m[lane] - length_m[lane] - rear_m[lane];
            let smallest_m = self.min_gap_m[lane].min(gap_m);
            self.min_gap_m[lane] = if care[lane] { self.min_gap_m[lane] } else { smallest_m };
        }
    }

    fn see_ttc(&mut self, front: &Self) {
        let n = self.min_ttc_s.len();
        let (front_m, length_m, rear_m) = (&front.position_m[..n], &front.length_m[..n], &self.position_m[..n]);
        let (front_mps, rear_mps) = (&front.speed_mps[..n], &self.speed_mps[..n]);
        for lane in 0..n {
            let gap_m = front_m[lane] - length_m[lane] - rear_m[lane];
            let ttc_s = ttc_s(gap_m, rear_mps[lane] - front_mps[lane]);
            self.min_ttc_s[lane] = self.min_ttc_s[lane].min(ttc_s);
        }
    }

    /// Takes a run out of the column.
    fn finish(&mut self, lane: usize) -> crate::sim::VehicleSummary {
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
fn screen(front: &Column<'_>, rear: &Column<'_>, dt_s: f64, care: &mut [bool]) {
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
