//! What of a scenario (or of a box of scenarios) the convex programs know.
//!
//! Everything is written for displacements from coasting: with d(t) = ∫∫a and w(t) = ∫a of an ego that starts at x₀ with
//! v₀, its position is x₀ + v₀ t + d and its speed v₀ + w. Whatever does not depend on the ego's choice is then one number
//! a row, the *slack*; over a box of scenarios the slack has an upper bound, which proofs use ([`Side::Loose`]), and a
//! lower bound, which escapes use ([`Side::Tight`]).

use crumple_verify::Interval;
use crumple_verify::claim::MOST_EGOS;

use super::family::Family;
use super::reason::Reason;
use crate::scenario::{ControllerSpec, Driver, LeadProfile, Scenario, VehicleClass, VehicleSpec};
use crate::sim::{Keep, Motion, Run, RunOptions, simulate};

/// Which bound of the slacks over the box.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// The upper one: what no scenario of the box exceeds.
    Loose,
    /// The lower one: what every scenario of the box has.
    Tight,
}

impl Side {
    fn of(self, low: f64, high: f64) -> f64 {
        match self {
            Self::Loose => high,
            Self::Tight => low,
        }
    }
}

/// The leader: scripted, so known.
#[derive(Debug, Clone)]
pub(super) struct Leader {
    pub(super) position_m: Interval,
    pub(super) speed_mps: Interval,
    pub(super) length_m: f64,
    /// Held over each step.
    pub(super) acceleration_mps2: Vec<Interval>,
    /// Rear bumper at each instant.
    rear_m: Vec<Interval>,
    rests_from: usize,
}

/// A vehicle that chooses its acceleration.
#[derive(Debug, Clone)]
pub(super) struct Ego {
    pub(super) position_m: Interval,
    pub(super) speed_mps: Interval,
    pub(super) length_m: f64,
    /// On this road.
    pub(super) max_brake_mps2: f64,
    pub(super) max_accel_mps2: f64,
    /// Steps at the start over which nothing it commands has an effect yet.
    pub(super) dead_steps: usize,
}

/// The vehicle behind the egos, driven by the latched emergency brake.
#[derive(Debug, Clone)]
pub(super) struct Follower {
    pub(super) position_m: Interval,
    pub(super) speed_mps: Interval,
    /// On this road.
    pub(super) brake_mps2: Interval,
    pub(super) ttc_s: f64,
    pub(super) reaction_steps: usize,
}

/// A leader, one or more egos, perhaps a follower, and a time grid.
#[derive(Debug, Clone)]
pub(super) struct Situation {
    pub(super) step_s: f64,
    pub(super) steps: usize,
    pub(super) leader: Leader,
    pub(super) egos: Vec<Ego>,
    pub(super) follower: Option<Follower>,
    /// Whether it stands for more than one scenario.
    pub(super) is_box: bool,
    /// Why an escape that was found may be none; the replay decides where it can.
    pub(super) escape_caveat: Option<Reason>,
    /// Why a proof would not be about this scenario.
    pub(super) proof_caveat: Option<Reason>,
}

