//! Reachability of a closed loop with a learned policy, from every initial state of a box.
//!
//! An ego vehicle drives behind a leader that brakes. A network decides the ego's acceleration. Behind the ego there
//! may be a follower with a latched emergency brake or a control law. A *reach* statement bisects a box of initial
//! states repeatedly. It claims that no member of some cells ever collides, and that other cells contain a member that
//! collides. The check derives these claims again from the network file and the cuts alone. [`form`] has affine forms,
//! and [`relax`] functions of them. [`controller`] bounds the network, with [`activation`] for its activation
//! functions. [`braking`], [`leader`] and [`propagate`] bound the vehicles. Uncertainty is always enlarged, never
//! dropped. Enclosures and their losses of tightness, with noise symbols as in [`form`]:
//!
//! - initial state: one symbol for each range, for the whole run; no loss;
//! - ReLU that may be active or not on [l, h]: a line plus an excess, for which there is a symbol until the output of
//!   the network is known; at most (h · -l)/(h - l);
//! - other activation functions: likewise, with a [line](activation) for each; second order in the width if smooth;
//! - tanh of the output: chord and its largest distance on either side; second order in the width;
//! - clipping of inputs and of the acceleration: two ReLUs; no loss while no member is clipped;
//! - rounding in single and double precision: bounds of each sum, from the weights; about 10⁻⁵ m/s²;
//! - leader with bounded braking: two symbols per decision interval; its observed acceleration is any allowed one at
//!   each decision;
//! - products (braking rate and time): product of the radii; second order;
//! - moving or standing: one set each, joined at each decision; some centimetres;
//! - follower with a law: the [law](follower), per step; second order in the width, more if its emergency brake may
//!   fire;
//! - firing instant of the follower: a propagation for each decision interval in which it may fire, with a symbol for
//!   the instant; a small loss;
//! - old noise symbols: merged in pairs ([order reduction](ego_set) of the zonotope); almost nothing;
//! - inside a decision interval of D steps h: the smaller gap at its ends less m (D h)²/8, for a relative acceleration
//!   of at most m; about 2 cm.
//!
//! # What is not covered
//! - The estimator: observations are within stated errors of the true state, at each decision anew and in any
//!   combination.
//! - Noise on accelerations, delays and lags: the vehicles have none.
//! - Agreement of the simulator with this semantics: tests compare the two.
//! - Agreement of an imported network with its source: an assumption; `crumple check --policy` reads the source again.
//! - Feasibility of commanded accelerations: the certificate holds no limits of the vehicle; crumple compares them when
//!   it creates the claim.
//! - Rounding of a simulator: motion is that of real numbers. Observation errors of 10⁻⁹ cover double precision within
//!   a kilometre of the origin, except if rounding decides which vehicle stands or brakes at an instant.

pub mod activation;
pub mod bounds;
pub mod braking;
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
pub mod safetensors;
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
    ControllerInput, LinearLayer, NativePolicy, NetworkFileFormat, NetworkFileSource, NetworkLayer,
    NeuralController, OBSERVATION_SIZE,
};
pub use follower::{AccAebLaw, FollowerLaw, FollowerModel, IdmLaw};
use propagate::reach_with_budget;
pub use propagate::{ReachProblem, ReachTube, reach, reach_with_tube};
pub use ranges::{BoxDimension, InitialRanges};

/// Memory limit of all threads for the data between two layers, in bytes.
const MAX_BYTES: usize = 256 << 20;
/// Maximum number of cells of a partition, and of cuts of one cell.
const MAX_CELLS: usize = 2_000_000;
const MAX_CUTS: usize = 48;
const MAX_STEPS: u32 = 100_000;

const LEADER_LIMIT_FIELD: &str = "leader_brakes_at_most_mps2";

