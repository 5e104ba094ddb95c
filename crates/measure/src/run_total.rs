//! Total of several runs: how many end without a collision, and with which kind of collision.

use serde::Serialize;

use super::contact_role::ContactRole;
use super::run_report::RunReport;
use crumple_core::quoting::TerminalText;
use crumple_sim::engine::Outcome;
use crumple_sim::scenario::Scenario;

/// End of a run, by its first collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEnd {
    /// No collision.
    NoCollision,
    /// First collision, with the role of the vehicles under test.
    Collision(ContactRole),
    /// The controller gave no valid command.
    ControllerFailed,
}

impl RunEnd {
    fn new(outcome: &Outcome, scenario: &Scenario) -> Self {
        match outcome {
            Outcome::NoCollision => Self::NoCollision,
            Outcome::Collision(contact) => Self::Collision(ContactRole::new(contact, scenario)),
            Outcome::ControllerFailed(_) => Self::ControllerFailed,
        }
    }
}

/// Findings about a run that a total counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunFindings {
    /// End of the run.
    pub end: RunEnd,
    /// True if a vehicle under test brakes unnecessarily.
    pub brakes_unnecessarily: bool,
    /// True if a vehicle under test falls behind its leader.
    pub fell_behind: bool,
    /// True if a specification is violated.
    pub violated: bool,
}

impl RunFindings {
    /// Returns the findings of a report.
    #[must_use]
    pub fn new(report: &RunReport<'_>) -> Self {
        Self {
            end: RunEnd::new(&report.outcome, report.simulated_scenario),
            brakes_unnecessarily: report.brakes_unnecessarily(),
            fell_behind: !report.fell_behind.is_empty(),
            violated: report.violates_specification(),
        }
    }
}

/// Numbers of scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct RunTotal {
    scenarios: usize,
    no_collision: usize,
    ego_hits_leader: usize,
    ego_hit_from_behind: usize,
    others_collide: usize,
    controller_failed: usize,
    brakes_unnecessarily: usize,
    fell_behind: usize,
    /// None without specifications.
    #[serde(skip_serializing_if = "Option::is_none")]
    violated: Option<usize>,
}

/// Last object of the JSON output for several runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct TotalReport {
    /// The total.
    pub total: RunTotal,
}

impl RunTotal {
    /// Counts the runs.
    #[must_use]
    pub fn new(runs: &[RunFindings], has_specifications: bool) -> Self {
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

    /// Returns the total for a reader, as lines; leaves out what no scenario has, except collisions.
    #[must_use]
    pub fn to_text(&self, controller: &str, estimator: &str) -> String {
        let all = self.scenarios;
        let scenarios = if all == 1 { "scenario" } else { "scenarios" };
        let mut text = format!(
            "total of {all} {scenarios}: {}, estimator {estimator}\n",
            TerminalText(controller)
        );
        for (index, (count, what)) in self.rows().into_iter().enumerate() {
            if count > 0 || index == 0 {
                text += &format!("  {count:>5} of {all}  {what}\n");
            }
        }
        text
    }

    /// Returns the numbers with their descriptions.
    fn rows(&self) -> [(usize, &'static str); 8] {
        [
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
        ]
    }
}
