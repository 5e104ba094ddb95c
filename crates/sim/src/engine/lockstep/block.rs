//! A block of runs that step together.

use pulp::Arch;

use super::column::VehicleColumn;
use super::per_run::RunSet;
use crate::engine::motion::{closest_gap_m, first_collision};
use crate::engine::platoon::PlatoonState;
use crate::engine::recorder::assemble_result;
use crate::engine::{
    AfterCollision, FailedController, Impact, RecordingLevel, Run, SimulationResult, Trace,
};

/// Runs with the same shape, at most [`RunSet::CAPACITY`]. The last run takes the slot of a finished one.
pub(super) struct LockstepBlock<'a> {
    arch: Arch,
    recording_level: RecordingLevel,
    lanes: Vec<RunLane<'a>>,
    columns: Vec<VehicleColumn<'a>>,
    collided: RunSet,
    /// Step at which the next run ends without a collision.
    next_end: usize,
}

pub(super) struct RunLane<'a> {
    index: usize,
    pub(super) run: &'a Run,
    steps: usize,
    impacts: Vec<Impact>,
    trace: Option<Trace>,
}

/// A run with a collision in this or an earlier step, which the scalar engine advances.
struct ScalarFallback {
    lane: usize,
    platoon: PlatoonState,
    /// End of the run in seconds, if a collision ended it.
    ended_s: Option<f64>,
}

/// Collisions and closest gaps of a step.
struct StepCollisions {
    /// Runs with a collision in this or an earlier step.
    colliding: RunSet,
    /// Minimum gaps of the pairs of other runs that are closest inside the step.
    closest: Vec<ClosestGap>,
}

struct ClosestGap {
    lane: usize,
    /// Rear vehicle of the pair.
    rear: usize,
    gap_m: f64,
}

impl<'a> LockstepBlock<'a> {
    pub(super) fn new(
        arch: Arch,
        runs: &'a [Run],
        members: &[usize],
        keep: RecordingLevel,
    ) -> Self {
        let platoons: Vec<PlatoonState> = members
            .iter()
            .map(|&index| runs[index].initial_platoon())
            .collect();
        let lanes: Vec<_> = members
            .iter()
            .zip(&platoons)
            .map(|(&index, platoon)| {
                let run = &runs[index];
                let steps = run.scenario().steps();
                let trace = Trace::begin(keep, platoon, steps * run.substeps() + 1);
                RunLane {
                    index,
                    run,
                    steps,
                    impacts: Vec::new(),
                    trace,
                }
            })
            .collect();
        let vehicles = platoons.first().map_or(0, |platoon| platoon.motion.len());
        let mut block = Self {
            arch,
            recording_level: keep,
            columns: (0..vehicles)
                .map(|vehicle| VehicleColumn::new(&lanes, &platoons, vehicle))
                .collect(),
            lanes,
            collided: RunSet::default(),
            next_end: 0,
        };
        block.init_min_gap_and_ttc();
        block.find_next_end();
        block
    }

    /// Simulates all runs; passes results with their index to `done`. Not generic, so that the engine compiles once.
    pub(super) fn run(mut self, done: &mut dyn FnMut(usize, SimulationResult)) {
        let Some(first) = self.lanes.first().map(|lane| lane.run) else {
            return;
        };
        for step in 0.. {
            if step == self.next_end {
                for lane in (0..self.lanes.len()).rev() {
                    if self.lanes[lane].steps == step {
                        self.record_sample(lane, first.time_grid.time_s(step, 0));
                        self.finish_run(lane, None, done);
                    }
                }
            }
            if self.lanes.is_empty() {
                return;
            }
            self.decide(
                [
                    first.time_grid.time_s(step, 0),
                    first.time_grid.time_s(step + 1, 0),
                ],
                done,
            );
            if self.lanes.is_empty() {
                return;
            }
            for substep in 0..first.substeps() {
                self.advance(first.time_grid.time_s(step, substep), first.dt_s(), done);
            }
        }
    }

