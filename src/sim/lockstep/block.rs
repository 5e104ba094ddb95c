//! A block of runs that step together.

use super::column::{Column, screen};
use crate::sim::platoon::Platoon;
use crate::sim::recorder::finished;
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
pub(super) struct Lane<'a, 's> {
    index: usize,
    pub(super) run: &'a Run<'s>,
    pub(super) impacts: Vec<Impact>,
    trace: Option<Trace>,
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
        let Lane { index, run, impacts, trace } = self.lanes.swap_remove(lane);
        let step_s = run.scenario().spec().step_s;
        self.care.swap_remove(lane);
        for decided_mps2 in &mut self.decided_mps2 {
            decided_mps2.swap_remove(lane);
        }
        let columns = self.columns.iter().enumerate();
        let interventions = columns.flat_map(|(vehicle, column)| column.interventions(lane, vehicle, step_s)).collect();
        let vehicles = self.columns.iter_mut().map(|column| column.finish(lane)).collect();
        done(index, finished(impacts, vehicles, interventions, trace));
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
