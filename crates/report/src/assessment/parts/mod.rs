//! The parts of an assessment, one file each, and the results that an assessment gathers before it concludes.
//!
//! A new section of the report is a file in this folder that implements [`ReportPart`], and here its line `mod` and its
//! row of the table of results. The line is not in the table: `cargo fmt` skips files whose `mod` a macro writes.

mod answer;
mod argument;
mod certificate_subject;
mod certificates;
mod comparison;
mod distinct_failure;
mod domain_followers;
mod everyday_drives;
mod failure_search;
mod failure_searches;
mod file_scenarios;
mod first_scenarios;
mod follower_kinds;
mod glossary;
mod harm;
#[cfg(test)]
mod library_text_tests;
mod limits;
mod oscillation_gain;
mod paper;
mod proofs;
mod provenance;
mod rate_certificates;
mod recorded_drives;
mod sampling;
mod scenario_cases;
mod search_campaign;
mod share;
mod space_descriptions;
mod suite_json;
mod suites;
mod summary;
mod usefulness;
mod violations;

pub(super) use answer::FirstPageSection;
pub use answer::{FirstPage, SafetyAnswer};
pub use argument::Argument;
pub use certificates::{CertificateStatus, CertificateSubject, CheckedCertificate};
pub use comparison::{
    AssessmentChange, AssessmentComparison, EarlierAssessment, MAX_EVIDENCE_BYTES,
};
pub use distinct_failure::{DistinctFailure, EscapeFile, MethodResult};
pub use failure_search::FailureSearch;
pub use failure_searches::SpaceSearches;
pub(super) use file_scenarios::{ANCHOR as FILE_SCENARIOS_ANCHOR, SCENARIO_FOLDER, scenario_path};
pub use first_scenarios::FirstScenarios;
pub use follower_kinds::{ControllerFollowers, FollowerSpace, KindCounts};
pub use glossary::Glossary;
pub(super) use harm::HARM_RUNS_FILE;
pub use harm::{ACTIVATION_MPS2, ControllerHarm, HarmGroup};
pub use limits::{AssessmentLimits, LimitingAssumption};
pub use oscillation_gain::{GainCurve, LargestGain, OscillationGain};
pub(super) use paper::ANCHOR as PAPER_ANCHOR;
pub use proofs::Proofs;
pub use provenance::{AssessmentProvenance, RunInfo};
pub(super) use rate_certificates::generated_certificate_names;
pub use sampling::{ControllerSample, PairedCounts, SpaceSample};
pub use scenario_cases::ScenarioCases;
pub use share::PercentInterval;
pub use space_descriptions::{ParameterDescription, SpaceDescription, SpaceDescriptions};
pub use suites::{PlannedSuiteResult, SuiteFailure, SuiteOutcome};
pub use summary::{ClaimRow, ClaimSummary, NameExplanation};
pub use usefulness::{ControllerUsefulness, SpaceBraking};
pub use violations::{ViolatingScenario, ViolatingScenarios};

use std::time::{Duration, Instant};

use serde::Serialize;

use super::claim_draft::ClaimDraft;
use super::gather_context::GatherContext;
use super::report_part::{ReportPart, sort_by_chapter};
use super::{AssessError, AssessmentPlan, Evidence};

/// Declares [`GatheredResults`]. A row names the file of a part, the part and its field, in the order of
/// `assessment.json`. The part has a function `gather` that returns the field.
macro_rules! gathered_results {
    ($($(#[$attribute:meta])* $file:ident::$part:ident => $field:ident: $type:ty,)*) => {
        $(pub use $file::$part;)*

        /// All results that an assessment gathered. The rest of the report follows from them and the plan.
        #[derive(Debug, Clone, Serialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub struct GatheredResults {
            $($(#[$attribute])* pub $field: $type,)*
            /// Proved claims.
            pub proofs: Proofs,
            /// Measured times, which no evidence depends on.
            #[serde(skip)]
            pub(super) part_times: PartTimes,
        }

        impl GatheredResults {
            pub(super) fn gather(work: &GatherContext<'_>) -> Result<Self, AssessError> {
                let mut part_times = PartTimes::default();
                $(
                    let begun = Instant::now();
                    let $field = $part::gather(work)?;
                    part_times.add(as_part::<$part>(&$field), begun.elapsed());
                )*
                let certified: Vec<&dyn ReportPart> = [$(as_part::<$part>(&$field)),*]
                    .into_iter()
                    .flatten()
                    .collect();
                let begun = Instant::now();
                let proofs = Proofs::gather(work, &certified)?;
                part_times.add(Some(&proofs), begun.elapsed());
                Ok(Self { $($field,)* proofs, part_times })
            }

            /// Returns the approximate number of runs that a plan needs for all parts.
            fn runs(plan: &AssessmentPlan) -> u64 {
                let runs = [$(<$part as ReportPart>::runs(plan),)* <Proofs as ReportPart>::runs(plan)];
                runs.into_iter().fold(0, u64::saturating_add)
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
    paper::PaperScenarios => paper_scenarios: Option<PaperScenarios>,
    /// Failures counted on random scenarios of scenario spaces.
    sampling::SpaceSamples => rate_spaces: SpaceSamples,
    /// Collisions ahead and behind, and harm; absent unless the configuration asks for them.
    #[serde(skip_serializing_if = "Option::is_none")]
    harm::HarmReport => harm: Option<HarmReport>,
    /// Scenarios from files; absent if the configuration names none.
    file_scenarios::FileScenarios => file_scenarios: Option<FileScenarios>,
    /// Tests that are modelled on regulations; absent if the configuration names no suites.
    #[serde(skip_serializing_if = "Option::is_none")]
    suites::Suites => suites: Option<Suites>,
    /// Results of searches for failures.
    failure_searches::FailureSearches => searches: FailureSearches,
    /// Behaviour of each controller in everyday traffic; absent if the plan makes no such drives.
    usefulness::UsefulnessReport => usefulness: Option<UsefulnessReport>,
    /// Every controller by kind of follower; absent if the plan makes no such drives.
    follower_kinds::FollowerReport => followers: Option<FollowerReport>,
    /// Every controller on recorded drives; absent if the configuration names none.
    #[serde(skip_serializing_if = "Option::is_none")]
    recorded_drives::RecordedDrives => recorded_drives: Option<RecordedDrives>,
}

/// Measured time of gathering each part, by the anchor of the part.
#[derive(Debug, Clone, Default)]
pub(super) struct PartTimes(Vec<(&'static str, Duration)>);

impl PartTimes {
    fn add(&mut self, part: Option<&dyn ReportPart>, time: Duration) {
        self.0
            .extend(part.map(|part| (part.heading().anchor, time)));
    }

    /// Returns the time of a part in seconds.
    pub(super) fn find_s(&self, anchor: &str) -> Option<f64> {
        let mut times = self.0.iter();
        let (_, time) = times.find(|(part, _)| *part == anchor)?;
        Some(time.as_secs_f64())
    }
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

impl AssessmentPlan {
    /// Returns the approximate number of runs of the plan: searches may end early.
    #[must_use]
    pub fn runs(&self) -> u64 {
        GatheredResults::runs(self)
    }

    /// Returns the number of runs if each controller makes the same number.
    pub(super) fn runs_of_all(&self, of_each: u64) -> u64 {
        (self.controllers.len() as u64).saturating_mul(of_each)
    }
}
