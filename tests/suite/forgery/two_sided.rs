//! Forged certificates of two-sided shields, and attacks on their claims. An accepted claim with a collision is a
//! forgery.

use crumple_evidence::{filter_certificate, initial_state_certificate};
use crumple_sim::control::{
    BuiltInController, ErrorBounds, FollowerClass as SimulatedClass,
    FollowerTrigger as SimulatedTrigger, RearErrorBounds, TwoSidedParams, TwoSidedSettings,
};
use crumple_sim::engine::{Motion, Run, RunOptions, closest_gap_m};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Scenario, built_in_scenario};
use crumple_verify::two_sided::{
    CREEP_SPEED_MPS, CoveredFollowers, FollowerCue, KnownPhase, NOTICED_BRAKE_MPS2,
    ObservedNeighbour, TwoSidedStart,
};
use crumple_verify::{Statement, TwoSidedClaim};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};
use rayon::prelude::*;

use super::closed_loop::TwoSidedLoop;
use super::{ForgedCertificate, GenuineCertificate, change_statement};

/// Attacks on each accepted claim about a plan, and about a filter, which plans at each step.
const PLAN_ATTACKS: u64 = 60;
const FILTER_ATTACKS: u64 = 2;

/// Longest attack, in steps.
const MAX_STEPS: usize = 3000;

/// Pieces of a random motion of the leader.
const LEADER_PIECES: usize = 6;

fn initial_state(scenario: &Scenario, settings: &str) -> GenuineCertificate {
    let idm = BuiltInController::from_name("idm").expect("built in");
    let options = RunOptions::new(idm).with_estimator(EstimatorKind::Truth);
    let run = Run::new(scenario, options).expect("a run");
    let settings = TwoSidedSettings::parse(settings).expect("settings");
    let certificate = initial_state_certificate(&run, 1, &settings).expect("a plan");
    GenuineCertificate::new(certificate, None, None)
}

/// Returns certificates of plans of each kind, and of a filter.
pub(crate) fn certificates() -> Vec<GenuineCertificate> {
    let paper = built_in_scenario("paper-1").expect("built in");
    let near = paper
        .edited(|spec| spec.vehicles[2].speed_mps += 4.0)
        .expect("valid");
    let noisy = paper
        .edited(|spec| {
            spec.vehicles[1].acceleration_noise_mps2 = 0.01;
            spec.vehicles[1].actuator_delay_s = 0.05;
        })
        .expect("valid");
    let errors = ",level=2,gap-error=0.2,behind-gap-error=0.2,behind-speed-error=0.3";
    let mut all: Vec<_> = [
        (&paper, ",level=3"),
        (&near, ",level=2"),
        (&noisy, ",level=2"),
        (&paper, ",level=2,reacts=0.5"),
        (&paper, errors),
    ]
    .into_iter()
    .map(|(scenario, settings)| initial_state(scenario, settings))
    .collect();
    let idm = BuiltInController::from_name("idm").expect("built in");
    let options = RunOptions::new(idm).with_estimator(EstimatorKind::Truth);
    let run = Run::new(&paper, options).expect("a run");
    let params = run
        .two_sided_shield(1, &TwoSidedSettings::default())
        .expect("covered");
    let filter = filter_certificate(&params).expect("accepted");
    all.push(GenuineCertificate::new(filter, None, None));
    all
}

/// Returns true if no attack refutes an accepted claim.
pub(super) fn is_true(claim: &TwoSidedClaim) -> bool {
    let attacks = if claim.start.is_some() {
        PLAN_ATTACKS
    } else {
        FILTER_ATTACKS
    };
    (0..attacks).all(|seed| {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        match &claim.start {
            Some(start) => !PlanAttack::new(claim, start, &mut random).collides(&mut random),
            None => filter_survives(claim, &mut random),
        }
    })
}

