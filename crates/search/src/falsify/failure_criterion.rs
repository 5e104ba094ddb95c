//! Relative falsification: a failure counts only if a partner simulation passes.
//!
//! With robustness r of the run and p of the partner, the result is max(r, -p): negative only if the run fails and the
//! partner passes. If the partner's controller gave no answer, the run does not count and is reported separately.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crumple_controllers::{Controllers, UnknownController};
use crumple_measure::RunVerdict;
use crumple_sim::engine::NamedController;

/// A condition that a partner simulation must satisfy for a failure to count.
#[derive(Debug, Clone)]
#[non_exhaustive]
pub enum FailureCriterion {
    /// Another controller passes the same scenario.
    Differential(NamedController),
}

impl FailureCriterion {
    /// Returns the controller of the partner simulation.
    pub(super) fn partner_controller(&self) -> &NamedController {
        let Self::Differential(partner) = self;
        partner
    }

    pub(super) fn is_self_comparison(&self, own: &NamedController) -> bool {
        let partner = self.partner_controller();
        let is_named_alike =
            partner.name == own.name && partner.disambiguating_hash() == own.disambiguating_hash();
        let own_digest = own.policy().map(|policy| policy.digest());
        let partner_digest = partner.policy().map(|policy| policy.digest());
        is_named_alike && partner_digest == own_digest
    }

    pub(super) fn to_record(&self) -> FailureCriterionRecord {
        let partner = self.partner_controller();
        FailureCriterionRecord::Differential {
            controller: partner.name.clone(),
            policy_sha256: partner.policy().map(|policy| policy.digest()),
            controller_sha256: partner.disambiguating_hash(),
        }
    }

    /// Combines a verdict with that of the partner. If the partner's controller fails, `failure` records it, and the
    /// robustness is infinite.
    pub(super) fn combine_verdicts(own: RunVerdict, partner: RunVerdict) -> RunVerdict {
        if let Some(failed) = partner.failure {
            return RunVerdict {
                failure: Some(failed),
                ..RunVerdict::new(f64::INFINITY)
            };
        }
        let is_undefined = own.robustness.is_nan() || partner.robustness.is_nan();
        let robustness = if is_undefined {
            f64::NAN
        } else {
            own.robustness.max(-partner.robustness)
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
    #[serde(alias = "against")]
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
}

impl FailureCriterionRecord {
    /// Returns the criterion; relative paths start at `folder`.
    ///
    /// # Errors
    /// [`UnknownController`] if there is no such controller.
    pub(super) fn resolve(
        &self,
        folder: &Path,
        controllers: Controllers,
    ) -> Result<FailureCriterion, UnknownController> {
        let Self::Differential { controller, .. } = self;
        Ok(FailureCriterion::Differential(
            controllers.find(controller, folder)?,
        ))
    }

    /// Describes the failures that count, as the end of a sentence.
    #[must_use]
    pub(crate) fn describe(&self) -> String {
        let Self::Differential { controller, .. } = self;
        format!("where `{controller}` satisfies the specification")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failure_counts_only_if_the_partner_passes() {
        let evaluated = |own: f64, partner: f64| {
            FailureCriterion::combine_verdicts(RunVerdict::new(own), RunVerdict::new(partner))
                .robustness
        };
        assert_eq!(evaluated(-3.0, 1.0), -1.0);
        assert_eq!(evaluated(-0.5, 1.0), -0.5);
        assert_eq!(evaluated(-0.5, f64::INFINITY), -0.5);
        assert_eq!(evaluated(2.0, 1.0), 2.0);
        assert_eq!(evaluated(-3.0, -4.0), 4.0);
        // A robustness of zero passes.
        assert!(evaluated(-3.0, 0.0) >= 0.0);
        assert_eq!(evaluated(f64::NEG_INFINITY, 1.0), -1.0);
        assert!(evaluated(f64::NAN, 1.0).is_nan() && evaluated(-1.0, f64::NAN).is_nan());
    }

    #[test]
    fn a_partner_without_an_answer_makes_the_robustness_infinite() {
        let silent = RunVerdict {
            failure: Some((1.5, 1)),
            ..RunVerdict::new(f64::NEG_INFINITY)
        };
        for own in [RunVerdict::new(-3.0), RunVerdict::new(3.0), silent] {
            let combined = FailureCriterion::combine_verdicts(own, silent);
            assert_eq!(
                (combined.robustness, combined.failure),
                (f64::INFINITY, Some((1.5, 1)))
            );
        }
        let own = FailureCriterion::combine_verdicts(silent, RunVerdict::new(2.0));
        assert_eq!((own.robustness, own.failure), (-2.0, Some((1.5, 1))));
    }
}
