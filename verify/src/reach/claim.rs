//! The claim about a box of initial states, and its check.

use serde::{Deserialize, Serialize};

use super::controller::{NetworkFileSource, NeuralController, OBSERVATION_SIZE};
use super::follower::{FollowerLaw, FollowerModel};
use super::propagate::{ReachProblem, reach_with_budget};
use super::ranges::{BoxDimension, InitialRanges};
use super::{check_policy_file_name, describe_network, load_controller, volume};
use crate::assumption::Assumption;
use crate::bounded;
use crate::certificate::CertificateProvenance;
use crate::claim::steps_to_seconds;
use crate::interval::Interval;
use crate::number::format_range;
use crate::rejection::Rejection;
use crate::scope::{NO_VEHICLE_BEHIND, Scope, describe_errors};
use crate::work::OpBudget;
use crate::{CheckInput, Claim, ClaimSubject, ProvedClaim};

/// Memory limit of all threads for the data between two layers, in bytes.
const MAX_BYTES: usize = 256 << 20;
/// Maximum number of cells of a partition, and of cuts of one cell.
const MAX_CELLS: usize = 2_000_000;
const MAX_CUTS: usize = 48;
const MAX_STEPS: u32 = 100_000;

const LEADER_LIMIT_FIELD: &str = "leader_brakes_at_most_mps2";

/// Tolerance by which shares of version 1 may exceed their volume: they assume exact halves, but the middle of a range
/// is rounded.
const V1_SHARE_TOLERANCE: f64 = 1e-9;

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

impl Claim for ReachClaim {
    fn name(&self) -> &'static str {
        "reach"
    }

    fn subject(&self) -> ClaimSubject<'_> {
        ClaimSubject::InitialStates(self)
    }

    fn assumptions(&self) -> Vec<Assumption> {
        let about_leader = match self.leader_brakes_at_most_mps2 {
            Some(_) => Assumption::LeaderWithinLimit,
            None => Assumption::ScriptedLeader,
        };
        let always = [
            Assumption::ExactMotion,
            about_leader,
            Assumption::PolicyDrives,
            Assumption::ObservedWithin,
            Assumption::TanhWithin,
        ];
        let of_source = [Assumption::ExpWithin, Assumption::NetworkAsRead];
        let of_source = of_source.into_iter().filter(|_| self.source.is_some());
        let latched = self.follower_ttc_s.map(|_| Assumption::LatchedFollower);
        let by_law = self
            .follower_law
            .as_ref()
            .map(|_| Assumption::FollowerByLaw);
        always
            .into_iter()
            .chain(of_source)
            .chain(latched)
            .chain(by_law)
            .collect()
    }

    fn scope(&self) -> Scope {
        let vehicles = vec![
            format!(
                "leader: {} m ahead, {} m/s, {}",
                self.range_text(BoxDimension::GapAheadM),
                self.range_text(BoxDimension::LeaderSpeedMps),
                describe_leader_braking(self)
            ),
            format!(
                "under test: {} m/s, driven by the {}",
                self.range_text(BoxDimension::EgoSpeedMps),
                describe_network(&self.policy_sha256, self.source.as_ref())
            ),
        ];
        let limits = vec![
            format!("{} steps of {} s", self.steps, self.step_s),
            reach_errors(self),
        ];
        Scope {
            behind: Some(describe_behind(self)),
            ..Scope::new(Some(self.horizon_s()), vehicles, limits)
        }
    }

    fn check_fields(&self, _provenance: &CertificateProvenance) -> Result<(), Rejection> {
        let is_imported = self.source.is_some();
        check_policy_file_name(&self.policy_file, &self.policy_sha256, is_imported)
    }

    fn check(&self, input: &CheckInput<'_>) -> Result<ProvedClaim, Rejection> {
        let controller = load_controller(input.policy, &self.policy_sha256, self.source.as_ref())?;
        let scene = self.problem(&controller)?;
        let leaves = self.leaves()?;
        let verdicts = check_leaves(&scene, &leaves, input.work);
        // The verdict does not depend on which thread first exceeded the budget.
        input.work.charge_or_reject(0)?;
        let [verified_share, falsified_share] = self.volume_shares()?;
        let mut smallest_gap_m = f64::INFINITY;
        for (index, verdict) in verdicts.into_iter().enumerate() {
            let gap_m = verdict.map_err(|problem| Rejection::Leaf {
                leaf: index,
                problem,
            })?;
            smallest_gap_m = smallest_gap_m.min(gap_m);
        }
        let tolerance = if input.is_first_version {
            V1_SHARE_TOLERANCE
        } else {
            0.0
        };
        check_stated(
            "verified_share_at_least",
            self.verified_share_at_least,
            verified_share + tolerance,
        )?;
        check_stated(
            "falsified_share_at_least",
            self.falsified_share_at_least,
            falsified_share + tolerance,
        )?;
        check_stated(
            "min_gap_m_at_least",
            self.min_gap_m_at_least,
            smallest_gap_m,
        )?;
        Ok(ProvedClaim::Reach {
            verified_share,
            falsified_share,
            min_gap_m: smallest_gap_m,
            horizon_s: self.horizon_s(),
            has_follower: scene.follower.is_some(),
            leader_brakes_at_most_mps2: self.leader_brakes_at_most_mps2,
        })
    }
}

