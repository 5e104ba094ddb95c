//! The parts of an assessment, one file each.

mod argument;
mod argument_figure;
mod certified;
mod compared;
mod distribution;
mod found;
mod learned;
mod limits;
mod paper;
mod proofs;
mod provenance;
mod scenarios;
mod search;
mod summary;
mod traffic;
mod worst;
mod worst_figure;

pub use argument::{Argument, Element, ElementKind};
pub use certified::{Proof, ProofStatus};
pub use compared::{Change, Comparison, ComparisonError, Earlier};
pub use distribution::{Distribution, Paired, Percent, Sampled};
pub use found::{Failure, MethodReached};
pub use learned::{BRAKING_MPS2, Braking, Learned, LearnedPolicy};
pub use limits::Limits;
pub use paper::PaperScenarios;
pub use proofs::{EXAMPLE_MPS, KernelGap, Proofs};
pub use provenance::Provenance;
pub use scenarios::ScenarioCases;
pub use search::{Search, Searches, SpaceSearches};
pub use summary::{Claim, Strength, Summary};
pub use traffic::Traffic;
pub(super) use worst::BUDGET;
pub use worst::{Mildest, WorstProfile, WorstProfiles};
