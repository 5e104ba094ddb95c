//! Steps of many runs side by side, where one vehicle of each is driven from outside with one command for all of them.
//!
//! A learner holds an action for ten steps, in a thousand runs in turn. One run after the other, each step waits for the one
//! before; side by side a quantity of a vehicle is one array over the runs, as in the lockstep engine. Here runs are only looked
//! at: what was computed is taken over by [`Stepper::drive_abreast`], unless vehicles could have touched on the way. A run can
//! so be anywhere, at any time of its scenario, and belong to whomever it likes.

use pulp::Arch;

use super::super::Motion;
use super::super::actuator::{Disturbance, unless_at_rest};
use super::super::motion::{self, may_touch};
use super::super::run::ActiveDriver;
use super::{Moment, Stepper, VehicleLoop};
use crate::control::{SimpleRule, within};
use crate::observation::{Neighbour, Observation};
use crate::policy::InSimd;
use crate::scenario::{Brake, LeadProfile};

/// Runs that fit in side by side: enough to fill the widest vector registers there are, few enough to stay in the first-level cache.
pub const ABREAST: usize = 16;

/// Vehicles of a line at most.
const MOST_VEHICLES: usize = 4;

/// A number for each run.
type Row = [f64; ABREAST];

const NOTHING: Row = [0.0; ABREAST];

/// Runs side by side, and what becomes of them within some steps.
pub struct Abreast {
    arch: Arch,
    steps: usize,
    taken: usize,
    /// Whether what becomes of them has been computed.
    is_computed: bool,
    /// Vehicles of every line.
    vehicles: usize,
    /// Of the scenarios, in seconds.
    step_s: f64,
    /// Steps made before, as a number.
    made: Row,
    drivers: [Drivers; MOST_VEHICLES],
    length_m: [Row; MOST_VEHICLES],
    /// Largest deceleration and acceleration.
    limits_mps2: [[Row; 2]; MOST_VEHICLES],
    /// The sources of noise after all steps.
    disturbances: [[Option<Disturbance>; ABREAST]; MOST_VEHICLES],
    /// Noise on the acceleration of each vehicle in each step, in m/s².
    noise_mps2: Vec<[Row; MOST_VEHICLES]>,
    /// Position, speed, and the acceleration held up to there, of each vehicle: at the start, and after each step.
    track: Vec<[[Row; 3]; MOST_VEHICLES]>,
    /// Runs of which nothing is known: vehicles may touch, or what was computed was taken over.
    unknown: [bool; ABREAST],
}

/// The place of a run among those side by side.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Place {
    run: usize,
    /// Who is driven from outside.
    vehicle: usize,
}

/// Who drives a vehicle position.
enum Drivers {
    /// Somebody outside, with commands for all steps.
    Outside(Row),
    /// Scripts that brake at a constant rate, as leaders nearly always do: onsets and rates.
    Brake([Row; 2]),
    /// Rules, with what they remember after all steps.
    Rules(Box<[SimpleRule; ABREAST]>),
}

impl Abreast {
    /// No runs yet, each of which is to make `steps` steps.
    #[must_use]
    pub fn new(steps: usize) -> Self {
        Self {
            arch: Arch::new(),
            steps,
            taken: 0,
            is_computed: false,
            vehicles: 0,
            step_s: 0.0,
            made: NOTHING,
            drivers: [const { Drivers::Outside(NOTHING) }; MOST_VEHICLES],
            length_m: [NOTHING; MOST_VEHICLES],
            limits_mps2: [[NOTHING; 2]; MOST_VEHICLES],
            disturbances: [const { [const { None }; ABREAST] }; MOST_VEHICLES],
            noise_mps2: vec![[NOTHING; MOST_VEHICLES]; steps],
            track: vec![[[NOTHING; 3]; MOST_VEHICLES]; steps + 1],
            unknown: [true; ABREAST],
        }
    }

    /// Steps that each run is to make.
    #[must_use]
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// Forgets all runs.
    pub fn clear(&mut self) {
        (self.taken, self.is_computed) = (0, false);
    }