impl ReachClaim {
    fn range_text(&self, dimension: BoxDimension) -> String {
        format_range(self.ranges.get(dimension))
    }

    /// Returns the reachability problem of the whole box.
    ///
    /// # Errors
    /// [`Rejection`] if the claim is invalid, or the controller's decisions do not fall on instants.
    pub fn problem<'a>(
        &self,
        controller: &'a NeuralController,
    ) -> Result<ReachProblem<'a>, Rejection> {
        let decision_steps = self.decision_steps(controller.decision_interval_s)?;
        self.check_initial_ranges()?;
        self.check_limits()?;
        self.check_unused_ranges()?;
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

    /// Returns the number of steps between two decisions.
    fn decision_steps(&self, decision_interval_s: f64) -> Result<u32, Rejection> {
        if !(self.step_s > 0.0 && self.step_s.is_finite()) {
            return Err(Rejection::invalid("step_s", "must be positive"));
        }
        let decision_steps = (decision_interval_s / self.step_s).round();
        if !(decision_steps >= 1.0
            && (decision_steps * self.step_s - decision_interval_s).abs() < 1e-9)
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
        if self.steps.is_multiple_of(decision_steps) {
            Ok(decision_steps)
        } else {
            Err(Rejection::invalid(
                "steps",
                "must be whole decision intervals",
            ))
        }
    }

    fn check_initial_ranges(&self) -> Result<(), Rejection> {
        for dimension in BoxDimension::ALL {
            if self.ranges.get(dimension).low() < 0.0 {
                return Err(Rejection::invalid(
                    format!("ranges.{}", dimension.field_name()),
                    "contains a negative number",
                ));
            }
        }
        Ok(())
    }

    /// Checks the time to collision, braking limit and observation errors.
    fn check_limits(&self) -> Result<(), Rejection> {
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
        Ok(())
    }

    /// Checks that rate and onset, which have no meaning for a leader with bounded braking, do not suggest one.
    fn check_unused_ranges(&self) -> Result<(), Rejection> {
        if self.leader_brakes_at_most_mps2.is_none() {
            return Ok(());
        }
        for dimension in [BoxDimension::LeaderBrakeMps2, BoxDimension::OnsetSteps] {
            if self.ranges.get(dimension) != Interval::ZERO {
                return Err(Rejection::invalid(
                    format!("ranges.{}", dimension.field_name()),
                    "must be 0 if the leader brakes arbitrarily",
                ));
            }
        }
        Ok(())
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
        let mut pending = vec![PendingCell {
            ranges: self.ranges,
            cuts: 0,
            share: 1.0,
        }];
        let mut leaves = Vec::new();
        if self.partition.len() > MAX_CELLS {
            return Err(Rejection::invalid("partition", "has too many cells"));
        }
        for (index, &cell) in self.partition.iter().enumerate() {
            let next = pending
                .pop()
                .ok_or_else(|| invalid_cell(index, "is one cell more than the cuts create"))?;
            if let PartitionCell::Cut(dimension) = cell {
                let [lower, upper] = next
                    .cut(dimension)
                    .ok_or_else(|| invalid_cell(index, "cuts a range that is a single number"))?;
                if next.cuts == MAX_CUTS {
                    return Err(invalid_cell(index, "cuts too often"));
                }
                pending.extend([upper, lower]);
            } else {
                leaves.push((cell, next.ranges, next.share));
            }
        }
        if pending.is_empty() {
            Ok(leaves)
        } else {
            Err(Rejection::invalid("partition", "ends too early"))
        }
    }
}

