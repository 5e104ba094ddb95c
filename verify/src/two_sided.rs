//! A vehicle between a leader and a follower of a class: no collision on either side.
//!
//! # What is claimed
//!
//! The ego vehicle acts every h seconds. The leader never brakes harder than c, and the follower belongs to a class
//! ([`CoveredFollowers`]). Other followers are not covered. Without [`start`](TwoSidedClaim::start), the claim is
//! about a filter. It holds for every state from which some plan avoids a collision on both sides: the filter, which
//! executes a command only if such a plan exists after it, and otherwise the rest of its plan, never leaves these
//! states. With a start, the claim is about one run: the [plan](TwoSidedPlan) avoids a collision on both sides from
//! the stated state.
//!
//! # What is checked
//!
//! For a filter, the conditions of the theorem `no_collision_on_either_side` of `verify/coq/TwoSided.v`, which holds
//! for all constants. For a run, the plan itself: [`check`](TwoSidedClaim) simulates it step by step, with bounds of
//! all motions in outward-rounded intervals. `two_sided/plan.rs` has the conditions and their proofs.

mod plan;

use serde::{Deserialize, Serialize};

use crate::assumption::Assumption;
use crate::bounded;
use crate::claim::ConstantPiece;
use crate::number::format_number;
use crate::rejection::Rejection;
use crate::scope::{Scope, describe_errors};
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// Deceleration of the ego vehicle that a follower notices, in m/s²: above it, brake lights must be lit also for
/// electric braking (UN R13-H, 5.2.22.4).
pub const NOTICED_BRAKE_MPS2: f64 = 1.3;

/// Speed below which a follower behind a standing ego vehicle is not covered, in m/s.
pub const CREEP_SPEED_MPS: f64 = 0.5;

/// Maximum of all speeds, gaps, errors and accelerations in a claim.
const MAX_QUANTITY: f64 = 1e5;

/// Maximum number of pieces of a plan.
const MAX_PIECES: usize = 10_000;

/// Event that makes a follower brake.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FollowerCue {
    /// The time to collision falls below this time at a step, in seconds. The follower then brakes to standstill.
    TtcBelowS(f64),
    /// The ego vehicle brakes by at least [`NOTICED_BRAKE_MPS2`], or stands. The follower brakes as long as it does.
    EgoBrakes,
}

/// A class of followers: all that behave as described, and no others.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CoveredFollowers {
    /// Event that makes the follower brake.
    pub brakes_when: FollowerCue,
    /// Maximum time from the event to braking, in seconds.
    pub reaction_s: f64,
    /// Minimum deceleration from then on, in m/s².
    pub brake_mps2: f64,
    /// Maximum magnitude of the acceleration before, in m/s².
    pub drift_mps2: f64,
}

/// Limits of the ego vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwoSidedEgo {
    /// Time between two commands, in seconds.
    pub step_s: f64,
    /// Full braking, in m/s².
    pub brake_mps2: f64,
    /// Maximum acceleration, in m/s².
    pub accel_mps2: f64,
    /// Maximum deviation of the acceleration from the command, in m/s².
    pub noise_mps2: f64,
    /// Steps from a command to its effect.
    pub delay_steps: u32,
}

/// Maximum errors of the observed quantities.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservationErrors {
    /// Gap ahead, in metres.
    pub gap_ahead_m: f64,
    /// Speed of the leader, in m/s.
    pub leader_speed_mps: f64,
    /// Own speed, in m/s.
    pub ego_speed_mps: f64,
    /// Gap behind, in metres.
    pub gap_behind_m: f64,
    /// Speed of the follower, in m/s.
    pub follower_speed_mps: f64,
}

impl ObservationErrors {
    fn named(&self) -> [(&'static str, f64, &'static str); 5] {
        [
            ("gap ahead", self.gap_ahead_m, "m"),
            ("leader's speed", self.leader_speed_mps, "m/s"),
            ("own speed", self.ego_speed_mps, "m/s"),
            ("gap behind", self.gap_behind_m, "m"),
            ("follower's speed", self.follower_speed_mps, "m/s"),
        ]
    }

    /// True if the ego vehicle observes the step in which the follower's brake fires.
    fn shows_firing(&self) -> bool {
        [
            self.ego_speed_mps,
            self.gap_behind_m,
            self.follower_speed_mps,
        ] == [0.0; 3]
    }
}

/// An observed neighbour.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ObservedNeighbour {
    /// Bumper gap, in metres.
    pub gap_m: f64,
    /// Speed, in m/s.
    pub speed_mps: f64,
}