    /// Takes in a run in which vehicle `index` is driven with a command of `command_mps2`, if it
    /// [suits](Stepper::suits_abreast) and its line is like those that are there: as many vehicles, the same step, the same kinds of
    /// drivers.
    pub fn admit(&mut self, stepper: &Stepper<'_, '_>, index: usize, command_mps2: f64) -> Option<Place> {
        let Stepper { pace, platoon, loops, step, .. } = stepper;
        let (place, vehicles) = (self.taken, loops.len());
        if place >= ABREAST || self.is_computed || !stepper.suits_abreast(index, self.steps) {
            return None;
        }
        if place == 0 {
            (self.vehicles, self.step_s) = (vehicles, pace.step_s);
        } else if self.vehicles != vehicles || self.step_s.to_bits() != pace.step_s.to_bits() {
            return None;
        }
        for (vehicle, of) in loops.iter().enumerate().take(MOST_VEHICLES) {
            let driver = if vehicle == index { Driver::Outside(command_mps2) } else { Driver::of(of)? };
            if !self.drivers[vehicle].seat(place, driver) {
                return None;
            }
            self.length_m[vehicle][place] = platoon.length_m[vehicle];
            let limits_mps2 = [of.actuator.max_brake_mps2, of.actuator.max_accel_mps2];
            for (row, limit_mps2) in self.limits_mps2[vehicle].iter_mut().zip(limits_mps2) {
                row[place] = limit_mps2;
            }
            let places = self.noise_mps2.iter_mut().map(|of_step| &mut of_step[vehicle][place]);
            let disturbance = &mut self.disturbances[vehicle][place];
            disturbance.clone_from(&of.disturbance);
            match disturbance {
                Some(disturbance) => disturbance.next_into(places),
                None => places.for_each(|place| *place = 0.0),
            }
            let Motion { position_m, speed_mps, acceleration_mps2 } = platoon.motion[vehicle];
            for (row, number) in self.track[0][vehicle].iter_mut().zip([position_m, speed_mps, acceleration_mps2]) {
                row[place] = number;
            }
        }
        self.made[place] = *step as f64;
        self.unknown[place] = true;
        self.taken += 1;
        Some(Place { run: place, vehicle: index })
    }

    /// Computes what becomes of all runs. Nobody is admitted from then on, until all are forgotten.
    pub fn run(&mut self) {
        if std::mem::replace(&mut self.is_computed, true) {
            return;
        }
        self.unknown = [false; ABREAST];
        let Self { arch, taken, step_s, made, drivers, length_m, limits_mps2, noise_mps2, track, unknown, .. } = self;
        let (vehicles, taken) = (self.vehicles.min(MOST_VEHICLES), (*taken).min(ABREAST));
        arch.dispatch(InSimd(
            #[inline(always)]
            || {
                for (step, noise_mps2) in noise_mps2.iter().enumerate() {
                    let (before, after) = track.split_at_mut(step + 1);
                    let (Some(now), Some(next)) = (before.last(), after.first_mut()) else { return };
                    let span_s = [step, step + 1].map(|step| made.map(|made| (made + step as f64) * *step_s));
                    // Everybody decides on the state at the start of the step, and writes into the next one.
                    for vehicle in 0..vehicles {
                        let line = Line { now, vehicle, vehicles, length_m };
                        let decided_mps2 =
                            drivers[vehicle].decide(&line, taken, &span_s, &limits_mps2[vehicle], &noise_mps2[vehicle]);
                        let [position_m, speed_mps, _] = &now[vehicle];
                        let [next_m, next_mps, held_mps2] = &mut next[vehicle];
                        for run in 0..ABREAST {
                            (next_m[run], next_mps[run]) =
                                motion::advance(position_m[run], speed_mps[run], decided_mps2[run], *step_s);
                        }
                        *held_mps2 = decided_mps2;
                    }
                    for rear in 1..vehicles {
                        let length_m = &length_m[rear - 1];
                        let ([front_m, ..], [rear_m, rear_mps, _]) = (&now[rear - 1], &now[rear]);
                        let next_mps = &next[rear][1];
                        for run in 0..ABREAST {
                            let gap_m = front_m[run] - length_m[run] - rear_m[run];
                            unknown[run] |= may_touch(gap_m, [rear_mps[run], next_mps[run]], *step_s);
                        }
                    }
                }
            },
        ));
    }
}

/// What is true of a vehicle position and its neighbours.
struct Line<'a> {
    now: &'a [[Row; 3]; MOST_VEHICLES],
    vehicle: usize,
    vehicles: usize,
    length_m: &'a [Row; MOST_VEHICLES],
}

impl Line<'_> {
    #[inline(always)]
    fn observation(&self, run: usize) -> Observation {
        let of = |vehicle: usize| at(&self.now[vehicle], run);
        let neighbour = |front: usize, other: usize| {
            let gap_m = of(front).position_m - self.length_m[front][run] - of(front + 1).position_m;
            let Motion { speed_mps, acceleration_mps2, .. } = of(other);
            Neighbour { gap_m, speed_mps, acceleration_mps2 }
        };
        let Motion { speed_mps, acceleration_mps2, .. } = of(self.vehicle);
        let (own, has_behind) = (self.vehicle, self.vehicle + 1 < self.vehicles);
        Observation {
            speed_mps,
            acceleration_mps2,
            ahead: own.checked_sub(1).map(|front| neighbour(front, front)),
            behind: has_behind.then(|| neighbour(own, own + 1)),
        }
    }
}