/// Simulates a closed loop of a filter with the constants of a claim.
fn filter_survives(claim: &TwoSidedClaim, random: &mut Xoshiro256PlusPlus) -> bool {
    let mut closed_loop = TwoSidedLoop::random(random.random(), true);
    let (ego, errors) = (&claim.ego, &claim.observation_error);
    // The tests of a plan would take too long with shorter steps.
    if !(0.005..=0.2).contains(&ego.step_s) || ego.delay_steps > 100 {
        return true;
    }
    closed_loop.params = TwoSidedParams {
        step_s: ego.step_s,
        brake_mps2: ego.brake_mps2,
        accel_mps2: ego.accel_mps2,
        noise_mps2: ego.noise_mps2,
        delay_steps: ego.delay_steps as usize,
        response_fraction: 1.0,
        level_mps2: claim.leader_brakes_at_most_mps2,
        errors: ErrorBounds {
            gap_m: errors.gap_ahead_m,
            speed_mps: errors.ego_speed_mps,
            ahead_speed_mps: errors.leader_speed_mps,
        },
        rear_errors: RearErrorBounds {
            gap_m: errors.gap_behind_m,
            speed_mps: errors.follower_speed_mps,
        },
        follower: claim.follower.map(simulated_class),
        ..closed_loop.params
    };
    // The leader of the loop was drawn for another level.
    closed_loop.leader_brake_mps2 = claim.leader_brakes_at_most_mps2;
    for (accel_mps2, _) in &mut closed_loop.leader {
        *accel_mps2 = accel_mps2.max(-claim.leader_brakes_at_most_mps2);
    }
    let reaction_s = claim.follower.map_or(0.0, |class| class.reaction_s);
    closed_loop.reaction_steps = (reaction_s / ego.step_s + 1e-9) as usize;
    let result = closed_loop.run();
    !result.is_in_set || !result.has_collision()
}

fn simulated_class(class: CoveredFollowers) -> SimulatedClass {
    SimulatedClass {
        trigger: match class.brakes_when {
            FollowerCue::TtcBelowS(ttc_s) => SimulatedTrigger::TimeToCollision(ttc_s),
            FollowerCue::EgoBrakes => SimulatedTrigger::LeaderBrakes,
        },
        reaction_s: class.reaction_s,
        brake_mps2: class.brake_mps2,
        drift_mps2: class.drift_mps2,
    }
}

fn extreme(random: &mut Xoshiro256PlusPlus) -> f64 {
    match random.random_range(0..4_u32) {
        0 => random.random_range(-1.0..1.0),
        1 => -1.0,
        _ => 1.0,
    }
}

/// One run of a plan, simulated without code of the planner or the checker.
struct PlanAttack<'c> {
    claim: &'c TwoSidedClaim,
    start: &'c TwoSidedStart,
    commands: Vec<f64>,
    /// Leader, ego vehicle, follower.
    vehicles: [Motion; 3],
    leader: [(f64, usize); LEADER_PIECES],
    drift_share: Option<f64>,
    noise_share: Option<f64>,
    /// Time since the event that makes the follower brake.
    since_event_s: Option<f64>,
    brake_factor: f64,
}

