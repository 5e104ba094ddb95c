//! The parts of an assessment, one file each.

mod answer;
mod argument;
mod certificate_subject;
mod certificates;
mod comparison;
mod distinct_failure;
mod everyday_drives;
mod failure_search;
mod failure_searches;
mod file_scenarios;
mod glossary;
mod harm;
mod limits;
mod oscillation_gain;
mod paper;
mod proofs;
mod provenance;
mod rate_certificates;
mod sampling;
mod scenario_cases;
mod search_campaign;
mod share;
mod space_descriptions;
mod suites;
mod summary;
mod usefulness;

pub(super) use answer::FirstPageSection;
pub use answer::{FirstPage, SafetyAnswer};
pub use argument::Argument;
pub use certificates::{CertificateStatus, CertificateSubject, CheckedCertificate};
pub use comparison::{
    AssessmentChange, AssessmentComparison, EarlierAssessment, MAX_EVIDENCE_BYTES,
};
pub use distinct_failure::{DistinctFailure, EscapeFile, MethodResult};
pub use failure_search::FailureSearch;
pub use failure_searches::{FailureSearches, SpaceSearches};
pub use file_scenarios::FileScenarios;
pub(super) use file_scenarios::scenario_path;
pub use glossary::Glossary;
pub use harm::{ACTIVATION_MPS2, ControllerHarm, HarmGroup, HarmReport};
pub use limits::{AssessmentLimits, LimitingAssumption};
pub use oscillation_gain::{GainCurve, LargestGain, OscillationGain};
pub use paper::PaperScenarios;
pub use proofs::Proofs;
pub use provenance::{AssessmentProvenance, RunInfo};
pub(super) use rate_certificates::generated_certificate_names;
pub use sampling::{ControllerSample, PairedCounts, SpaceSample, SpaceSamples};
pub use scenario_cases::ScenarioCases;
pub use share::PercentInterval;
pub use space_descriptions::{ParameterDescription, SpaceDescription, SpaceDescriptions};
pub use suites::{SuiteFailure, SuiteFindings, SuiteOutcome, SuiteTest, Suites};
pub use summary::{ClaimRow, ClaimSummary, NameExplanation};
pub use usefulness::{ControllerUsefulness, UsefulnessReport};
