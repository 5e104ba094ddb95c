//! Model of a scenario for the convex programs.
//!
//! All quantities are displacements from coasting: with d(t) = ∫∫a and w(t) = ∫a, an ego that starts at x₀ with v₀ has
//! position x₀ + v₀ t + d and speed v₀ + w. The rest of each row is a constant, the *slack*.

use crumple_verify::claim::MAX_EGOS;
use crumple_verify::{Interval, SceneEgo, SceneFollower};

use super::reason::UndecidedReason;
use super::scripted_leader::ScriptedLeader;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Driver, Scenario, VehicleSpec};

/// A leader, one or more egos, perhaps a follower, and a time grid.
#[derive(Debug, Clone)]
pub(super) struct AvoidanceProblem {
    pub(super) step_s: f64,
    pub(super) steps: usize,
    pub(super) leader: ScriptedLeader,
    pub(super) egos: Vec<SceneEgo>,
    /// Steps at the start before the first command of each ego has an effect.
    pub(super) dead_steps: Vec<usize>,
    /// Vehicle behind the egos with a latched emergency brake, as in a certificate.
    pub(super) follower: Option<SceneFollower>,
    /// Reason why an escape of the model may not be one; a replay decides if possible.
    pub(super) escape_caveat: Option<UndecidedReason>,
    /// Reason why a proof would not apply to this scenario.
    pub(super) proof_caveat: Option<UndecidedReason>,
}

impl AvoidanceProblem {
    /// Models a scenario.
    ///
    /// # Errors
    /// [`UndecidedReason`] if neither verdict can be reached.
    pub(super) fn new(scenario: &Scenario) -> Result<Self, UndecidedReason> {
        if !scenario.has_only_point_masses() {
            return Err(UndecidedReason::Plant);
        }
        let last_ego = last_ego(scenario)?;
        let behind = BehindEgos::new(scenario, last_ego + 1);
        Ok(Self {
            step_s: scenario.spec().step_s,
            steps: scenario.steps(),
            leader: ScriptedLeader::new(scenario),
            egos: (1..=last_ego)
                .map(|index| scene_ego(scenario, index))
                .collect(),
            dead_steps: (1..=last_ego)
                .map(|index| delay_steps(scenario, &scenario.vehicles()[index]))
                .collect(),
            follower: behind.follower,
            escape_caveat: ego_response_caveat(scenario, last_ego).or(behind.escape_caveat),
            proof_caveat: ego_proof_caveat(scenario, last_ego).or(behind.proof_caveat),
        })
    }

    pub(super) fn time_s(&self, step: usize) -> f64 {
        step as f64 * self.step_s
    }

    /// Returns the number of firings of the follower's brake: one per step, and never.
    pub(super) fn firing_count(&self) -> usize {
        if self.follower.is_some() {
            self.steps + 1
        } else {
            1
        }
    }

    pub(super) fn never_firing(&self) -> usize {
        if self.follower.is_some() {
            self.steps
        } else {
            0
        }
    }

    /// Returns the first step from which the leader stands; the number of steps if never.
    pub(super) fn leader_standstill_step(&self) -> usize {
        self.leader.standstill_step
    }

    /// Returns the first step at which the leader stands, and the first command, of full braking, has stopped each ego.
    pub(super) fn all_may_stand_step(&self) -> usize {
        let egos = self.egos.iter().zip(&self.dead_steps);
        let stopped = egos.map(|(ego, dead_steps)| {
            let braking_s = ego.speed_mps.high() / ego.max_brake_mps2;
            ((braking_s / self.step_s).ceil() as usize).saturating_add(*dead_steps)
        });
        let stopped = stopped.max().unwrap_or(0);
        stopped.clamp(self.leader_standstill_step(), self.steps)
    }

    /// Returns the first step from which the follower stands; the number of steps if never, 0 without a follower.
    pub(super) fn follower_standstill_step(&self, firing: usize) -> usize {
        self.follower.as_ref().map_or(0, |follower| {
            let braking_s = follower.speed_mps.high() / follower.brake_mps2.low();
            let rests = (firing + follower.reaction_steps as usize) as f64
                + (braking_s / self.step_s).ceil();
            if rests < self.steps as f64 {
                rests as usize
            } else {
                self.steps
            }
        })
    }

