//! Partition of a box of initial states until the checker's bounds prove that a policy avoids collisions.
//! `crumple_verify` computes the bounds. This module bisects every undecided box along the dimension with the largest
//! share of the uncertainty. Boxes are independent and are processed by depth, so the result does not depend on
//! threads.

mod report;

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

use crumple_verify::reach::{
    BoxDimension, InitialRanges, NeuralController, PartitionCell, ReachClaim, ReachProblem,
    ReachResult, Undecided, controller_file_name, reach,
};
use crumple_verify::{Certificate, Interval, Rejection, Statement};
use rand::RngExt;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::initial_set::InitialSet;
use crumple_core::digest::sha256;
use crumple_core::field_error::FieldError;
use crumple_core::observer::{Observer, Stopped};
use crumple_core::text_file::{self, FileError};
use crumple_networks::{InvalidMapping, NetworkController};
use crumple_search::worst_case::build_certificate;
use crumple_sim::control::{ControllerSource, IntoSource};
use crumple_sim::engine::{Outcome, RecordingLevel, Run, RunError, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::random::{self, Purpose};
use crumple_sim::scenario::{
    Brake, Driver, InvalidField, LeadProfile, Scenario, built_in_scenario, built_in_scenario_names,
    file,
};
pub use report::ReachReport;

/// Allowance for rounding of the simulator in double precision, in metres, m/s and m/s².
const ROUNDING: f64 = 1e-9;
const SAMPLES_PER_BOX: u64 = 16;

/// A box of initial states as its file states it: a scenario and ranges.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoxSpec {
    /// Version of the file format: 1.
    pub version: u32,
    /// Reason for the ranges.
    #[serde(default)]
    pub about: String,
    /// Built-in scenario: a braking leader, the vehicle under test, and at most one follower with baseline, idm or
    /// acc-aeb.
    pub scenario: String,
    /// Maximum error of the eight observed numbers, in metres, m/s and m/s². Default: negligible.
    #[serde(default = "default_observation_error")]
    pub observation_error: [f64; 8],
    /// Maximum free braking of the leader, in m/s². If given, its acceleration is any constant from minus this to 0 in
    /// each step until it stands, and `ranges` has no braking of the leader.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leader_brakes_at_most_mps2: Option<f64>,
    /// Controller that replaces the follower's: `baseline`, `idm` or `acc-aeb`, by name or with settings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub follower_drives: Option<Driver>,
    /// Ranges; last, because TOML writes tables after values.
    pub ranges: RangesSpec,
}

fn default_observation_error() -> [f64; 8] {
    [ROUNDING; 8]
}

/// Ranges of quantities that differ from the scenario. Each is a number or `{ low = …, high = … }`.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
#[expect(
    missing_docs,
    reason = "each is what its name says, in the unit that its name says"
)]
pub struct RangesSpec {
    pub gap_ahead_m: Option<Interval>,
    pub gap_behind_m: Option<Interval>,
    pub leader_speed_mps: Option<Interval>,
    pub ego_speed_mps: Option<Interval>,
    pub follower_speed_mps: Option<Interval>,
    pub leader_brake_mps2: Option<Interval>,
    pub follower_brake_mps2: Option<Interval>,
    pub onset_s: Option<Interval>,
}

