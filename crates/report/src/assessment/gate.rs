//! Gates: the conditions of an assessment to pass.

use serde::{Deserialize, Serialize};

use super::AssessConfig;
use super::parts::EVERYDAY_SPACES;

/// A condition that must hold for an assessment to pass.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "require", rename_all = "kebab-case", deny_unknown_fields)]
#[non_exhaustive]
pub enum AssessmentGate {
    /// A controller collides in none of the paper's scenarios. Before 0.4.0: `no-contact-in-paper-scenarios`.
    #[serde(alias = "no-contact-in-paper-scenarios")]
    NoCollisionInPaperScenarios {
        /// Name of the controller.
        controller: String,
    },
    /// A controller collides in none of the scenarios of `scenarios` and `recordings`; spaces are not considered.
    NoCollisionInScenarioFiles {
        /// Name of the controller.
        controller: String,
    },
    /// A controller collides in none of the simulated random scenarios of a space. Scenarios that a collision of other
    /// vehicles ends count against it.
    NoCollisionInSpace {
        /// Name of the controller.
        controller: String,
        /// Scenario space: one of `distributions`, or `traffic` or `high-risk` if `everyday_draws` is above 0.
        space: String,
    },
    /// The failure rate of a controller in a scenario space is at most this, by bounds on counted runs.
    RateAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest bound that passes, in percent.
        percent: f64,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space: Option<String>,
    },
    /// A controller collides in no more random scenarios of a space than another one.
    RateNotAbove {
        /// Name of the controller.
        controller: String,
        /// Name of the other controller.
        than: String,
        /// Scenario space, one of `distributions`. Default: the only one there is.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        space: Option<String>,
    },
    /// No search found a failure of a controller that is avoidable or undecided.
    NoAvoidableFailure {
        /// Name of the controller.
        controller: String,
        /// Scenario space of the search.
        space: String,
    },
    /// A controller brakes unnecessarily in at most this share of its drives in everyday traffic.
    #[serde(rename = "needless-braking-at-most")]
    UnnecessaryBrakingAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest share that passes, in percent.
        percent: f64,
    },
    /// A controller falls behind in at most this share of its drives in everyday traffic.
    LeftBehindAtMost {
        /// Name of the controller.
        controller: String,
        /// Largest share that passes, in percent.
        percent: f64,
    },
    /// No speed oscillation grows from vehicle to vehicle in a line with a controller: the largest gain over all mean
    /// speeds and frequencies, rounded to three decimals, is at most 1.000. Before 0.4.0: in a single manoeuvre.
    StringStable {
        /// Name of the controller.
        controller: String,
    },
    /// A controller passes every test of a suite that can be run.
    SuitePassed {
        /// Name of the controller.
        controller: String,
        /// Suite, as `suites` names it.
        suite: String,
    },
    /// The checker accepts every certificate.
    ProofsAccepted {},
    /// The assessment is compared with an earlier one, and no result is worse.
    NothingWorse {},
}

impl AssessmentGate {
    pub(super) fn controllers_mut(&mut self) -> Vec<(&'static str, &mut String)> {
        match self {
            Self::RateNotAbove {
                controller, than, ..
            } => vec![("controller", controller), ("than", than)],
            Self::NoCollisionInPaperScenarios { controller }
            | Self::NoCollisionInScenarioFiles { controller }
            | Self::NoCollisionInSpace { controller, .. }
            | Self::RateAtMost { controller, .. }
            | Self::UnnecessaryBrakingAtMost { controller, .. }
            | Self::LeftBehindAtMost { controller, .. }
            | Self::StringStable { controller }
            | Self::SuitePassed { controller, .. }
            | Self::NoAvoidableFailure { controller, .. } => vec![("controller", controller)],
            Self::ProofsAccepted {} | Self::NothingWorse {} => Vec::new(),
        }
    }