impl<'c> PlanAttack<'c> {
    fn new(
        claim: &'c TwoSidedClaim,
        start: &'c TwoSidedStart,
        random: &mut Xoshiro256PlusPlus,
    ) -> Self {
        let errors = &claim.observation_error;
        let mut true_state = |at: Option<ObservedNeighbour>, [gap, speed]: [f64; 2]| {
            let at = at.unwrap_or(ObservedNeighbour {
                gap_m: 1e6,
                speed_mps: 0.0,
            });
            (
                at.gap_m - gap * extreme(random),
                (at.speed_mps + speed * extreme(random)).max(0.0),
            )
        };
        let (ahead_m, ahead_mps) =
            true_state(start.leader, [errors.gap_ahead_m, errors.leader_speed_mps]);
        let (behind_m, behind_mps) = true_state(
            start.follower,
            [errors.gap_behind_m, errors.follower_speed_mps],
        );
        let own_mps = (start.ego_speed_mps + errors.ego_speed_mps * extreme(random)).max(0.0);
        let motion = |position_m: f64, speed_mps: f64| Motion {
            position_m,
            speed_mps,
            acceleration_mps2: 0.0,
        };
        let reaction_s = claim.follower.map_or(0.0, |class| class.reaction_s);
        let commands = &start.plan.commands;
        Self {
            claim,
            start,
            commands: commands
                .iter()
                .flat_map(|piece| std::iter::repeat_n(piece.1, piece.0 as usize))
                .take(MAX_STEPS)
                .collect(),
            vehicles: [
                motion(ahead_m, ahead_mps),
                motion(0.0, own_mps),
                motion(-behind_m, behind_mps),
            ],
            leader: Self::random_leader(claim, random),
            drift_share: [Some(-1.0), Some(1.0), Some(0.0), None][random.random_range(0..4)],
            noise_share: [Some(-1.0), Some(1.0), None][random.random_range(0..3)],
            since_event_s: match start.phase {
                KnownPhase::BrakesWithinS(left_s) => Some(reaction_s - left_s),
                KnownPhase::Unknown if random.random() => Some(0.0),
                _ => None,
            },
            brake_factor: if random.random() {
                1.0
            } else {
                random.random_range(1.0..2.0)
            },
        }
    }

    fn random_leader(
        claim: &TwoSidedClaim,
        random: &mut Xoshiro256PlusPlus,
    ) -> [(f64, usize); LEADER_PIECES] {
        let limit_mps2 = claim.leader_brakes_at_most_mps2;
        let brakes_at_once = random.random::<f64>() < 0.4;
        std::array::from_fn(|_| {
            if brakes_at_once {
                return (-limit_mps2, MAX_STEPS);
            }
            let accel_mps2 = [-limit_mps2, -0.5 * limit_mps2, 0.0, 3.0][random.random_range(0..4)];
            let steps = random.random_range(0.0..3.0) / claim.ego.step_s;
            (accel_mps2, steps as usize)
        })
    }

    fn leader_mps2(&self, step: usize) -> f64 {
        let mut until = 0_usize;
        for (accel_mps2, steps) in self.leader {
            until = until.saturating_add(steps);
            if step < until {
                return accel_mps2;
            }
        }
        -self.claim.leader_brakes_at_most_mps2
    }

    /// True if the follower's brake fires now by its time to collision.
    fn fires(&self, ttc_s: f64) -> bool {
        let [_, own, follower] = self.vehicles;
        let gap_m = own.position_m - follower.position_m;
        gap_m < ttc_s * (follower.speed_mps - own.speed_mps)
    }

    /// Returns true if vehicles collide.
    fn collides(mut self, random: &mut Xoshiro256PlusPlus) -> bool {
        let mut fired_at = None;
        for step in 0..MAX_STEPS {
            if let Some(FollowerCue::TtcBelowS(ttc_s)) =
                self.claim.follower.map(|class| class.brakes_when)
                && self.since_event_s.is_none()
                && self.fires(ttc_s)
            {
                if step == 0 && self.start.phase == KnownPhase::Waiting {
                    // The claim assumes that the brake has not fired.
                    return false;
                }
                fired_at = Some(step);
                self.since_event_s = Some(0.0);
            }
            let command = self.command(step, fired_at);
            if self.advance(step, command, random) {
                return true;
            }
            if self.vehicles[1].speed_mps == 0.0
                && self.vehicles[2].speed_mps == 0.0
                && step > MAX_STEPS / 2
            {
                return false;
            }
        }
        false
    }

    fn command(&self, step: usize, fired_at: Option<usize>) -> f64 {
        let full_mps2 = -self.claim.ego.brake_mps2;
        let first = self.commands.get(step).copied().unwrap_or(full_mps2);
        let (Some(after), Some(fired)) = (&self.start.plan.after_firing, fired_at) else {
            return first;
        };
        let Some(since) = step.checked_sub(fired + self.claim.ego.delay_steps as usize) else {
            return first;
        };
        let mut listed = 0_u64;
        let entry = after.steps.iter().find(|piece| {
            listed += u64::from(piece.0);
            fired as u64 <= listed
        });
        let steps = entry.or(after.steps.last()).map_or(0, |piece| piece.1);
        if since < steps as usize {
            after.accel_mps2
        } else {
            full_mps2
        }
    }

