//! Forged invariant sets, and attacks from their states. An accepted set with a collision is a forgery.

use crumple_sim::control::{BuiltInController, ControllerSource, Ego};
use crumple_sim::observation::{Neighbour, Observation};
use crumple_verify::invariant::table::HeightTable;
use crumple_verify::{InvariantClaim, ProvedClaim, Statement};
use rand::rngs::Xoshiro256PlusPlus;
use rand::{RngExt, SeedableRng};

use super::{ForgedCertificate, GenuineCertificate, change_statement};

const STEP_S: f64 = 0.01;
/// Times within a decision interval at which the leader of an attack changes its acceleration.
const PARTS: u32 = 4;
/// Attacks on the boundary of an accepted set.
const ATTACKS: u32 = 20;

/// Returns the claim of a statement about an invariant set.
pub(crate) fn set_claim(statement: &mut Statement) -> &mut InvariantClaim {
    let Statement::Invariant(claim) = statement else {
        panic!("a set")
    };
    claim
}

impl GenuineCertificate {
    /// Changes one thing of an invariant set at random.
    pub(crate) fn with_changed_set(&self, random: &mut Xoshiro256PlusPlus) -> ForgedCertificate {
        let forged = change_statement(&self.certificate, |statement| {
            change_set(set_claim(statement), random);
        });
        ForgedCertificate {
            change: "another set".to_owned(),
            text: forged.to_canonical_json(),
            policy: self.policy.clone(),
        }
    }
}

fn change_set(claim: &mut InvariantClaim, random: &mut Xoshiro256PlusPlus) {
    let run = random.random_range(0..claim.heights.len());
    match random.random_range(0..10_u32) {
        0 => claim.heights[run].1 -= random.random_range(1..200_i64),
        1 => {
            // One node falls.
            let by = random.random_range(1..400_i64);
            claim.heights[run].1 -= by;
            if let Some(next) = claim.heights.get_mut(run + 1) {
                next.1 += by;
            }
        }
        2 => claim.leader_mps2[0] *= random.random_range(1.0..1.5),
        3 => claim.own_mps2[0] *= random.random_range(1.0..1.5),
        4 => claim.share_at_least += random.random_range(1e-9..0.1),
        5 => claim.min_gap_m_at_least += random.random_range(1e-6..0.1),
        6 => {
            claim.ends_beyond_gap_m = Some(claim.region_gap_m + random.random_range(-1.0..20.0));
        }
        7 => claim.splits = random.random_range(0..3),
        8 => claim.axes[random.random_range(0..2_usize)].high *= random.random_range(1.0..1.2),
        _ => {
            claim.observation_error[random.random_range(0..3_usize)] +=
                random.random_range(0.01..0.5);
        }
    }
}

/// Returns true if no attack refutes an accepted claim about a set of the genuine controller, `idm`, and its share is
/// near that of the genuine set.
pub(super) fn is_true(
    claimed: &InvariantClaim,
    accepted: &ProvedClaim,
    genuine: &ProvedClaim,
) -> bool {
    let ProvedClaim::Invariant { share: proved, .. } = accepted else {
        return false;
    };
    let ProvedClaim::Invariant { share, .. } = genuine else {
        return false;
    };
    let table = HeightTable::from_runs(claimed.axes, &claimed.heights).expect("an accepted table");
    let smallest = attack_boundary(&table, claimed.region_own_mps[1], ATTACKS);
    *proved >= claimed.share_at_least
        && *proved < share + 0.05
        && smallest >= claimed.min_gap_m_at_least
}

/// Drives `idm` behind a random or hard-braking leader, and returns the smallest gap, with the exact motion between
/// decisions.
fn attack(
    [mut gap, mut own, mut leader]: [f64; 3],
    most_mps: f64,
    random: &mut Xoshiro256PlusPlus,
) -> f64 {
    let ego = Ego {
        vehicle: 1,
        max_brake_mps2: 7.5,
        max_accel_mps2: 3.0,
        length_m: 5.0,
        step_s: STEP_S,
    };
    let mut controller = BuiltInController::from_name("idm")
        .unwrap()
        .start(&ego, 0)
        .unwrap();
    // Accelerate for a random time, then brake, with a random part of random pieces.
    let (brakes_at, is_random) = (random.random_range(0..300_u32), random.random_bool(0.3));
    let mut smallest = gap;
    let advance = |speed: f64, acceleration: f64, time: f64| {
        let end = (speed + acceleration * time).max(0.0);
        let covered = if speed + acceleration * time >= 0.0 {
            (speed + end) * 0.5 * time
        } else {
            speed * speed / (-2.0 * acceleration)
        };
        (covered, end)
    };
    for step in 0..1500_u32 {
        let ahead = Some(Neighbour {
            gap_m: gap,
            speed_mps: leader,
            acceleration_mps2: 0.0,
        });
        let seen = Observation {
            speed_mps: own,
            acceleration_mps2: 0.0,
            ahead,
            behind: None,
        };
        let command = controller.decide(&seen).unwrap().clamp(-7.5, 3.0);
        for _ in 0..PARTS {
            let part = STEP_S / f64::from(PARTS);
            let wish = match (is_random, step < brakes_at) {
                (true, true) => random.random_range(-7.5..3.0),
                (false, true) => 3.0,
                (_, false) => -7.5,
            };
            // The leader never exceeds its largest speed.
            let acceleration = f64::min(wish, (most_mps - leader) / part);
            let ((own_m, own_later), (leader_m, leader_later)) = (
                advance(own, command, part),
                advance(leader, acceleration, part),
            );
            gap += leader_m - own_m;
            (own, leader, smallest) = (own_later, leader_later, smallest.min(gap));
        }
    }
    smallest
}

/// Attacks states at the boundary, and a little above, and returns the smallest gap of all.
pub(crate) fn attack_boundary(table: &HeightTable, mps: f64, attacks: u32) -> f64 {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(59);
    let mut smallest = f64::INFINITY;
    for _ in 0..attacks {
        let (own, leader) = (random.random_range(0.0..mps), random.random_range(0.0..mps));
        let height = table.height_at([own, leader]).expect("in the table");
        let gap = height
            + if random.random_bool(0.5) {
                0.0
            } else {
                random.random_range(0.0..5.0)
            };
        smallest = smallest.min(attack([gap, own, leader], mps, &mut random));
    }
    smallest
}