/// Reason why a box allows no claim.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidBox {
    /// A field of the box, its scenario or a range is invalid.
    #[error("{0}")]
    Field(FieldError),
    /// The scenario or box cannot be written.
    #[error("cannot be written as TOML: {0}")]
    Unwritable(#[from] toml::ser::Error),
    /// The controller is unsuitable.
    #[error("the controller {0}")]
    Controller(String),
    /// The observations of the network cannot be bounded.
    #[error("the controller cannot be analysed: {0}")]
    Mapping(#[from] InvalidMapping),
    /// An initial state of the box makes no scenario.
    #[error("an initial state of the box is not a valid scenario: {0}")]
    Start(#[from] InvalidField),
    /// An initial state of the box cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// The observer stopped the partition.
    #[error("the partition of the box was {0}")]
    Stopped(#[from] Stopped),
}

/// Maximum number of boxes: 300 MB of memory, and the limit of the checker. The rest stays undecided.
pub const MAX_BOXES: usize = 1_000_000;

/// A box and a policy to verify.
pub struct ReachPlan {
    scenario: Scenario,
    follower_drives: Option<Driver>,
    /// The scenario and the box as files.
    texts: [String; 2],
    controller: Arc<dyn ControllerSource>,
    bytes: Vec<u8>,
    actor: NeuralController,
    claim: ReachClaim,
}

/// Result at one depth of the partition, as shares of the volume.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct VolumeShares {
    /// Maximum number of bisections of a box.
    pub depth: u32,
    /// Share of the volume without collisions.
    pub verified: f64,
    /// Share of the volume in boxes with an initial state that ends in a collision.
    pub falsified: f64,
    /// Undecided share of the volume.
    pub undecided: f64,
    /// Number of boxes that were bounded so far.
    pub boxes: usize,
    /// Time since the start, in seconds.
    pub seconds: f64,
}

/// Numbers of undecided boxes by reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct UndecidedCounts {
    /// The vehicle under test may hit the leader.
    pub ahead: usize,
    /// The follower may hit the vehicle under test.
    pub behind: usize,
    /// Bounds are too wide, or the follower may brake at too many times.
    pub too_wide: usize,
}

/// Result of a partition.
#[derive(Debug, Clone, PartialEq)]
pub struct Partition {
    /// Certificate, not yet checked.
    pub certificate: Certificate,
    /// Results, one per depth.
    pub shares: Vec<VolumeShares>,
    /// Reasons of the undecided boxes.
    pub undecided: UndecidedCounts,
}

struct PartitionNode {
    ranges: InitialRanges,
    cell: PartitionCell,
    first_child: Option<usize>,
    result: Option<ReachResult>,
}

impl PartitionNode {
    fn new(ranges: InitialRanges) -> Self {
        Self {
            ranges,
            cell: PartitionCell::Undecided,
            first_child: None,
            result: None,
        }
    }
}

fn with_ranges<'a>(problem: &ReachProblem<'a>, ranges: InitialRanges) -> ReachProblem<'a> {
    ReachProblem {
        ranges,
        ..problem.clone()
    }
}

/// Boxes of a partition. The first is the whole box.
struct PartitionTree {
    nodes: Vec<PartitionNode>,
    /// Share of the volume without collisions.
    verified: f64,
    /// Smallest gap in the verified boxes, in metres.
    min_gap_m: f64,
}

impl PartitionTree {
    fn new(ranges: InitialRanges) -> Self {
        Self {
            nodes: vec![PartitionNode::new(ranges)],
            verified: 0.0,
            min_gap_m: f64::INFINITY,
        }
    }

    /// Stores the result of a node at a level. Bisects an undecided box if it may, and returns its new children.
    fn set_result(
        &mut self,
        node: usize,
        result: ReachResult,
        level: u32,
        may_bisect: bool,
    ) -> Range<usize> {
        let children = self.nodes.len();
        self.nodes[node].result = Some(result);
        if result.undecided.is_none() {
            self.nodes[node].cell = PartitionCell::Verified;
            self.verified += 0.5_f64.powi(level as i32);
            let [ahead_m, behind_m] = result.gaps_m;
            self.min_gap_m = self.min_gap_m.min(ahead_m).min(behind_m);
        } else if may_bisect
            && children + 1 < MAX_BOXES
            && let Some((dimension, halves)) = choose_cut(&self.nodes[node].ranges, &result)
        {
            self.nodes[node].cell = PartitionCell::Cut(dimension);
            self.nodes[node].first_child = Some(children);
            self.nodes.extend(halves.map(PartitionNode::new));
        }
        children..self.nodes.len()
    }

    /// Returns the smallest gap, rounded down to micrometres, so that other rounding in another version keeps the
    /// proof.
    fn min_gap_m_at_least(&self) -> f64 {
        if self.min_gap_m.is_finite() {
            (self.min_gap_m * 1e6).floor() / 1e6
        } else {
            0.0
        }
    }

