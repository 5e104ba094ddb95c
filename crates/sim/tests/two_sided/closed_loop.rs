//! Closed loops of a two-sided filter with reckless controllers, adversarial leaders and followers of a class.
//!
//! The vehicles are simulated here, independently of the filter's predictions: exact motion in each step, and the
//! smallest gap inside it.

use crumple_sim::control::{
    CREEP_SPEED_MPS, ErrorBounds, FollowerClass, FollowerTrigger, LevelMeter, NOTICED_BRAKE_MPS2,
    RearErrorBounds, TwoSidedFilter, TwoSidedParams,
};
use crumple_sim::engine::{Motion, closest_gap_m};
use crumple_sim::observation::{Neighbour, Observation};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

/// Longest run, in steps.
const MAX_STEPS: usize = 2500;

/// Smallest and largest gap at the start, in metres.
const GAPS_M: [f64; 2] = [2.0, 160.0];

/// Pieces of the leader's acceleration.
const LEADER_PIECES: usize = 12;

/// Commands of the controller behind the filter, all reckless.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Reckless {
    FullThrottle,
    FullBrake,
    /// A random command at each step.
    Random,
    /// A random command that is held for half a second.
    RandomHeld,
    /// Full brake and full throttle in turn, for this number of steps each.
    BangBang(usize),
}

/// One closed loop: assumptions, initial state and behaviour of all vehicles.
#[derive(Debug, Clone)]
pub(crate) struct TwoSidedLoop {
    pub(crate) params: TwoSidedParams,
    pub(crate) gap_m: f64,
    pub(crate) ahead_mps: f64,
    pub(crate) speed_mps: f64,
    pub(crate) rear_gap_m: f64,
    pub(crate) rear_mps: f64,
    pub(crate) controller: Reckless,
    /// The leader's accelerations, and their lengths in steps; the last one is held.
    pub(crate) leader: [(f64, usize); LEADER_PIECES],
    /// Largest deceleration of the leader, in m/s².
    pub leader_brake_mps2: f64,
    /// Acceleration of the follower before its trigger, relative to its limit: at random if absent.
    pub(crate) drift_share: Option<f64>,
    pub(crate) drift_steps: usize,
    /// Steps from the trigger to the brake.
    pub(crate) reaction_steps: usize,
    /// The follower's deceleration relative to the least.
    pub(crate) brake_factor: f64,
    /// Errors relative to their bounds: at random if absent.
    pub(crate) error_share: Option<f64>,
    pub(crate) noise_share: Option<f64>,
    pub(crate) seed: u64,
}

/// Result of a closed loop.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LoopResult {
    /// True if the first state is in S at the level to keep, as [`LevelMeter`] measures it.
    pub(crate) is_in_set: bool,
    /// Smallest gaps ahead and behind, in metres.
    pub(crate) min_gaps_m: [f64; 2],
    /// Steps with replaced commands.
    pub(crate) replaced: usize,
    pub(crate) steps: usize,
    /// True if the filter had no plan at the level to keep after some step.
    pub(crate) left_set: bool,
}

impl Default for LoopResult {
    fn default() -> Self {
        Self {
            is_in_set: false,
            min_gaps_m: [f64::INFINITY; 2],
            replaced: 0,
            steps: 0,
            left_set: false,
        }
    }
}

impl LoopResult {
    pub(crate) fn has_collision(&self) -> bool {
        self.min_gaps_m[0] <= 0.0 || self.min_gaps_m[1] <= 0.0
    }
}

fn range(random: &mut Xoshiro256PlusPlus, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}

fn chance(random: &mut Xoshiro256PlusPlus, probability: f64) -> bool {
    random.random::<f64>() < probability
}

fn pick<const N: usize>(random: &mut Xoshiro256PlusPlus, values: [f64; N]) -> f64 {
    values[random.random_range(0..N)]
}