impl Situation {
    /// Reads a scenario, or a box of them.
    ///
    /// # Errors
    /// The [`Reason`] why neither verdict can be reached.
    pub(super) fn new(family: &Family) -> Result<Self, Reason> {
        let [low, high] = family.ends();
        let vehicles = low.vehicles();
        let last_ego = last_ego(low)?;
        if !family.is_point()
            && let Some(vehicle) = vehicles.iter().position(|v| v.acceleration_noise_mps2 > 0.0)
        {
            return Err(Reason::Noise { vehicle });
        }
        let spans = |of: fn(&VehicleSpec) -> f64, index: usize| {
            let of = |scenario: &Scenario| scenario.vehicles().get(index).map_or(0.0, of);
            between(of(low), of(high))
        };
        let ego = |index: usize| {
            let vehicle = &vehicles[index];
            Ego {
                position_m: spans(|v| v.position_m, index),
                speed_mps: spans(|v| v.speed_mps, index),
                length_m: vehicle.length_m(),
                max_brake_mps2: low.usable_brake_mps2(index),
                max_accel_mps2: vehicle.max_accel_mps2(),
                dead_steps: delay_steps(low, vehicle),
            }
        };
        let egos: Vec<Ego> = (1..=last_ego).map(ego).collect();
        let has_lag = |v: &VehicleSpec| v.actuator_lag_s > 0.0 || v.jerk_limit_mps3.is_some();
        let under_test = || (1..=last_ego).filter_map(|index| Some((index, vehicles.get(index)?)));
        let mut escape_caveat =
            under_test().find(|(_, v)| has_lag(v)).map(|(vehicle, _)| Reason::EgoResponse { vehicle });
        let mut proof_caveat =
            under_test().find(|(_, v)| v.acceleration_noise_mps2 > 0.0).map(|(vehicle, _)| Reason::Noise { vehicle });
        if last_ego > MOST_EGOS {
            proof_caveat.get_or_insert(Reason::TooManyVehicles { egos: last_ego, most: MOST_EGOS });
        }
        let behind = last_ego + 1;
        let mut follower = None;
        if let Some(vehicle) = vehicles.get(behind) {
            match &vehicle.driver {
                Driver::Controller(ControllerSpec::Baseline(aeb)) if !has_lag(vehicle) => {
                    if vehicle.acceleration_noise_mps2 > 0.0 {
                        proof_caveat.get_or_insert(Reason::Noise { vehicle: behind });
                    }
                    follower = Some(Follower {
                        position_m: spans(|v| v.position_m, behind),
                        speed_mps: spans(|v| v.speed_mps, behind),
                        brake_mps2: between(low.usable_brake_mps2(behind), high.usable_brake_mps2(behind)),
                        ttc_s: aeb.ttc_s,
                        reaction_steps: delay_steps(low, vehicle),
                    });
                }
                // Whatever it does, a collision among the vehicles ahead of it is one.
                driver => {
                    escape_caveat.get_or_insert(Reason::Follower { vehicle: behind, driver: driver.name() });
                }
            }
            if behind + 1 < vehicles.len() {
                escape_caveat.get_or_insert(Reason::BehindFollower { vehicle: behind + 1 });
            }
        }
        Ok(Self {
            step_s: low.spec().step_s,
            steps: low.steps(),
            leader: Leader::new(low, high),
            egos,
            follower,
            is_box: !family.is_point(),
            escape_caveat,
            proof_caveat,
        })
    }

    /// The instant of a step, in seconds.
    pub(super) fn time_s(&self, step: usize) -> f64 {
        step as f64 * self.step_s
    }

    /// The number of ways the follower's brake can fire: at each step, or never.
    pub(super) fn firings(&self) -> usize {
        if self.follower.is_some() { self.steps + 1 } else { 1 }
    }

    /// The firing that stands for never.
    pub(super) fn never(&self) -> usize {
        if self.follower.is_some() { self.steps } else { 0 }
    }

    /// The first step from which the leader stands for good, in every scenario of the box; the number of steps if it does not.
    pub(super) fn leader_rests_from(&self) -> usize {
        self.leader.rests_from
    }

    /// The same of a follower whose brake fires at `firing`.
    pub(super) fn follower_rests_from(&self, firing: usize) -> usize {
        self.follower.as_ref().map_or(0, |follower| {
            let braking_s = follower.speed_mps.high() / follower.brake_mps2.low();
            let rests = (firing + follower.reaction_steps) as f64 + (braking_s / self.step_s).ceil();
            if rests < self.steps as f64 { rests as usize } else { self.steps }
        })
    }

    /// Bound on d of the first ego behind the leader: its slack to the leader's rear bumper, in metres.
    pub(super) fn front_slack_m(&self, step: usize, side: Side) -> f64 {
        let (Some(ego), Some(rear)) = (self.egos.first(), self.leader.rear_m.get(step)) else { return f64::NAN };
        let t = self.time_s(step);
        let coast = |x: f64, v: f64| x + v * t;
        side.of(
            rear.low() - coast(ego.position_m.high(), ego.speed_mps.high()),
            rear.high() - coast(ego.position_m.low(), ego.speed_mps.low()),
        )
    }

    /// Slack between ego `ahead` and the one behind it if both coast, in metres.
    pub(super) fn pair_slack_m(&self, ahead: usize, step: usize, side: Side) -> f64 {
        let (Some(front), Some(rear)) = (self.egos.get(ahead), self.egos.get(ahead + 1)) else { return f64::NAN };
        let t = self.time_s(step);
        let gap = |f: (f64, f64), r: (f64, f64)| f.0 + f.1 * t - front.length_m - (r.0 + r.1 * t);
        side.of(
            gap((front.position_m.low(), front.speed_mps.low()), (rear.position_m.high(), rear.speed_mps.high())),
            gap((front.position_m.high(), front.speed_mps.high()), (rear.position_m.low(), rear.speed_mps.low())),
        )
    }