    /// Returns the cells in the order of the certificate: each before its halves, the lower half first.
    fn cells(&self) -> Vec<PartitionCell> {
        let mut cells = Vec::new();
        let mut pending = vec![0_usize];
        while let Some(number) = pending.pop() {
            let node = &self.nodes[number];
            cells.push(node.cell);
            if let Some(lower) = node.first_child {
                pending.extend([lower + 1, lower]);
            }
        }
        cells
    }

    fn undecided_counts(&self) -> UndecidedCounts {
        let mut counts = UndecidedCounts::default();
        let undecided = self.nodes.iter();
        for node in undecided.filter(|node| node.cell == PartitionCell::Undecided) {
            match node.result.and_then(|result| result.undecided) {
                Some(Undecided::MayCollide { pair: 0, .. }) => counts.ahead += 1,
                Some(Undecided::MayCollide { .. }) => counts.behind += 1,
                _ => counts.too_wide += 1,
            }
        }
        counts
    }
}

impl BoxSpec {
    /// Creates a box around a scenario, with the true state as observation.
    #[must_use]
    pub fn around(scenario: &str, ranges: RangesSpec) -> Self {
        Self {
            version: 1,
            about: String::new(),
            scenario: scenario.to_owned(),
            observation_error: default_observation_error(),
            leader_brakes_at_most_mps2: None,
            follower_drives: None,
            ranges,
        }
    }

    /// Parses a box; `path` only names the text in errors.
    ///
    /// # Errors
    /// [`FileError`] if the text is not a box.
    pub fn from_toml(text: &str, path: &Path) -> Result<Self, FileError> {
        text_file::parse_first_version(text, path, |spec: &Self| spec.version)
    }

    /// Returns the scenario of the box, in which the follower's controller can be replaced as stated.
    fn find_scenario(&self) -> Result<Scenario, InvalidBox> {
        let Some(scenario) = built_in_scenario(&self.scenario) else {
            let names: Vec<_> = built_in_scenario_names()
                .iter()
                .map(|(name, _)| *name)
                .collect();
            return Err(InvalidBox::field(
                "scenario",
                format!(
                    "must be a built-in scenario ({}), found `{}`",
                    names.join(", "),
                    self.scenario
                ),
            ));
        };
        if let Some(driver) = &self.follower_drives {
            let edited = scenario.edited(|spec| {
                if let Some(follower) = spec.vehicles.get_mut(2) {
                    follower.driver = driver.clone();
                }
            });
            edited.map_err(map_invalid_start)?;
        }
        Ok(scenario)
    }
}

fn claim_without_partition(
    digest: String,
    actor: &NeuralController,
    initial: InitialSet,
    spec: &BoxSpec,
) -> ReachClaim {
    ReachClaim {
        policy_file: controller_file_name(&digest, actor.source.is_some()),
        policy_sha256: digest,
        source: actor.source.clone(),
        step_s: initial.step_s,
        steps: initial.steps,
        follower_ttc_s: initial.follower_ttc_s,
        follower_law: initial.follower_law.map(Box::new),
        leader_brakes_at_most_mps2: initial.leader_brakes_at_most_mps2,
        observation_error: spec.observation_error,
        ranges: initial.ranges,
        partition: Vec::new(),
        verified_share_at_least: 0.0,
        falsified_share_at_least: 0.0,
        min_gap_m_at_least: 0.0,
    }
}