/// Knowledge about the follower at the start.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum KnownPhase {
    /// The event has not occurred, at the first step included.
    Waiting,
    /// The event may have occurred.
    Unknown,
    /// The follower brakes after this time at the latest, in seconds.
    BrakesWithinS(f64),
}

/// Commands of the ego vehicle.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwoSidedPlan {
    /// Accelerations from the start on, in m/s², those of pending commands first; full braking afterwards.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_PIECES, _, _>")]
    pub commands: Vec<ConstantPiece<f64>>,
    /// Commands once the follower's brake has fired, in place of the rest of `commands`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub after_firing: Option<PlanAfterFiring>,
}

/// Commands after the step at which the follower's brake fires: an acceleration, and then full braking.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PlanAfterFiring {
    /// The acceleration, in m/s².
    pub accel_mps2: f64,
    /// Steps of the acceleration if the brake fires at step 1, 2 and so on: each value for a number of steps, the last
    /// one for all later steps.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_PIECES, _, _>")]
    pub steps: Vec<ConstantPiece<u32>>,
}

/// The state at the start of a run, as observed, and a plan.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwoSidedStart {
    /// Own speed, in m/s.
    pub ego_speed_mps: f64,
    /// The leader, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader: Option<ObservedNeighbour>,
    /// The follower, if the claim has a class.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower: Option<ObservedNeighbour>,
    /// Knowledge about the follower.
    pub phase: KnownPhase,
    /// The plan.
    pub plan: TwoSidedPlan,
}

/// No collision on either side, for a filter or in a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwoSidedClaim {
    /// The class of followers; `None` without a follower.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower: Option<CoveredFollowers>,
    /// c, the level: largest deceleration of the leader, in m/s².
    pub leader_brakes_at_most_mps2: f64,
    /// Limits of the ego vehicle.
    pub ego: TwoSidedEgo,
    /// Maximum errors of observations.
    pub observation_error: ObservationErrors,
    /// State and plan of a run; `None` for a claim about a filter.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub start: Option<TwoSidedStart>,
}

impl CoveredFollowers {
    /// Returns the followers in words, after "a follower that".
    #[must_use]
    pub fn describe(&self) -> String {
        let [brake, drift, reaction] =
            [self.brake_mps2, self.drift_mps2, self.reaction_s].map(format_number);
        let drives = format!("before that accelerates or slows by at most {drift} m/s²");
        match self.brakes_when {
            FollowerCue::TtcBelowS(ttc_s) => format!(
                "brakes at {brake} m/s² or more within {reaction} s once the time to collision is below {} s at a \
                 step, keeps braking to standstill, and {drives}",
                format_number(ttc_s)
            ),
            FollowerCue::EgoBrakes => format!(
                "brakes at {brake} m/s² or more within {reaction} s after the vehicle ahead of it begins to brake by \
                 at least {NOTICED_BRAKE_MPS2} m/s² or to stand, keeps braking as long as that vehicle does so, and \
                 {drives}"
            ),
        }
    }
}

impl Claim for TwoSidedClaim {
    fn name(&self) -> &'static str {
        "two-sided"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::AnyNeighbours
    }

    fn assumptions(&self) -> Vec<Assumption> {
        let mut assumptions = vec![
            Assumption::ExactMotion,
            Assumption::LeaderWithinLimit,
            Assumption::ObservedWithin,
            Assumption::EgoOnPlan,
        ];
        assumptions.extend(
            self.follower
                .is_some()
                .then_some(Assumption::FollowerInClass),
        );
        assumptions
    }

    fn scope(&self) -> Scope {
        let class = self.follower.map(|class| {
            format!(
                "behind: only a follower that {}; behind a standing vehicle only if it is not slower than \
                 {CREEP_SPEED_MPS} m/s",
                class.describe()
            )
        });
        let ego = &self.ego;
        let [c, step, brake, accel, noise] = [
            self.leader_brakes_at_most_mps2,
            ego.step_s,
            ego.brake_mps2,
            ego.accel_mps2,
            ego.noise_mps2,
        ]
        .map(format_number);
        let vehicles = class
            .into_iter()
            .chain([
                format!("ahead: never brakes harder than {c} m/s², and does not reverse"),
                format!(
                    "own: acts every {step} s, with a delay of {} steps, from -{brake} to {accel} m/s², up to {noise} \
                     m/s² of noise",
                    ego.delay_steps
                ),
            ])
            .collect();
        let mut limits = vec![describe_errors(&self.observation_error.named())];
        limits.extend(self.start.as_ref().map(TwoSidedStart::describe));
        Scope {
            behind: self
                .follower
                .is_none()
                .then(|| crate::scope::NO_VEHICLE_BEHIND.to_owned()),
            ..Scope::new(Some(f64::INFINITY), vehicles, limits)
        }
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        if input.is_first_version {
            return Err(Rejection::invalid(
                "version",
                "must be 2 for this kind of claim",
            ));
        }
        self.check_constants()?;
        if let Some(start) = &self.start {
            plan::check(self, start, input.work)?;
        }
        Ok(ProvedClaim::TwoSided {
            follower: self.follower,
            leader_brakes_at_most_mps2: self.leader_brakes_at_most_mps2,
            is_one_run: self.start.is_some(),
        })
    }
}

