//! The parts of an assessment, one file each.

mod distribution;
mod learned;
mod limits;
mod map_cell;
mod map_grid;
mod maps;
mod maps_figure;
mod paper;
mod proofs;
mod provenance;
mod scenarios;
mod summary;
mod traffic;
mod worst;
mod worst_figure;

pub use distribution::{Distribution, Paired, Percent, Sampled};
pub use learned::{BRAKING_MPS2, Braking, Learned, LearnedPolicy};
pub use limits::Limits;
pub use map_cell::{MapCell, MapRow, UnknownCell};
pub use map_grid::{Held, MapAxis};
pub use maps::{FailureMap, FailureMaps};
pub use paper::PaperScenarios;
pub use proofs::{EXAMPLE_MPS, KernelProof, KernelStatus, Proofs};
pub use provenance::Provenance;
pub use scenarios::ScenarioCases;
pub use summary::{Claim, Strength, Summary};
pub use traffic::Traffic;
pub use worst::{Mildest, WorstProfile, WorstProfiles};
