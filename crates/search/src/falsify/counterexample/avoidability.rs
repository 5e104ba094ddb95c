//! Avoidability of failures.

use serde::{Deserialize, Serialize};

use crate::confirmation::escape_survives;
use crate::worst_case::{AvoidOptions, AvoidanceVerdict, SearchEffort, avoid};
use crumple_core::digits::format_fixed_down;
use crumple_measure::{RunVerdict, Specification};
use crumple_sim::scenario::Scenario;

/// Answer to the question whether any controller could have avoided a failure. [`avoid`] defines the classes.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[serde(into = "AvoidabilityOutput", from = "AvoidabilityInput")]
#[non_exhaustive]
pub enum Avoidability {
    /// Not analysed: the specification is a formula, or the file is older than the analysis.
    #[default]
    NotAsked,
    /// Some acceleration of the vehicles under test avoids the failure. A replay without collision confirmed it.
    Avoidable {
        /// Smallest gap of the best escape found, in metres.
        best_min_gap_m: f64,
    },
    /// No acceleration avoids the failure; the checker accepted the proof.
    Unavoidable,
    /// Neither could be shown.
    Undecided {
        /// Reason why the analysis failed.
        reason: String,
    },
}

/// The class of an [`Avoidability`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum AvoidabilityClass {
    /// [`Avoidability::NotAsked`].
    #[default]
    NotAsked,
    /// [`Avoidability::Avoidable`].
    Avoidable,
    /// [`Avoidability::Unavoidable`].
    Unavoidable,
    /// [`Avoidability::Undecided`].
    Undecided,
}

/// Avoidability of a failure, and an escape if it is avoidable.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AvoidabilityAnalysis {
    /// Class of the failure.
    pub avoidability: Avoidability,
    /// Scenario with a script in place of every vehicle under test, without collision; only for avoidable failures.
    pub escape: Option<Scenario>,
    /// True if the escape has no collision with the multi-body plant either; see [`escape_survives`].
    pub escape_survives: Option<bool>,
}

impl AvoidabilityAnalysis {
    /// Analyses a failure if the specification is [`Specification::NoCollision`] and the verdict is a collision.
    #[must_use]
    pub fn classify(
        specification: &Specification,
        verdict: &RunVerdict,
        scenario: &Scenario,
    ) -> Self {
        match (specification, verdict.collision) {
            (Specification::NoCollision, Some(_)) => Self::classify_collision(scenario),
            _ => Self::default(),
        }
    }

    /// Analyses a scenario that ends in a collision.
    #[must_use]
    pub fn classify_collision(scenario: &Scenario) -> Self {
        let options = AvoidOptions {
            effort: SearchEffort::Decide,
            ..AvoidOptions::default()
        };
        let avoidability = match avoid(scenario, options).map(|avoidance| avoidance.verdict) {
            Ok(AvoidanceVerdict::Avoidable(escape)) => {
                return Self {
                    avoidability: Avoidability::Avoidable {
                        best_min_gap_m: escape.min_gap_m,
                    },
                    escape_survives: escape_survives(scenario, &escape.acceleration_mps2),
                    escape: Some(escape.scenario),
                };
            }
            Ok(AvoidanceVerdict::Unavoidable(_)) => Avoidability::Unavoidable,
            Ok(AvoidanceVerdict::Undecided(reason)) => Avoidability::Undecided {
                reason: reason.to_string(),
            },
            Err(error) => Avoidability::Undecided {
                reason: error.to_string(),
            },
        };
        Self {
            avoidability,
            ..Self::default()
        }
    }
}

impl Avoidability {
    /// Returns the avoidability if the specification is [`Specification::NoCollision`] and the verdict is a collision.
    #[must_use]
    pub fn classify(
        specification: &Specification,
        verdict: &RunVerdict,
        scenario: &Scenario,
    ) -> Self {
        AvoidabilityAnalysis::classify(specification, verdict, scenario).avoidability
    }

    /// Returns the avoidability of a scenario that ends in a collision.
    #[must_use]
    pub fn classify_collision(scenario: &Scenario) -> Self {
        AvoidabilityAnalysis::classify_collision(scenario).avoidability
    }

    /// Returns the class.
    #[must_use]
    pub fn class(&self) -> AvoidabilityClass {
        match self {
            Self::NotAsked => AvoidabilityClass::NotAsked,
            Self::Avoidable { .. } => AvoidabilityClass::Avoidable,
            Self::Unavoidable => AvoidabilityClass::Unavoidable,
            Self::Undecided { .. } => AvoidabilityClass::Undecided,
        }
    }

