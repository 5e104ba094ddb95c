//! A specification asked of one scenario.

use serde::Serialize;

use super::{CampaignError, FailureKind, Specification};
use crate::scenario::Scenario;
use crate::sim::{Run, RunOptions, simulate};

/// What a specification says of a scenario.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Judged {
    /// The specification.
    pub specification: String,
    /// Whether it holds.
    pub satisfied: bool,
    /// Robustness: below 0 if and only if it does not hold.
    #[serde(with = "crate::falsify::wide")]
    pub robustness: f64,
}

impl Specification {
    /// Judges a scenario as a campaign does: on a run of its own, that ends at contact or goes on as the specification needs.
    ///
    /// # Errors
    /// [`CampaignError`] if the scenario cannot be run with these options, or the specification does not fit it.
    pub fn judge_scenario(&self, scenario: &Scenario, options: RunOptions) -> Result<Judged, CampaignError> {
        let run = Run::new(scenario, options.with_after_contact(self.after_contact()))?;
        let verdict = self.judge(&run, &simulate(&run, self.keep()))?;
        let (robustness, satisfied) = (verdict.robustness, FailureKind::of(&verdict, self).is_none());
        Ok(Judged { specification: self.to_string(), satisfied, robustness })
    }
}
