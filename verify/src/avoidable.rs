//! Proof of avoidability: the stated profile is replayed over the whole box.
//!
//! Leader and egos move as [`motion`](crate::motion) states. The follower's firing instant may differ between members
//! of the box. Before firing it coasts, so it fires at instant k, if not before, exactly if
//!
//! ```text
//! guard = (x_k - L - r_k) - θ (v_r - v_k),   r_k = r_0 + v_r k h,
//! ```
//!
//! is negative. Once the guard is surely negative every member has fired. Firing later never moves the follower back.
//! So no member's follower is ahead of one that fires at that instant, and the last ego is compared with this one.
//!
//! Between two instants a gap g satisfies g'' ≤ m. Here m is the largest acceleration of the vehicle ahead (at least 0,
//! as it may stop) less the smallest of the one behind (at most 0). Then g(t) ≥ chord(t) - m t (h - t) / 2, hence
//!
//! ```text
//! g ≥ min(g at begin, g at end) - m h² / 8   throughout the step.
//! ```
//!
//! The profile is accepted if this is positive for every pair in every step.
//!
//! # After the last instant
//! The claim may extend beyond the profile ([`SafetyAfterHorizon`]). Let g be the gaps and v the speeds at the last
//! instant, and b the brake limit of an ego, or the brake of a follower whose reaction is over. In a frame that moves
//! with a speed u >= 0, a vehicle that brakes to u and holds it covers (v - u)² / (2 b). If that is less than its gap,
//! it stays behind the initial position of the vehicle ahead. So no collision occurs if that vehicle never falls back
//! in this frame.
//!
//! With u = 0 no vehicle falls back, because none reverses, whatever the leader does. With u the least speed of leader
//! and egos, no ego that brakes to u at most falls back, nor does a leader that does not brake. A follower that has not
//! fired may fire later and fall back; its speed must not exceed u.

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::claim::{ConstantPiece, MAX_EGOS, Scene, SceneFollower};
use crate::interval::Interval;
use crate::motion::{distance_and_speed_after, expand_pieces};
use crate::rejection::Rejection;
use crate::scope::Scope;
use crate::work::OPS_PER_INTERVAL_OP;
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

const OPS_PER_STEP: u64 = 20 * OPS_PER_INTERVAL_OP;

/// A profile that avoids a collision.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AvoidableClaim {
    /// Scene of the claim.
    pub scene: Scene,
    /// Acceleration of each ego over each of the N steps, in m/s².
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_EGOS, _, _>")]
    pub witness: Vec<Vec<ConstantPiece<f64>>>,
    /// Optional claim: lower bound of all gaps, in metres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub min_gap_m_at_least: Option<f64>,
}

/// Safety after a stated profile has ended without a collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SafetyAfterHorizon {
    /// Every vehicle behind the leader can stop within the gap ahead: safe for any leader.
    ForAnyLeader,
    /// Every vehicle behind the leader can slow down to the slowest ahead: safe if the leader brakes no more.
    UnlessLeaderBrakes,
    /// Nothing is shown.
    Unproved,
}

impl SafetyAfterHorizon {
    /// Returns the name in results.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::ForAnyLeader => "whatever-the-leader-does",
            Self::UnlessLeaderBrakes => "if-the-leader-does-not-brake",
            Self::Unproved => "not-shown",
        }
    }
}

impl std::fmt::Display for SafetyAfterHorizon {
    fn fmt(&self, formatter: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        formatter.write_str(match self {
            Self::ForAnyLeader => {
                "and a collision remains avoidable afterwards, whatever the leader does"
            }
            Self::UnlessLeaderBrakes => {
                "and a collision remains avoidable afterwards, if the leader does not brake again"
            }
            Self::Unproved => "nothing is proved about the time afterwards",
        })
    }
}