    /// Computes the commands of all drivers for the state at the start of the step. Ends runs in which a driver fails.
    fn decide(&mut self, span_s: [f64; 2], done: &mut dyn FnMut(usize, SimulationResult)) {
        // Allocates only if a controller fails.
        let mut failed: Vec<(usize, FailedController)> = Vec::new();
        for vehicle in 0..self.columns.len() {
            let (front, rest) = self.columns.split_at_mut(vehicle);
            if let [own, behind @ ..] = rest {
                let failures = own.decide(
                    self.arch,
                    &self.lanes,
                    [front.last(), behind.first()],
                    span_s,
                    self.collided,
                );
                failed.extend(failures.into_iter().map(|(lane, failure)| {
                    (
                        lane,
                        FailedController {
                            time_s: span_s[0],
                            vehicle,
                            failure,
                        },
                    )
                }));
            }
        }
        self.end_failed_runs(failed, done);
        for column in &mut self.columns {
            std::mem::swap(
                &mut column.acceleration_mps2,
                &mut column.next_acceleration_mps2,
            );
        }
        for lane in self.collided.iter() {
            let mut platoon = self.gather(lane);
            platoon.share_acceleration();
            self.scatter(lane, &platoon);
        }
    }

    /// Ends runs in which a driver failed. If several drivers of a run failed, the result names the foremost vehicle.
    fn end_failed_runs(
        &mut self,
        mut failed: Vec<(usize, FailedController)>,
        done: &mut dyn FnMut(usize, SimulationResult),
    ) {
        // Descending, because the last run takes the slot of one that ends.
        failed.sort_by_key(|(lane, failed)| (std::cmp::Reverse(*lane), failed.vehicle));
        failed.dedup_by_key(|(lane, _)| *lane);
        for (lane, failed) in failed {
            self.record_sample(lane, failed.time_s);
            self.finish_run(lane, Some(failed), done);
        }
    }

    fn advance(&mut self, from_s: f64, dt_s: f64, done: &mut dyn FnMut(usize, SimulationResult)) {
        if self.recording_level == RecordingLevel::Trace {
            (0..self.lanes.len()).for_each(|lane| self.record_sample(lane, from_s));
        }
        for column in &mut self.columns {
            column.step(self.arch, dt_s);
        }
        let StepCollisions { colliding, closest } = self.find_collisions(dt_s);
        let exact: Vec<ScalarFallback> = colliding
            .iter()
            .map(|lane| self.advance_scalar(lane, from_s, dt_s))
            .collect();
        self.update_min_gap_and_ttc();
        for ClosestGap { lane, rear, gap_m } in closest {
            let min_gap_m = &mut self.columns[rear].min_gap_m[lane];
            *min_gap_m = min_gap_m.min(gap_m);
        }
        for ScalarFallback { lane, platoon, .. } in &exact {
            self.scatter(*lane, platoon);
        }
        self.columns
            .iter_mut()
            .for_each(VehicleColumn::swap_buffers);
        for ScalarFallback { lane, ended_s, .. } in exact.into_iter().rev() {
            if let Some(ended_s) = ended_s {
                self.record_sample(lane, ended_s);
                self.finish_run(lane, None, done);
            }
        }
    }

    /// Finds the runs with a collision in this or an earlier step, and the minimum gaps inside the step of all others.
    fn find_collisions(&mut self, dt_s: f64) -> StepCollisions {
        let mut colliding = self.collided;
        let mut closest = Vec::new();
        let all = RunSet::first(self.lanes.len());
        for (rear, pair) in (1..).zip(self.columns.windows(2)) {
            let [front, behind] = pair else { continue };
            for lane in behind
                .screen(self.arch, front, dt_s)
                .intersection(all)
                .difference(colliding)
                .iter()
            {
                let front_motion = front.motion(lane);
                let rear_motion = behind.motion(lane);
                let length_m = front.length_m[lane];
                if first_collision(front_motion, rear_motion, length_m, dt_s).is_some() {
                    colliding.insert(lane);
                } else {
                    closest.push(ClosestGap {
                        lane,
                        rear,
                        gap_m: closest_gap_m(front_motion, rear_motion, length_m, dt_s),
                    });
                }
            }
        }
        closest.retain(|gap| !colliding.contains(gap.lane));
        StepCollisions { colliding, closest }
    }