/// Parameters at random: with `is_exact`, without lag, noise and errors.
fn random_params(random: &mut Xoshiro256PlusPlus, is_exact: bool) -> TwoSidedParams {
    let friction = if chance(random, 0.5) {
        1.0
    } else {
        range(random, 0.3, 1.0)
    };
    let brake_mps2 = friction * range(random, 5.0, 9.0);
    let reacts = chance(random, 0.25);
    let step_s = pick(random, [0.01, 0.01, 0.02, 0.05]);
    let follower = FollowerClass {
        trigger: if reacts {
            FollowerTrigger::LeaderBrakes
        } else {
            FollowerTrigger::TimeToCollision(range(random, 0.9, 2.5))
        },
        reaction_s: if reacts {
            range(random, 0.0, 1.5)
        } else {
            range(random, 0.0, 0.5)
        },
        brake_mps2: friction * range(random, 4.0, 9.0),
        drift_mps2: if chance(random, 0.3) {
            0.0
        } else {
            range(random, 0.0, 0.6)
        },
    };
    let accel_mps2 = pick(random, [0.0, 0.5, 1.5, 3.0, 6.0]);
    let has_lag = !is_exact && chance(random, 0.4);
    let has_noise = !is_exact && chance(random, 0.4);
    let has_errors = !is_exact && chance(random, 0.6);
    let mut error = |high: f64| {
        if has_errors {
            range(random, 0.0, high)
        } else {
            0.0
        }
    };
    let errors = ErrorBounds {
        gap_m: error(0.3),
        speed_mps: error(0.1),
        ahead_speed_mps: error(0.5),
    };
    let rear_errors = RearErrorBounds {
        gap_m: error(0.3),
        speed_mps: error(0.5),
    };
    TwoSidedParams {
        step_s,
        brake_mps2,
        accel_mps2,
        noise_mps2: if has_noise {
            range(random, 0.0, 0.2)
        } else {
            0.0
        },
        delay_steps: if chance(random, 0.3) {
            random.random_range(0..20)
        } else {
            0
        },
        response_fraction: if has_lag {
            -(-step_s / range(random, 0.03, 0.4)).exp_m1()
        } else {
            1.0
        },
        level_mps2: friction * range(random, 1.0, 9.0),
        errors,
        rear_errors,
        follower: chance(random, 0.95).then_some(follower),
        margin_m: 0.05,
        raises: chance(random, 0.2),
    }
}

impl TwoSidedLoop {
    /// Returns a closed loop at random; its state may be outside S.
    pub(crate) fn random(seed: u64, is_exact: bool) -> Self {
        Self::random_with_gaps(seed, is_exact, GAPS_M.map(f64::ln))
    }

    /// Returns a closed loop at random with initial gaps between two values, whose logarithms are given.
    pub(crate) fn random_with_gaps(seed: u64, is_exact: bool, ln_gaps: [f64; 2]) -> Self {
        let mut source = Xoshiro256PlusPlus::seed_from_u64(seed);
        let random = &mut source;
        let params = random_params(random, is_exact);
        let speed_mps = range(random, 0.0, 35.0);
        let mut near = || {
            let change = if chance(random, 0.6) {
                0.0
            } else {
                range(random, -6.0, 6.0)
            };
            (speed_mps + change).max(0.0)
        };
        let [ahead_mps, rear_mps] = [near(), near()];
        let mut gap_m = || (range(random, ln_gaps[0], ln_gaps[1])).exp();
        let [gap_m, rear_gap_m] = [gap_m(), gap_m()];
        let mut closed_loop = Self {
            params,
            gap_m,
            ahead_mps,
            speed_mps,
            rear_gap_m,
            rear_mps,
            controller: [
                Reckless::FullThrottle,
                Reckless::FullBrake,
                Reckless::Random,
                Reckless::RandomHeld,
                Reckless::BangBang(random.random_range(1..200)),
            ][random.random_range(0..5)],
            leader: [(0.0, 0); LEADER_PIECES],
            leader_brake_mps2: params.level_mps2,
            drift_share: [Some(-1.0), Some(1.0), Some(0.0), None][random.random_range(0..4)],
            drift_steps: random.random_range(1..300),
            reaction_steps: 0,
            brake_factor: if chance(random, 0.7) {
                1.0
            } else {
                range(random, 1.0, 2.0)
            },
            error_share: [Some(-1.0), Some(1.0), None][random.random_range(0..3)],
            noise_share: [Some(-1.0), Some(1.0), None][random.random_range(0..3)],
            seed,
        };
        closed_loop.leader = closed_loop.random_leader(random);
        let reaction_s = params.follower.map_or(0.0, |class| class.reaction_s);
        let most = (reaction_s / params.step_s + 1e-9) as usize;
        closed_loop.reaction_steps = if chance(random, 0.8) {
            most
        } else {
            random.random_range(0..=most)
        };
        closed_loop
    }