impl ReachPlan {
    /// Creates a plan for a policy or network and a box.
    ///
    /// # Errors
    /// [`InvalidBox`] if the checker does not support the scenario or the controller, or if a command exceeds the
    /// limits of the vehicle.
    pub fn new(controller: impl IntoSource, spec: &BoxSpec) -> Result<Self, InvalidBox> {
        let controller = controller.into_source();
        let scenario = spec.find_scenario()?;
        let initial = InitialSet::new(&scenario, spec)?;
        let bytes = checker_file(&controller)?.ok_or_else(|| {
            InvalidBox::Controller("must be a policy of crumple or a network".to_owned())
        })?;
        let actor = NeuralController::from_bytes(&bytes).map_err(InvalidBox::Controller)?;
        if !initial.can_execute(actor.action_bounds_mps2) {
            return Err(excessive_command_error(
                actor.action_bounds_mps2,
                initial.accel_limits_mps2,
                &controller,
            ));
        }
        let claim = claim_without_partition(sha256(&bytes), &actor, initial, spec);
        claim.problem(&actor).map_err(map_rejection)?;
        let plan = Self {
            texts: [file::to_toml(&scenario)?, toml::to_string(spec)?],
            scenario,
            follower_drives: spec.follower_drives.clone(),
            controller,
            bytes,
            actor,
            claim,
        };
        // Run one initial state now, so that errors not checked above surface here.
        plan.has_collision_at(&[0.5; 8])?;
        Ok(plan)
    }

    /// Returns the policy file, for the checker.
    #[must_use]
    pub fn policy_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Returns the name of the policy file in the certificate.
    #[must_use]
    pub fn policy_file(&self) -> &str {
        &self.claim.policy_file
    }

    /// Bisects undecided boxes up to `depth` times and [`MAX_BOXES`] in all. Reports each completed depth.
    ///
    /// # Errors
    /// [`InvalidBox`] if an initial state makes no scenario, or `observer` stops.
    pub fn partition(
        &self,
        depth: u32,
        observer: &dyn Observer<VolumeShares>,
    ) -> Result<Partition, InvalidBox> {
        let begin = Instant::now();
        let mut problem = self.claim.problem(&self.actor).map_err(map_rejection)?;
        problem.stop_when_undecided = true;
        let mut tree = PartitionTree::new(self.claim.ranges);
        let mut due = vec![0_usize];
        let mut shares = Vec::new();
        for level in 0..=depth {
            let results: Vec<ReachResult> = due
                .par_iter()
                .map(|&node| reach(&with_ranges(&problem, tree.nodes[node].ranges)))
                .collect();
            let mut next = Vec::new();
            for (&node, result) in due.iter().zip(results) {
                next.extend(tree.set_result(node, result, level, level < depth));
            }
            let now = VolumeShares {
                depth: level,
                verified: tree.verified,
                falsified: 0.0,
                undecided: 1.0 - tree.verified,
                boxes: tree.nodes.len() - next.len(),
                seconds: begin.elapsed().as_secs_f64(),
            };
            observer.notify(&now)?;
            shares.push(now);
            if next.is_empty() {
                break;
            }
            due = next;
        }
        self.falsify(&problem, &mut tree.nodes)?;
        Ok(self.build_partition(&tree, shares, begin))
    }

    /// Searches each undecided box for a state that surely ends in a collision.
    fn falsify(
        &self,
        problem: &ReachProblem<'_>,
        nodes: &mut [PartitionNode],
    ) -> Result<(), InvalidBox> {
        let undecided: Vec<usize> = (0..nodes.len())
            .filter(|&node| nodes[node].cell == PartitionCell::Undecided)
            .collect();
        let points = undecided
            .par_iter()
            .map(|&node| {
                let cell = with_ranges(problem, nodes[node].ranges);
                self.find_collision(&cell, node as u64)
            })
            .collect::<Result<Vec<_>, _>>()?;
        for (node, point) in undecided.into_iter().zip(points) {
            if let Some(point) = point {
                nodes[node].cell = PartitionCell::Falsified(point);
            }
        }
        Ok(())
    }

    /// Searches the middle of a box and random states for one that surely ends in a collision.
    fn find_collision(
        &self,
        cell: &ReachProblem<'_>,
        stream_number: u64,
    ) -> Result<Option<[f64; 8]>, InvalidBox> {
        let mut stream = random::stream(0, Purpose::ScenarioSampling, stream_number);
        for sample in 0..=SAMPLES_PER_BOX {
            let mut shares: [f64; 8] =
                std::array::from_fn(|_| if sample == 0 { 0.5 } else { stream.random() });
            if cell.leader_brakes_at_most_mps2.is_some() {
                shares[BoxDimension::LeaderBrakeMps2 as usize] = 1.0;
            }
            let point = interpolate(&cell.scripted_ranges(), &shares);
            if self.has_collision(&point)?
                && cell
                    .at_point(&point)
                    .is_some_and(|problem| reach(&problem).surely_collides)
            {
                return Ok(Some(point));
            }
        }
        Ok(None)
    }

