//! Relative falsification: a failure counts only if a partner simulation passes.
//!
//! With robustness r of the run and p of the partner, the result is max(r, -p): negative only if the run fails and the
//! partner passes. If the partner's controller gave no answer, the run does not count and is reported separately.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crumple_world::measure::RunVerdict;
use crumple_world::scenario::{Driver, Scenario, ScenarioSpec};
use crumple_world::sim::{NamedController, UnknownController};

/// A condition that a partner simulation must satisfy for a failure to count.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum FailureCriterion {
    /// Another controller passes the same scenario.
    Differential(NamedController),
    /// The controller under test passes a partner scenario that should not be easier.
    Metamorphic(MetamorphicRelation),
}

/// A change that should make no scenario worse. A scenario violates the relation if it fails, although its partner with
/// less of the change passes.
///
/// Based on metamorphic testing, which needs no oracle (Chen, Cheung and Yiu 1998, HKUST-CS98-01).
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum MetamorphicRelation {
    /// All vehicles ahead of the first vehicle under test start further away.
    LargerGap {
        /// Additional gap, in metres.
        by_m: f64,
    },
    /// The road has more friction.
    MoreFriction {
        /// Additional friction coefficient.
        by: f64,
    },
    /// The vehicles under test react earlier, as after an earlier warning.
    EarlierReaction {
        /// Difference of the reaction delays, in seconds.
        by_s: f64,
    },
}

/// The error of a relation that cannot be parsed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "unknown relation `{0}`: use larger-gap=M, in metres above 0, more-friction=F, above 0 and below 1, or \
     earlier-reaction=S, in seconds above 0"
)]
pub struct UnknownRelation(String);

const LARGER_GAP: &str = "larger-gap";
const MORE_FRICTION: &str = "more-friction";
const EARLIER_REACTION: &str = "earlier-reaction";

impl MetamorphicRelation {
    /// Returns the partner of a scenario, with less of the change; `None` if it would be invalid.
    #[must_use]
    pub fn partner(self, scenario: &Scenario) -> Option<Scenario> {
        match self {
            Self::LargerGap { by_m } => {
                let first = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index))?;
                let nearer = scenario.edited(|spec| {
                    spec.vehicles.iter_mut().take(first).for_each(|ahead| ahead.position_m -= by_m);
                });
                (first > 0).then_some(nearer.ok()?)
            }
            Self::MoreFriction { by } => scenario.edited(|spec| spec.environment.friction -= by).ok(),
            Self::EarlierReaction { by_s } => {
                let delay = |spec: &mut ScenarioSpec| {
                    let under_test = spec.vehicles.iter_mut().filter(|vehicle| vehicle.driver == Driver::UnderTest);
                    under_test.for_each(|vehicle| vehicle.reaction_delay_s += by_s);
                };
                scenario.edited(delay).ok()
            }
        }
    }

    /// Describes the partner, as the end of a sentence.
    #[must_use]
    pub fn describe_partner(self) -> String {
        match self {
            Self::LargerGap { by_m } => format!("with {by_m} m less of a gap ahead at the start"),
            Self::MoreFriction { by } => format!("with a friction that is lower by {by}"),
            Self::EarlierReaction { by_s } => format!("with reactions that are {by_s} s later"),
        }
    }
}

impl fmt::Display for MetamorphicRelation {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::LargerGap { by_m } => write!(out, "{LARGER_GAP}={by_m}"),
            Self::MoreFriction { by } => write!(out, "{MORE_FRICTION}={by}"),
            Self::EarlierReaction { by_s } => write!(out, "{EARLIER_REACTION}={by_s}"),
        }
    }
}

impl FromStr for MetamorphicRelation {
    type Err = UnknownRelation;

