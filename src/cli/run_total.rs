//! Total of several runs: how many end without a collision, and with which kind of collision.

use std::fmt::Write;

use serde::Serialize;

use crumple_core::quoting::TerminalText;
use crumple_measure::ContactRole;
use crumple_sim::engine::Outcome;
use crumple_sim::scenario::Scenario;

/// End of a run, by its first collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum RunEnd {
    NoCollision,
    /// First collision, with the role of the ego vehicles.
    Collision(ContactRole),
    ControllerFailed,
}

impl RunEnd {
    pub(super) fn new(outcome: &Outcome, scenario: &Scenario) -> Self {
        match outcome {
            Outcome::NoCollision => Self::NoCollision,
            Outcome::Collision(contact) => Self::Collision(ContactRole::new(contact, scenario)),
            Outcome::ControllerFailed(_) => Self::ControllerFailed,
        }
    }
}

/// Findings about a run that a total counts.
#[derive(Debug, Clone, Copy)]
pub(super) struct RunFindings {
    pub(super) end: RunEnd,
    pub(super) brakes_unnecessarily: bool,
    pub(super) fell_behind: bool,
    /// True if a specification of `--spec` is violated.
    pub(super) violated: bool,
}

/// Numbers of scenarios.
#[derive(Debug, Serialize)]
pub(super) struct RunTotal {
    scenarios: usize,
    no_collision: usize,
    ego_hits_leader: usize,
    ego_hit_from_behind: usize,
    others_collide: usize,
    controller_failed: usize,
    brakes_unnecessarily: usize,
    fell_behind: usize,
    /// None without `--spec`.
    #[serde(skip_serializing_if = "Option::is_none")]
    violated: Option<usize>,
}

/// Last object of the JSON output for a folder.
#[derive(Serialize)]
pub(super) struct TotalReport {
    pub(super) total: RunTotal,
}

impl RunTotal {
    pub(super) fn new(runs: &[RunFindings], has_specifications: bool) -> Self {
        let count = |is_counted: &dyn Fn(&RunFindings) -> bool| {
            runs.iter().filter(|run| is_counted(run)).count()
        };
        let ends = |end: RunEnd| count(&|run| run.end == end);
        Self {
            scenarios: runs.len(),
            no_collision: ends(RunEnd::NoCollision),
            ego_hits_leader: ends(RunEnd::Collision(ContactRole::Hits)),
            ego_hit_from_behind: ends(RunEnd::Collision(ContactRole::HitFromBehind)),
            others_collide: ends(RunEnd::Collision(ContactRole::Bystander)),
            controller_failed: ends(RunEnd::ControllerFailed),
            brakes_unnecessarily: count(&|run| run.brakes_unnecessarily),
            fell_behind: count(&|run| run.fell_behind),
            violated: has_specifications.then(|| count(&|run| run.violated)),
        }
    }

    /// Describes the total; leaves out what no scenario has, except collisions.
    pub(super) fn describe(&self, controller: &str, estimator: &str) -> String {
        let ends = [
            (self.no_collision, "no collision"),
            (
                self.ego_hits_leader,
                "COLLISION: the ego vehicle hits its leader",
            ),
            (
                self.ego_hit_from_behind,
                "COLLISION: the ego vehicle is hit from behind",
            ),
            (self.others_collide, "COLLISION of other vehicles"),
            (self.controller_failed, "CONTROLLER FAILED"),
            (self.brakes_unnecessarily, "unnecessary braking"),
            (self.fell_behind, "ego vehicle left behind by its leader"),
            (
                self.violated.unwrap_or_default(),
                "VIOLATED: a specification",
            ),
        ];
        let all = self.scenarios;
        let scenarios = if all == 1 { "scenario" } else { "scenarios" };
        let mut text = format!(
            "total of {all} {scenarios}: {}, estimator {estimator}\n",
            TerminalText(controller)
        );
        for (index, (count, what)) in ends.into_iter().enumerate() {
            if count > 0 || index == 0 {
                // Writing to a string does not fail.
                let _ = writeln!(text, "  {count:>5} of {all}  {what}");
            }
        }
        text
    }
}