    /// Returns true if the failure is avoidable; `None` if that is unknown.
    #[must_use]
    pub fn is_avoidable(&self) -> Option<bool> {
        match self {
            Self::Avoidable { .. } => Some(true),
            Self::Unavoidable => Some(false),
            Self::NotAsked | Self::Undecided { .. } => None,
        }
    }

    /// Returns the smallest gap of the best escape found, in metres.
    #[must_use]
    pub fn best_min_gap_m(&self) -> Option<f64> {
        if let Self::Avoidable { best_min_gap_m } = self {
            Some(*best_min_gap_m)
        } else {
            None
        }
    }

    #[must_use]
    pub(crate) fn undecided_because(&self) -> Option<&str> {
        if let Self::Undecided { reason } = self {
            Some(reason)
        } else {
            None
        }
    }

    /// Describes the result; `None` if it was not analysed.
    #[must_use]
    pub fn describe(&self) -> Option<String> {
        match self {
            Self::NotAsked => None,
            Self::Avoidable { best_min_gap_m } => {
                let gap = format_fixed_down(*best_min_gap_m, 2);
                Some(format!("avoidable: an escape keeps {gap} m"))
            }
            Self::Unavoidable => Some("unavoidable: proved for every controller".to_owned()),
            Self::Undecided { reason } => Some(format!("undecided whether avoidable: {reason}")),
        }
    }
}

#[derive(Serialize)]
struct AvoidabilityOutput {
    avoidable: Option<bool>,
    avoidability: AvoidabilityClass,
    best_min_gap_m: Option<f64>,
    undecided_because: Option<String>,
}

/// The fields of [`AvoidabilityOutput`] that are read; `avoidable` follows from the class.
#[derive(Deserialize)]
struct AvoidabilityInput {
    #[serde(default)]
    avoidability: AvoidabilityClass,
    #[serde(default)]
    best_min_gap_m: Option<f64>,
    #[serde(default)]
    undecided_because: Option<String>,
}

impl From<Avoidability> for AvoidabilityOutput {
    fn from(from: Avoidability) -> Self {
        Self {
            avoidable: from.is_avoidable(),
            avoidability: from.class(),
            best_min_gap_m: from.best_min_gap_m(),
            undecided_because: from.undecided_because().map(str::to_owned),
        }
    }
}

impl From<AvoidabilityInput> for Avoidability {
    fn from(read: AvoidabilityInput) -> Self {
        match (read.avoidability, read.best_min_gap_m) {
            (AvoidabilityClass::Avoidable, Some(best_min_gap_m)) => {
                Self::Avoidable { best_min_gap_m }
            }
            (AvoidabilityClass::Unavoidable, _) => Self::Unavoidable,
            (AvoidabilityClass::Undecided, _) => Self::Undecided {
                reason: read.undecided_because.unwrap_or_default(),
            },
            (AvoidabilityClass::NotAsked | AvoidabilityClass::Avoidable, _) => Self::NotAsked,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_gap_of_an_escape_is_rounded_down() {
        let avoidable = Avoidability::Avoidable {
            best_min_gap_m: 0.009,
        };
        assert_eq!(
            avoidable.describe().unwrap(),
            "avoidable: an escape keeps 0.00 m"
        );
    }

    #[test]
    fn every_class_round_trips_and_old_files_have_none() {
        let all = [
            (Avoidability::NotAsked, "null"),
            (
                Avoidability::Avoidable {
                    best_min_gap_m: 0.1 + 0.2,
                },
                "true",
            ),
            (Avoidability::Unavoidable, "false"),
            (
                Avoidability::Undecided {
                    reason: "noise".to_owned(),
                },
                "null",
            ),
        ];
        for (avoidability, avoidable) in all {
            let text = serde_json::to_string(&avoidability).unwrap();
            assert!(
                text.starts_with(&format!(r#"{{"avoidable":{avoidable},"#)),
                "{text}"
            );
            assert_eq!(
                serde_json::from_str::<Avoidability>(&text).unwrap(),
                avoidability
            );
        }
        let old: Avoidability = serde_json::from_str(r#"{"avoidable":"not-asked"}"#).unwrap();
        assert_eq!(old, Avoidability::NotAsked);
    }
}