    fn from_str(text: &str) -> Result<Self, UnknownRelation> {
        let unknown = || UnknownRelation(text.to_owned());
        let (name, number) = text.split_once('=').ok_or_else(unknown)?;
        let number = number.parse::<f64>().ok().filter(|number| number.is_finite() && *number > 0.0);
        match (name, number.ok_or_else(unknown)?) {
            (LARGER_GAP, by_m) => Ok(Self::LargerGap { by_m }),
            (MORE_FRICTION, by) if by < 1.0 => Ok(Self::MoreFriction { by }),
            (EARLIER_REACTION, by_s) => Ok(Self::EarlierReaction { by_s }),
            _ => Err(unknown()),
        }
    }
}

impl FailureCriterion {
    pub(super) fn partner(&self, scenario: &Scenario) -> Option<Scenario> {
        match self {
            Self::Differential(_) => Some(scenario.clone()),
            Self::Metamorphic(relation) => relation.partner(scenario),
        }
    }

    /// Returns the controller of the partner simulation, if `own` is under test.
    pub(super) fn partner_controller<'a>(&'a self, own: &'a NamedController) -> &'a NamedController {
        match self {
            Self::Differential(other) => other,
            Self::Metamorphic(_) => own,
        }
    }

    pub(super) fn is_self_comparison(&self, own: &NamedController) -> bool {
        let digest = |controller: &NamedController| controller.policy().map(|policy| policy.digest());
        match self {
            Self::Differential(other) => {
                let is_named_alike = other.name == own.name && other.disambiguating_hash() == own.disambiguating_hash();
                is_named_alike && digest(other) == digest(own)
            }
            Self::Metamorphic(_) => false,
        }
    }

    pub(super) fn to_record(&self) -> FailureCriterionRecord {
        match self {
            Self::Differential(other) => FailureCriterionRecord::Differential {
                controller: other.name.clone(),
                policy_sha256: other.policy().map(|policy| policy.digest()),
                controller_sha256: other.disambiguating_hash(),
            },
            Self::Metamorphic(relation) => FailureCriterionRecord::Metamorphic(*relation),
        }
    }

    /// Combines a verdict with that of the partner. Without a partner, the robustness is infinite. If the partner's
    /// controller fails, `failure` records it, and the robustness is infinite.
    pub(super) fn combine_verdicts(own: RunVerdict, partner: Option<RunVerdict>) -> RunVerdict {
        if let Some(failed) = partner.and_then(|partner| partner.failure) {
            return RunVerdict { failure: Some(failed), ..RunVerdict::new(f64::INFINITY) };
        }
        let robustness = match partner.map(|partner| partner.robustness) {
            None => f64::INFINITY,
            Some(beside) if own.robustness.is_nan() || beside.is_nan() => f64::NAN,
            Some(beside) => own.robustness.max(-beside),
        };
        RunVerdict { robustness, ..own }
    }
}

/// A [`FailureCriterion`] in a file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum FailureCriterionRecord {
    /// A [`FailureCriterion::Differential`].
    #[serde(rename = "against")]
    Differential {
        /// Name of the other controller, or its file.
        controller: String,
        /// Hash of its policy; `None` if the controller is not a policy.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        policy_sha256: Option<String>,
        /// Identity of the controller, if its name does not determine it.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        controller_sha256: Option<String>,
    },
    /// A [`FailureCriterion::Metamorphic`].
    Metamorphic(MetamorphicRelation),
}

impl FailureCriterionRecord {
    /// Returns the criterion; relative paths start at `folder`.
    ///
    /// # Errors
    /// [`UnknownController`] if there is no such controller.
    pub(super) fn resolve(&self, folder: &Path) -> Result<FailureCriterion, UnknownController> {
        Ok(match self {
            Self::Differential { controller, .. } => {
                FailureCriterion::Differential(NamedController::find(controller, folder)?)
            }
            Self::Metamorphic(relation) => FailureCriterion::Metamorphic(*relation),
        })
    }