    fn random_leader(&self, random: &mut Xoshiro256PlusPlus) -> [(f64, usize); LEADER_PIECES] {
        let brake_mps2 = self.leader_brake_mps2;
        let kind = random.random_range(0..3);
        std::array::from_fn(|index| {
            let steps = (range(random, 0.0, 4.0) / self.params.step_s) as usize;
            let accel_mps2 = match kind {
                // Waits, and brakes fully.
                0 => [0.0, -brake_mps2][index.min(1)],
                // Bang-bang.
                1 => pick(random, [-brake_mps2, -brake_mps2, 3.0]),
                _ => range(random, -brake_mps2, 3.0),
            };
            (accel_mps2, steps)
        })
    }

    /// Returns the closed loop with another leader, near this one.
    pub(crate) fn with_changed_leader(&self, random: &mut Xoshiro256PlusPlus) -> Self {
        let mut changed = self.clone();
        let index = random.random_range(0..LEADER_PIECES);
        let brake_mps2 = self.leader_brake_mps2;
        let (accel_mps2, steps) = &mut changed.leader[index];
        if chance(random, 0.5) {
            *accel_mps2 = pick(random, [-brake_mps2, 0.0, 3.0, -0.5 * brake_mps2]);
        } else {
            *steps = (range(random, 0.0, 4.0) / self.params.step_s) as usize;
        }
        changed
    }

    /// Simulates two steps, and executes another command than that of the filter in the first. Returns for each whether
    /// the state is in S by a [`LevelMeter`] without a plan of the step before, and whether the filter has a plan at
    /// that level.
    pub(crate) fn first_steps(&self) -> [[bool; 2]; 2] {
        let mut simulation = LoopSimulation::new(self);
        // One for each step, because a meter also tries its last plan, which the filter does not know.
        let mut meters = [0, 1].map(|_| LevelMeter::new(self.params));
        let keep_mps2 = self.params.level_mps2;
        [0, 1].map(|step| {
            let observation = simulation.observation();
            meters
                .iter_mut()
                .for_each(|meter| meter.observe(&observation));
            let is_in_set = meters[step].keeps(keep_mps2);
            let wanted_mps2 = simulation.wanted_mps2(step);
            let decided_mps2 = simulation.decide(&observation, wanted_mps2);
            let level_mps2 = simulation.filter.level_mps2();
            let executed_mps2 = 0.5 * decided_mps2;
            simulation.filter.record_command(executed_mps2);
            meters
                .iter_mut()
                .for_each(|meter| meter.record_command(executed_mps2));
            simulation.advance(step, executed_mps2, &mut LoopResult::default());
            [
                is_in_set,
                level_mps2.is_some_and(|level| level >= keep_mps2),
            ]
        })
    }

    /// Simulates as [`Self::run`] does, and returns the times of the filter's steps by a clock, in its unit.
    pub(crate) fn run_timed(&self, clock: fn() -> u64) -> (LoopResult, Vec<u64>) {
        let mut simulation = LoopSimulation::new(self);
        simulation.clock = Some(clock);
        simulation.run()
    }

    /// Simulates until all stand, or a collision.
    pub(crate) fn run(&self) -> LoopResult {
        LoopSimulation::new(self).run().0
    }
}

struct LoopSimulation<'l> {
    setup: &'l TwoSidedLoop,
    random: Xoshiro256PlusPlus,
    filter: TwoSidedFilter,
    /// Leader, ego vehicle, follower.
    vehicles: [Motion; 3],
    pending_mps2: std::collections::VecDeque<f64>,
    response_mps2: f64,
    /// Steps since the trigger of the follower.
    triggered: Option<usize>,
    held_mps2: f64,
    clock: Option<fn() -> u64>,
    times: Vec<u64>,
}

