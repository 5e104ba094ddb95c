//! Nobody touches: the stated profile is replayed over the whole box.
//!
//! Leader and egos move as [`motion`](crate::motion) says. The follower fires at an instant that may differ from member to
//! member of the box. Before it has fired it coasts, so whether it fires at instant k if it has not before is decided by
//!
//! ```text
//! guard = (x_k - L - r_k) - θ (v_r - v_k),   r_k = r_0 + v_r k h,
//! ```
//!
//! and once the guard is surely negative every member has fired. As firing later never moves the follower back, no member's
//! follower is ahead of one that fires at that instant, and it is this one that the last ego is compared with.
//!
//! Between two instants a gap g satisfies g'' ≤ m, where m is the most that the vehicle ahead accelerates (at least 0, as it
//! may stop) less the least that the one behind does (at most 0). Then g(t) ≥ chord(t) - m t (h - t) / 2, hence
//!
//! ```text
//! g ≥ min(g at begin, g at end) - m h² / 8   throughout the step.
//! ```
//!
//! The profile is accepted if this is positive for every pair in every step.
//!
//! # After the last instant
//! The script and the profiles end, but the road does not ([`Afterwards`]). Let g be the gaps and v the speeds at the last instant,
//! and b the limit of an ego's brake, or the brake of a follower that has fired and whose reaction is over. In a frame that moves with
//! a speed u >= 0, whoever brakes to u and holds it covers (v - u)² / (2 b); if that is less than the gap ahead, it stays behind where the
//! vehicle ahead was. So nobody touches if that vehicle never falls back in this frame. With u = 0 nobody falls back, for nobody reverses:
//! it does not matter what the leader does. With u the least of the speeds of leader and egos, no ego falls back that brakes to u at most, nor
//! a leader that does not brake. A follower that has not fired may do so later, and then falls back; it must not be faster than u.

use crate::certificate::AvoidableClaim;
use crate::claim::Scene;
use crate::interval::Interval;
use crate::motion::{distance_and_speed_after, expand_pieces};
use crate::work::{OPS_PER_INTERVAL_OP, OpBudget};
use crate::{ProvedClaim, Rejection, SafetyAfterHorizon};

/// Operations for one step of one vehicle.
const OPS_PER_STEP: u64 = 20 * OPS_PER_INTERVAL_OP;

pub(crate) fn check(claim: &AvoidableClaim, work: &OpBudget) -> Result<ProvedClaim, Rejection> {
    claim.scene.check()?;
    work.charge_or_reject(claim.scene.instant_count() * claim.scene.vehicle_count() * OPS_PER_STEP)?;
    check_profiles(claim)?;
    let (smallest_gap_m, afterwards) = replay(claim)?;
    let stated_m = claim.min_gap_m_at_least.unwrap_or(0.0);
    if smallest_gap_m >= stated_m {
        Ok(ProvedClaim::Avoidable {
            min_gap_m: smallest_gap_m,
            horizon_s: claim.scene.horizon_s(),
            after_horizon: afterwards,
        })
    } else {
        Err(Rejection::GapTooSmall { stated_m, min_gap_m: smallest_gap_m })
    }
}

fn check_profiles(AvoidableClaim { scene, witness, .. }: &AvoidableClaim) -> Result<(), Rejection> {
    if witness.len() != scene.egos.len() {
        return Err(Rejection::invalid("witness", "must hold one profile for each ego"));
    }
    for (index, (profile, ego)) in witness.iter().zip(&scene.egos).enumerate() {
        scene.check_profile_length(profile, || format!("witness[{index}]"))?;
        let is_able = |a: f64| -ego.max_brake_mps2 <= a && a <= ego.max_accel_mps2;
        if let Some(piece) = profile.iter().position(|held| !is_able(held.1)) {
            return Err(Rejection::invalid(
                format!("witness[{index}][{piece}]"),
                "is beyond what the ego is able to do",
            ));
        }
    }
    Ok(())
}

