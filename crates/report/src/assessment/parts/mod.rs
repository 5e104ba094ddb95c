//! The parts of an assessment, one file each.

mod answer;
mod argument;
mod certificates;
mod comparison;
mod distinct_failure;
mod exposure;
mod failure_searches;
mod file_scenarios;
mod glossary;
mod harm;
mod limits;
mod paper;
mod proofs;
mod provenance;
mod rate_certificates;
mod sampling;
mod scenario_cases;
mod space_descriptions;
mod specification_searches;
mod string_stability;
mod suites;
mod summary;
mod usefulness;
mod worst_profiles;
mod worst_profiles_figure;

pub use answer::{FirstPage, SafetyAnswer};
pub use argument::{Argument, GsnElement, GsnElementKind};
pub use certificates::{CertificateStatus, CertificateSubject, CheckedCertificate};
pub use comparison::{AssessmentChange, AssessmentComparison, ComparisonError, EarlierAssessment, MAX_EVIDENCE_BYTES};
pub use distinct_failure::{DistinctFailure, EscapeFile, MethodResult};
pub use failure_searches::{FailureSearch, FailureSearches, SpaceSearches};
pub use file_scenarios::FileScenarios;
pub(super) use file_scenarios::scenario_path;
pub use glossary::Glossary;
pub use harm::{ACTIVATION_MPS2, ControllerHarm, HarmGroup, HarmReport};
pub use limits::{AssessmentLimits, LimitingAssumption};
pub use paper::PaperScenarios;
pub use proofs::{EXAMPLE_MPS, KernelGap, Proofs};
pub use provenance::{AssessmentProvenance, RunInfo};
pub(super) use rate_certificates::generated_certificate_names;
pub use sampling::{ControllerSample, PairedCounts, PercentInterval, SpaceSample, SpaceSamples};
pub use scenario_cases::ScenarioCases;
pub use space_descriptions::{ParameterDescription, SpaceDescription, SpaceDescriptions};
pub use specification_searches::{
    SpaceSpecificationSearches, SpecificationSearch, SpecificationSearches, SpecificationViolation,
};
pub use string_stability::StringStabilityVerdict;
pub use suites::{SuiteFailure, SuiteFindings, SuiteOutcome, SuiteTest, Suites};
pub(super) use summary::GatheredEvidence;
pub use summary::{ClaimRow, ClaimSummary, NameExplanation};
pub(super) use usefulness::EVERYDAY_SPACES;
pub use usefulness::{ControllerUsefulness, UsefulnessReport};
pub(super) use worst_profiles::ATTACK_BUDGET;
pub use worst_profiles::{MildestAttack, WorstProfile, WorstProfiles};
