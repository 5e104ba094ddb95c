//! Gates: the conditions of an assessment to pass, as a configuration states them.

use serde::{Deserialize, Serialize};

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
    #[serde(alias = "needless-braking-at-most")]
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
