//! Total of several runs: how many end without a collision, and with which kind of collision.

use std::borrow::Cow;

use serde::Serialize;

use super::collision_role::CollisionRole;
use super::replay_share::ReplayShare;
use super::run_report::RunReport;
use crumple_core::quoting::TerminalText;
use crumple_core::text_file::is_default;
use crumple_sim::engine::Outcome;
use crumple_sim::scenario::{PlantKind, Scenario};

/// End of a run, by its first collision.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RunEnd {
    /// No collision.
    NoCollision,
    /// First collision, with the role of the vehicles under test.
    Collision(CollisionRole),
    /// The controller gave no valid command.
    ControllerFailed,
}

impl RunEnd {
    fn new(outcome: &Outcome, scenario: &Scenario) -> Self {
        match outcome {
            Outcome::NoCollision => Self::NoCollision,
            Outcome::Collision(collision) => {
                Self::Collision(CollisionRole::new(collision, scenario))
            }
            Outcome::ControllerFailed(_) => Self::ControllerFailed,
        }
    }
}

/// Findings about a run that a total counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunFindings {
    /// End of the run.
    pub end: RunEnd,
    /// True if a vehicle under test brakes unnecessarily, whatever causes it.
    pub brakes_unnecessarily: bool,
    /// True if only a vehicle behind causes this braking.
    pub brakes_only_with_vehicle_behind: bool,
    /// True if a vehicle under test falls behind its leader.
    pub fell_behind: bool,
    /// True if a specification is violated.
    pub violated: bool,
    /// True if the last vehicle is under test, so that no vehicle can hit it from behind.
    pub ends_under_test: bool,
}

impl RunFindings {
    /// Returns the findings of a report.
    #[must_use]
    pub fn new(report: &RunReport<'_>) -> Self {
        Self {
            end: RunEnd::new(&report.outcome, report.simulated_scenario),
            brakes_unnecessarily: report.brakes_unnecessarily(),
            brakes_only_with_vehicle_behind: report.brakes_only_with_vehicle_behind,
            fell_behind: !report.fell_behind.is_empty(),
            violated: report.violates_specification(),
            ends_under_test: report.simulated_scenario.ends_under_test(),
        }
    }
}

const HIT_BY_RECORDING: &str = "collision from behind with a vehicle that repeats recorded speeds: \
    does not count against the controller";
const NO_VEHICLE_BEHIND: &str = "no vehicle behind: collisions from behind cannot happen";

/// Share of scenarios with a collision under a plant that replaces that of the scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PlantCollisions {
    plant: &'static str,
    #[serde(flatten)]
    share: ReplayShare,
}

/// Numbers of scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct RunTotal {
    scenarios: usize,
    no_collision: usize,
    ego_hits_leader: usize,
    ego_hit_from_behind: usize,
    /// Left out without such a collision.
    #[serde(skip_serializing_if = "is_default")]
    ego_hit_by_recording: usize,
    others_collide: usize,
    controller_failed: usize,
    brakes_unnecessarily: usize,
    /// Those of them in which only a vehicle behind causes it; left out if there is none.
    #[serde(skip_serializing_if = "is_default")]
    brakes_only_with_vehicle_behind: usize,
    fell_behind: usize,
    /// Scenarios whose last vehicle is under test; left out if there is none.
    #[serde(skip_serializing_if = "is_default")]
    without_vehicle_behind: usize,
    /// None without specifications.
    #[serde(skip_serializing_if = "Option::is_none")]
    violated: Option<usize>,
    /// None without a plant that replaces that of the scenarios.
    #[serde(skip_serializing_if = "Option::is_none")]
    plant_collisions: Option<PlantCollisions>,
}

/// Last object of the JSON output for several runs.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
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
            ego_hits_leader: ends(RunEnd::Collision(CollisionRole::Hits)),
            ego_hit_from_behind: ends(RunEnd::Collision(CollisionRole::HitFromBehind)),
            ego_hit_by_recording: ends(RunEnd::Collision(CollisionRole::HitByRecording)),
            others_collide: ends(RunEnd::Collision(CollisionRole::Bystander)),
            controller_failed: ends(RunEnd::ControllerFailed),
            brakes_unnecessarily: count(&|run| run.brakes_unnecessarily),
            brakes_only_with_vehicle_behind: count(&|run| run.brakes_only_with_vehicle_behind),
            fell_behind: count(&|run| run.fell_behind),
            without_vehicle_behind: count(&|run| run.ends_under_test),
            violated: has_specifications.then(|| count(&|run| run.violated)),
            plant_collisions: None,
        }
    }

    /// Adds in how many runs a collision happens, if a plant replaces that of the scenarios.
    #[must_use]
    pub fn with_plant(self, plant: PlantKind, collides: impl IntoIterator<Item = bool>) -> Self {
        let plant = plant.name();
        let share = ReplayShare::from_results(collides);
        Self {
            plant_collisions: share.map(|share| PlantCollisions { plant, share }),
            ..self
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
        if let Some(PlantCollisions { plant, share }) = &self.plant_collisions {
            text += &format!(
                "{plant}: {}\n",
                share.describe("scenarios whose controllers answer have a collision")
            );
        }
        text
    }

    /// Returns the numbers with their descriptions.
    fn rows(&self) -> [(usize, Cow<'static, str>); 10] {
        let braking = match self.brakes_only_with_vehicle_behind {
            0 => "unnecessary braking".to_owned(),
            behind => format!(
                "unnecessary braking, {behind} of them only with the vehicle behind: not counted against the controller"
            ),
        };
        [
            (self.no_collision, "no collision".into()),
            (
                self.ego_hits_leader,
                "COLLISION: the ego vehicle hits its leader".into(),
            ),
            (
                self.ego_hit_from_behind,
                "COLLISION: the ego vehicle is hit from behind".into(),
            ),
            (self.ego_hit_by_recording, HIT_BY_RECORDING.into()),
            (self.others_collide, "COLLISION of other vehicles".into()),
            (self.controller_failed, "CONTROLLER FAILED".into()),
            (self.brakes_unnecessarily, braking.into()),
            (
                self.fell_behind,
                "the ego vehicle falls behind its leader".into(),
            ),
            (
                self.violated.unwrap_or_default(),
                "VIOLATED: a specification".into(),
            ),
            (self.without_vehicle_behind, NO_VEHICLE_BEHIND.into()),
        ]
    }
}