#[inline(always)]
fn at([position_m, speed_mps, acceleration_mps2]: &[Row; 3], run: usize) -> Motion {
    Motion { position_m: position_m[run], speed_mps: speed_mps[run], acceleration_mps2: acceleration_mps2[run] }
}

impl Drivers {
    /// Gives a driver a place, if it is of the kind of those who have one.
    fn seat(&mut self, place: usize, driver: Driver) -> bool {
        match (&mut *self, driver) {
            (Self::Outside(commands_mps2), Driver::Outside(command_mps2)) => commands_mps2[place] = command_mps2,
            (Self::Brake(brakes), Driver::Brake(brake)) => {
                [brakes[0][place], brakes[1][place]] = [brake.onset_s, brake.rate_mps2];
            }
            (Self::Rules(rules), Driver::Rule(rule)) => rules[place] = rule,
            (_, _) if place > 0 => return false,
            (_, Driver::Outside(command_mps2)) => *self = Self::Outside([command_mps2; ABREAST]),
            (_, Driver::Brake(Brake { onset_s, rate_mps2 })) => {
                *self = Self::Brake([[onset_s; ABREAST], [rate_mps2; ABREAST]]);
            }
            (_, Driver::Rule(rule)) => *self = Self::Rules(Box::new(std::array::from_fn(|_| rule.clone()))),
        }
        true
    }

    /// The accelerations of a step.
    #[inline(always)]
    fn decide(
        &mut self,
        line: &Line<'_>,
        taken: usize,
        [from_s, to_s]: &[Row; 2],
        [max_brake_mps2, max_accel_mps2]: &[Row; 2],
        noise_mps2: &Row,
    ) -> Row {
        let mut wanted_mps2 = NOTHING;
        match self {
            Self::Outside(commands_mps2) => wanted_mps2 = *commands_mps2,
            Self::Brake([onset_s, rate_mps2]) => {
                for run in 0..ABREAST {
                    let brake = Brake { onset_s: onset_s[run], rate_mps2: rate_mps2[run] };
                    wanted_mps2[run] = brake.acceleration_mps2(from_s[run], to_s[run]);
                }
            }
            Self::Rules(rules) => {
                for (run, rule) in rules.iter_mut().enumerate().take(taken) {
                    wanted_mps2[run] = rule.wanted_mps2(&line.observation(run));
                }
            }
        }
        let speed_mps = &line.now[line.vehicle][1];
        for run in 0..ABREAST {
            let answer_mps2 = within(wanted_mps2[run], max_brake_mps2[run], max_accel_mps2[run]);
            wanted_mps2[run] = unless_at_rest(answer_mps2, noise_mps2[run], speed_mps[run]);
        }
        wanted_mps2
    }
}

/// Who drives one vehicle.
enum Driver {
    Outside(f64),
    Brake(Brake),
    Rule(SimpleRule),
}

impl Driver {
    /// None where it is neither a script that brakes at a constant rate nor a simple rule.
    fn of(of: &VehicleLoop<'_>) -> Option<Self> {
        match &of.driver {
            ActiveDriver::Profile(LeadProfile::Brake(brake)) => Some(Self::Brake(brake.clone())),
            ActiveDriver::Profile(_) => None,
            ActiveDriver::Controller(controller) => controller.simple_rule().map(Self::Rule),
        }
    }
}

impl Stepper<'_, '_> {
    /// Whether the next `steps` steps can be made side by side with those of other runs while vehicle `index` is driven from
    /// outside: that at most four vehicles are in it, who stay in their lane and see the truth, answer without delay, brake by script
    /// or drive by a simple rule, and have not touched, and that nothing of it is kept but where it gets to.
    ///
    /// To ask all runs first is faster than to ask each before it is admitted: this looks at all that is read then, and the machine
    /// fetches what belongs to one run while it waits for another's.
    #[inline]
    #[must_use]
    pub fn suits_abreast(&self, index: usize, steps: usize) -> bool {
        let Self { pace, platoon, loops, tallies, trace, impacts, failed, step, ended, .. } = self;
        let is_watched = trace.is_some() || !tallies.is_empty();
        let is_plain = platoon.lane.is_plain() && impacts.is_empty() && failed.is_none() && pace.substeps == 1;
        let suits = |(vehicle, of): (usize, &VehicleLoop<'_>)| {
            let is_prompt = of.estimator.is_none() && of.actuator.is_immediate() && of.command_mps2.is_none();
            is_prompt && (vehicle == index || Driver::of(of).is_some())
        };
        !ended
            && !is_watched
            && is_plain
            && step.saturating_add(steps) <= pace.steps
            && loops.len() <= MOST_VEHICLES
            && loops.iter().enumerate().all(suits)
            && platoon.motion.iter().zip(&platoon.length_m).all(|(at, length_m)| (at.position_m - length_m).is_finite())
    }