    fn advance(&mut self, step: usize, command: f64, random: &mut Xoshiro256PlusPlus) -> bool {
        let ego = &self.claim.ego;
        let noise = ego.noise_mps2
            * self
                .noise_share
                .unwrap_or_else(|| random.random_range(-1.0..1.0));
        let own = &mut self.vehicles[1];
        own.acceleration_mps2 = if own.speed_mps == 0.0 && (command <= 0.0 || command + noise < 0.0)
        {
            0.0
        } else {
            command + noise
        };
        self.vehicles[0].acceleration_mps2 = self.leader_mps2(step);
        if let Some(FollowerCue::EgoBrakes) = self.claim.follower.map(|class| class.brakes_when) {
            let own = self.vehicles[1];
            let stands = own.speed_mps == 0.0 && own.after(ego.step_s).speed_mps == 0.0;
            let is_noticed = own.acceleration_mps2 <= -NOTICED_BRAKE_MPS2 || stands;
            self.since_event_s = is_noticed.then_some(self.since_event_s.unwrap_or(0.0));
        }
        let drift_share = self
            .drift_share
            .unwrap_or_else(|| random.random_range(-1.0..1.0));
        let coasts_s = match (self.claim.follower, self.since_event_s) {
            (Some(class), Some(since_s)) => (class.reaction_s - since_s).min(ego.step_s).max(0.0),
            _ => ego.step_s,
        };
        let drift_mps2 = self
            .claim
            .follower
            .map_or(0.0, |class| drift_share * class.drift_mps2);
        let brake_mps2 = self
            .claim
            .follower
            .map_or(0.0, |class| -self.brake_factor * class.brake_mps2);
        let step_s = ego.step_s;
        let collides =
            self.advance_by(coasts_s, drift_mps2) || self.advance_by(step_s - coasts_s, brake_mps2);
        self.since_event_s = self.since_event_s.map(|since_s| since_s + step_s);
        collides
    }

    fn advance_by(&mut self, time_s: f64, follower_mps2: f64) -> bool {
        if time_s <= 0.0 {
            return false;
        }
        self.vehicles[2].acceleration_mps2 = follower_mps2;
        let [leader, own, follower] = self.vehicles;
        let hits_leader =
            self.start.leader.is_some() && closest_gap_m(leader, own, 0.0, time_s) <= 0.0;
        let is_covered = own.speed_mps > 0.0 || follower.speed_mps >= CREEP_SPEED_MPS;
        let is_hit = self.start.follower.is_some()
            && is_covered
            && closest_gap_m(own, follower, 0.0, time_s) <= 0.0;
        self.vehicles = self.vehicles.map(|vehicle| vehicle.after(time_s));
        hits_leader || is_hit
    }
}

/// Returns the claim of a statement about a two-sided shield.
fn two_sided_claim(statement: &mut Statement) -> &mut TwoSidedClaim {
    let Statement::TwoSided(claim) = statement else {
        panic!("a two-sided claim")
    };
    claim
}

impl GenuineCertificate {
    /// Changes numbers of a two-sided claim at random, towards a stronger claim.
    fn with_stronger_claim(&self, random: &mut Xoshiro256PlusPlus) -> ForgedCertificate {
        let forged = change_statement(&self.certificate, |statement| {
            let claim = two_sided_claim(statement);
            for _ in 0..random.random_range(1..3_u32) {
                strengthen(claim, random);
            }
        });
        ForgedCertificate {
            change: "another claim".to_owned(),
            text: forged.to_canonical_json(),
            policy: None,
        }
    }
}

