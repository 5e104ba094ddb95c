//! Invariant sets: states from which a controller never collides with a leader within limits. `crumple_verify` has the
//! condition and checks it; [`search`] finds a boundary; [`refute`] searches for leaders that defeat the controller
//! from states outside.

mod refute;
mod report;
mod search;
mod spec;

use std::sync::Arc;

use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::{HEIGHT_UNIT_M, HeightTable, TableAxis};
use crumple_verify::{Certificate, InvariantClaim, Rejection, Statement};

use super::reach::{InvalidBox, checker_file};
use crumple_core::observer::Observer;
use crumple_search::worst_case::build_certificate;
use crumple_sim::control::{BuiltInController, Controller, ControllerSource, Ego, IntoSource};
use crumple_sim::scenario::file;
use crumple_sim::scenario::{Driver, Scenario};
pub use refute::Defeat;
pub use report::InvariantReport;
use search::BoundarySearch;
pub use spec::InvariantSpec;

/// Largest height of a boundary, in multiples of the region's largest gap.
const HIGHEST_GAPS: f64 = 3.0;
/// Number of halvings of the range of own speeds, if the largest own speed of the region allows no set.
const SPEED_HALVINGS: u32 = 4;
/// Rows of the table above the largest initial own speed.
const EXTRA_ROWS: u32 = 2;

/// Fineness of the search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InvariantOptions {
    /// Cells of the own and of the leader's speed.
    pub cells: u32,
    /// Number of times that the check may divide a cell.
    pub splits: u32,
    /// Lowest height at which the search begins, in metres.
    pub smallest_gap_m: f64,
}

/// Progress of a search.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct InvariantProgress {
    /// Largest initial own speed of this attempt, in m/s.
    pub own_mps: f64,
    /// Stage of the attempt.
    pub stage: InvariantStage,
    /// Completed nodes or cells of this stage. Cells that a later one changes again are no longer complete.
    pub done: usize,
    /// Nodes or cells of the table.
    pub total: usize,
}

/// Stage of an attempt to find a set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum InvariantStage {
    /// Simulates leaders from the states of each node.
    Simulate,
    /// Raises the boundary in this pass over the cells, from 1.
    Raise {
        /// Number of the pass.
        pass: u32,
    },
}

/// A controller, its limits and a region.
pub struct InvariantPlan {
    scenario: Scenario,
    controller: Arc<dyn ControllerSource>,
    texts: [String; 2],
    bytes: Option<Vec<u8>>,
    claim: InvariantClaim,
}

/// Result of a search: the table and its certificate, not yet checked.
#[derive(Debug)]
pub struct InvariantSet {
    /// Boundary of the set.
    pub table: HeightTable,
    /// Certificate.
    pub certificate: Certificate,
    /// Passes of the last attempt.
    pub passes: u32,
    /// Share of the region above the gaps from which a simulated leader causes a collision. No set of this form has
    /// more.
    pub simulated_share: f64,
}

impl InvariantPlan {
    /// Creates a plan.
    ///
    /// # Errors
    /// [`InvalidBox`] if the checker does not support the controller or the scenario, or a limit is invalid.
    pub fn new(
        controller: impl IntoSource,
        scenario: &Scenario,
        mut spec: InvariantSpec,
    ) -> Result<Self, InvalidBox> {
        let controller = controller.into_source();
        let bytes = checker_file(&controller)?;
        spec.controller = match controller.downcast_ref::<BuiltInController>() {
            Some(law) if bytes.is_none() => Some(Driver::Controller(law.clone())),
            _ => None,
        };
        if spec.controller.is_none() && bytes.is_none() {
            return Err(InvalidBox::Controller(
                "must be idm, acc-aeb, a policy or a network".to_owned(),
            ));
        }
        let claim = spec.frame(scenario, bytes.as_deref())?;
        claim.check_model(bytes.as_deref()).map_err(map_rejection)?;
        let texts = [file::to_toml(scenario)?, toml::to_string(&spec)?];
        let plan = Self {
            scenario: scenario.clone(),
            controller,
            texts,
            bytes,
            claim,
        };
        plan.check_can_simulate()?;
        Ok(plan)
    }

    /// Returns the policy file, for the checker.
    #[must_use]
    pub fn policy_bytes(&self) -> Option<&[u8]> {
        self.bytes.as_deref()
    }

    /// Searches for a set up to the largest own speed for which there is one. Returns `None` if there is none.
    ///
    /// # Errors
    /// [`InvalidBox`] if the observer stops, or the region is invalid.
    pub fn search(
        &self,
        options: InvariantOptions,
        observer: &dyn Observer<InvariantProgress>,
    ) -> Result<Option<InvariantSet>, InvalidBox> {
        let [low, high] = self.claim.region_own_mps;
        // The first attempt has the whole region.
        if let Some(set) = self.attempt(options, high, observer)? {
            return Ok(Some(set));
        }
        let mut possible_mps = low.max(0.0);
        let mut impossible_mps = high;
        let mut best = None;
        for _ in 0..SPEED_HALVINGS {
            let own_mps = 0.5 * (possible_mps + impossible_mps);
            match self.attempt(options, own_mps, observer)? {
                Some(set) => {
                    possible_mps = own_mps;
                    best = Some(set);
                }
                None => impossible_mps = own_mps,
            }
        }
        Ok(best)
    }