    /// Returns the field, and the problem, that prevents any assessment of this configuration from evaluating the gate.
    pub(super) fn config_problem(&self, config: &AssessConfig) -> Option<(&'static str, String)> {
        let needs_drives = || {
            (config.everyday_draws == 0)
                .then(|| ("require", "needs `everyday_draws` above 0".to_owned()))
        };
        match self {
            Self::NoCollisionInPaperScenarios { .. } if !config.paper => {
                Some(("require", "needs `paper = true`".to_owned()))
            }
            Self::NoAvoidableFailure { space, .. } if !config.search_spaces().contains(space) => {
                Some(("space", format!("`{space}` is not among `search.spaces`")))
            }
            Self::RateAtMost { percent, space, .. } => {
                share_problem(*percent).or_else(|| space_problem(space, config))
            }
            Self::RateNotAbove {
                controller, than, ..
            } if controller == than => Some((
                "than",
                "is the controller itself: name another one".to_owned(),
            )),
            Self::RateNotAbove { .. } if config.draws == 0 => {
                Some(("require", "needs `draws` above 0".to_owned()))
            }
            Self::RateNotAbove { space, .. } => space_problem(space, config),
            Self::NoCollisionInSpace { space, .. } => simulated_space_problem(space, config),
            Self::NoCollisionInScenarioFiles { .. }
                if config.scenarios.is_empty() && config.recordings.is_empty() =>
            {
                Some(("require", "needs `scenarios` or `recordings`".to_owned()))
            }
            Self::UnnecessaryBrakingAtMost { percent, .. }
            | Self::LeftBehindAtMost { percent, .. } => {
                share_problem(*percent).or_else(needs_drives)
            }
            Self::StringStable { .. } => needs_drives(),
            Self::SuitePassed { controller, suite } => suite_problem(config, controller, suite),
            _ => None,
        }
    }
}

fn suite_problem(
    config: &AssessConfig,
    controller: &String,
    suite: &str,
) -> Option<(&'static str, String)> {
    let Some(named) = config.suites.iter().find(|named| named.suite == suite) else {
        return Some(("suite", format!("`{suite}` is not among `suites`")));
    };
    let is_tested = named
        .controllers
        .as_ref()
        .is_none_or(|tested| tested.contains(controller));
    (!is_tested).then(|| {
        (
            "controller",
            format!("`{controller}` is not tested by suite `{suite}`"),
        )
    })
}

fn share_problem(percent: f64) -> Option<(&'static str, String)> {
    let is_share = (0.0..=100.0).contains(&percent);
    (!is_share).then(|| ("percent", format!("must be from 0 to 100, found {percent}")))
}

fn space_problem(space: &Option<String>, config: &AssessConfig) -> Option<(&'static str, String)> {
    let known = config.rate_spaces();
    match space {
        _ if known.is_empty() => Some(("require", "needs `distributions`".to_owned())),
        Some(space) if !known.contains(space) => {
            Some(("space", format!("`{space}` is not among `distributions`")))
        }
        None if known.len() > 1 => Some((
            "space",
            "must be named, because there are several `distributions`".to_owned(),
        )),
        _ => None,
    }
}

fn simulated_space_problem(space: &str, config: &AssessConfig) -> Option<(&'static str, String)> {
    let is_drawn = config.rate_spaces().iter().any(|known| known == space);
    let is_driven = EVERYDAY_SPACES.contains(&space);
    match (is_drawn && config.draws > 0) || (is_driven && config.everyday_draws > 0) {
        true => None,
        false if is_drawn => Some(("require", "needs `draws` above 0".to_owned())),
        false if is_driven => Some((
            "require",
            format!("needs `everyday_draws` above 0, or `{space}` in `distributions`"),
        )),
        false => {
            let [traffic, high_risk] = EVERYDAY_SPACES;
            Some((
                "space",
                format!(
                    "`{space}` is neither among `distributions` nor `{traffic}` or `{high_risk}`"
                ),
            ))
        }
    }
}