impl<'l> LoopSimulation<'l> {
    fn new(setup: &'l TwoSidedLoop) -> Self {
        let motion = |position_m: f64, speed_mps: f64| Motion {
            position_m,
            speed_mps,
            acceleration_mps2: 0.0,
        };
        Self {
            setup,
            random: Xoshiro256PlusPlus::seed_from_u64(setup.seed ^ 0x5eed),
            filter: TwoSidedFilter::new(setup.params),
            vehicles: [
                motion(setup.gap_m, setup.ahead_mps),
                motion(0.0, setup.speed_mps),
                motion(-setup.rear_gap_m, setup.rear_mps),
            ],
            pending_mps2: vec![0.0; setup.params.delay_steps].into(),
            response_mps2: 0.0,
            triggered: None,
            held_mps2: 0.0,
            clock: None,
            times: Vec::new(),
        }
    }

    fn decide(&mut self, observation: &Observation, wanted_mps2: f64) -> f64 {
        let begin = self.clock.map(|clock| clock());
        let command_mps2 = self.filter.decide(observation, wanted_mps2);
        if let (Some(clock), Some(begin)) = (self.clock, begin) {
            self.times.push(clock() - begin);
        }
        command_mps2
    }

    fn error(&mut self, bound: f64) -> f64 {
        let share = self
            .setup
            .error_share
            .unwrap_or_else(|| range(&mut self.random, -1.0, 1.0));
        0.999 * share * bound
    }

    fn observation(&mut self) -> Observation {
        let [leader, own, rear] = self.vehicles;
        let TwoSidedParams {
            errors,
            rear_errors,
            ..
        } = self.setup.params;
        let behind = self.setup.params.follower.is_some();
        let [gap, speed, ahead, rear_gap, rear_speed] = [
            errors.gap_m,
            errors.speed_mps,
            errors.ahead_speed_mps,
            rear_errors.gap_m,
            rear_errors.speed_mps,
        ]
        .map(|bound| self.error(bound));
        Observation {
            speed_mps: (own.speed_mps + speed).max(0.0),
            acceleration_mps2: own.acceleration_mps2,
            ahead: Some(Neighbour {
                gap_m: leader.position_m - own.position_m + gap,
                speed_mps: (leader.speed_mps + ahead).max(0.0),
                acceleration_mps2: leader.acceleration_mps2,
            }),
            behind: behind.then_some(Neighbour {
                gap_m: own.position_m - rear.position_m - rear_gap,
                speed_mps: (rear.speed_mps + rear_speed).max(0.0),
                acceleration_mps2: rear.acceleration_mps2,
            }),
        }
    }

    fn wanted_mps2(&mut self, step: usize) -> f64 {
        let TwoSidedParams {
            brake_mps2,
            accel_mps2,
            step_s,
            ..
        } = self.setup.params;
        let random_mps2 = range(&mut self.random, -brake_mps2, accel_mps2);
        match self.setup.controller {
            Reckless::FullThrottle => accel_mps2,
            Reckless::FullBrake => -brake_mps2,
            Reckless::Random => random_mps2,
            Reckless::RandomHeld => {
                if step.is_multiple_of((0.5 / step_s) as usize) {
                    self.held_mps2 = random_mps2;
                }
                self.held_mps2
            }
            Reckless::BangBang(steps) => [-brake_mps2, accel_mps2][step / steps % 2],
        }
    }

    fn leader_mps2(&self, step: usize) -> f64 {
        let mut until = 0;
        for (accel_mps2, steps) in self.setup.leader {
            until += steps;
            if step < until {
                return accel_mps2;
            }
        }
        -self.setup.leader_brake_mps2
    }

    /// Returns the follower's acceleration in this step, whose own acceleration is known, from its acceleration before
    /// the trigger. It observes the true state.
    fn follower_mps2(&mut self, drift_mps2: f64) -> f64 {
        let Some(class) = self.setup.params.follower else {
            return 0.0;
        };
        let [_, own, rear] = self.vehicles;
        match class.trigger {
            FollowerTrigger::TimeToCollision(ttc_s) => {
                let gap_m = own.position_m - rear.position_m;
                if self.triggered.is_none()
                    && gap_m - ttc_s * (rear.speed_mps - own.speed_mps) < 0.0
                {
                    self.triggered = Some(0);
                }
            }
            FollowerTrigger::LeaderBrakes => {
                let stands =
                    own.speed_mps == 0.0 && own.after(self.setup.params.step_s).speed_mps == 0.0;
                let is_noticed = own.acceleration_mps2 <= -NOTICED_BRAKE_MPS2 || stands;
                self.triggered = is_noticed.then_some(self.triggered.unwrap_or(0));
            }
        }
        match self.triggered {
            Some(steps) if steps >= self.setup.reaction_steps => {
                -self.setup.brake_factor * class.brake_mps2
            }
            _ => drift_mps2,
        }
    }