impl Claim for AvoidableClaim {
    fn name(&self) -> &'static str {
        "avoidable"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::Scene {
            scene: &self.scene,
            profile: Some(&self.witness),
        }
    }

    fn assumptions(&self) -> Vec<Assumption> {
        self.scene.assumptions(Assumption::EgoOnProfile)
    }

    fn scope(&self) -> Scope {
        Scope {
            covers_after_horizon: true,
            ..self.scene.scope()
        }
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        self.scene.check()?;
        input.work.charge_or_reject(
            self.scene.instant_count() * self.scene.vehicle_count() * OPS_PER_STEP,
        )?;
        check_profiles(self)?;
        let EscapeReplay {
            smallest_gap_m,
            after_horizon,
        } = replay(self)?;
        let stated_m = self.min_gap_m_at_least.unwrap_or(0.0);
        if smallest_gap_m >= stated_m {
            Ok(ProvedClaim::Avoidable {
                min_gap_m: smallest_gap_m,
                horizon_s: self.scene.horizon_s(),
                after_horizon,
            })
        } else {
            Err(Rejection::GapTooSmall {
                stated_m,
                min_gap_m: smallest_gap_m,
            })
        }
    }
}

fn check_profiles(AvoidableClaim { scene, witness, .. }: &AvoidableClaim) -> Result<(), Rejection> {
    if witness.len() != scene.egos.len() {
        return Err(Rejection::invalid(
            "witness",
            "must have one profile for each ego vehicle",
        ));
    }
    for (index, (profile, ego)) in witness.iter().zip(&scene.egos).enumerate() {
        scene.check_profile_length(profile, || format!("witness[{index}]"))?;
        let limits = -ego.max_brake_mps2..=ego.max_accel_mps2;
        if let Some(piece) = profile.iter().position(|piece| !limits.contains(&piece.1)) {
            return Err(Rejection::invalid(
                format!("witness[{index}][{piece}]"),
                "exceeds the limits of the ego vehicle",
            ));
        }
    }
    Ok(())
}

/// Result of the simulation of an escape.
struct EscapeReplay {
    /// Lower bound of all gaps at all times, in metres.
    smallest_gap_m: f64,
    after_horizon: SafetyAfterHorizon,
}

fn replay(
    AvoidableClaim { scene, witness, .. }: &AvoidableClaim,
) -> Result<EscapeReplay, Rejection> {
    let profiles: Vec<Vec<Interval>> =
        std::iter::once(expand_pieces(&scene.leader.acceleration_mps2).collect())
            .chain(
                witness
                    .iter()
                    .map(|profile| expand_pieces(profile).map(Interval::point).collect()),
            )
            .collect();
    let mut line: Vec<(Interval, Interval)> =
        std::iter::once((scene.leader.position_m, scene.leader.speed_mps))
            .chain(scene.egos.iter().map(|ego| (ego.position_m, ego.speed_mps)))
            .collect();
    let step_s = Interval::point(scene.step_s);
    let eighth = step_s.sqr() * Interval::point(0.125);
    let mut fires = scene.steps;
    let mut smallest_gap_m = f64::INFINITY;
    let mut before = gaps_m(scene, &line, fires, 0);
    for k in 0..scene.steps {
        if fires == scene.steps && must_fire(scene, &line, k) {
            fires = k;
        }
        let mut accelerations: Vec<Interval> =
            profiles.iter().map(|profile| profile[k as usize]).collect();
        for ((x, v), &a) in line.iter_mut().zip(&accelerations) {
            let (covered_m, speed_mps) = distance_and_speed_after(*v, a, step_s);
            (*x, *v) = (*x + covered_m, speed_mps);
        }
        accelerations.extend(scene.follower.as_ref().map(|follower| -follower.brake_mps2));
        let now = gaps_m(scene, &line, fires, k + 1);
        for (front, (begin, end)) in before.iter().zip(&now).enumerate() {
            let ahead = accelerations[front].max(Interval::ZERO);
            let behind = accelerations[front + 1].min(Interval::ZERO);
            let gap_m = (begin.min(*end) - (ahead - behind) * eighth).low();
            if gap_m > 0.0 {
                smallest_gap_m = smallest_gap_m.min(gap_m);
            } else {
                return Err(Rejection::MayCollide {
                    front_vehicle: front,
                    step: k,
                    gap_m,
                });
            }
        }
        before = now;
    }
    Ok(EscapeReplay {
        smallest_gap_m,
        after_horizon: safety_after_horizon(scene, &line, fires, &before),
    })
}

