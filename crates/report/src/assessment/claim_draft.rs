//! Claims about all controllers, before their evidence is known.

use super::AssessmentPlan;
use super::claims::{AssuranceClaim, Domain, Property};
use crumple_sim::observation::EstimatorKind;

/// One property in one domain, claimed of every controller.
#[derive(Debug, Clone)]
pub(super) struct ClaimDraft {
    /// Anchor of the part with the evidence.
    pub(super) part: &'static str,
    /// Claim in words, if they differ from its own description.
    pub(super) text: Option<String>,
    /// Claim about each controller; absent if it does not apply.
    pub(super) claims: Vec<Option<AssuranceClaim>>,
}

impl ClaimDraft {
    pub(super) fn new(part: &'static str, claims: Vec<Option<AssuranceClaim>>) -> Self {
        Self {
            part,
            text: None,
            claims,
        }
    }

    /// Claims a property of every controller, with the estimator of the plan.
    pub(super) fn about_all(
        plan: &AssessmentPlan,
        part: &'static str,
        property: Property,
        domain: Domain,
    ) -> Self {
        Self::with_estimator(plan, plan.config.estimator, part, property, domain)
    }

    /// Claims a property of every controller, with any estimator.
    pub(super) fn with_estimator(
        plan: &AssessmentPlan,
        estimator: EstimatorKind,
        part: &'static str,
        property: Property,
        domain: Domain,
    ) -> Self {
        let claims = (0..plan.controllers.len()).map(|index| {
            Some(AssuranceClaim {
                subject: plan.claim_subject(index, estimator)?,
                property: property.clone(),
                domain: domain.clone(),
            })
        });
        Self::new(part, claims.collect())
    }

    pub(super) fn with_text(self, text: String) -> Self {
        Self {
            text: Some(text),
            ..self
        }
    }

    /// Drops the claim about the first controller.
    pub(super) fn without_first(mut self) -> Self {
        if let Some(first) = self.claims.first_mut() {
            *first = None;
        }
        self
    }
}
