//! The closed loop of a learned policy, from every start of a box.
//!
//! Behind a leader that brakes drives an ego whose accelerations a network decides, or how far they depart from a law; behind it, perhaps, a follower with a latched
//! emergency brake, or one that follows by a law. A *reach* statement cuts a box of starts in halves again and again; of some of the boxes it ends with it
//! claims that no member ever touches anybody, of others that they hold a point that does. Both are derived here again, from the
//! file of the network and the cuts alone: [`form`] are the numbers, [`relax`] the functions, [`actor`] bounds the network, [`activation`]
//! what is between its layers, [`braking`], [`led`] and [`drive`] the vehicles. What is uncertain is always enlarged, never dropped:
//!
//! | what | how it is enclosed | lost |
//! |---|---|---|
//! | start | one symbol for each range, for the whole run | nothing |
//! | rectifier that may be active or not | line and excess, a symbol within the decision | (h · -l)/(h - l) at most |
//! | other functions between layers | likewise, of each its own [line](activation) | second order in the width, where they are smooth |
//! | tanh of the answer | chord and its largest distance on either side | second order in the width |
//! | cut of inputs and of the acceleration at their limits | two rectifiers | nothing while no member is cut |
//! | single and double precision | bounds of each sum, from the weights | about 10⁻⁵ m/s² |
//! | leader that brakes as it likes | two symbols for the time between two decisions | what it did within the last step, at each decision anew |
//! | products (braking rate and time) | product of the radii | second order |
//! | standing or not | a set for those who move and one for those who stand, joined at each decision | some centimetres |
//! | who follows by a law | the [law](follower), step by step | second order in the width; more where its emergency brake may fire |
//! | an ego that departs from a law | [law and departure](departure), step by step | second order in the width; more where the action may leave its dead zone or not |
//! | which instant the follower fires at | a run for each decision interval in which it may, the instant a symbol | little |
//! | what decisions long past were off by | symbols that act alike become one | next to nothing |
//! | inside a decision interval | m (D h)²/8 off the smaller gap at its ends | about 2 cm |
//!
//! # What is not covered
//! The estimator: the claim is for observations within stated errors of the truth, at each decision anew and in any combination.
//! Noise on accelerations, delays and lags: the claim is for vehicles that have none. Whether the file drives the
//! simulator as said here: tests compare. Whether the file of a network from outside says what the source file and its mapping mean: that
//! is as crumple has read them, an assumption of the claim; who has the source can have it read again (`crumple check --policy`). Whether the vehicle can do what the policy asks for: whoever draws up a box compares, a
//! certificate does not know the vehicle. Motion is that of real numbers; stated observation errors of 10⁻⁹ also cover what a
//! simulator in double precision rounds within a kilometre of its origin, but for who stands or brakes at an instant that rounding decides.

pub mod activation;
pub mod bounds;
pub mod braking;
pub mod command_profile;
pub mod controller;
pub mod ego_set;
#[cfg(test)]
mod fixtures;
pub mod follower;
pub mod form;
pub mod leader;
pub mod network_file;
pub mod policy_file;
pub mod propagate;
mod ranges;
pub mod relax;
pub mod residual;
mod safetensors;
mod volume;
pub mod window;

use serde::{Deserialize, Serialize};

use crate::bounded;
use crate::canonical::sha256;
use crate::claim::steps_to_seconds;
use crate::interval::Interval;
use crate::work::OpBudget;
use crate::{ProvedClaim, Rejection};
pub use activation::Activation;
pub use controller::{
    ControllerInput, LinearLayer, NativePolicy, NetworkFileFormat, NetworkFileSource, NetworkLayer, NeuralController,
    OBSERVATION_SIZE,
};
pub use follower::{AccAebLaw, FollowerLaw, FollowerModel, IdmLaw};
use propagate::reach_with_budget;
pub use propagate::{ReachProblem, ReachTube, reach, reach_with_tube};
pub use ranges::{BoxDimension, InitialRanges};
pub use residual::ResidualPolicy;

/// Most bytes that all threads together take for what is between two layers.
const MAX_BYTES: usize = 256 << 20;
/// Most cells of a partition, and most cuts of one cell.
const MAX_CELLS: usize = 2_000_000;
const MAX_CUTS: usize = 48;
/// Most steps of a run.
const MAX_STEPS: u32 = 100_000;

const LEADER_LIMIT_FIELD: &str = "leader_brakes_at_most_mps2";

