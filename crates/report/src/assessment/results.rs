//! The results of simulations, searches and checks: everything that an assessment gathers before it concludes.

use serde::Serialize;

use super::claim_draft::ClaimDraft;
use super::gather_context::GatherContext;
use super::parts::{
    FailureSearches, FileScenarios, HarmReport, PaperScenarios, Proofs, SpaceSamples, Suites,
    UsefulnessReport,
};
use super::report_part::{ReportPart, sort_by_chapter};
use super::{AssessError, AssessmentPlan, Evidence};

/// Declares [`GatheredResults`]. A row names a part and its field, in the order of `assessment.json`. The part has a
/// function `gather` that returns the field.
macro_rules! gathered_results {
    ($($(#[$attribute:meta])* $part:ident => $field:ident: $type:ty,)*) => {
        /// All results that an assessment gathered. The rest of the report follows from them and the plan.
        #[derive(Debug, Clone, Serialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct GatheredResults {
            $($(#[$attribute])* pub $field: $type,)*
            /// Proved claims.
            pub proofs: Proofs,
        }

        impl GatheredResults {
            pub(super) fn gather(work: &GatherContext<'_>) -> Result<Self, AssessError> {
                $(let $field = $part::gather(work)?;)*
                let certified: Vec<&dyn ReportPart> = [$(as_part::<$part>(&$field)),*]
                    .into_iter()
                    .flatten()
                    .collect();
                let proofs = Proofs::gather(work, &certified)?;
                Ok(Self { $($field,)* proofs })
            }

            /// Returns the parts that were gathered, in the order of the fields.
            pub(super) fn parts(&self) -> Vec<&dyn ReportPart> {
                let parts = [$(as_part::<$part>(&self.$field),)* as_part::<Proofs>(&self.proofs)];
                parts.into_iter().flatten().collect()
            }
        }
    };
}

gathered_results! {
    /// Paper's three scenarios; absent if the plan leaves the paper out.
    PaperScenarios => paper_scenarios: Option<PaperScenarios>,
    /// Failures counted on random scenarios of scenario spaces.
    SpaceSamples => rate_spaces: SpaceSamples,
    /// Collisions ahead and behind, and harm; absent unless the configuration asks for them.
    #[serde(skip_serializing_if = "Option::is_none")]
    HarmReport => harm: Option<HarmReport>,
    /// Scenarios from files; absent if the configuration names none.
    FileScenarios => file_scenarios: Option<FileScenarios>,
    /// Tests that are modelled on regulations; absent if the configuration names no suites.
    #[serde(skip_serializing_if = "Option::is_none")]
    Suites => suites: Option<Suites>,
    /// Results of searches for failures.
    FailureSearches => searches: FailureSearches,
    /// Behaviour of each controller in everyday traffic; absent if the plan makes no such drives.
    UsefulnessReport => usefulness: Option<UsefulnessReport>,
}

/// Returns a field as a part; `None` if it is absent.
fn as_part<'a, P: ReportPart + 'a>(field: impl Into<Option<&'a P>>) -> Option<&'a dyn ReportPart> {
    field.into().map(|part| part as &dyn ReportPart)
}

impl GatheredResults {
    pub(super) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        self.parts()
            .into_iter()
            .flat_map(|part| part.evidence(plan))
            .collect()
    }

    /// Returns the claims of all parts, in the order of the page.
    pub(super) fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let mut parts = self.parts();
        sort_by_chapter(&mut parts);
        parts
            .into_iter()
            .flat_map(|part| part.claims(plan))
            .collect()
    }
}
