//! One vehicle position in all runs of a block: arrays with one entry per run.

use pulp::Arch;

use super::block::RunLane;
use super::drivers::Drivers;
use super::loops::{self, PairSlices};
use super::noise::Noise;
use super::per_run::{PerRun, RunSet};
use super::view::{NeighbourhoodView, StateSlices};
use crate::control::ControllerFailure;
use crate::engine::actuator::{Actuator, Disturbance, add_noise_unless_at_rest};
use crate::engine::motion::Motion;
use crate::engine::platoon::PlatoonState;
use crate::engine::recorder::{VehicleExtremes, summarize_vehicle};
use crate::engine::shielding::interventions;
use crate::engine::{Intervention, VehicleSummary};
use crate::estimate::{EgoEstimator, TrueState};
use crate::policy::SimdClosure;

pub(super) struct VehicleColumn<'a> {
    drivers: Drivers<'a>,
    /// Empty if all vehicles observe the true state.
    estimators: Vec<EgoEstimator>,
    /// Empty if every vehicle responds at once and fully.
    actuators: Vec<Actuator>,
    noise: Noise,
    max_brake_mps2: PerRun,
    max_accel_mps2: PerRun,
    pub(super) length_m: PerRun,
    pub(super) mass_kg: PerRun,
    pub(super) position_m: PerRun,
    pub(super) speed_mps: PerRun,
    pub(super) acceleration_mps2: PerRun,
    /// Accelerations of the next step; other vehicles still read the current ones.
    pub(super) next_acceleration_mps2: PerRun,
    pub(super) next_position_m: PerRun,
    pub(super) next_speed_mps: PerRun,
    pub(super) locked_to_front: RunSet,
    pub(super) min_gap_m: PerRun,
    min_ttc_s: PerRun,
    max_brake_so_far_mps2: PerRun,
    /// Place of the vehicle in its lane, from the front.
    vehicle: usize,
}