    /// Returns the bound on d of the first ego: its slack to the leader's rear bumper, in metres.
    pub(super) fn front_slack_m(&self, step: usize) -> f64 {
        let (Some(ego), Some(rear_m)) = (self.egos.first(), self.leader.rear_m.get(step)) else {
            return f64::NAN;
        };
        rear_m - self.coasting_m(ego.position_m, ego.speed_mps, step)
    }

    /// Returns the position of a coasting vehicle, in metres.
    fn coasting_m(&self, position_m: Interval, speed_mps: Interval, step: usize) -> f64 {
        position_m.low() + speed_mps.low() * self.time_s(step)
    }

    /// Returns the slack between ego `ahead` and the next one if both coast, in metres.
    pub(super) fn pair_slack_m(&self, ahead: usize, step: usize) -> f64 {
        let (Some(front), Some(rear)) = (self.egos.get(ahead), self.egos.get(ahead + 1)) else {
            return f64::NAN;
        };
        let front_m = self.coasting_m(front.position_m, front.speed_mps, step);
        front_m - front.length_m - self.coasting_m(rear.position_m, rear.speed_mps, step)
    }

    /// Returns the slack between the coasting last ego and a follower whose brake fires at `firing`, in metres.
    pub(super) fn rear_slack_m(&self, firing: usize, step: usize) -> f64 {
        let (Some(ego), Some(follower)) = (self.egos.last(), &self.follower) else {
            return f64::NAN;
        };
        self.coasting_m(ego.position_m, ego.speed_mps, step)
            - ego.length_m
            - self.follower_front_m(follower, firing, step)
    }

    /// Returns the front bumper of a follower that coasts until `firing` and the reaction time, then brakes, in metres.
    fn follower_front_m(&self, follower: &SceneFollower, firing: usize, step: usize) -> f64 {
        let brakes_from = (firing + follower.reaction_steps as usize).min(step);
        let v = follower.speed_mps.low();
        let brake_mps2 = follower.brake_mps2.low();
        let coasting_s = self.time_s(brakes_from);
        let braking_s = ((step - brakes_from) as f64 * self.step_s).min(v / brake_mps2);
        follower.position_m.low() + v * coasting_s + (v - 0.5 * brake_mps2 * braking_s) * braking_s
    }

    /// Returns the bound on d + θ w of the last ego for the guard to have fired by step `firing`.
    pub(super) fn fired_slack_m(&self, firing: usize) -> f64 {
        let (Some(ego), Some(follower)) = (self.egos.last(), &self.follower) else {
            return f64::NAN;
        };
        let theta = follower.ttc_s;
        let own_m = self.coasting_m(ego.position_m, ego.speed_mps, firing);
        let rear_m = self.coasting_m(follower.position_m, follower.speed_mps, firing);
        // -(gap - θ (closing speed)) if all vehicles coast.
        -(own_m - ego.length_m - rear_m - theta * (follower.speed_mps.low() - ego.speed_mps.low()))
    }

    /// Returns the bound on -w of an ego: its initial speed, in m/s.
    pub(super) fn speed_slack_mps(&self, ego: usize) -> f64 {
        self.egos
            .get(ego)
            .map_or(f64::NAN, |ego| ego.speed_mps.low())
    }

    /// Returns the smallest initial gap, in metres: an upper bound for every escape.
    pub(super) fn initial_gap_m(&self) -> f64 {
        let pairs = (0..self.egos.len().saturating_sub(1)).map(|ahead| self.pair_slack_m(ahead, 0));
        let rear = self.follower.iter().map(|_| self.rear_slack_m(0, 0));
        pairs.chain(rear).fold(self.front_slack_m(0), f64::min)
    }
}

/// Model of the vehicles behind the last ego.
#[derive(Default)]
struct BehindEgos {
    follower: Option<SceneFollower>,
    escape_caveat: Option<UndecidedReason>,
    proof_caveat: Option<UndecidedReason>,
}