/// What becomes of a box under a policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReachClaim {
    /// The policy file, expected beside the certificate.
    pub policy_file: String,
    /// Its SHA-256, in hexadecimal.
    pub policy_sha256: String,
    /// The file that it was read from, if it is a network from outside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<NetworkFileSource>,
    /// h, the time between two instants, in seconds.
    pub step_s: f64,
    /// N, the number of steps.
    pub steps: u32,
    /// θ of a follower that holds its speed until its latched emergency brake fires, in seconds; null if it follows by a law, or
    /// nobody is behind.
    pub follower_ttc_s: Option<f64>,
    /// By which law somebody follows; absent if nobody does. Then `follower_brake_mps2` of the box is the hardest that it brakes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower_law: Option<Box<FollowerLaw>>,
    /// b of a leader that brakes as it likes: over each step it accelerates at any rate from -b to 0, in m/s², until it stands.
    /// `leader_brake_mps2` and `onset_steps` of the box are 0 then. Absent if it brakes as these say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader_brakes_at_most_mps2: Option<f64>,
    /// By how much each observed number may differ from the truth at a decision: gaps ahead and behind in metres, speeds ahead,
    /// own and behind in m/s, accelerations ahead, own and behind in m/s².
    pub observation_error: [f64; OBSERVATION_SIZE],
    /// The box.
    pub ranges: InitialRanges,
    /// How it is cut: a cut is followed by all of its lower half, then all of its upper half.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_CELLS, _, _>")]
    pub partition: Vec<PartitionCell>,
    /// Share of the box's volume in which nobody touches. Version 1 took each cut for half of what was cut.
    pub verified_share_at_least: f64,
    /// Share of the box's volume, likewise, in cells with a point from which somebody touches.
    pub falsified_share_at_least: f64,
    /// No gap of a verified member is ever smaller, in metres.
    pub min_gap_m_at_least: f64,
}

/// A box of the partition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartitionCell {
    /// Cut in two in the middle of a range.
    Cut(BoxDimension),
    /// No member ever touches.
    Verified,
    /// This member does, in the order of the ranges; if the leader brakes as it likes, one that brakes at this rate from this instant on.
    Falsified([f64; 8]),
    /// Nothing is claimed.
    Undecided,
}

/// Why contact is not excluded.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Undecided {
    /// A gap may close.
    #[error("the gap {} the ego may be as small as {gap_m:.3} m by step {step}", if *pair == 0 { "ahead of" } else { "behind" })]
    MayCollide {
        /// 0 for the gap ahead, 1 for the one behind.
        pair: usize,
        /// By when.
        step: u32,
        /// What is proved of the gap, in metres.
        gap_m: f64,
    },
    /// Bounds have become too wide to go on.
    #[error("bounds are too wide at step {step}")]
    TooWide {
        /// When.
        step: u32,
    },
    /// The follower may fire in too many intervals.
    #[error("too many cases have to be told apart at step {step}")]
    TooManySets {
        /// When.
        step: u32,
    },
}

/// What is known of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachResult {
    /// Lower bounds of the gaps ahead and behind up to where it was given up, in metres.
    pub gaps_m: [f64; 2],
    /// Why contact is not excluded; none if it is.
    pub undecided: Option<Undecided>,
    /// Whether every member surely touches.
    pub surely_collides: bool,
    /// How much of what is in doubt each dimension accounts for, in its unit.
    pub sensitivity: [f64; 8],
}

impl ReachResult {
    const INITIAL: Self =
        Self { gaps_m: [f64::INFINITY; 2], undecided: None, surely_collides: false, sensitivity: [0.0; 8] };
}