impl<'a> VehicleColumn<'a> {
    pub(super) fn new(lanes: &[RunLane<'a>], platoons: &[PlatoonState], vehicle: usize) -> Self {
        let per_run =
            |take: &dyn Fn(&PlatoonState) -> f64| PerRun::from_values(platoons.iter().map(take));
        let actuators: Vec<_> = lanes
            .iter()
            .map(|lane| Actuator::new(lane.run.scenario(), vehicle))
            .collect();
        let estimator: Vec<_> = lanes
            .iter()
            .zip(platoons)
            .filter_map(|(lane, platoon)| lane.run.estimator(vehicle, platoon))
            .collect();
        let nothing = PerRun::constant(0.0, lanes.len());
        Self {
            drivers: Drivers::new(
                lanes
                    .iter()
                    .map(|lane| lane.run.start_driver(vehicle))
                    .collect(),
            ),
            estimators: estimator,
            max_brake_mps2: PerRun::from_values(
                actuators.iter().map(|actuator| actuator.max_brake_mps2),
            ),
            max_accel_mps2: PerRun::from_values(
                actuators.iter().map(|actuator| actuator.max_accel_mps2),
            ),
            actuators: if actuators.iter().all(Actuator::is_immediate) {
                Vec::new()
            } else {
                actuators
            },
            noise: Noise::new(
                lanes
                    .iter()
                    .map(|lane| Disturbance::new(lane.run.scenario(), vehicle))
                    .collect(),
            ),
            length_m: per_run(&|platoon| platoon.length_m[vehicle]),
            mass_kg: per_run(&|platoon| platoon.mass_kg[vehicle]),
            position_m: per_run(&|platoon| platoon.motion[vehicle].position_m),
            speed_mps: per_run(&|platoon| platoon.motion[vehicle].speed_mps),
            min_gap_m: per_run(&|platoon| platoon.min_gap_m[vehicle]),
            acceleration_mps2: nothing.clone(),
            next_acceleration_mps2: nothing.clone(),
            next_position_m: nothing.clone(),
            next_speed_mps: nothing,
            locked_to_front: RunSet::default(),
            min_ttc_s: PerRun::constant(VehicleExtremes::INITIAL.min_ttc_s, lanes.len()),
            max_brake_so_far_mps2: PerRun::constant(
                VehicleExtremes::INITIAL.max_brake_mps2,
                lanes.len(),
            ),
            vehicle,
        }
    }

    pub(super) fn motion(&self, run: usize) -> Motion {
        Motion {
            position_m: self.position_m[run],
            speed_mps: self.speed_mps[run],
            acceleration_mps2: self.acceleration_mps2[run],
        }
    }

    /// Computes the acceleration of the next step. `collided` are the runs with an earlier collision.
    pub(super) fn decide(
        &mut self,
        arch: Arch,
        lanes: &[RunLane<'a>],
        [front, behind]: [Option<&Self>; 2],
        span_s: [f64; 2],
        collided: RunSet,
    ) -> Vec<(usize, ControllerFailure)> {
        let failed = self.command(arch, lanes, [front, behind], span_s);
        self.replace_commands_after_impact(lanes);
        self.respond(arch);
        let locked = match collided.is_empty() {
            true => None,
            false => Some(RunSet(
                self.locked_to_front.0 | behind.map_or(0, |behind| behind.locked_to_front.0),
            )),
        };
        self.add_noise(arch, locked);
        failed
    }

    /// Replaces the commands of vehicles that have hit their leader, as their runs state.
    fn replace_commands_after_impact(&mut self, lanes: &[RunLane<'a>]) {
        for run in self.locked_to_front.iter() {
            let command_mps2 = lanes
                .get(run)
                .and_then(|lane| lane.run.command_after_impact_mps2(self.vehicle));
            if let Some(command_mps2) = command_mps2 {
                self.next_acceleration_mps2[run] = command_mps2;
            }
        }
    }

    /// Returns the runs in which the vehicle does not observe its follower, because that has hit it.
    fn hides_follower(&self, lanes: &[RunLane<'a>], behind: Option<&Self>) -> RunSet {
        let mut hidden = RunSet::default();
        for run in behind
            .map_or(RunSet::default(), |behind| behind.locked_to_front)
            .iter()
        {
            let is_hidden = lanes
                .get(run)
                .is_some_and(|lane| lane.run.command_after_impact_mps2(self.vehicle).is_some());
            if is_hidden {
                hidden.insert(run);
            }
        }
        hidden
    }

    /// Turns commands into responses of the vehicles.
    #[inline]
    fn respond(&mut self, arch: Arch) {
        let decided = &mut self.next_acceleration_mps2;
        if self.actuators.is_empty() {
            let limits = [&self.max_brake_mps2, &self.max_accel_mps2];
            arch.dispatch(SimdClosure(
                #[inline(always)]
                || loops::limit(decided.padded_mut(), limits[0].padded(), limits[1].padded()),
            ));
        } else {
            let decided = decided.as_mut_slice().iter_mut();
            for (run, (decided, actuator)) in decided.zip(&mut self.actuators).enumerate() {
                *decided = actuator.respond(*decided, self.speed_mps[run]);
            }
        }
    }

    /// Adds the noise. `locked` are the runs in which this vehicle is locked to another one; `None` if no run of the
    /// block had a collision.
    #[inline]
    fn add_noise(&mut self, arch: Arch, locked: Option<RunSet>) {
        let decided = &mut self.next_acceleration_mps2;
        let noise_mps2 = self.noise.next_mps2();
        let speed_mps = &self.speed_mps;
        match locked {
            None => arch.dispatch(SimdClosure(
                #[inline(always)]
                || loops::disturb(decided.padded_mut(), noise_mps2, speed_mps.padded()),
            )),
            Some(locked) => {
                for (run, decided) in decided.as_mut_slice().iter_mut().enumerate() {
                    *decided = if locked.contains(run) {
                        *decided + noise_mps2[run]
                    } else {
                        add_noise_unless_at_rest(*decided, noise_mps2[run], speed_mps[run])
                    };
                }
            }
        }
    }

    #[inline(always)]
    fn state_slices(&self, runs: usize) -> StateSlices<'_> {
        StateSlices::first(
            runs,
            [
                &self.position_m,
                &self.length_m,
                &self.speed_mps,
                &self.acceleration_mps2,
            ],
        )
    }

    /// Computes the commands of the drivers. Returns the runs in which a driver failed, with the failure.
    fn command(
        &mut self,
        arch: Arch,
        lanes: &[RunLane<'a>],
        [front, behind]: [Option<&Self>; 2],
        span_s: [f64; 2],
    ) -> Vec<(usize, ControllerFailure)> {
        // The compiler knows that all slices have this length, so that no index needs a bounds check.
        let runs = lanes.len();
        let hides_follower = self.hides_follower(lanes, behind);
        // Not `state_slices`, which would borrow the drivers too.
        let own = StateSlices::first(
            runs,
            [
                &self.position_m,
                &self.length_m,
                &self.speed_mps,
                &self.acceleration_mps2,
            ],
        );
        let view = NeighbourhoodView {
            own,
            front: front.map(|front| front.state_slices(runs)),
            behind: behind.map(|behind| behind.state_slices(runs)),
            hides_follower,
        };
        let mut failed = Vec::new();
        let commands_mps2 = &mut self.next_acceleration_mps2.padded_mut()[..runs];
        if self.estimators.is_empty() {
            self.drivers
                .command_from_true_state(arch, span_s, &view, commands_mps2, &mut failed);
        } else {
            // Sensors measure the true gap behind, also if the driver does not observe it.
            let measured = NeighbourhoodView {
                hides_follower: RunSet::default(),
                ..view
            };
            let estimators = &mut self.estimators;
            self.drivers.perceive(
                runs,
                #[inline(always)]
                |run| view.observation(run),
            );
            self.drivers.command(
                arch,
                span_s,
                own.speed_mps,
                |run| {
                    let truth = TrueState {
                        position_m: own.position_m[run],
                        observation: measured.observation(run),
                    };
                    let mut observation = estimators[run].observe(&truth);
                    // In place, because a copy of the observation takes time in every step.
                    if hides_follower.contains(run) {
                        observation.behind = None;
                    }
                    observation
                },
                commands_mps2,
                &mut failed,
            );
        }
        failed
    }

    pub(super) fn step(&mut self, arch: Arch, dt_s: f64) {
        let now = [&self.position_m, &self.speed_mps, &self.acceleration_mps2].map(PerRun::padded);
        let next_position_m = &mut self.next_position_m;
        let next_speed_mps = &mut self.next_speed_mps;
        let max_brake_so_far_mps2 = &mut self.max_brake_so_far_mps2;
        arch.dispatch(SimdClosure(
            #[inline(always)]
            || {
                loops::advance(
                    dt_s,
                    now,
                    next_position_m.padded_mut(),
                    next_speed_mps.padded_mut(),
                );
                loops::update_max_brake(max_brake_so_far_mps2.padded_mut(), now[2]);
            },
        ));
    }

    /// Finds the runs in which this vehicle and its leader may collide, or are closest, inside the step.
    pub(super) fn screen(&self, arch: Arch, front: &Self, dt_s: f64) -> RunSet {
        let now: PairSlices<'_> = [
            &front.position_m,
            &front.length_m,
            &self.position_m,
            &front.speed_mps,
            &self.speed_mps,
        ]
        .map(PerRun::padded);
        let next_mps = [front.next_speed_mps.padded(), self.next_speed_mps.padded()];
        arch.dispatch(SimdClosure(
            #[inline(always)]
            || loops::screen(dt_s, now, next_mps),
        ))
    }

    pub(super) fn update_min_gap_and_ttc(&mut self, arch: Arch, front: &Self) {
        let next: PairSlices<'_> = [
            &front.next_position_m,
            &front.length_m,
            &self.next_position_m,
            &front.next_speed_mps,
            &self.next_speed_mps,
        ]
        .map(PerRun::padded);
        let min_gap_m = &mut self.min_gap_m;
        let min_ttc_s = &mut self.min_ttc_s;
        arch.dispatch(SimdClosure(
            #[inline(always)]
            || loops::update_min_gap_and_ttc(next, min_gap_m.padded_mut(), min_ttc_s.padded_mut()),
        ));
    }

    pub(super) fn swap_buffers(&mut self) {
        std::mem::swap(&mut self.position_m, &mut self.next_position_m);
        std::mem::swap(&mut self.speed_mps, &mut self.next_speed_mps);
    }

    /// Returns the interventions of the shield of this vehicle, number `vehicle` of the lane, in a run.
    pub(super) fn interventions(
        &self,
        run: usize,
        vehicle: usize,
        step_s: f64,
    ) -> Vec<Intervention> {
        interventions(self.drivers.overrides(run), vehicle, step_s)
    }

    pub(super) fn remove_run(&mut self, run: usize) -> VehicleSummary {
        let last = self.position_m.as_slice().len() - 1;
        self.locked_to_front.swap_remove(run, last);
        self.drivers.swap_remove(run);
        self.noise.swap_remove(run);
        if !self.actuators.is_empty() {
            self.actuators.swap_remove(run);
        }
        if !self.estimators.is_empty() {
            self.estimators.swap_remove(run);
        }
        for array in [
            &mut self.max_brake_mps2,
            &mut self.max_accel_mps2,
            &mut self.length_m,
            &mut self.mass_kg,
            &mut self.position_m,
            &mut self.acceleration_mps2,
            &mut self.next_acceleration_mps2,
            &mut self.next_position_m,
            &mut self.next_speed_mps,
        ] {
            array.swap_remove(run);
        }
        let tally = VehicleExtremes {
            min_ttc_s: self.min_ttc_s.swap_remove(run),
            max_brake_mps2: self.max_brake_so_far_mps2.swap_remove(run),
        };
        summarize_vehicle(
            self.min_gap_m.swap_remove(run),
            tally,
            self.speed_mps.swap_remove(run),
        )
    }
}