    fn build_partition(
        &self,
        tree: &PartitionTree,
        mut shares: Vec<VolumeShares>,
        begin: Instant,
    ) -> Partition {
        let mut claim = ReachClaim {
            partition: tree.cells(),
            min_gap_m_at_least: tree.min_gap_m_at_least(),
            ..self.claim.clone()
        };
        // Shares as the checker computes them, rounded down for unequal halves.
        let [verified, falsified] = claim.volume_shares().unwrap_or_default();
        claim.verified_share_at_least = verified;
        claim.falsified_share_at_least = falsified;
        if let Some(last) = shares.last_mut() {
            last.verified = verified;
            last.falsified = falsified;
            last.undecided = 1.0 - verified - falsified;
            last.seconds = begin.elapsed().as_secs_f64();
        }
        let [scenario, spec] = self.texts.clone();
        let name = self.scenario.spec().name.clone();
        Partition {
            certificate: build_certificate(
                name,
                Some(scenario),
                Some(spec),
                Statement::Reach(claim),
            ),
            shares,
            undecided: tree.undecided_counts(),
        }
    }

    fn has_collision_at(&self, shares: &[f64; 8]) -> Result<bool, InvalidBox> {
        self.has_collision(&interpolate(&self.claim.ranges, shares))
    }

    /// Returns an initial state of the box as a scenario; the order is that of the ranges.
    ///
    /// # Errors
    /// [`InvalidBox`] if it makes no scenario.
    pub fn scenario_at(&self, point: &[f64; 8]) -> Result<Scenario, InvalidBox> {
        let [
            ahead_m,
            behind_m,
            leader_mps,
            ego_mps,
            follower_mps,
            brake_mps2,
            follower_brake_mps2,
            onset,
        ] = *point;
        let onset_s = onset * self.claim.step_s;
        let scenario = self.scenario.edited(|spec| {
            if let [leader, ego, rest @ ..] = spec.vehicles.as_mut_slice() {
                (leader.speed_mps, ego.speed_mps) = (leader_mps, ego_mps);
                leader.position_m = ego.position_m + ahead_m + leader.length_m();
                leader.driver = Driver::Profile(LeadProfile::Brake(Brake {
                    onset_s,
                    rate_mps2: brake_mps2,
                }));
                for follower in rest {
                    follower.position_m = ego.position_m - ego.length_m() - behind_m;
                    (follower.speed_mps, follower.max_brake_mps2) =
                        (follower_mps, Some(follower_brake_mps2));
                    if let Some(driver) = &self.follower_drives {
                        follower.driver = driver.clone();
                    }
                }
            }
        });
        scenario.map_err(map_invalid_start)
    }

    fn has_collision(&self, point: &[f64; 8]) -> Result<bool, InvalidBox> {
        let scenario = self.scenario_at(point)?;
        let options = RunOptions::new(self.controller.clone()).with_estimator(EstimatorKind::Truth);
        let run = Run::new(&scenario, options)?;
        Ok(simulate(&run, RecordingLevel::Summary).outcome != Outcome::NoCollision)
    }
}

impl InvalidBox {
    pub(super) fn field(field: &str, problem: impl Into<String>) -> Self {
        Self::Field(FieldError::new(field, problem))
    }
}

/// Converts a rejection by the checker to the terms of the box file, with the onset in seconds.
fn map_rejection(rejection: Rejection) -> InvalidBox {
    match rejection {
        Rejection::Invalid { field, problem } if field == "ranges.onset_steps" => {
            InvalidBox::field("ranges.onset_s", problem)
        }
        Rejection::Invalid { field, problem }
            if field.starts_with("ranges.") || field == "observation_error" =>
        {
            InvalidBox::field(&field, problem)
        }
        Rejection::Policy { problem } => InvalidBox::Controller(problem),
        other => InvalidBox::field("scenario", format!("its {other}")),
    }
}