    /// Returns the claim with the axes of a table for initial own speeds up to `own_mps`, still without heights.
    fn claim_with_axes(&self, options: InvariantOptions, own_mps: f64) -> InvariantClaim {
        let mut claim = InvariantClaim {
            splits: options.splits,
            ..self.claim.clone()
        };
        let [low, high] = claim.region_own_mps;
        let low = if claim.motion == MotionModel::Absolute {
            0.0
        } else {
            low
        };
        let cells = (f64::from(options.cells) * (own_mps - low) / (high - low))
            .ceil()
            .max(4.0) as u32;
        let rows = cells + EXTRA_ROWS;
        let mut own = TableAxis {
            low,
            high: low + (own_mps - low) * (f64::from(rows) / f64::from(cells)),
            cells: rows,
        };
        while own.node(cells as usize) > own_mps {
            own.high = own.high.next_down();
        }
        claim.initial_own_mps_at_most = own.node(cells as usize);
        let leader = match claim.motion {
            MotionModel::Absolute => TableAxis {
                low: 0.0,
                high: claim.region_leader_mps[1],
                cells: options.cells,
            },
            MotionModel::Relative => TableAxis::point(0.0),
        };
        claim.axes = [own, leader];
        claim
    }

    /// Searches for a set of initial own speeds up to `own_mps`; `None` if there is none.
    fn attempt(
        &self,
        options: InvariantOptions,
        own_mps: f64,
        observer: &dyn Observer<InvariantProgress>,
    ) -> Result<Option<InvariantSet>, InvalidBox> {
        let claim = self.claim_with_axes(options, own_mps);
        let mut table = lowest_table(&claim, options.smallest_gap_m)?;
        let highest_m = claim
            .ends_beyond_gap_m
            .unwrap_or(HIGHEST_GAPS * claim.region_gap_m);
        let mut stopped = Ok(());
        let mut observe = |stage: InvariantStage, [done, total]: [usize; 2]| {
            stopped = observer.notify(&InvariantProgress {
                own_mps,
                stage,
                done,
                total,
            });
            stopped.is_ok()
        };
        let Some(controller) = self.start(&claim) else {
            return Ok(None);
        };
        let mut search = BoundarySearch {
            claim: &claim,
            controller,
            policy: self.bytes.as_deref(),
            highest_m,
        };
        let is_simulated = search.raise_to_simulation(&mut table, &mut observe);
        let simulated_share = claim.share(&table).map_err(map_rejection)?;
        let passes = if is_simulated {
            search.raise_boundary(&mut table, &mut observe)
        } else {
            None
        };
        stopped?;
        let Some(passes) = passes else {
            return Ok(None);
        };
        let certificate = self.certificate(claim, &table)?;
        Ok(Some(InvariantSet {
            table,
            certificate,
            passes,
            simulated_share,
        }))
    }

    /// Builds the certificate of a claim with the heights of a table.
    fn certificate(
        &self,
        mut claim: InvariantClaim,
        table: &HeightTable,
    ) -> Result<Certificate, InvalidBox> {
        claim.heights = table.to_runs();
        claim.share_at_least = claim.share(table).map_err(map_rejection)?;
        // Rounded down to micrometres, so that other rounding in another version keeps the proof.
        claim.min_gap_m_at_least = ((table.extremes()[0] - claim.floor_m()) * 1e6)
            .floor()
            .max(0.0)
            / 1e6;
        let [scenario, spec] = self.texts.clone();
        let name = self.scenario.spec().name.clone();
        let statement = Statement::Invariant(Box::new(claim));
        Ok(build_certificate(
            name,
            Some(scenario),
            Some(spec),
            statement,
        ))
    }

    /// Starts the controller so that it decides at each call.
    fn start(&self, claim: &InvariantClaim) -> Option<Box<dyn Controller>> {
        let ego = Ego {
            vehicle: 1,
            max_brake_mps2: -claim.own_mps2[0],
            max_accel_mps2: claim.own_mps2[1],
            length_m: self.scenario.vehicles()[1].length_m(),
            step_s: claim.step_s * f64::from(claim.decision_steps),
        };
        self.controller.start(&ego, 0).ok()
    }
}

/// Returns a table with the lowest allowed height everywhere.
///
/// # Errors
/// [`InvalidBox`] for an invalid region, before the long part of the search.
fn lowest_table(claim: &InvariantClaim, smallest_gap_m: f64) -> Result<HeightTable, InvalidBox> {
    let lowest_m = claim.floor_m().max(smallest_gap_m);
    let start_m = ((lowest_m / HEIGHT_UNIT_M).floor() + 1.0) * HEIGHT_UNIT_M;
    let table = HeightTable::new(claim.axes, start_m).map_err(map_rejection)?;
    claim.check_axes(&table).map_err(map_rejection)?;
    claim.share(&table).map_err(map_rejection)?;
    Ok(table)
}

fn map_rejection(rejection: Rejection) -> InvalidBox {
    match rejection {
        Rejection::Invalid { field, problem } => InvalidBox::field(&field, problem),
        Rejection::Policy { problem } => InvalidBox::Controller(problem),
        other => InvalidBox::field("scenario", format!("its {other}")),
    }
}

/// True if a claim has the limits, region and controller of its texts.
pub(super) fn has_frame(claim: &InvariantClaim, frame: InvariantClaim) -> bool {
    let InvariantClaim {
        initial_own_mps_at_most,
        axes,
        splits,
        share_at_least,
        min_gap_m_at_least,
        ..
    } = *claim;
    let heights = claim.heights.clone();
    let set = InvariantClaim {
        initial_own_mps_at_most,
        axes,
        splits,
        heights,
        share_at_least,
        min_gap_m_at_least,
        ..frame
    };
    set == *claim
}