/// A cell of the partition that is not read yet.
struct PendingCell {
    ranges: InitialRanges,
    /// Number of cuts that created it.
    cuts: usize,
    /// Lower bound of its share of the box's volume.
    share: f64,
}

impl PendingCell {
    /// Returns the lower and the upper half, or `None` if the range is a single number.
    fn cut(&self, dimension: BoxDimension) -> Option<[Self; 2]> {
        let halves = self.ranges.bisect(dimension)?;
        Some(halves.map(|half| Self {
            ranges: half,
            cuts: self.cuts + 1,
            share: volume::part_share(self.share, half.get(dimension), self.ranges.get(dimension)),
        }))
    }
}

fn invalid_cell(index: usize, problem: &'static str) -> Rejection {
    Rejection::invalid(format!("partition[{index}]"), problem)
}

/// Checks that a stated lower bound is at most the proved one.
fn check_stated(field: &'static str, stated: f64, proved: f64) -> Result<(), Rejection> {
    match stated.partial_cmp(&proved) {
        None | Some(std::cmp::Ordering::Greater) => {
            Err(Rejection::invalid(field, "exceeds the proved value"))
        }
        Some(_) => Ok(()),
    }
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
    std::thread::scope(|scope| {
        let parts: Vec<_> = leaves
            .chunks(leaves.len().div_ceil(threads).max(1))
            .map(|part| {
                scope.spawn(move || {
                    part.iter()
                        .map(|(cell, ranges, _)| check_leaf(scene, cell, ranges, work))
                        .collect::<Vec<_>>()
                })
            })
            .collect();
        parts
            .into_iter()
            .flat_map(|part| {
                part.join()
                    .unwrap_or_else(|_| vec![Err("its check failed".to_owned())])
            })
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

fn describe_leader_braking(claim: &ReachClaim) -> String {
    if let Some(limit_mps2) = claim.leader_brakes_at_most_mps2 {
        return format!(
            "never speeds up, and brakes as it likes: over each step at another rate from 0 to {limit_mps2} m/s²"
        );
    }
    let onset = claim.ranges.onset_steps;
    let onset_s = Interval::new(onset.low() * claim.step_s, onset.high() * claim.step_s);
    let onset_s = onset_s.map_or_else(|| "no time".to_owned(), format_range);
    let brake_mps2 = claim.range_text(BoxDimension::LeaderBrakeMps2);
    format!("brakes at {brake_mps2} m/s² from {onset_s} s on")
}

fn describe_behind(claim: &ReachClaim) -> String {
    let brake_mps2 = claim.range_text(BoxDimension::FollowerBrakeMps2);
    let braking = match (claim.follower_ttc_s, &claim.follower_law) {
        (Some(ttc_s), _) => {
            format!("brakes at {brake_mps2} m/s² once its time to collision falls below {ttc_s} s")
        }
        (None, Some(law)) => {
            let accel_mps2 = law.max_accel_mps2();
            format!(
                "{law}; it brakes at up to {brake_mps2} and accelerates at up to {accel_mps2} m/s²"
            )
        }
        (None, None) => return NO_VEHICLE_BEHIND.to_owned(),
    };
    let gap_m = claim.range_text(BoxDimension::GapBehindM);
    let speed_mps = claim.range_text(BoxDimension::FollowerSpeedMps);
    format!("behind: {gap_m} m behind, {speed_mps} m/s, {braking}")
}

/// Describes the observation errors of a reach claim; those of a follower only if there is one.
fn reach_errors(claim: &ReachClaim) -> String {
    let [
        gap,
        gap_behind,
        leader,
        own,
        follower,
        leader_mps2,
        own_mps2,
        follower_mps2,
    ] = claim.observation_error;
    let mut errors = vec![
        ("gap ahead", gap, "m"),
        ("leader's speed", leader, "m/s"),
        ("own speed", own, "m/s"),
        ("leader's acceleration", leader_mps2, "m/s²"),
        ("own acceleration", own_mps2, "m/s²"),
    ];
    if claim.follower_ttc_s.is_some() || claim.follower_law.is_some() {
        errors.extend([
            ("gap behind", gap_behind, "m"),
            ("follower's speed", follower, "m/s"),
            ("follower's acceleration", follower_mps2, "m/s²"),
        ]);
    }
    describe_errors(&errors)
}

#[cfg(test)]
mod tests;