impl BehindEgos {
    /// Models the vehicle at `index` as a follower with an emergency brake, if it has one and if there is one.
    fn new(scenario: &Scenario, index: usize) -> Self {
        let mut model = Self::default();
        let Some(vehicle) = scenario.vehicles().get(index) else {
            return model;
        };
        match &vehicle.driver {
            Driver::Controller(BuiltInController::Baseline(aeb)) if !has_lag(vehicle) => {
                let reaction_steps = delay_steps(scenario, vehicle);
                model.proof_caveat = (vehicle.acceleration_noise_mps2 > 0.0)
                    .then_some(UndecidedReason::Noise { vehicle: index });
                model.follower = Some(SceneFollower {
                    position_m: Interval::point(vehicle.position_m),
                    speed_mps: Interval::point(vehicle.speed_mps),
                    brake_mps2: Interval::point(scenario.usable_brake_mps2(index)),
                    ttc_s: aeb.ttc_s,
                    reaction_steps: u32::try_from(reaction_steps).unwrap_or(u32::MAX),
                });
            }
            // A proof remains possible: a collision ahead of this vehicle does not depend on its behaviour.
            driver => {
                model.escape_caveat = Some(UndecidedReason::Follower {
                    vehicle: index,
                    driver: driver.name().into(),
                });
            }
        }
        if index + 1 < scenario.vehicles().len() {
            model
                .escape_caveat
                .get_or_insert(UndecidedReason::BehindFollower { vehicle: index + 1 });
        }
        model
    }
}

fn scene_ego(scenario: &Scenario, index: usize) -> SceneEgo {
    let vehicle = &scenario.vehicles()[index];
    SceneEgo {
        position_m: Interval::point(vehicle.position_m),
        speed_mps: Interval::point(vehicle.speed_mps),
        length_m: vehicle.length_m(),
        max_brake_mps2: scenario.usable_brake_mps2(index),
        max_accel_mps2: vehicle.max_accel_mps2(),
    }
}

fn has_lag(vehicle: &VehicleSpec) -> bool {
    !vehicle.response().is_full_at_once()
}

/// Returns the egos, which are behind the leader, and their indices.
fn egos(scenario: &Scenario, last_ego: usize) -> impl Iterator<Item = (usize, &VehicleSpec)> {
    scenario
        .vehicles()
        .iter()
        .enumerate()
        .take(last_ego + 1)
        .skip(1)
}

/// Returns the first ego whose lag the model ignores, as a reason.
fn ego_response_caveat(scenario: &Scenario, last_ego: usize) -> Option<UndecidedReason> {
    egos(scenario, last_ego)
        .find(|(_, vehicle)| has_lag(vehicle))
        .map(|(vehicle, _)| UndecidedReason::EgoResponse { vehicle })
}

/// Returns the reason why the egos alone prevent a proof: noise, or their number.
fn ego_proof_caveat(scenario: &Scenario, last_ego: usize) -> Option<UndecidedReason> {
    let noise = egos(scenario, last_ego)
        .find(|(_, vehicle)| vehicle.acceleration_noise_mps2 > 0.0)
        .map(|(vehicle, _)| UndecidedReason::Noise { vehicle });
    let number = (last_ego > MAX_EGOS).then_some(UndecidedReason::TooManyVehicles {
        egos: last_ego,
        most: MAX_EGOS,
    });
    noise.or(number)
}

/// Returns the index of the last of the vehicles under test behind a scripted leader.
fn last_ego(scenario: &Scenario) -> Result<usize, UndecidedReason> {
    let vehicles = scenario.vehicles();
    if !scenario.keeps_lanes() {
        return Err(UndecidedReason::LaneChanges);
    }
    if !vehicles
        .first()
        .is_some_and(|leader| matches!(leader.driver, Driver::Profile(_)))
    {
        return Err(UndecidedReason::Leader);
    }
    let egos = vehicles
        .iter()
        .skip(1)
        .take_while(|vehicle| vehicle.driver == Driver::UnderTest)
        .count();
    let all_under_test = vehicles
        .iter()
        .filter(|vehicle| vehicle.driver == Driver::UnderTest);
    if egos == 0 || all_under_test.count() > egos {
        return Err(UndecidedReason::NoEgo);
    }
    Ok(egos)
}

/// Returns reaction and actuator delay in steps, as in the simulation.
pub(super) fn delay_steps(scenario: &Scenario, vehicle: &VehicleSpec) -> usize {
    ((vehicle.response().delay_s / scenario.spec().step_s).round() as usize).min(scenario.steps())
}
