//! The best escape found from a scenario, and how far a controller stays behind.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::work::Work;
use super::{Case, Rounded, StoreError};
use crumple_search::worst_case::{AvoidOptions, Avoidance, AvoidanceVerdict, avoid};
use crumple_world::scenario::{Scenario, file};

/// Whether a contact was avoidable for any driver, and by how much.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Best {
    /// There is a profile without contact, which was replayed.
    Avoidable {
        /// The largest smallest gap that was reached, between any two vehicles, in metres, rounded down.
        min_gap_m: Rounded<2>,
        /// No driver keeps a larger smallest gap, in metres, rounded up.
        min_gap_bound_m: Option<Rounded<2>>,
        /// When the emergency brake of the follower fires on that profile, in seconds.
        follower_brakes_s: Option<Rounded<2>>,
    },
    /// No driver avoids a contact; the checker has accepted the proof.
    Unavoidable,
    /// Neither was shown.
    Undecided {
        /// Why.
        reason: String,
    },
}

impl Best {
    /// What [`Best::of`] says of a scenario, computed only if no earlier run has kept it.
    pub(super) fn kept(scenario: &Scenario, work: &Work<'_>) -> Result<Self, StoreError> {
        let text = file::to_toml(scenario).map_err(StoreError::encoding)?;
        work.store.get(&format!("best of {}", scenario.spec().name), &text, || Ok(Self::of(scenario)))
    }

    pub(super) fn of(scenario: &Scenario) -> Self {
        let undecided = |reason: String| Self::Undecided { reason };
        let Avoidance { verdict, min_gap_bound_m, .. } = match avoid(scenario, AvoidOptions::default()) {
            Ok(found) => found,
            Err(error) => return undecided(error.to_string()),
        };
        match verdict {
            AvoidanceVerdict::Avoidable(escape) => Self::Avoidable {
                min_gap_m: Rounded::down(escape.min_gap_m),
                min_gap_bound_m: min_gap_bound_m.map(Rounded::up),
                follower_brakes_s: escape.trigger_time_s.map(Rounded::new),
            },
            AvoidanceVerdict::Unavoidable(_) => Self::Unavoidable,
            AvoidanceVerdict::Undecided(reason) => undecided(reason.to_string()),
        }
    }

    /// How much more of the smallest gap the best escape found kept than the controller of a case, from the numbers as they are
    /// shown; none if none was found, or if others crashed first. Zero for a controller that did better than the
    /// profile that was found, which can only be within its grid.
    pub(super) fn regret_m(&self, case: &Case) -> Option<Rounded<2>> {
        match self {
            Self::Avoidable { min_gap_m, .. } if case.verdict.counts() => {
                Some(Rounded::new((min_gap_m.value() - case.min_gap_m?.value()).max(0.0)))
            }
            _ => None,
        }
    }

    /// In a sentence.
    pub(super) fn words(&self) -> String {
        match self {
            Self::Avoidable { min_gap_m, min_gap_bound_m, follower_brakes_s } => {
                let fires =
                    follower_brakes_s.map(|time_s| format!(", firing the follower's emergency brake at {time_s} s"));
                let bound = min_gap_bound_m.map(|bound_m| {
                    format!("; nobody keeps more than {bound_m} m, by a computed bound without a certificate")
                });
                format!(
                    "Avoidable: the best escape found keeps a smallest gap of {min_gap_m} m{}{}.",
                    fires.unwrap_or_default(),
                    bound.unwrap_or_default()
                )
            }
            Self::Unavoidable => {
                "Unavoidable: whatever is done, vehicles touch; the checker has accepted the proof.".to_owned()
            }
            Self::Undecided { reason } => format!("Undecided whether anyone could have avoided a contact: {reason}."),
        }
    }

    /// In a word or two, for a cell.
    pub(super) fn brief(&self) -> String {
        match self {
            Self::Avoidable { min_gap_m, .. } => format!("{min_gap_m} m"),
            Self::Unavoidable => "unavoidable".to_owned(),
            Self::Undecided { .. } => "undecided".to_owned(),
        }
    }
}

/// What the numbers are, and how they relate.
pub(super) const WHAT_REGRET_IS: &str = "The best escape found is a profile for the vehicles under test, from \
    convex programming with knowledge of the future, held over steps of 0.1 s (or finer, where those do not decide), and \
    replayed by the simulation; one on a finer grid may keep more. A controller's regret is its smallest gap less the controller's \
    own, ahead or behind. The bound beside it comes from the multipliers of those programs and is of every driver, but it is \
    computed and has no certificate; as far as it holds, regret understates what was lost by no more than the distance between \
    the two.";