/// A lower bound of every gap at every time, in metres, and what holds from the last instant on.
fn replay(AvoidableClaim { scene, witness, .. }: &AvoidableClaim) -> Result<(f64, SafetyAfterHorizon), Rejection> {
    let profiles: Vec<Vec<Interval>> = std::iter::once(expand_pieces(&scene.leader.acceleration_mps2).collect())
        .chain(witness.iter().map(|profile| expand_pieces(profile).map(Interval::point).collect()))
        .collect();
    let mut line: Vec<(Interval, Interval)> = std::iter::once((scene.leader.position_m, scene.leader.speed_mps))
        .chain(scene.egos.iter().map(|ego| (ego.position_m, ego.speed_mps)))
        .collect();
    let step_s = Interval::point(scene.step_s);
    let eighth = step_s.sqr() * Interval::point(0.125);
    let mut fires = scene.steps;
    let mut smallest_m = f64::INFINITY;
    let mut before = gaps_m(scene, &line, fires, 0);
    for k in 0..scene.steps {
        if fires == scene.steps && must_fire(scene, &line, k) {
            fires = k;
        }
        let mut accelerations: Vec<Interval> = profiles.iter().map(|profile| profile[k as usize]).collect();
        for ((x, v), &a) in line.iter_mut().zip(&accelerations) {
            let (covered_m, speed_mps) = distance_and_speed_after(*v, a, step_s);
            (*x, *v) = (*x + covered_m, speed_mps);
        }
        accelerations.extend(scene.follower.as_ref().map(|follower| -follower.brake_mps2));
        let now = gaps_m(scene, &line, fires, k + 1);
        for (front, (begin, end)) in before.iter().zip(&now).enumerate() {
            let (ahead, behind) =
                (accelerations[front].max(Interval::ZERO), accelerations[front + 1].min(Interval::ZERO));
            let gap_m = (begin.min(*end) - (ahead - behind) * eighth).low();
            if gap_m > 0.0 {
                smallest_m = smallest_m.min(gap_m);
            } else {
                return Err(Rejection::MayCollide { front_vehicle: front, step: k, gap_m });
            }
        }
        before = now;
    }
    Ok((smallest_m, safety_after_horizon(scene, &line, fires, &before)))
}

/// What holds from the last instant on, with the positions and speeds of leader and egos and the gaps there.
fn safety_after_horizon(
    scene: &Scene,
    line: &[(Interval, Interval)],
    fires: u32,
    gaps_m: &[Interval],
) -> SafetyAfterHorizon {
    // None moves more slowly as long as nobody brakes below it.
    let slowest = Interval::point(line.iter().map(|(_, v)| v.low()).fold(f64::INFINITY, f64::min));
    let followed = scene.follower.as_ref().map(|follower| {
        // The last instant means never.
        let brakes = fires < scene.steps && fires.saturating_add(follower.reaction_steps) <= scene.steps;
        let brake_mps2 = if brakes { follower.brake_mps2 } else { Interval::ZERO };
        (scene.follower_speed_mps(follower, fires, scene.steps), brake_mps2)
    });
    let egos = scene.egos.iter().zip(line.iter().skip(1));
    let behind = egos.map(|(ego, (_, v))| (*v, Interval::point(ego.max_brake_mps2))).chain(followed);
    let behind: Vec<_> = behind.zip(gaps_m).collect();
    let keep_off = |to_mps: Interval| {
        behind.iter().all(|&((v, brake_mps2), &gap_m)| {
            let too_fast_mps = v - to_mps;
            let covered_m = too_fast_mps.sqr().over(brake_mps2 + brake_mps2);
            too_fast_mps.high() <= 0.0 || (covered_m - gap_m).high() < 0.0
        })
    };
    if keep_off(Interval::ZERO) {
        SafetyAfterHorizon::ForAnyLeader
    } else if keep_off(slowest) {
        SafetyAfterHorizon::UnlessLeaderBrakes
    } else {
        SafetyAfterHorizon::Unproved
    }
}

/// The gaps at instant `k`, front to rear, the last one to a follower that fires at `fires`.
fn gaps_m(scene: &Scene, line: &[(Interval, Interval)], fires: u32, k: u32) -> Vec<Interval> {
    let lengths_m = std::iter::once(scene.leader.length_m).chain(scene.egos.iter().map(|ego| ego.length_m));
    let rears = line.iter().zip(lengths_m).map(|((x, _), length_m)| *x - Interval::point(length_m));
    let follower = scene.follower.as_ref().map(|follower| scene.follower_position_m(follower, fires, k));
    let fronts = line.iter().skip(1).map(|(x, _)| *x).chain(follower);
    rears.zip(fronts).map(|(rear, front)| rear - front).collect()
}

/// Whether at instant `k` the guard is negative in every member in which it was not before.
fn must_fire(scene: &Scene, line: &[(Interval, Interval)], k: u32) -> bool {
    let (Some(follower), Some(ego), Some((x, v))) = (&scene.follower, scene.egos.last(), line.last()) else {
        return false;
    };
    let gap = *x - Interval::point(ego.length_m) - scene.follower_position_m(follower, scene.steps, k);
    (gap - Interval::point(follower.ttc_s) * (follower.speed_mps - *v)).high() < 0.0
}