impl TwoSidedClaim {
    /// Checks the conditions of the theorem, and the range of each number.
    fn check_constants(&self) -> Result<(), Rejection> {
        let ego = &self.ego;
        let is_positive = |value: f64| value > 0.0 && value <= MAX_QUANTITY;
        let is_bounded = |value: f64| (0.0..=MAX_QUANTITY).contains(&value);
        let must_be_positive = [
            ("ego.step_s", ego.step_s),
            ("ego.brake_mps2", ego.brake_mps2),
            (
                "leader_brakes_at_most_mps2",
                self.leader_brakes_at_most_mps2,
            ),
        ];
        let must_be_bounded = [
            ("ego.accel_mps2", ego.accel_mps2),
            ("ego.noise_mps2", ego.noise_mps2),
        ];
        let invalid = must_be_positive
            .into_iter()
            .find(|(_, value)| !is_positive(*value))
            .or_else(|| {
                must_be_bounded
                    .into_iter()
                    .find(|(_, value)| !is_bounded(*value))
            });
        if let Some((field, _)) = invalid {
            return Err(Rejection::invalid(field, "is out of range"));
        }
        if !self
            .observation_error
            .named()
            .iter()
            .all(|(_, error, _)| is_bounded(*error))
        {
            return Err(Rejection::invalid("observation_error", "is out of range"));
        }
        if ego.noise_mps2 >= ego.brake_mps2 {
            return Err(Rejection::invalid(
                "ego.noise_mps2",
                "can cancel full braking",
            ));
        }
        let Some(class) = self.follower else {
            return Ok(());
        };
        if !is_positive(class.brake_mps2)
            || !is_bounded(class.reaction_s)
            || !is_bounded(class.drift_mps2)
        {
            return Err(Rejection::invalid("follower", "is out of range"));
        }
        match class.brakes_when {
            FollowerCue::TtcBelowS(ttc_s) if !(is_bounded(ttc_s) && ttc_s > ego.step_s) => Err(
                Rejection::invalid("follower.brakes_when", "must exceed the step"),
            ),
            _ => Ok(()),
        }
    }
}

impl TwoSidedStart {
    fn describe(&self) -> String {
        let neighbour = |name: &str, observed: &Option<ObservedNeighbour>| {
            observed.as_ref().map_or_else(String::new, |at| {
                let [gap, speed] = [at.gap_m, at.speed_mps].map(format_number);
                format!(", {name} at a gap of {gap} m with {speed} m/s")
            })
        };
        let phase = match (self.follower, self.phase) {
            (None, _) => String::new(),
            (_, KnownPhase::Waiting) => ", whose brake has not fired".to_owned(),
            (_, KnownPhase::Unknown) => ", whose brake may have fired".to_owned(),
            (_, KnownPhase::BrakesWithinS(left_s)) => {
                format!(", which brakes within {} s", format_number(left_s))
            }
        };
        format!(
            "start: {} m/s{}{}{phase}; the vehicle executes the plan in the file",
            format_number(self.ego_speed_mps),
            neighbour("leader", &self.leader),
            neighbour("follower", &self.follower)
        )
    }
}

/// Describes a proved claim; the class of followers comes first.
pub(crate) fn describe_proved(
    follower: Option<&CoveredFollowers>,
    leader_brakes_at_most_mps2: f64,
    is_one_run: bool,
) -> String {
    let class = follower.map_or_else(
        || "without a follower".to_owned(),
        |class| format!("with a follower that {}", class.describe()),
    );
    let leader = format!(
        "while the leader brakes at most at {} m/s²",
        format_number(leader_brakes_at_most_mps2)
    );
    if is_one_run {
        format!(
            "two-sided: {class}: from the stated state, the plan avoids a collision on either side {leader}"
        )
    } else {
        format!(
            "two-sided: {class}: a filter with these constants keeps every state from which a plan avoids a collision \
             on either side, {leader}"
        )
    }
}