    /// Takes over what was computed of this run side by side with others, and hands each step's moment to `after`. To the last
    /// bit what [`drive`](Self::drive) does with the same command.
    ///
    /// Does nothing and returns false where vehicles may have touched, or the run is not where it was.
    #[inline]
    pub fn drive_abreast(&mut self, abreast: &mut Abreast, place: Place, mut after: impl FnMut(&Moment<'_>)) -> bool {
        let (Place { run: place, vehicle: index }, vehicles) = (place, self.loops.len());
        let is_known = place < abreast.taken.min(ABREAST) && !abreast.unknown[place] && vehicles == abreast.vehicles;
        let [start, steps @ ..] = abreast.track.as_slice() else { return false };
        if !is_known || vehicles > MOST_VEHICLES || abreast.made[place] != self.step as f64 {
            return false;
        }
        if !self.platoon.motion.iter().zip(start).all(|(motion, rows)| at(rows, place) == *motion) {
            return false;
        }
        let mut motion = start.each_ref().map(|rows| at(rows, place));
        for line in steps {
            for (motion, rows) in motion.iter_mut().zip(line) {
                *motion = at(rows, place);
            }
            self.step += 1;
            self.ended = self.step == self.pace.steps;
            let gap_m = (1..vehicles)
                .contains(&index)
                .then(|| motion[index - 1].position_m - abreast.length_m[index - 1][place] - motion[index].position_m);
            after(&Moment { motion: &motion[..vehicles], gap_m, has_touched: false, has_ended: self.ended });
        }
        self.platoon.motion.copy_from_slice(&motion[..vehicles]);
        // Once only: what noise has come to is taken out of it.
        abreast.unknown[place] = true;
        let taken = abreast.drivers.iter().zip(&mut abreast.disturbances);
        for (vehicle, (drivers, disturbances)) in self.loops.iter_mut().zip(taken) {
            vehicle.seen = None;
            std::mem::swap(&mut vehicle.disturbance, &mut disturbances[place]);
            if let (Drivers::Rules(rules), ActiveDriver::Controller(controller)) = (drivers, &mut vehicle.driver) {
                rules[place].hand_over(controller);
            }
        }
        true
    }
}

#[cfg(test)]
mod tests {
    use std::ops::ControlFlow;

    use super::*;
    use crate::control::{ControllerSpec, NoSettings};
    use crate::observation::EstimatorKind;
    use crate::scenario::Scenario;
    use crate::scenario::space::{BUILT_IN_SPACES, built_in_space};
    use crate::sim::{AfterContact, Run, RunOptions};

    const STEPS: usize = 10;

    fn runs(scenarios: &[Scenario], after: AfterContact) -> Vec<Run<'_>> {
        let idle = RunOptions::new(ControllerSpec::MatchLeader(NoSettings::default()));
        let options = idle.with_estimator(EstimatorKind::Truth).with_after_contact(after);
        scenarios.iter().map(|scenario| Run::new(scenario, options.clone()).unwrap()).collect()
    }

    /// What a moment tells, as text: to the last bit, and whatever it is.
    fn told(now: &Moment<'_>) -> String {
        format!("{now:?}")
    }

    /// Commands between full braking and full acceleration that change now and then, others in every run.
    fn command_mps2(run: usize, decision: usize) -> f64 {
        let turn = (run * 7919 + decision / 3 * 104_729) % 1009;
        -7.5 + 10.5 * turn as f64 / 1008.0
    }