    fn advance_scalar(&mut self, lane: usize, from_s: f64, dt_s: f64) -> ScalarFallback {
        let mut platoon = self.gather(lane);
        let RunLane { run, impacts, .. } = &mut self.lanes[lane];
        let after_collision = run.options().after_collision;
        let done_s = platoon.advance(from_s, dt_s, after_collision, impacts);
        if !impacts.is_empty() {
            self.collided.insert(lane);
        }
        let ends = after_collision == AfterCollision::Stop && !impacts.is_empty();
        for (column, motion) in self.columns.iter_mut().zip(&platoon.motion) {
            column.next_position_m[lane] = motion.position_m;
            column.next_speed_mps[lane] = motion.speed_mps;
        }
        ScalarFallback {
            lane,
            platoon,
            ended_s: ends.then_some(from_s + done_s),
        }
    }

    fn init_min_gap_and_ttc(&mut self) {
        for column in &mut self.columns {
            column.step(self.arch, 0.0);
        }
        self.update_min_gap_and_ttc();
    }

    fn update_min_gap_and_ttc(&mut self) {
        for rear in 1..self.columns.len() {
            let (front, rear) = self.columns.split_at_mut(rear);
            if let ([.., front], [rear, ..]) = (front, rear) {
                rear.update_min_gap_and_ttc(self.arch, front);
            }
        }
    }

    fn record_sample(&mut self, lane: usize, time_s: f64) {
        let columns = &self.columns;
        if let Some(trace) = &mut self.lanes[lane].trace {
            trace.push_sample(time_s, columns.iter().map(|column| column.motion(lane)));
        }
    }

    fn finish_run(
        &mut self,
        lane: usize,
        failed: Option<FailedController>,
        done: &mut dyn FnMut(usize, SimulationResult),
    ) {
        self.collided.swap_remove(lane, self.lanes.len() - 1);
        let RunLane {
            index,
            run,
            impacts,
            trace,
            ..
        } = self.lanes.swap_remove(lane);
        let step_s = run.scenario().spec().step_s;
        let columns = self.columns.iter().enumerate();
        let interventions = columns
            .flat_map(|(vehicle, column)| column.interventions(lane, vehicle, step_s))
            .collect();
        let vehicles = self
            .columns
            .iter_mut()
            .map(|column| column.remove_run(lane))
            .collect();
        self.find_next_end();
        done(
            index,
            assemble_result(impacts, vehicles, interventions, trace, failed),
        );
    }

    fn find_next_end(&mut self) {
        self.next_end = self.lanes.iter().map(|lane| lane.steps).min().unwrap_or(0);
    }

    /// Copies one run into a platoon, for the scalar engine.
    fn gather(&self, lane: usize) -> PlatoonState {
        PlatoonState {
            lane: crate::engine::lane::LaneState::with_all(self.columns.len()),
            motion: self
                .columns
                .iter()
                .map(|column| column.motion(lane))
                .collect(),
            length_m: self
                .columns
                .iter()
                .map(|column| column.length_m[lane])
                .collect(),
            mass_kg: self
                .columns
                .iter()
                .map(|column| column.mass_kg[lane])
                .collect(),
            locked_to_front: self
                .columns
                .iter()
                .map(|column| column.locked_to_front.contains(lane))
                .collect(),
            min_gap_m: self
                .columns
                .iter()
                .map(|column| column.min_gap_m[lane])
                .collect(),
        }
    }

    /// Writes back what the scalar engine changes, except positions and speeds.
    fn scatter(&mut self, lane: usize, platoon: &PlatoonState) {
        for (vehicle, column) in self.columns.iter_mut().enumerate() {
            column.acceleration_mps2[lane] = platoon.motion[vehicle].acceleration_mps2;
            column.min_gap_m[lane] = platoon.min_gap_m[vehicle];
            if platoon.locked_to_front[vehicle] {
                column.locked_to_front.insert(lane);
            }
        }
    }
}
