//! One vehicle position in all runs of a block: arrays with one entry a run.

use pulp::Arch;

use super::block::Lane;
use super::drivers::Drivers;
use super::loops::{self, Pairs};
use super::noise::Noise;
use super::per_run::{PerRun, Runs};
use super::view::{Seen, View};
use crate::control::ControllerFailure;
use crate::estimate::{EgoEstimator, TrueState};
use crate::policy::InSimd;
use crate::sim::actuator::{Actuator, unless_at_rest};
use crate::sim::motion::Motion;
use crate::sim::platoon::Platoon;
use crate::sim::recorder::{Tally, summary};
use crate::sim::shielding::interventions;
use crate::sim::{Intervention, VehicleSummary};

/// One vehicle position in all runs.
pub(super) struct Column<'a> {
    drivers: Drivers<'a>,
    /// Empty if everybody sees the truth.
    estimator: Vec<EgoEstimator>,
    /// Empty if every vehicle responds at once and fully.
    sluggish: Vec<Actuator>,
    noise: Noise,
    max_brake_mps2: PerRun,
    max_accel_mps2: PerRun,
    pub(super) length_m: PerRun,
    pub(super) mass_kg: PerRun,
    pub(super) position_m: PerRun,
    pub(super) speed_mps: PerRun,
    pub(super) acceleration_mps2: PerRun,
    /// What was decided for the next step while others still look at the last one.
    pub(super) decided_mps2: PerRun,
    pub(super) next_position_m: PerRun,
    pub(super) next_speed_mps: PerRun,
    /// Runs in which the vehicle sticks to the one ahead of it.
    pub(super) sticks: Runs,
    pub(super) min_gap_m: PerRun,
    min_ttc_s: PerRun,
    hardest_brake_mps2: PerRun,
}

