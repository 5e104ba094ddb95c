//! Objective of a search after the first failure.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::EvaluatedPoint;

/// Definition of the best failure. Until a failure is found, every search minimises the robustness.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
#[non_exhaustive]
pub enum SearchObjective {
    /// The smallest robustness: after a collision the highest impact speed.
    #[default]
    Severest,
    /// The greatest density under the space's distribution.
    Likeliest,
    /// The smallest distance from nominal.
    Nearest,
    /// The greatest harm of the first collision: expected number of seriously injured drivers.
    Harm,
}

/// The error of a name that is not that of an objective.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("unknown aim `{name}`; the aims are: {}", SearchObjective::ALL.map(SearchObjective::name).join(", "))]
pub struct UnknownObjective {
    /// The name.
    pub name: String,
}

impl SearchObjective {
    /// All objectives.
    pub const ALL: [Self; 4] = [Self::Severest, Self::Likeliest, Self::Nearest, Self::Harm];

    /// Returns the name used on the command line and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Severest => "severest",
            Self::Likeliest => "likeliest",
            Self::Nearest => "nearest",
            Self::Harm => "harm",
        }
    }

    /// Returns the cost to minimise. Without a failure it is the robustness. For other objectives than
    /// [`Self::Severest`], a failure has a negative cost, which is lower the better it meets the objective.
    #[must_use]
    pub(crate) fn cost(self, evaluated: &EvaluatedPoint) -> f64 {
        let robustness = evaluated.verdict.robustness;
        let fails = robustness < 0.0;
        match self {
            Self::Likeliest if fails => -2.0 - squash(evaluated.ln_likelihood),
            Self::Nearest if fails => -2.0 + evaluated.distance_from_nominal,
            Self::Harm if fails => -1.0 - evaluated.harm,
            _ => robustness,
        }
    }
}

/// Maps all numbers, infinite ones included, monotonically to -1..1.
fn squash(x: f64) -> f64 {
    if x.is_infinite() {
        x.signum()
    } else {
        x / (1.0 + x.abs())
    }
}

impl fmt::Display for SearchObjective {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(self.name())
    }
}

impl FromStr for SearchObjective {
    type Err = UnknownObjective;

    fn from_str(name: &str) -> Result<Self, UnknownObjective> {
        Self::ALL
            .into_iter()
            .find(|objective| objective.name() == name)
            .ok_or_else(|| UnknownObjective {
                name: name.to_owned(),
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_measure::RunVerdict;
    use proptest::prelude::*;

    fn evaluated(robustness: f64, ln_likelihood: f64, departure: f64) -> EvaluatedPoint {
        let verdict = RunVerdict::new(robustness);
        EvaluatedPoint {
            number: 1,
            point: vec![0.5],
            values: vec![0.5],
            ln_likelihood,
            distance_from_nominal: departure,
            harm: -robustness / 100.0,
            verdict,
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// A failure is better than none, and of two failures the one nearer to the objective is better.
        #[test]
        fn failures_come_first_in_the_order_of_the_objective(
            safe in 0.0..100.0f64,
            deep in [-50.0..-1e-9f64, -50.0..-1e-9],
            likely in [
                prop_oneof![Just(f64::NEG_INFINITY), -90.0..30.0f64],
                prop_oneof![Just(f64::NEG_INFINITY), -90.0..30.0f64],
            ],
            far in [0.0..1.0f64, 0.0..1.0],
        ) {
            let [first, second] = [0, 1].map(|i| evaluated(deep[i], likely[i], far[i]));
            for aim in SearchObjective::ALL {
                prop_assert_eq!(aim.name().parse::<SearchObjective>(), Ok(aim));
                prop_assert!(aim.cost(&first) < aim.cost(&evaluated(safe, likely[0], far[0])));
            }
            let is_first = |aim: SearchObjective| aim.cost(&first) < aim.cost(&second);
            prop_assert_eq!(is_first(SearchObjective::Severest), deep[0] < deep[1]);
            prop_assert_eq!(is_first(SearchObjective::Nearest), far[0] < far[1]);
            prop_assert_eq!(is_first(SearchObjective::Harm), deep[0] < deep[1]);
            prop_assert_eq!(is_first(SearchObjective::Likeliest), likely[0] > likely[1]);
        }
    }
}