/// A claim about a box of initial states under a policy.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReachClaim {
    /// File name of the policy, in the certificate's folder.
    pub policy_file: String,
    /// SHA-256 of the policy file, in hexadecimal.
    pub policy_sha256: String,
    /// Source file of an imported network.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub source: Option<NetworkFileSource>,
    /// h, the time between two instants, in seconds.
    pub step_s: f64,
    /// N, the number of steps.
    pub steps: u32,
    /// θ, the TTC threshold of a follower with a latched emergency brake, in seconds; null for one with a law, or
    /// without a follower.
    pub follower_ttc_s: Option<f64>,
    /// Law of the follower, if it has one. `follower_brake_mps2` of the box is then its hardest braking.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower_law: Option<Box<FollowerLaw>>,
    /// Brake limit b, in m/s², of a leader with bounded braking: over each step until it stands, it holds any
    /// acceleration from -b to 0. `leader_brake_mps2` and `onset_steps` of the box are then 0. Absent for a leader that
    /// follows these two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader_brakes_at_most_mps2: Option<f64>,
    /// Largest error of each observed number at a decision: gaps ahead and behind in metres, speeds ahead, own and
    /// behind in m/s, accelerations ahead, own and behind in m/s².
    pub observation_error: [f64; OBSERVATION_SIZE],
    /// The box.
    pub ranges: InitialRanges,
    /// Partition of the box in preorder: a cut is followed by all cells of its lower half, then by those of its upper
    /// half.
    #[serde(deserialize_with = "bounded::deserialize_list::<MAX_CELLS, _, _>")]
    pub partition: Vec<PartitionCell>,
    /// Share of the box's volume in verified cells. Version 1 assumed that each cut makes exact halves.
    pub verified_share_at_least: f64,
    /// Share of the box's volume in falsified cells, with the same assumption in version 1.
    pub falsified_share_at_least: f64,
    /// Lower bound of the gaps of verified members, in metres.
    pub min_gap_m_at_least: f64,
}

/// A cell of the partition.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PartitionCell {
    /// Bisected in a dimension.
    Cut(BoxDimension),
    /// No member ever collides.
    Verified,
    /// The member with these values, in the order of the ranges, collides. A leader with bounded braking then brakes at
    /// this rate from this onset.
    Falsified([f64; 8]),
    /// Nothing is claimed.
    Undecided,
}

/// Reason for which a collision is not excluded.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Undecided {
    /// A gap may close.
    #[error(
        "the gap {} the ego vehicle may be as small as {gap_m:.3} m by step {step}",
        if *pair == 0 { "ahead of" } else { "behind" }
    )]
    MayCollide {
        /// 0 for the gap ahead, 1 for the one behind.
        pair: usize,
        /// Step by which it may close.
        step: u32,
        /// Proved lower bound of the gap, in metres.
        gap_m: f64,
    },
    /// The bounds have become too wide.
    #[error("bounds are too wide at step {step}")]
    TooWide {
        /// Step at which they became too wide.
        step: u32,
    },
    /// The follower may fire in too many intervals.
    #[error("there are too many cases at step {step}")]
    TooManySets {
        /// Step of the interval.
        step: u32,
    },
}

/// The result of the analysis of a box.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ReachResult {
    /// Lower bounds of the gaps ahead and behind until the analysis ended, in metres.
    pub gaps_m: [f64; 2],
    /// Reason for which a collision is not excluded; `None` if it is.
    pub undecided: Option<Undecided>,
    /// True if every member surely collides.
    pub surely_collides: bool,
    /// Contribution of each dimension to the undecided gap, in metres.
    pub sensitivity: [f64; 8],
}

impl ReachResult {
    const INITIAL: Self = Self {
        gaps_m: [f64::INFINITY; 2],
        undecided: None,
        surely_collides: false,
        sensitivity: [0.0; 8],
    };
}