    fn drift_mps2(&mut self, step: usize) -> f64 {
        match self.setup.params.follower {
            Some(class) => class.drift_mps2 * self.drift_share(step),
            None => 0.0,
        }
    }

    fn drift_share(&mut self, step: usize) -> f64 {
        match self.setup.drift_share {
            Some(share) if self.setup.drift_steps > 150 => share,
            Some(share) => share * [1.0, -1.0][step / self.setup.drift_steps % 2],
            None => range(&mut self.random, -1.0, 1.0),
        }
    }

    /// Returns the own acceleration in this step.
    fn own_mps2(&mut self, command_mps2: f64) -> f64 {
        let params = self.setup.params;
        self.pending_mps2.push_back(command_mps2);
        let due_mps2 = self.pending_mps2.pop_front().unwrap_or(command_mps2);
        // The vehicle cannot accelerate beyond its limit.
        let due_mps2 = due_mps2.min(params.accel_mps2);
        self.response_mps2 += params.response_fraction * (due_mps2 - self.response_mps2);
        let share = self
            .setup
            .noise_share
            .unwrap_or_else(|| range(&mut self.random, -1.0, 1.0));
        let noisy_mps2 = self.response_mps2 + share * params.noise_mps2;
        if self.vehicles[1].speed_mps == 0.0 && (self.response_mps2 <= 0.0 || noisy_mps2 < 0.0) {
            0.0
        } else {
            noisy_mps2
        }
    }

    fn run(mut self) -> (LoopResult, Vec<u64>) {
        let keep_mps2 = self.setup.params.level_mps2;
        let mut result = LoopResult::default();
        for step in 0..MAX_STEPS {
            let observation = self.observation();
            if step == 0 {
                // The selection must not depend on the filter that it tests.
                result.is_in_set = keeps_level(self.setup.params, &observation);
                if !result.is_in_set {
                    return (result, self.times);
                }
            }
            let wanted_mps2 = self.wanted_mps2(step);
            let command_mps2 = self.decide(&observation, wanted_mps2);
            let level_mps2 = self.filter.level_mps2();
            result.left_set |= level_mps2.is_none_or(|level| level < keep_mps2);
            result.replaced += usize::from(command_mps2 != wanted_mps2);
            result.steps += 1;
            self.advance(step, command_mps2, &mut result);
            let all_stand = self.vehicles.iter().all(|vehicle| vehicle.speed_mps == 0.0);
            if result.has_collision() || all_stand && step > MAX_STEPS / 10 {
                break;
            }
        }
        (result, self.times)
    }

    fn advance(&mut self, step: usize, command_mps2: f64, result: &mut LoopResult) {
        let step_s = self.setup.params.step_s;
        let drift_mps2 = self.drift_mps2(step);
        self.vehicles[0].acceleration_mps2 = self.leader_mps2(step);
        self.vehicles[1].acceleration_mps2 = self.own_mps2(command_mps2);
        // A follower that watches the ego vehicle's braking sees it in the step in which it begins.
        self.vehicles[2].acceleration_mps2 = self.follower_mps2(drift_mps2);
        let [leader, own, rear] = self.vehicles;
        result.min_gaps_m[0] = result.min_gaps_m[0].min(closest_gap_m(leader, own, 0.0, step_s));
        let is_covered = own.speed_mps > 0.0 || rear.speed_mps >= CREEP_SPEED_MPS;
        if self.setup.params.follower.is_some() && is_covered {
            result.min_gaps_m[1] = result.min_gaps_m[1].min(closest_gap_m(own, rear, 0.0, step_s));
        }
        self.vehicles = self.vehicles.map(|vehicle| vehicle.after(step_s));
        self.triggered = self.triggered.map(|steps| steps + 1);
    }
}

/// True if a plan exists from the first observation on at the level to keep.
pub(crate) fn keeps_level(params: TwoSidedParams, first: &Observation) -> bool {
    let mut meter = LevelMeter::new(params);
    meter.observe(first);
    meter.keeps(params.level_mps2)
}