    /// Describes the failures that count, as the end of a sentence.
    #[must_use]
    pub(crate) fn describe(&self) -> String {
        match self {
            Self::Differential { controller, .. } => format!("where `{controller}` satisfies the specification"),
            Self::Metamorphic(relation) => format!("that do not occur {}", relation.describe_partner()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::scenario::built_in_scenario;

    #[test]
    fn relations_survive_their_texts() {
        for text in ["larger-gap=2", "larger-gap=0.25", "more-friction=0.1", "earlier-reaction=0.5"] {
            assert_eq!(text.parse::<MetamorphicRelation>().unwrap().to_string(), text);
        }
        for text in ["", "larger-gap", "larger-gap=", "larger-gap=-1", "larger-gap=nan", "more-friction=1", "less=1"] {
            assert!(text.parse::<MetamorphicRelation>().is_err(), "{text}");
        }
    }

    #[test]
    fn partners_differ_only_as_the_relation_requires() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let nearer = MetamorphicRelation::LargerGap { by_m: 2.0 }.partner(&scenario).unwrap();
        let positions = |scenario: &Scenario| scenario.vehicles().iter().map(|v| v.position_m).collect::<Vec<_>>();
        let (own, partner) = (positions(&scenario), positions(&nearer));
        assert_eq!(own[0] - 2.0, partner[0]);
        assert_eq!(own[1..], partner[1..]);
        let slippery = MetamorphicRelation::MoreFriction { by: 0.25 }.partner(&scenario).unwrap();
        assert_eq!(slippery.spec().environment.friction, scenario.spec().environment.friction - 0.25);
        let later = MetamorphicRelation::EarlierReaction { by_s: 0.2 }.partner(&scenario).unwrap();
        let delays: Vec<_> = later.vehicles().iter().map(|vehicle| vehicle.reaction_delay_s).collect();
        assert_eq!(delays, [0.0, 0.2, 0.0]);
        // An invalid scenario is no partner.
        assert!(MetamorphicRelation::LargerGap { by_m: 1e3 }.partner(&scenario).is_none());
        assert!(MetamorphicRelation::MoreFriction { by: 0.999 }.partner(&scenario).is_none());
    }

    #[test]
    fn a_failure_counts_where_the_partner_holds() {
        let evaluated = |own: f64, partner: Option<f64>| {
            FailureCriterion::combine_verdicts(RunVerdict::new(own), partner.map(RunVerdict::new)).robustness
        };
        assert_eq!(evaluated(-3.0, Some(1.0)), -1.0);
        assert_eq!(evaluated(-0.5, Some(1.0)), -0.5);
        assert_eq!(evaluated(-0.5, Some(f64::INFINITY)), -0.5);
        assert_eq!(evaluated(2.0, Some(1.0)), 2.0);
        assert_eq!(evaluated(-3.0, Some(-4.0)), 4.0);
        // A robustness of zero passes.
        assert!(evaluated(-3.0, Some(0.0)) >= 0.0);
        assert_eq!(evaluated(-3.0, None), f64::INFINITY);
        assert_eq!(evaluated(f64::NEG_INFINITY, Some(1.0)), -1.0);
        assert!(evaluated(f64::NAN, Some(1.0)).is_nan() && evaluated(-1.0, Some(f64::NAN)).is_nan());
    }

    #[test]
    fn a_partner_without_an_answer_neither_holds_nor_fails() {
        let silent = RunVerdict { failure: Some((1.5, 1)), ..RunVerdict::new(f64::NEG_INFINITY) };
        for own in [RunVerdict::new(-3.0), RunVerdict::new(3.0), silent] {
            let beside = FailureCriterion::combine_verdicts(own, Some(silent));
            assert_eq!((beside.robustness, beside.failure), (f64::INFINITY, Some((1.5, 1))));
        }
        let own = FailureCriterion::combine_verdicts(silent, Some(RunVerdict::new(2.0)));
        assert_eq!((own.robustness, own.failure), (-2.0, Some((1.5, 1))));
    }
}