    /// Slack between the last ego, coasting, and a follower whose brake fires at `firing`, in metres.
    pub(super) fn rear_slack_m(&self, firing: usize, step: usize, side: Side) -> f64 {
        let (Some(ego), Some(follower)) = (self.egos.last(), &self.follower) else { return f64::NAN };
        let t = self.time_s(step);
        let bumper = |x: f64, v: f64| x + v * t - ego.length_m;
        side.of(
            bumper(ego.position_m.low(), ego.speed_mps.low()) - follower.position_m(self, firing, step, Side::Loose),
            bumper(ego.position_m.high(), ego.speed_mps.high()) - follower.position_m(self, firing, step, Side::Tight),
        )
    }

    /// Bound on d + θ w of the last ego at step `firing` for the guard to have fired there.
    pub(super) fn fired_slack_m(&self, firing: usize, side: Side) -> f64 {
        let (Some(ego), Some(follower)) = (self.egos.last(), &self.follower) else { return f64::NAN };
        let t = self.time_s(firing);
        let theta = follower.ttc_s;
        // - (gap - θ (closing speed)) with everybody coasting.
        let of = |x: f64, v: f64, r: f64, vr: f64| -(x + v * t - ego.length_m - (r + vr * t) - theta * (vr - v));
        side.of(
            of(ego.position_m.high(), ego.speed_mps.high(), follower.position_m.low(), follower.speed_mps.low()),
            of(ego.position_m.low(), ego.speed_mps.low(), follower.position_m.high(), follower.speed_mps.high()),
        )
    }

    /// Bound on -w of an ego: its speed at the start, in m/s.
    pub(super) fn speed_slack_mps(&self, ego: usize, side: Side) -> f64 {
        self.egos.get(ego).map_or(f64::NAN, |ego| side.of(ego.speed_mps.low(), ego.speed_mps.high()))
    }

    /// The smallest gap at the start, in metres: no escape has a larger smallest gap.
    pub(super) fn first_gap_m(&self, side: Side) -> f64 {
        let pairs = (0..self.egos.len().saturating_sub(1)).map(|ahead| self.pair_slack_m(ahead, 0, side));
        let rear = self.follower.iter().map(|_| self.rear_slack_m(0, 0, side));
        pairs.chain(rear).fold(self.front_slack_m(0, side), f64::min)
    }
}

impl Leader {
    fn new(low: &Scenario, high: &Scenario) -> Self {
        let (one, other) = (alone_mps2(low), alone_mps2(high));
        let hull = one.iter().zip(&other).map(|(&a, &b)| between(a, b));
        let driver = |scenario: &Scenario| scenario.vehicles().first().map(|leader| leader.driver.clone());
        let mut hardest = Interval::point(0.0);
        // Where rate or onset vary, the first to stand no longer says how hard the others brake: it did before.
        let acceleration_mps2: Vec<Interval> = if driver(low) == driver(high) {
            hull.collect()
        } else {
            hull.map(|span| {
                hardest = hardest.hull(Interval::point(span.low()));
                span.hull(Interval::point(hardest.low()))
            })
            .collect()
        };
        let first = |of: fn(&VehicleSpec) -> f64| {
            let of = |scenario: &Scenario| scenario.vehicles().first().map_or(0.0, of);
            between(of(low), of(high))
        };
        let length_m = low.vehicles().first().map_or(0.0, VehicleSpec::length_m);
        let (position_m, speed_mps) = (first(|v| v.position_m), first(|v| v.speed_mps));
        let drive = |pick: fn(Interval) -> f64| {
            let mut motion =
                Motion { position_m: pick(position_m), speed_mps: pick(speed_mps), acceleration_mps2: 0.0 };
            let mut rear_m = vec![motion.position_m - length_m];
            for span in &acceleration_mps2 {
                motion = Motion { acceleration_mps2: pick(*span), ..motion }.after(low.spec().step_s);
                rear_m.push(motion.position_m - length_m);
            }
            rear_m
        };
        let (rearmost, foremost) = (drive(Interval::low), drive(Interval::high));
        let rear_m: Vec<Interval> = rearmost.iter().zip(&foremost).map(|(&low, &high)| between(low, high)).collect();
        let moves = rear_m.windows(2).rposition(|pair| pair.first() != pair.last());
        let rests_from = moves.map_or(0, |step| step + 1);
        Self { position_m, speed_mps, length_m, acceleration_mps2, rear_m, rests_from }
    }
}

