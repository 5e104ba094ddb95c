//! Counts of how the runs of one controller end.

use serde::{Deserialize, Serialize};

use super::case::CaseVerdict;
use super::claims::Strength;
use crumple_sim::engine::FailedControllerRuns;

/// Counts of how the runs of one controller end.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RunEnds {
    /// Number of scenarios in which a vehicle under test collides.
    pub collisions: u64,
    /// Scenarios in which the controller gave no answer: failures, but no collisions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Number of scenarios that end with a collision of other vehicles: no evidence about the controller.
    #[serde(alias = "cut_short")]
    pub ended_by_others: u64,
    /// Number of scenarios in which a vehicle under test first hits its leader.
    pub hit: u64,
    /// Number of scenarios in which a vehicle under test is first hit from behind.
    pub was_hit: u64,
}

impl RunEnds {
    pub(super) fn from_verdicts<'a>(verdicts: impl IntoIterator<Item = &'a CaseVerdict>) -> Self {
        let mut ends = Self::default();
        verdicts.into_iter().for_each(|verdict| ends.add(verdict));
        ends
    }

    pub(super) fn add(&mut self, verdict: &CaseVerdict) {
        let hit = matches!(verdict, CaseVerdict::Hit(_));
        let was_hit = matches!(verdict, CaseVerdict::WasHit(_));
        self.collisions += u64::from(hit || was_hit);
        FailedControllerRuns::merge(&mut self.unanswered, verdict.unanswered());
        self.ended_by_others += u64::from(!verdict.is_conclusive());
        self.hit += u64::from(hit);
        self.was_hit += u64::from(was_hit);
    }

    /// Returns the number of scenarios in which the controller gave no answer.
    #[must_use]
    pub fn unanswered_runs(&self) -> u64 {
        self.unanswered
            .as_ref()
            .map_or(0, |unanswered| unanswered.runs)
    }

    /// Returns the number of failures: collisions and scenarios without an answer.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.collisions.saturating_add(self.unanswered_runs())
    }

    /// Returns the strength of the claim that no run fails. Runs that other vehicles ended do not count.
    pub(super) fn strength(&self, runs: u64) -> Strength {
        let conclusive = runs - self.ended_by_others;
        Strength::from_counts_with_unanswered(
            self.collisions,
            conclusive,
            self.unanswered.as_ref(),
            true,
        )
    }
}

/// Notes that a controller gave no answer in some of its runs.
pub(super) fn note_unanswered(
    controller: &str,
    unanswered: &FailedControllerRuns,
    runs: u64,
) -> String {
    let description = unanswered.describe(runs);
    format!("{controller} {description}. These are failures of the controller, but no collisions.")
}
