//! Rules of conduct of vehicles under test towards followers and passengers, independent of collisions.

use std::fmt;
use std::str::FromStr;

use super::demand::InducedBraking;
use super::usefulness::{SpeedAmplification, UnnecessaryBraking};
use crumple_sim::engine::{Impact, SimulationResult, Trace};
use crumple_sim::scenario::Scenario;

/// A rule that every vehicle under test must obey until its first impact, based on the measures of an assessment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DrivingRule {
    /// No unnecessary braking ([`UnnecessaryBraking`]). Robustness is the margin of deceleration, in m/s².
    NoUnnecessaryBraking,
    /// A limit on the braking of the follower ([`InducedBraking::peak_brake_mps2`]), in m/s², positive. Robustness is
    /// the margin to it.
    InducedBraking {
        /// Limit, in m/s², positive.
        max_mps2: f64,
    },
    /// No amplification of a disturbance ([`SpeedAmplification`]), if all vehicles start at one speed. Robustness is 1
    /// minus the ratio of the largest speed deviations of the vehicle and its leader.
    NoAmplification,
}

/// Robustness without a leader, a follower, or a disturbance: above that of any rule.
const NOT_APPLICABLE: f64 = f64::INFINITY;

const NO_UNNECESSARY_BRAKING: &str = "no braking without cause";
const NO_AMPLIFICATION: &str = "no amplification";
const INDUCED_BRAKING: &str = "imposed braking at most";
/// Printed unit, and its alternative spellings.
const UNITS: [&str; 3] = ["m/s2", "m/s²", "m/s^2"];

impl DrivingRule {
    /// Examples of all rules, for readers.
    pub const EXAMPLES: [&str; 3] = [
        NO_UNNECESSARY_BRAKING,
        "imposed braking at most 4 m/s2",
        NO_AMPLIFICATION,
    ];

    /// Returns the smallest robustness of the vehicles under test; negative if one violates the rule. `None` without a
    /// trace.
    pub(super) fn robustness(&self, scenario: &Scenario, result: &SimulationResult) -> Option<f64> {
        let trace = result.trace.as_ref()?;
        let under_test =
            (0..scenario.vehicles().len()).filter(|&index| scenario.is_under_test(index));
        Some(
            under_test
                .filter_map(|index| self.vehicle_robustness(trace, &result.impacts, index))
                .fold(NOT_APPLICABLE, f64::min),
        )
    }

    /// Returns the robustness of vehicle `index`; `None` if the rule does not apply to it.
    fn vehicle_robustness(&self, trace: &Trace, impacts: &[Impact], index: usize) -> Option<f64> {
        match self {
            Self::NoUnnecessaryBraking => UnnecessaryBraking::margin_mps2(trace, impacts, index),
            Self::InducedBraking { max_mps2 } => {
                let induced = InducedBraking::from_trace(trace, impacts, index)?;
                Some(max_mps2 - induced.peak_brake_mps2?)
            }
            Self::NoAmplification => {
                let start_s = trace.time_s.first()?;
                let all = SpeedAmplification::from_trace(trace, *start_s)?;
                let ratio = all.of_each.get(index.checked_sub(1)?).copied().flatten()?;
                Some(1.0 - ratio)
            }
        }
    }
}

impl fmt::Display for DrivingRule {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoUnnecessaryBraking => out.write_str(NO_UNNECESSARY_BRAKING),
            Self::InducedBraking { max_mps2 } => {
                write!(out, "{INDUCED_BRAKING} {max_mps2} {}", UNITS[0])
            }
            Self::NoAmplification => out.write_str(NO_AMPLIFICATION),
        }
    }
}

/// An error for a text that is not a driving rule.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is not a driving rule: the rules are {}", DrivingRule::EXAMPLES.join(", "))]
pub struct UnknownDrivingRule {
    /// Text of the rule.
    text: String,
}

impl FromStr for DrivingRule {
    type Err = UnknownDrivingRule;

    fn from_str(text: &str) -> Result<Self, UnknownDrivingRule> {
        match text {
            NO_UNNECESSARY_BRAKING => Ok(Self::NoUnnecessaryBraking),
            NO_AMPLIFICATION => Ok(Self::NoAmplification),
            _ => {
                let rest = text.strip_prefix(INDUCED_BRAKING);
                let number =
                    rest.and_then(|rest| UNITS.iter().find_map(|unit| rest.strip_suffix(unit)));
                let limit = number.and_then(|number| number.trim().parse::<f64>().ok());
                let max_mps2 = limit
                    .filter(|limit| limit.is_finite() && *limit > 0.0)
                    .ok_or_else(|| UnknownDrivingRule {
                        text: text.to_owned(),
                    })?;
                Ok(Self::InducedBraking { max_mps2 })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{AfterCollision, RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::PaperDistribution;
    use proptest::prelude::*;

    #[test]
    fn driving_rules_parse_as_they_are_printed_and_other_texts_are_refused() {
        for text in DrivingRule::EXAMPLES {
            assert_eq!(text.parse::<DrivingRule>().unwrap().to_string(), text);
        }
        for unit in UNITS {
            let text = format!("imposed braking at most 4 {unit}");
            assert_eq!(
                text.parse(),
                Ok(DrivingRule::InducedBraking { max_mps2: 4.0 }),
                "{text}"
            );
        }
        for text in [
            "",
            "no braking",
            "imposed braking at most m/s2",
            "imposed braking at most -1 m/s2",
            "imposed braking at most inf m/s2",
        ] {
            assert!(text.parse::<DrivingRule>().is_err(), "{text}");
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(40))]
        /// The sign agrees with the measures of an assessment.
        #[test]
        fn the_sign_of_the_robustness_agrees_with_the_measure(index in 0..200_u64, controller in 0..4_usize) {
            let scenario = PaperDistribution { seed: 3 }.draw(index).unwrap();
            let name = ["idm", "baseline", "acc-aeb", "match-leader"][controller];
            let options = RunOptions::new(BuiltInController::from_name(name).unwrap());
            let run = Run::new(&scenario, options.with_after_collision(AfterCollision::Continue)).unwrap();
            let result = simulate(&run, RecordingLevel::Trace);
            let trace = result.trace.as_ref().unwrap();
            let unnecessary = UnnecessaryBraking::from_trace(trace, &result.impacts, 1).unwrap();
            let margin = DrivingRule::NoUnnecessaryBraking.robustness(&scenario, &result).unwrap();
            prop_assert_eq!(margin < 0.0, !unnecessary.is_empty(), "{} {:?}", margin, unnecessary);
            let induced = InducedBraking::from_trace(trace, &result.impacts, 1);
            let induced = induced.and_then(|braking| braking.peak_brake_mps2);
            let left = DrivingRule::InducedBraking { max_mps2: 4.0 }.robustness(&scenario, &result).unwrap();
            prop_assert_eq!(left < 0.0, induced.is_some_and(|peak| peak > 4.0));
        }
    }
}
