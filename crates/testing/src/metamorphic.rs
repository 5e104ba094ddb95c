//! Changes of a scenario that should make no outcome worse.

use std::fmt;

use crumple_sim::scenario::{Driver, Scenario};

/// A change that should make no scenario worse. A scenario violates the relation if it fails, although its partner with
/// less of the change passes.
///
/// Based on metamorphic testing, which needs no oracle (Chen, Cheung and Yiu 1998, HKUST-CS98-01).
#[derive(Debug, Clone, Copy, PartialEq)]
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

impl MetamorphicRelation {
    /// Returns the partner of a scenario, with less of the change; `None` if it would be invalid.
    #[must_use]
    pub fn partner(self, scenario: &Scenario) -> Option<Scenario> {
        match self {
            Self::LargerGap { by_m } => {
                let first =
                    (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index))?;
                let nearer = scenario.edited(|spec| {
                    spec.vehicles
                        .iter_mut()
                        .take(first)
                        .for_each(|ahead| ahead.position_m -= by_m);
                });
                (first > 0).then_some(nearer.ok()?)
            }
            Self::MoreFriction { by } => {
                scenario.edited(|spec| spec.environment.friction -= by).ok()
            }
            Self::EarlierReaction { by_s } => {
                let delayed = scenario.edited(|spec| {
                    let under_test = spec
                        .vehicles
                        .iter_mut()
                        .filter(|vehicle| vehicle.driver == Driver::UnderTest);
                    under_test.for_each(|vehicle| vehicle.reaction_delay_s += by_s);
                });
                delayed.ok()
            }
        }
    }

    /// Describes the partner, as the end of a sentence.
    pub(crate) fn describe_partner(self) -> String {
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
            Self::LargerGap { by_m } => write!(out, "larger-gap={by_m}"),
            Self::MoreFriction { by } => write!(out, "more-friction={by}"),
            Self::EarlierReaction { by_s } => write!(out, "earlier-reaction={by_s}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::built_in_scenario;

    #[test]
    fn partners_differ_only_as_the_relation_requires() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let nearer = MetamorphicRelation::LargerGap { by_m: 2.0 }
            .partner(&scenario)
            .unwrap();
        let positions = |scenario: &Scenario| {
            scenario
                .vehicles()
                .iter()
                .map(|v| v.position_m)
                .collect::<Vec<_>>()
        };
        let (own, partner) = (positions(&scenario), positions(&nearer));
        assert_eq!(own[0] - 2.0, partner[0]);
        assert_eq!(own[1..], partner[1..]);
        let slippery = MetamorphicRelation::MoreFriction { by: 0.25 }
            .partner(&scenario)
            .unwrap();
        assert_eq!(
            slippery.spec().environment.friction,
            scenario.spec().environment.friction - 0.25
        );
        let later = MetamorphicRelation::EarlierReaction { by_s: 0.2 }
            .partner(&scenario)
            .unwrap();
        let delays: Vec<_> = later
            .vehicles()
            .iter()
            .map(|vehicle| vehicle.reaction_delay_s)
            .collect();
        assert_eq!(delays, [0.0, 0.2, 0.0]);
        // An invalid scenario is no partner.
        assert!(
            MetamorphicRelation::LargerGap { by_m: 1e3 }
                .partner(&scenario)
                .is_none()
        );
        assert!(
            MetamorphicRelation::MoreFriction { by: 0.999 }
                .partner(&scenario)
                .is_none()
        );
    }
}