impl ReachClaim {
    /// Returns the reachability problem of the whole box.
    ///
    /// # Errors
    /// [`Rejection`] if the claim is invalid, or the controller's decisions do not fall on instants.
    pub fn problem<'a>(
        &self,
        controller: &'a NeuralController,
    ) -> Result<ReachProblem<'a>, Rejection> {
        if !(self.step_s > 0.0 && self.step_s.is_finite()) {
            return Err(Rejection::invalid("step_s", "must be positive"));
        }
        let decision_steps = (controller.decision_interval_s / self.step_s).round();
        if !(decision_steps >= 1.0
            && (decision_steps * self.step_s - controller.decision_interval_s).abs() < 1e-9)
        {
            return Err(Rejection::invalid(
                "step_s",
                "must divide the decision interval",
            ));
        }
        if !(1..=MAX_STEPS).contains(&self.steps) || decision_steps > f64::from(self.steps) {
            return Err(Rejection::invalid(
                "steps",
                "must be from one decision interval to 100 000",
            ));
        }
        let decision_steps = decision_steps as u32;
        if !self.steps.is_multiple_of(decision_steps) {
            return Err(Rejection::invalid(
                "steps",
                "must be whole decision intervals",
            ));
        }
        for dimension in BoxDimension::ALL {
            if self.ranges.get(dimension).low() < 0.0 {
                return Err(Rejection::invalid(
                    format!("ranges.{}", dimension.field_name()),
                    "contains a negative number",
                ));
            }
        }
        let of_follower = self
            .follower_ttc_s
            .iter()
            .map(|ttc_s| ("follower_ttc_s", ttc_s));
        let of_leader = self
            .leader_brakes_at_most_mps2
            .iter()
            .map(|limit| (LEADER_LIMIT_FIELD, limit));
        let errors = self
            .observation_error
            .iter()
            .map(|error| ("observation_error", error));
        for (field, value) in of_follower.chain(of_leader).chain(errors) {
            if !(*value >= 0.0 && value.is_finite()) {
                return Err(Rejection::invalid(field, "is negative or infinite"));
            }
        }
        // Rate and onset have no meaning for a leader with bounded braking and must not suggest one.
        let unused = [BoxDimension::LeaderBrakeMps2, BoxDimension::OnsetSteps].into_iter();
        let mut unused = unused.filter(|_| self.leader_brakes_at_most_mps2.is_some());
        if let Some(dimension) =
            unused.find(|&dimension| self.ranges.get(dimension) != Interval::ZERO)
        {
            let field = format!("ranges.{}", dimension.field_name());
            return Err(Rejection::invalid(
                field,
                "must be 0 if the leader brakes arbitrarily",
            ));
        }
        Ok(ReachProblem {
            controller,
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

    /// Returns the follower model.
    ///
    /// # Errors
    /// [`Rejection`] if two are stated, or an invalid one.
    fn follower_model(&self) -> Result<Option<FollowerModel>, Rejection> {
        match (self.follower_ttc_s, self.follower_law.as_deref()) {
            (Some(_), Some(_)) => Err(Rejection::invalid(
                "follower_law",
                "and `follower_ttc_s` must not both be present",
            )),
            (Some(ttc_s), None) => Ok(Some(FollowerModel::Latched { ttc_s })),
            (None, law) => Ok(law
                .copied()
                .map(FollowerLaw::validate)
                .transpose()?
                .map(FollowerModel::ByLaw)),
        }
    }

    /// Returns N h, rounded to the nanosecond; the claim covers no later time.
    #[must_use]
    pub(crate) fn horizon_s(&self) -> f64 {
        steps_to_seconds(self.step_s, self.steps)
    }

    /// Returns the uncut cells with their ranges and lower bounds of their volume shares, exact if every cut is in
    /// equal halves.
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
            let (ranges, cuts, share) = pending
                .pop()
                .ok_or_else(|| invalid("is one cell more than the cuts create"))?;
            if let PartitionCell::Cut(dimension) = cell {
                let [lower, upper] = ranges
                    .bisect(dimension)
                    .ok_or_else(|| invalid("cuts a range that is a single number"))?;
                if cuts == MAX_CUTS {
                    return Err(invalid("cuts too often"));
                }
                let share_of = |half: &InitialRanges| {
                    volume::part_share(share, half.get(dimension), ranges.get(dimension))
                };
                let shares = [&upper, &lower].map(share_of);
                pending.extend([(upper, cuts + 1, shares[0]), (lower, cuts + 1, shares[1])]);
            } else {
                leaves.push((cell, ranges, share));
            }
        }
        if pending.is_empty() {
            Ok(leaves)
        } else {
            Err(Rejection::invalid("partition", "ends too early"))
        }
    }
}

/// Tolerance by which shares of version 1 may exceed their volume: they assume exact halves, but the middle of a range
/// is rounded.
const V1_SHARE_TOLERANCE: f64 = 1e-9;