    /// Makes all runs, and returns every moment of each; and how many decisions there were, and how many of them were foreseen.
    fn made(runs: &[Run<'_>], arch: Option<Arch>) -> (Vec<Vec<String>>, [usize; 2]) {
        let mut steppers: Vec<_> = runs.iter().map(Stepper::without_summaries).collect();
        let mut moments = vec![Vec::new(); runs.len()];
        let mut abreast = Abreast::new(STEPS);
        let (mut decisions, mut foreseen) = (0, 0);
        for decision in 0.. {
            if steppers.iter().all(Stepper::has_ended) {
                break;
            }
            for group in (0..runs.len()).collect::<Vec<_>>().chunks(ABREAST) {
                abreast.clear();
                if let Some(arch) = arch {
                    abreast.arch = arch;
                }
                let mut admit = |&run: &usize| {
                    let place = abreast.admit(&steppers[run], 1, command_mps2(run, decision));
                    assert!(place.is_none() || steppers[run].suits_abreast(1, STEPS));
                    place.filter(|_| arch.is_some())
                };
                let places: Vec<_> = group.iter().map(&mut admit).collect();
                abreast.run();
                for (&run, place) in group.iter().zip(places) {
                    let (stepper, command_mps2) = (&mut steppers[run], command_mps2(run, decision));
                    let moments = &mut moments[run];
                    decisions += usize::from(!stepper.has_ended());
                    // Learners look at the state between decisions, which counts as having looked.
                    stepper.observe(1);
                    if let Some(place) = place
                        && stepper.drive_abreast(&mut abreast, place, |now| moments.push(told(now)))
                    {
                        foreseen += 1;
                        assert!(!stepper.drive_abreast(&mut abreast, place, |_| {}), "only once");
                        continue;
                    }
                    stepper.drive(
                        1,
                        STEPS,
                        |_| command_mps2,
                        |now| {
                            moments.push(told(now));
                            ControlFlow::Continue(())
                        },
                    );
                }
            }
        }
        for (moments, stepper) in moments.iter_mut().zip(steppers) {
            moments.push(format!("{:?}", stepper.finish()));
        }
        (moments, [decisions, foreseen])
    }

    /// Whatever the space, runs of all of them side by side, mixed, are to the bit what each is by itself: through contacts and after them, at rest,
    /// at the end of the time, and on every width of registers.
    #[test]
    fn runs_side_by_side_are_runs_alone() {
        let spaces = BUILT_IN_SPACES.into_iter().map(|(name, ..)| built_in_space(name).unwrap());
        let scenarios: Vec<_> =
            spaces.flat_map(|space| (0..5).map(move |index| space.draw(3, index).unwrap())).collect();
        let (mut touched, mut together) = (0, 0);
        for after in [AfterContact::Stop, AfterContact::Continue] {
            let runs = runs(&scenarios, after);
            let (alone, [_, none]) = made(&runs, None);
            assert_eq!(none, 0);
            touched += alone.iter().flatten().filter(|told| told.contains("has_touched: true")).count();
            for arch in crate::policy::every_path() {
                let (side_by_side, [_, foreseen]) = made(&runs, Some(arch));
                for (run, (alone, beside)) in alone.iter().zip(&side_by_side).enumerate() {
                    assert_eq!(alone, beside, "{}", scenarios[run].spec().name);
                }
                together += foreseen;
            }
        }
        assert!(touched > 20 && together > 500, "{touched} {together}");
    }

    /// Of the paper's task nearly every decision is computed side by side.
    #[test]
    fn the_papers_task_is_made_side_by_side() {
        let space = built_in_space("paper").unwrap();
        let scenarios: Vec<_> = (0..40).map(|index| space.draw(0, index).unwrap()).collect();
        let (_, [decisions, foreseen]) = made(&runs(&scenarios, AfterContact::Stop), Some(Arch::new()));
        assert!(foreseen * 10 > decisions * 9, "{foreseen} of {decisions}");
    }

    /// What was computed of one run is no other's.
    #[test]
    fn a_place_is_taken_by_the_run_that_it_is_of_where_it_was() {
        let space = built_in_space("paper").unwrap();
        let scenarios: Vec<_> = (0..2).map(|index| space.draw(0, index).unwrap()).collect();
        let runs = runs(&scenarios, AfterContact::Stop);
        let [mut own, mut other] = [0, 1].map(|run| Stepper::without_summaries(&runs[run]));
        let mut abreast = Abreast::new(STEPS);
        let place = abreast.admit(&own, 1, 0.0).unwrap();
        assert!(!own.drive_abreast(&mut Abreast::new(STEPS), place, |_| {}));
        assert!(!own.drive_abreast(&mut abreast, place, |_| {}), "nothing is computed yet");
        abreast.run();
        assert_eq!(abreast.admit(&own, 1, 0.0), None, "everything is computed");
        assert!(!other.drive_abreast(&mut abreast, place, |_| {}));
        own.step();
        assert!(!own.drive_abreast(&mut abreast, place, |_| {}));
        assert_eq!(own.steps_made(), 1);
        abreast.clear();
        assert!(!other.drive_abreast(&mut abreast, place, |_| {}), "nobody is there any more");
    }
}