impl<'a> Column<'a> {
    pub(super) fn new(lanes: &[Lane<'a>], platoons: &[Platoon], vehicle: usize) -> Self {
        let of = |take: &dyn Fn(&Platoon) -> f64| PerRun::of(platoons.iter().map(take));
        let actuators: Vec<_> = lanes.iter().map(|lane| lane.run.actuator(vehicle)).collect();
        let estimator: Vec<_> =
            lanes.iter().zip(platoons).filter_map(|(lane, platoon)| lane.run.estimator(vehicle, platoon)).collect();
        let nothing = PerRun::all(0.0, lanes.len());
        Self {
            drivers: Drivers::new(lanes.iter().map(|lane| lane.run.driver(vehicle)).collect()),
            estimator,
            max_brake_mps2: PerRun::of(actuators.iter().map(|actuator| actuator.max_brake_mps2)),
            max_accel_mps2: PerRun::of(actuators.iter().map(|actuator| actuator.max_accel_mps2)),
            sluggish: if actuators.iter().all(Actuator::is_immediate) { Vec::new() } else { actuators },
            noise: Noise::new(lanes.iter().map(|lane| lane.run.disturbance(vehicle)).collect()),
            length_m: of(&|platoon| platoon.length_m[vehicle]),
            mass_kg: of(&|platoon| platoon.mass_kg[vehicle]),
            position_m: of(&|platoon| platoon.motion[vehicle].position_m),
            speed_mps: of(&|platoon| platoon.motion[vehicle].speed_mps),
            min_gap_m: of(&|platoon| platoon.min_gap_m[vehicle]),
            acceleration_mps2: nothing.clone(),
            decided_mps2: nothing.clone(),
            next_position_m: nothing.clone(),
            next_speed_mps: nothing,
            sticks: Runs::default(),
            min_ttc_s: PerRun::all(Tally::NOTHING_YET.min_ttc_s, lanes.len()),
            hardest_brake_mps2: PerRun::all(Tally::NOTHING_YET.max_brake_mps2, lanes.len()),
        }
    }

    pub(super) fn motion(&self, run: usize) -> Motion {
        Motion {
            position_m: self.position_m[run],
            speed_mps: self.speed_mps[run],
            acceleration_mps2: self.acceleration_mps2[run],
        }
    }

    /// From what is true to the acceleration of the next step. `touched` are the runs in which vehicles have touched.
    pub(super) fn decide(
        &mut self,
        arch: Arch,
        lanes: &[Lane<'a>],
        [front, behind]: [Option<&Self>; 2],
        span_s: [f64; 2],
        touched: Runs,
    ) -> Vec<(usize, ControllerFailure)> {
        let failed = self.command(arch, lanes, [front, behind], span_s);
        if self.sluggish.is_empty() {
            let (decided, limits) = (&mut self.decided_mps2, [&self.max_brake_mps2, &self.max_accel_mps2]);
            arch.dispatch(InSimd(
                #[inline(always)]
                || loops::limit(decided.filled_mut(), limits[0].filled(), limits[1].filled()),
            ));
        } else {
            for (decided, actuator) in self.decided_mps2.as_mut_slice().iter_mut().zip(&mut self.sluggish) {
                *decided = actuator.respond(*decided);
            }
        }
        let (decided, noise_mps2, speed) = (&mut self.decided_mps2, self.noise.next_mps2(), &self.speed_mps);
        if touched.is_empty() {
            arch.dispatch(InSimd(
                #[inline(always)]
                || loops::disturb(decided.filled_mut(), noise_mps2, speed.filled()),
            ));
        } else {
            let stuck = Runs(self.sticks.0 | behind.map_or(0, |behind| behind.sticks.0));
            for (run, decided) in decided.as_mut_slice().iter_mut().enumerate() {
                *decided = if stuck.contains(run) {
                    *decided + noise_mps2[run]
                } else {
                    unless_at_rest(*decided, noise_mps2[run], speed[run])
                };
            }
        }
        failed
    }

    #[inline(always)]
    fn seen(&self, runs: usize) -> Seen<'_> {
        Seen::first(runs, [&self.position_m, &self.length_m, &self.speed_mps, &self.acceleration_mps2])
    }

    /// What the drivers want; the runs in which one failed, and why.
    fn command(
        &mut self,
        arch: Arch,
        lanes: &[Lane<'a>],
        [front, behind]: [Option<&Self>; 2],
        span_s: [f64; 2],
    ) -> Vec<(usize, ControllerFailure)> {
        // One length for all, known as such, so that no index needs a check.
        let runs = lanes.len();
        // Not by `seen`, which would take hold of the drivers as well.
        let own = Seen::first(runs, [&self.position_m, &self.length_m, &self.speed_mps, &self.acceleration_mps2]);
        let (front, behind) = (front.map(|front| front.seen(runs)), behind.map(|behind| behind.seen(runs)));
        let view = View { own, front, behind };
        let mut failed = Vec::new();
        let commands_mps2 = &mut self.decided_mps2.filled_mut()[..runs];
        if self.estimator.is_empty() {
            self.drivers.command_by_truth(arch, span_s, &view, commands_mps2, &mut failed);
        } else {
            let estimator = &mut self.estimator;
            let see = |run: usize| {
                let truth = TrueState { position_m: own.position_m[run], observation: view.observation(run) };
                estimator[run].observe(&truth)
            };
            self.drivers.command(arch, span_s, own.speed_mps, see, commands_mps2, &mut failed);
        }
        failed
    }

    /// Where the vehicle is after `dt_s` if nobody touches it.
    pub(super) fn step(&mut self, arch: Arch, dt_s: f64) {
        let now = [&self.position_m, &self.speed_mps, &self.acceleration_mps2].map(PerRun::filled);
        let (next_position_m, next_speed_mps) = (&mut self.next_position_m, &mut self.next_speed_mps);
        let hardest_brake_mps2 = &mut self.hardest_brake_mps2;
        arch.dispatch(InSimd(
            #[inline(always)]
            || {
                loops::advance(dt_s, now, next_position_m.filled_mut(), next_speed_mps.filled_mut());
                loops::note_braking(hardest_brake_mps2.filled_mut(), now[2]);
            },
        ));
    }

    /// Marks the runs in which this vehicle and the one ahead may touch, or are closest, inside the step.
    pub(super) fn screen(&self, arch: Arch, front: &Self, dt_s: f64) -> Runs {
        let now = Pairs {
            front_m: front.position_m.filled(),
            front_length_m: front.length_m.filled(),
            rear_m: self.position_m.filled(),
            front_mps: front.speed_mps.filled(),
            rear_mps: self.speed_mps.filled(),
        };
        let next_mps = [front.next_speed_mps.filled(), self.next_speed_mps.filled()];
        arch.dispatch(InSimd(
            #[inline(always)]
            || loops::screen(dt_s, now, next_mps),
        ))
    }

    /// Takes in gap and time to collision at the end of the step.
    pub(super) fn note_approach(&mut self, arch: Arch, front: &Self) {
        let next = Pairs {
            front_m: front.next_position_m.filled(),
            front_length_m: front.length_m.filled(),
            rear_m: self.next_position_m.filled(),
            front_mps: front.next_speed_mps.filled(),
            rear_mps: self.next_speed_mps.filled(),
        };
        let (min_gap_m, min_ttc_s) = (&mut self.min_gap_m, &mut self.min_ttc_s);
        arch.dispatch(InSimd(
            #[inline(always)]
            || loops::note_approach(next, min_gap_m.filled_mut(), min_ttc_s.filled_mut()),
        ));
    }

    /// The end of the step becomes the start of the next one.
    pub(super) fn turn_over(&mut self) {
        std::mem::swap(&mut self.position_m, &mut self.next_position_m);
        std::mem::swap(&mut self.speed_mps, &mut self.next_speed_mps);
    }

    /// What a shield of this vehicle, number `vehicle` of the line, did in a run.
    pub(super) fn interventions(&self, run: usize, vehicle: usize, step_s: f64) -> Vec<Intervention> {
        self.drivers.shielded(run).map_or_else(Vec::new, |controller| interventions(controller, vehicle, step_s))
    }

    /// Takes a run out of the column.
    pub(super) fn finish(&mut self, run: usize) -> VehicleSummary {
        let last = self.position_m.as_slice().len() - 1;
        self.sticks.swap_remove(run, last);
        self.drivers.swap_remove(run);
        self.noise.swap_remove(run);
        if !self.sluggish.is_empty() {
            self.sluggish.swap_remove(run);
        }
        if !self.estimator.is_empty() {
            self.estimator.swap_remove(run);
        }
        for array in [
            &mut self.max_brake_mps2,
            &mut self.max_accel_mps2,
            &mut self.length_m,
            &mut self.mass_kg,
            &mut self.position_m,
            &mut self.acceleration_mps2,
            &mut self.decided_mps2,
            &mut self.next_position_m,
            &mut self.next_speed_mps,
        ] {
            array.swap_remove(run);
        }
        let tally = Tally {
            min_ttc_s: self.min_ttc_s.swap_remove(run),
            max_brake_mps2: self.hardest_brake_mps2.swap_remove(run),
        };
        summary(self.min_gap_m.swap_remove(run), tally, self.speed_mps.swap_remove(run))
    }
}