impl ReachClaim {
    /// What is driven, from one of the boxes.
    ///
    /// # Errors
    /// [`Rejection`] if the claim makes no sense, or the actor decides at no instants.
    pub fn problem<'a>(&self, actor: &'a NeuralController) -> Result<ReachProblem<'a>, Rejection> {
        if !(self.step_s > 0.0 && self.step_s.is_finite()) {
            return Err(Rejection::invalid("step_s", "must be positive"));
        }
        let decision_steps = (actor.decision_interval_s / self.step_s).round();
        if !(decision_steps >= 1.0 && (decision_steps * self.step_s - actor.decision_interval_s).abs() < 1e-9) {
            return Err(Rejection::invalid("step_s", "does not divide the time between decisions"));
        }
        if !(1..=MAX_STEPS).contains(&self.steps) || decision_steps > f64::from(self.steps) {
            return Err(Rejection::invalid("steps", "must be from one decision to 100 000"));
        }
        if let Some(departure) = actor.residual_over.filter(|departure| !departure.is_complete_in_one_step(self.step_s))
        {
            let (rate, step_s) = (departure.rate_per_s, self.step_s);
            let problem = format!(
                "lets departures from its law come and go at {rate} 1/s: over a step of {step_s} s that is no more than a part of the way, and \
                 only who goes all of it within a step can be followed"
            );
            return Err(Rejection::Policy { problem });
        }
        let decision_steps = decision_steps as u32;
        if !self.steps.is_multiple_of(decision_steps) {
            return Err(Rejection::invalid("steps", "must be whole decisions"));
        }
        for dimension in BoxDimension::ALL {
            if self.ranges.get(dimension).low() < 0.0 {
                return Err(Rejection::invalid(
                    format!("ranges.{}", dimension.field_name()),
                    "holds a negative number",
                ));
            }
        }
        let of_follower = self.follower_ttc_s.iter().map(|ttc_s| ("follower_ttc_s", ttc_s));
        let of_leader = self.leader_brakes_at_most_mps2.iter().map(|limit| (LEADER_LIMIT_FIELD, limit));
        let errors = self.observation_error.iter().map(|error| ("observation_error", error));
        for (field, value) in of_follower.chain(of_leader).chain(errors) {
            if !(*value >= 0.0 && value.is_finite()) {
                return Err(Rejection::invalid(field, "is negative or infinite"));
            }
        }
        // One rate and one onset say nothing of a leader that brakes as it likes: they must not look as if they did.
        let unused = [BoxDimension::LeaderBrakeMps2, BoxDimension::OnsetSteps].into_iter();
        let mut unused = unused.filter(|_| self.leader_brakes_at_most_mps2.is_some());
        if let Some(dimension) = unused.find(|&dimension| self.ranges.get(dimension) != Interval::ZERO) {
            let field = format!("ranges.{}", dimension.field_name());
            return Err(Rejection::invalid(field, "must be 0 where the leader brakes as it likes"));
        }
        Ok(ReachProblem {
            controller: actor,
            ranges: self.ranges,
            follower: self.follower_model()?,
            leader_brakes_at_most_mps2: self.leader_brakes_at_most_mps2,
            observation_error: self.observation_error,
            step_s: self.step_s,
            steps: self.steps,
            decision_steps,
            stop_when_undecided: true,
        })
    }

    /// Who drives behind.
    ///
    /// # Errors
    /// [`Rejection`] if two are stated, or one that makes no sense.
    fn follower_model(&self) -> Result<Option<FollowerModel>, Rejection> {
        match (self.follower_ttc_s, self.follower_law.as_deref()) {
            (Some(_), Some(_)) => Err(Rejection::invalid("follower_law", "and `follower_ttc_s` are two followers")),
            (Some(ttc_s), None) => Ok(Some(FollowerModel::Latched { ttc_s })),
            (None, law) => Ok(law.copied().map(FollowerLaw::validate).transpose()?.map(FollowerModel::ByLaw)),
        }
    }

    /// N h, to the nanosecond: the claim is about no later time.
    #[must_use]
    pub(crate) fn horizon_s(&self) -> f64 {
        steps_to_seconds(self.step_s, self.steps)
    }

    /// The cells that are not cut, with their ranges and lower bounds of their shares of the volume, exact where every cut was
    /// one in equal halves.
    ///
    /// # Errors
    /// [`Rejection`] if the cuts do not make a partition.
    pub fn leaves(&self) -> Result<Vec<(PartitionCell, InitialRanges, f64)>, Rejection> {
        let mut pending = vec![(self.ranges, 0, 1.0)];
        let mut leaves = Vec::new();
        if self.partition.len() > MAX_CELLS {
            return Err(Rejection::invalid("partition", "has too many cells"));
        }
        for (index, &cell) in self.partition.iter().enumerate() {
            let invalid = |problem| Rejection::invalid(format!("partition[{index}]"), problem);
            let (ranges, cuts, share) = pending.pop().ok_or_else(|| invalid("is one cell too many"))?;
            if let PartitionCell::Cut(dimension) = cell {
                let [lower, upper] = ranges.bisect(dimension).ok_or_else(|| invalid("cuts what is a single number"))?;
                if cuts == MAX_CUTS {
                    return Err(invalid("cuts too often"));
                }
                let share_of =
                    |half: &InitialRanges| volume::part_share(share, half.get(dimension), ranges.get(dimension));
                let shares = [&upper, &lower].map(share_of);
                pending.extend([(upper, cuts + 1, shares[0]), (lower, cuts + 1, shares[1])]);
            } else {
                leaves.push((cell, ranges, share));
            }
        }
        if pending.is_empty() { Ok(leaves) } else { Err(Rejection::invalid("partition", "ends too early")) }
    }
}

/// What version 1 states of shares may exceed their volume by this much: it counted cuts, and the middle of a range is rounded.
const V1_SHARE_TOLERANCE: f64 = 1e-9;