fn safety_after_horizon(
    scene: &Scene,
    line: &[(Interval, Interval)],
    fires: u32,
    gaps_m: &[Interval],
) -> SafetyAfterHorizon {
    // A lower bound of all speeds while no vehicle brakes below it.
    let slowest = Interval::point(
        line.iter()
            .map(|(_, v)| v.low())
            .fold(f64::INFINITY, f64::min),
    );
    let follower = scene
        .follower
        .as_ref()
        .map(|follower| RearVehicle::from_follower(scene, follower, fires));
    let egos = scene.egos.iter().zip(line.iter().skip(1));
    let behind: Vec<_> = egos
        .map(|(ego, (_, v))| RearVehicle {
            speed_mps: *v,
            brake_mps2: Interval::point(ego.max_brake_mps2),
        })
        .chain(follower)
        .zip(gaps_m)
        .collect();
    if behind
        .iter()
        .all(|(vehicle, gap_m)| vehicle.can_keep_gap(**gap_m, Interval::ZERO))
    {
        SafetyAfterHorizon::ForAnyLeader
    } else if behind
        .iter()
        .all(|(vehicle, gap_m)| vehicle.can_keep_gap(**gap_m, slowest))
    {
        SafetyAfterHorizon::UnlessLeaderBrakes
    } else {
        SafetyAfterHorizon::Unproved
    }
}

/// A vehicle behind another one, after the last instant.
struct RearVehicle {
    speed_mps: Interval,
    brake_mps2: Interval,
}

impl RearVehicle {
    /// Creates the follower, which brakes only if its brake has fired and its reaction is over.
    fn from_follower(scene: &Scene, follower: &SceneFollower, fires: u32) -> Self {
        let brakes =
            fires < scene.steps && fires.saturating_add(follower.reaction_steps) <= scene.steps;
        Self {
            speed_mps: scene.follower_speed_mps(follower, fires, scene.steps),
            brake_mps2: if brakes {
                follower.brake_mps2
            } else {
                Interval::ZERO
            },
        }
    }

    /// True if it slows to `to_mps` before it has closed a gap by braking.
    fn can_keep_gap(&self, gap_m: Interval, to_mps: Interval) -> bool {
        let too_fast_mps = self.speed_mps - to_mps;
        let covered_m = too_fast_mps.sqr().over(self.brake_mps2 + self.brake_mps2);
        too_fast_mps.high() <= 0.0 || (covered_m - gap_m).high() < 0.0
    }
}

fn gaps_m(scene: &Scene, line: &[(Interval, Interval)], fires: u32, k: u32) -> Vec<Interval> {
    let lengths_m =
        std::iter::once(scene.leader.length_m).chain(scene.egos.iter().map(|ego| ego.length_m));
    let rears = line
        .iter()
        .zip(lengths_m)
        .map(|((x, _), length_m)| *x - Interval::point(length_m));
    let follower = scene
        .follower
        .as_ref()
        .map(|follower| scene.follower_position_m(follower, fires, k));
    let fronts = line.iter().skip(1).map(|(x, _)| *x).chain(follower);
    rears
        .zip(fronts)
        .map(|(rear, front)| rear - front)
        .collect()
}

/// True if at instant `k` the guard is negative in every member that has not fired.
fn must_fire(scene: &Scene, line: &[(Interval, Interval)], k: u32) -> bool {
    let (Some(follower), Some(ego), Some((x, v))) =
        (&scene.follower, scene.egos.last(), line.last())
    else {
        return false;
    };
    let gap =
        *x - Interval::point(ego.length_m) - scene.follower_position_m(follower, scene.steps, k);
    (gap - Interval::point(follower.ttc_s) * (follower.speed_mps - *v)).high() < 0.0
}
