//! What a vehicle under test must not do to others and to its passengers, whether or not anybody touches.

use std::fmt;
use std::str::FromStr;

use super::demand::InducedBraking;
use super::usefulness::{SpeedAmplification, UnnecessaryBraking};
use crate::scenario::Scenario;
use crate::sim::SimulationResult;

/// A rule that every vehicle under test has to keep until its first impact, by the measures of an assessment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum DrivingRule {
    /// It does not brake without cause ([`UnnecessaryBraking`]). Robustness is how much harder it could have braked, in m/s².
    NoUnnecessaryBraking,
    /// The vehicle behind brakes at most so hard ([`InducedBraking::peak_brake_mps2`]), in m/s², positive. Robustness is what is left.
    InducedBraking {
        /// The limit, in m/s².
        max_mps2: f64,
    },
    /// It passes on no disturbance enlarged, where the line drives at one speed at the start ([`SpeedAmplification`]). Robustness is 1
    /// less the ratio of the largest deviations of speed, its own to that of the vehicle ahead.
    NoAmplification,
}

/// What is said where nobody is ahead, behind, or disturbed: more than any rule can leave.
const NOT_APPLICABLE: f64 = f64::INFINITY;

const NO_UNNECESSARY_BRAKING: &str = "no braking without cause";
const NO_AMPLIFICATION: &str = "no amplification";
const INDUCED_BRAKING: &str = "imposed braking at most";
/// The unit as it is printed, and other ways in which a user may write it.
const UNITS: [&str; 3] = ["m/s2", "m/s²", "m/s^2"];

impl DrivingRule {
    /// How all of them are written, for a reader.
    pub const EXAMPLES: [&str; 3] = [NO_UNNECESSARY_BRAKING, "imposed braking at most 4 m/s2", NO_AMPLIFICATION];

    /// How far the vehicles under test are from breaking the rule, the nearest of them; negative if one breaks it. None without a trace.
    pub(super) fn robustness(&self, scenario: &Scenario, result: &SimulationResult) -> Option<f64> {
        let trace = result.trace.as_ref()?;
        let under_test = (0..scenario.vehicles().len()).filter(|&index| scenario.is_under_test(index));
        let of_each = |index: usize| match self {
            Self::NoUnnecessaryBraking => UnnecessaryBraking::margin_mps2(trace, &result.impacts, index),
            Self::InducedBraking { max_mps2: at_most_mps2 } => {
                let imposed = InducedBraking::from_trace(trace, &result.impacts, index)
                    .and_then(|imposed| imposed.peak_brake_mps2);
                imposed.map(|peak_mps2| at_most_mps2 - peak_mps2)
            }
            Self::NoAmplification => {
                let start_s = trace.time_s.first()?;
                let all = SpeedAmplification::from_trace(trace, *start_s)?;
                index.checked_sub(1).and_then(|pair| all.of_each.get(pair).copied().flatten()).map(|ratio| 1.0 - ratio)
            }
        };
        Some(under_test.filter_map(of_each).fold(NOT_APPLICABLE, f64::min))
    }
}

impl fmt::Display for DrivingRule {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NoUnnecessaryBraking => out.write_str(NO_UNNECESSARY_BRAKING),
            Self::InducedBraking { max_mps2: at_most_mps2 } => {
                write!(out, "{INDUCED_BRAKING} {at_most_mps2} {}", UNITS[0])
            }
            Self::NoAmplification => out.write_str(NO_AMPLIFICATION),
        }
    }
}

/// A text is no rule of conduct.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{text}` is no rule of conduct: there are {}", DrivingRule::EXAMPLES.join(", "))]
pub struct UnknownDrivingRule {
    /// What was found.
    text: String,
}

impl FromStr for DrivingRule {
    type Err = UnknownDrivingRule;

    fn from_str(text: &str) -> Result<Self, UnknownDrivingRule> {
        let unknown = || UnknownDrivingRule { text: text.to_owned() };
        match text {
            NO_UNNECESSARY_BRAKING => Ok(Self::NoUnnecessaryBraking),
            NO_AMPLIFICATION => Ok(Self::NoAmplification),
            _ => {
                let rest = text.strip_prefix(INDUCED_BRAKING);
                let number = rest.and_then(|rest| UNITS.iter().find_map(|unit| rest.strip_suffix(unit)));
                let limit = number.and_then(|number| number.trim().parse::<f64>().ok());
                let at_most_mps2 = limit.filter(|limit| limit.is_finite() && *limit > 0.0).ok_or_else(unknown)?;
                Ok(Self::InducedBraking { max_mps2: at_most_mps2 })
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::control::ControllerSpec;
    use crate::measure::Specification;
    use crate::scenario::{PaperDistribution, built_in_scenario};
    use crate::sim::{AfterContact, RecordingLevel, Run, RunOptions, simulate};
    use proptest::prelude::*;

    #[test]
    fn rules_survive_their_texts_and_others_are_none() {
        for text in DrivingRule::EXAMPLES {
            assert_eq!(text.parse::<DrivingRule>().unwrap().to_string(), text);
        }
        for unit in UNITS {
            let text = format!("imposed braking at most 4 {unit}");
            assert_eq!(text.parse(), Ok(DrivingRule::InducedBraking { max_mps2: 4.0 }), "{text}");
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

    /// Behind a leader that keeps its speed whoever brakes fully brakes without cause, and a reference driver does not.
    #[test]
    fn full_brakes_without_cause_are_found_and_causes_are_known() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let judged = |rule: &str, controller: &str| {
            let rule = Specification::parse(rule, &scenario).unwrap();
            let options = RunOptions::new(ControllerSpec::from_name(controller).unwrap());
            rule.judge_scenario(&scenario, options).unwrap().robustness
        };
        assert!(judged(NO_UNNECESSARY_BRAKING, "idm") >= 0.0);
        assert!(judged("imposed braking at most 20 m/s2", "baseline") > 0.0);
        assert!(judged("imposed braking at most 0.1 m/s2", "baseline") < 0.0);
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(40))]
        /// The sign is that of the measures which assessments count.
        #[test]
        fn the_sign_is_that_of_the_measure(index in 0..200_u64, controller in 0..4_usize) {
            let scenario = PaperDistribution { seed: 3 }.draw(index).unwrap();
            let name = ["idm", "baseline", "acc-aeb", "match-leader"][controller];
            let options = RunOptions::new(ControllerSpec::from_name(name).unwrap());
            let run = Run::new(&scenario, options.with_after_contact(AfterContact::Continue)).unwrap();
            let result = simulate(&run, RecordingLevel::Trace);
            let trace = result.trace.as_ref().unwrap();
            let needless = UnnecessaryBraking::from_trace(trace, &result.impacts, 1).unwrap();
            let margin = DrivingRule::NoUnnecessaryBraking.robustness(&scenario, &result).unwrap();
            prop_assert_eq!(margin < 0.0, !needless.is_empty(), "{} {:?}", margin, needless);
            let imposed = InducedBraking::from_trace(trace, &result.impacts, 1).and_then(|imposed| imposed.peak_brake_mps2);
            let left = DrivingRule::InducedBraking { max_mps2: 4.0 }.robustness(&scenario, &result).unwrap();
            prop_assert_eq!(left < 0.0, imposed.is_some_and(|peak| peak > 4.0));
        }
    }
}