/// Converts an invalid initial state to an error of the range that caused it.
fn map_invalid_start(invalid: InvalidField) -> InvalidBox {
    if let Some(setting) = invalid.field.strip_prefix("vehicles[2].driver.") {
        return InvalidBox::field("follower_drives", format!("{setting} {}", invalid.problem));
    }
    let range = match invalid.field.as_str() {
        // Overlap is an error of the vehicle behind.
        "vehicles[1].position_m" => "ranges.gap_ahead_m",
        "vehicles[2].position_m" => "ranges.gap_behind_m",
        "vehicles[0].speed_mps" => "ranges.leader_speed_mps",
        "vehicles[1].speed_mps" => "ranges.ego_speed_mps",
        "vehicles[2].speed_mps" => "ranges.follower_speed_mps",
        "vehicles[2].max_brake_mps2" => "ranges.follower_brake_mps2",
        "vehicles[0].driver.brake.onset_s" => "ranges.onset_s",
        brake if brake.starts_with("vehicles[0].driver.brake") => "ranges.leader_brake_mps2",
        _ => return InvalidBox::Start(invalid),
    };
    InvalidBox::field(
        range,
        format!(
            "contains an initial state that is not a valid scenario: {}",
            invalid.problem
        ),
    )
}

/// Returns the error of a command beyond the limits of the vehicle; for a network it names the field.
fn excessive_command_error(
    command_mps2: [f64; 2],
    limits_mps2: [f64; 2],
    controller: &Arc<dyn ControllerSource>,
) -> InvalidBox {
    let [low_mps2, high_mps2] = command_mps2;
    let [min_mps2, max_mps2] = limits_mps2;
    let is_too_low = low_mps2 < min_mps2;
    let bound_mps2 = if is_too_low { low_mps2 } else { high_mps2 };
    let problem = format!(
        "commands up to {bound_mps2} m/s², and the limits of the vehicle are {min_mps2} to {max_mps2} m/s²"
    );
    if controller.downcast_ref::<NetworkController>().is_none() {
        return InvalidBox::Controller(problem);
    }
    let field = match is_too_low {
        true => "output.low_mps2".to_owned(),
        false => "output.high_mps2".to_owned(),
    };
    InvalidMapping { field, problem }.into()
}

/// Returns the file by which the checker identifies a controller: a policy or a network; `None` for others and for
/// shielded ones.
///
/// # Errors
/// [`InvalidMapping`] if an input of the network is not an affine function of the observation.
pub fn checker_file(
    controller: &Arc<dyn ControllerSource>,
) -> Result<Option<Vec<u8>>, InvalidMapping> {
    if controller.as_shield().is_some() {
        return Ok(None);
    }
    match controller.downcast_ref::<NetworkController>() {
        Some(network) => network.checker_file().map(Some),
        None => Ok(controller
            .policy()
            .and_then(|policy| policy.to_bytes().ok())),
    }
}

/// Chooses the dimension with the largest share of the uncertainty, and returns its halves.
fn choose_cut(
    ranges: &InitialRanges,
    reached: &ReachResult,
) -> Option<(BoxDimension, [InitialRanges; 2])> {
    let mut order: Vec<(f64, BoxDimension)> = reached
        .sensitivity
        .into_iter()
        .zip(BoxDimension::ALL)
        .collect();
    order.sort_by(|a, b| b.0.total_cmp(&a.0));
    order
        .into_iter()
        .find_map(|(_, dimension)| Some((dimension, ranges.bisect(dimension)?)))
}

/// Returns the state at these shares of the ranges.
fn interpolate(ranges: &InitialRanges, shares: &[f64; 8]) -> [f64; 8] {
    std::array::from_fn(|i| {
        let range = ranges.get(BoxDimension::ALL[i]);
        (range.low() + shares[i] * (range.high() - range.low())).clamp(range.low(), range.high())
    })
}

#[cfg(test)]
mod tests;