fn strengthen(claim: &mut TwoSidedClaim, random: &mut Xoshiro256PlusPlus) {
    let much = random.random_range(0.0..1.0_f64).powi(2);
    let Some(start) = &mut claim.start else {
        claim.leader_brakes_at_most_mps2 *= 1.0 + much;
        return;
    };
    match (
        random.random_range(0..13_u32),
        &mut claim.follower,
        &mut start.plan.after_firing,
    ) {
        (0, _, _) => claim.leader_brakes_at_most_mps2 *= 1.0 + much,
        (1, Some(class), _) => class.brake_mps2 *= 1.0 - 0.5 * much,
        (2, Some(class), _) => class.reaction_s += much,
        (3, Some(class), _) => class.drift_mps2 += much,
        (4, _, _) => claim.ego.noise_mps2 += 0.3 * much,
        (5, _, _) => {
            if let Some(leader) = &mut start.leader {
                leader.gap_m *= 1.0 - much;
            }
        }
        (6, _, _) => {
            if let Some(follower) = &mut start.follower {
                follower.gap_m *= 1.0 - much;
            }
        }
        (7, _, _) => start.ego_speed_mps *= 1.0 + 0.3 * much,
        (8, _, _) => {
            if let Some(follower) = &mut start.follower {
                follower.speed_mps *= 1.0 + 0.3 * much;
            }
        }
        (9, _, Some(after)) => after
            .steps
            .iter_mut()
            .for_each(|piece| piece.1 += (40.0 * much) as u32),
        (10, _, Some(after)) => after.accel_mps2 += much,
        (11, _, _) => {
            if let Some(piece) = start.plan.commands.first_mut() {
                piece.1 *= 1.0 - much;
            }
        }
        _ => claim.observation_error.gap_ahead_m += much,
    }
}

/// Result of the check and of the attacks.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum AttackOutcome {
    Accepted,
    Rejected,
    RejectedAndRefuted,
}

/// Forges a certificate, checks it, and attacks its claim; `None` if it is no longer a claim of this kind.
fn attacked(genuine: &[GenuineCertificate], index: u64) -> Option<AttackOutcome> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(index);
    let origin = &genuine[index as usize % genuine.len()];
    let forged = if index.is_multiple_of(4) {
        origin.forge(genuine, &mut random)
    } else {
        origin.with_stronger_claim(&mut random)
    };
    let accepted = super::accepted_claim(&forged);
    let is_accepted = accepted.is_some();
    let claimed = match accepted {
        Some((certificate, _)) => certificate,
        None => crumple_verify::Certificate::from_json(&forged.text).ok()?,
    };
    let Statement::TwoSided(claim) = claimed.statement else {
        return None;
    };
    let holds = is_true(&claim);
    assert!(
        holds || !is_accepted,
        "{index}: {}: {}",
        forged.change,
        forged.text
    );
    Some(match (is_accepted, holds) {
        (true, _) => AttackOutcome::Accepted,
        (false, true) => AttackOutcome::Rejected,
        (false, false) => AttackOutcome::RejectedAndRefuted,
    })
}

/// Forges `FORGERIES` certificates, and attacks each claim that the checker accepts. The attacks also refute many of
/// the rejected claims, which shows that they are strong.
#[test]
fn no_attack_refutes_an_accepted_claim() {
    let wanted = super::forgery_count();
    let genuine = certificates();
    let counts = (0..wanted)
        .into_par_iter()
        .filter_map(|index| attacked(&genuine, index))
        .map(|outcome| std::array::from_fn(|which| u64::from(which == outcome as usize)))
        .reduce(
            || [0_u64; 3],
            |sum, one| std::array::from_fn(|which| sum[which] + one[which]),
        );
    let [accepted, rejected, refuted] = counts;
    println!(
        "{wanted} forged: {accepted} accepted, {rejected} rejected, {refuted} rejected and refuted by an attack"
    );
    assert!(
        accepted > wanted / 50 && refuted > wanted / 20,
        "{counts:?}"
    );
}