pub(crate) fn check(
    claim: &ReachClaim,
    policy: Option<&[u8]>,
    is_old: bool,
    work: &OpBudget,
) -> Result<ProvedClaim, Rejection> {
    let actor = load_controller(policy, &claim.policy_sha256, claim.source.as_ref())?;
    let scene = claim.problem(&actor)?;
    let leaves = claim.leaves()?;
    let verdicts = check_leaves(&scene, &leaves, work);
    // Whether it was too much does not depend on which thread was first to notice.
    work.charge_or_reject(0)?;
    let [verified_share, falsified_share] = claim.volume_shares()?;
    let mut smallest_gap_m = f64::INFINITY;
    for (index, verdict) in verdicts.into_iter().enumerate() {
        let gap_m = verdict.map_err(|problem| Rejection::Leaf { leaf: index, problem })?;
        smallest_gap_m = smallest_gap_m.min(gap_m);
    }
    let spare = if is_old { V1_SHARE_TOLERANCE } else { 0.0 };
    let stated = [
        ("verified_share_at_least", claim.verified_share_at_least, verified_share + spare),
        ("falsified_share_at_least", claim.falsified_share_at_least, falsified_share + spare),
        ("min_gap_m_at_least", claim.min_gap_m_at_least, smallest_gap_m),
    ];
    let is_more = |(_, stated, found): &&(_, f64, f64)| stated.partial_cmp(found).is_none_or(std::cmp::Ordering::is_gt);
    if let Some((field, ..)) = stated.iter().find(is_more) {
        return Err(Rejection::invalid(*field, "is more than is proved"));
    }
    Ok(ProvedClaim::Reach {
        verified_share,
        falsified_share,
        min_gap_m: smallest_gap_m,
        horizon_s: claim.horizon_s(),
        has_follower: scene.follower.is_some(),
        leader_brakes_at_most_mps2: claim.leader_brakes_at_most_mps2,
        residual_over: actor.residual_over,
    })
}

/// The actor of a file, if it is the one that is meant and was read from what it is said to be.
pub(crate) fn load_controller(
    file: Option<&[u8]>,
    digest: &str,
    source: Option<&NetworkFileSource>,
) -> Result<NeuralController, Rejection> {
    let wrong = |problem: &str| Rejection::Policy { problem: problem.to_owned() };
    let file = file.ok_or_else(|| wrong("is not there"))?;
    let found = sha256(file);
    if found != digest {
        return Err(Rejection::Policy { problem: format!("has the SHA-256 {found}, and `policy_sha256` is {digest}") });
    }
    let actor = NeuralController::from_bytes(file).map_err(|problem| Rejection::Policy { problem })?;
    if actor.source.as_ref() == source { Ok(actor) } else { Err(wrong("was read from another file than `source`")) }
}

/// The name of the file of an actor, beside a certificate.
#[must_use]
pub fn controller_file_name(digest: &str, is_from_outside: bool) -> String {
    let kind = if is_from_outside { "network" } else { "policy" };
    format!("{kind}-{}.safetensors", digest.get(..12).unwrap_or_default())
}

/// For each leaf the smallest gap that is proved, or what stands against it; on all cores, in order.
fn check_leaves(
    scene: &ReachProblem<'_>,
    leaves: &[(PartitionCell, InitialRanges, f64)],
    work: &OpBudget,
) -> Vec<Result<f64, String>> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = cores.min(MAX_BYTES / scene.controller.max_decision_bytes().max(1)).max(1);
    let judge = |(cell, ranges, _): &(PartitionCell, InitialRanges, f64)| check_leaf(scene, cell, ranges, work);
    std::thread::scope(|scope| {
        let parts = leaves.chunks(leaves.len().div_ceil(threads).max(1));
        let parts: Vec<_> = parts.map(|part| scope.spawn(move || part.iter().map(judge).collect::<Vec<_>>())).collect();
        let died = || vec![Err("the check of it failed".to_owned())];
        parts.into_iter().flat_map(|part| part.join().unwrap_or_else(|_| died())).collect()
    })
}

fn check_leaf(
    scene: &ReachProblem<'_>,
    cell: &PartitionCell,
    ranges: &InitialRanges,
    work: &OpBudget,
) -> Result<f64, String> {
    match cell {
        PartitionCell::Verified => {
            let reached = reach_with_budget(&ReachProblem { ranges: *ranges, ..scene.clone() }, work);
            let gap_m = reached.gaps_m[0].min(reached.gaps_m[1]);
            reached.undecided.map_or(Ok(gap_m), |doubt| Err(doubt.to_string()))
        }
        PartitionCell::Falsified(point) => {
            let cell = ReachProblem { ranges: *ranges, ..scene.clone() };
            let reached = reach_with_budget(&cell.at_point(point).ok_or("the point is not in it")?, work);
            if reached.surely_collides { Ok(f64::INFINITY) } else { Err("the point is not shown to touch".to_owned()) }
        }
        PartitionCell::Undecided | PartitionCell::Cut(_) => Ok(f64::INFINITY),
    }
}

#[cfg(test)]
mod tests;