impl Follower {
    /// Front bumper at a step, in metres: coasting until `firing` and the reaction time, then braking to standstill.
    fn position_m(&self, situation: &Situation, firing: usize, step: usize, side: Side) -> f64 {
        let brakes_from = (firing + self.reaction_steps).min(step);
        let (x, v) = (
            side.of(self.position_m.low(), self.position_m.high()),
            side.of(self.speed_mps.low(), self.speed_mps.high()),
        );
        let brake_mps2 = side.of(self.brake_mps2.high(), self.brake_mps2.low());
        let coasting_s = situation.time_s(brakes_from);
        let braking_s = ((step - brakes_from) as f64 * situation.step_s).min(v / brake_mps2);
        x + v * coasting_s + (v - 0.5 * brake_mps2 * braking_s) * braking_s
    }
}

/// Everything between two numbers.
fn between(one: f64, other: f64) -> Interval {
    Interval::point(one).hull(Interval::point(other))
}

/// The last of the vehicles under test behind a scripted leader.
fn last_ego(scenario: &Scenario) -> Result<usize, Reason> {
    let vehicles = scenario.vehicles();
    if !vehicles.first().is_some_and(|leader| matches!(leader.driver, Driver::Profile(_))) {
        return Err(Reason::Leader);
    }
    let is_ego = |vehicle: &VehicleSpec| vehicle.driver == Driver::UnderTest;
    let egos = vehicles.iter().skip(1).take_while(|vehicle| is_ego(vehicle)).count();
    if egos == 0 || vehicles.iter().filter(|vehicle| is_ego(vehicle)).count() > egos {
        return Err(Reason::NoEgo);
    }
    Ok(egos)
}

/// Reaction and actuator delay in whole steps, as the simulation counts them.
fn delay_steps(scenario: &Scenario, vehicle: &VehicleSpec) -> usize {
    let delay_s = vehicle.reaction_delay_s + vehicle.actuator_delay_s;
    ((delay_s / scenario.spec().step_s).round() as usize).min(scenario.steps())
}

/// The acceleration of the scripted leader in each step, its noise included: it reacts to nobody, so it drives alone.
///
/// Without noise it is what the script asks for, also of a leader that stands: in a box another one may still be moving. A
/// script asks the faster of two vehicles for no more acceleration than the slower, so whatever starts between the ends of
/// a box is asked for something between.
fn alone_mps2(scenario: &Scenario) -> Vec<f64> {
    let Some(leader) = scenario.vehicles().first() else { return Vec::new() };
    let Driver::Profile(profile) = &leader.driver else { return Vec::new() };
    if leader.acceleration_noise_mps2 > 0.0 {
        return simulated_mps2(scenario);
    }
    let step_s = scenario.spec().step_s;
    let mut motion = Motion { position_m: 0.0, speed_mps: leader.speed_mps, acceleration_mps2: 0.0 };
    let of_step = |step: usize| {
        let asked = profile.acceleration_mps2(step as f64 * step_s, (step + 1) as f64 * step_s, motion.speed_mps);
        let acceleration_mps2 = asked.max(-scenario.usable_brake_mps2(0)).min(leader.max_accel_mps2());
        motion = Motion { acceleration_mps2, ..motion }.after(step_s);
        acceleration_mps2
    };
    (0..scenario.steps()).map(of_step).collect()
}

/// The same by simulation.
fn simulated_mps2(scenario: &Scenario) -> Vec<f64> {
    let alone = scenario.edited(|spec| {
        spec.vehicles.truncate(2);
        if let Some(other) = spec.vehicles.get_mut(1) {
            // Far behind and standing.
            *other = VehicleSpec::new(VehicleClass::Light, -1e6, 0.0, Driver::Profile(LeadProfile::ConstantSpeed));
        }
    });
    let Ok(alone) = alone else { return Vec::new() };
    let Ok(run) = Run::new(&alone, RunOptions::new(ControllerSpec::MatchLeader)) else { return Vec::new() };
    let trace = simulate(&run, Keep::Trace).trace;
    let leader = trace.and_then(|trace| trace.vehicles.into_iter().next());
    leader.map_or(Vec::new(), |track| track.acceleration_mps2.into_iter().take(scenario.steps()).collect())
}