pub(crate) fn check(
    claim: &ReachClaim,
    policy: Option<&[u8]>,
    is_old: bool,
    work: &OpBudget,
) -> Result<ProvedClaim, Rejection> {
    let controller = load_controller(policy, &claim.policy_sha256, claim.source.as_ref())?;
    let scene = claim.problem(&controller)?;
    let leaves = claim.leaves()?;
    let verdicts = check_leaves(&scene, &leaves, work);
    // The verdict does not depend on which thread first exceeded the budget.
    work.charge_or_reject(0)?;
    let [verified_share, falsified_share] = claim.volume_shares()?;
    let mut smallest_gap_m = f64::INFINITY;
    for (index, verdict) in verdicts.into_iter().enumerate() {
        let gap_m = verdict.map_err(|problem| Rejection::Leaf {
            leaf: index,
            problem,
        })?;
        smallest_gap_m = smallest_gap_m.min(gap_m);
    }
    let tolerance = if is_old { V1_SHARE_TOLERANCE } else { 0.0 };
    let stated = [
        (
            "verified_share_at_least",
            claim.verified_share_at_least,
            verified_share + tolerance,
        ),
        (
            "falsified_share_at_least",
            claim.falsified_share_at_least,
            falsified_share + tolerance,
        ),
        (
            "min_gap_m_at_least",
            claim.min_gap_m_at_least,
            smallest_gap_m,
        ),
    ];
    let is_more = |(_, stated, found): &&(_, f64, f64)| {
        stated
            .partial_cmp(found)
            .is_none_or(std::cmp::Ordering::is_gt)
    };
    if let Some((field, ..)) = stated.iter().find(is_more) {
        return Err(Rejection::invalid(*field, "exceeds the proved value"));
    }
    Ok(ProvedClaim::Reach {
        verified_share,
        falsified_share,
        min_gap_m: smallest_gap_m,
        horizon_s: claim.horizon_s(),
        has_follower: scene.follower.is_some(),
        leader_brakes_at_most_mps2: claim.leader_brakes_at_most_mps2,
    })
}

/// Loads the controller of a file and checks its digest and source.
pub(crate) fn load_controller(
    file: Option<&[u8]>,
    digest: &str,
    source: Option<&NetworkFileSource>,
) -> Result<NeuralController, Rejection> {
    let wrong = |problem: &str| Rejection::Policy {
        problem: problem.to_owned(),
    };
    let file = file.ok_or_else(|| wrong("is not there"))?;
    let found = sha256(file);
    if found != digest {
        return Err(Rejection::Policy {
            problem: format!("has SHA-256 {found}, and `policy_sha256` is {digest}"),
        });
    }
    let controller =
        NeuralController::from_bytes(file).map_err(|problem| Rejection::Policy { problem })?;
    if controller.source.as_ref() == source {
        Ok(controller)
    } else {
        Err(wrong("was read from another file than `source`"))
    }
}

/// Returns the name of a controller file in the certificate's folder.
#[must_use]
pub fn controller_file_name(digest: &str, is_imported: bool) -> String {
    let kind = if is_imported { "network" } else { "policy" };
    format!(
        "{kind}-{}.safetensors",
        digest.get(..12).unwrap_or_default()
    )
}

/// Returns for each leaf the smallest proved gap or the problem, in order; runs on all cores.
fn check_leaves(
    scene: &ReachProblem<'_>,
    leaves: &[(PartitionCell, InitialRanges, f64)],
    work: &OpBudget,
) -> Vec<Result<f64, String>> {
    let cores = std::thread::available_parallelism().map_or(1, usize::from);
    let threads = cores
        .min(MAX_BYTES / scene.controller.max_decision_bytes().max(1))
        .max(1);
    let judge = |(cell, ranges, _): &(PartitionCell, InitialRanges, f64)| {
        check_leaf(scene, cell, ranges, work)
    };
    std::thread::scope(|scope| {
        let parts = leaves.chunks(leaves.len().div_ceil(threads).max(1));
        let parts: Vec<_> = parts
            .map(|part| scope.spawn(move || part.iter().map(judge).collect::<Vec<_>>()))
            .collect();
        let died = || vec![Err("its check failed".to_owned())];
        parts
            .into_iter()
            .flat_map(|part| part.join().unwrap_or_else(|_| died()))
            .collect()
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
            let reached = reach_with_budget(
                &ReachProblem {
                    ranges: *ranges,
                    ..scene.clone()
                },
                work,
            );
            let gap_m = reached.gaps_m[0].min(reached.gaps_m[1]);
            reached
                .undecided
                .map_or(Ok(gap_m), |undecided| Err(undecided.to_string()))
        }
        PartitionCell::Falsified(point) => {
            let cell = ReachProblem {
                ranges: *ranges,
                ..scene.clone()
            };
            let reached = reach_with_budget(
                &cell
                    .at_point(point)
                    .ok_or("the point is outside the cell")?,
                work,
            );
            if reached.surely_collides {
                Ok(f64::INFINITY)
            } else {
                Err("the point is not proved to collide".to_owned())
            }
        }
        PartitionCell::Undecided | PartitionCell::Cut(_) => Ok(f64::INFINITY),
    }
}

#[cfg(test)]
mod tests;
