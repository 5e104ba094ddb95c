//! Files of a retraining.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::RetrainError;
use crumple_core::digest::{Sha256, sha256};
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::{RunFolder, RunFolderError};

pub(super) const REPORT_JSON: &str = "report.json";
pub(super) const REPORT_MARKDOWN: &str = "report.md";
/// Record that completes a round.
pub(super) const ROUND_RECORD: &str = "round.json";
pub(super) const POLICY: &str = "policy.safetensors";
pub(super) const TRAINING_CASES: &str = "retrained-on.json";
pub(super) const TEST_SET: &str = "judged-on.json";
pub(super) const VALIDATION_SET: &str = "kept-aside.json";
pub(super) const SELECTION_SET: &str = "selection.json";
pub(super) const LEARNER: &str = "learner.safetensors";
/// Evaluated checkpoints of a training in progress.
pub(super) const CHECKPOINTS: &str = "checkpoints.json";
pub(super) const PLAN: &str = "retrain.toml";

/// Returns the SHA-256 over the JSON of scenarios, one after the other.
pub(super) fn scenarios_sha256(scenarios: &[Scenario]) -> Result<String, RetrainError> {
    let mut digest = Sha256::default();
    for scenario in scenarios {
        digest.update(serde_json::to_string(scenario.spec()).map_err(RetrainError::encoding)?);
    }
    Ok(digest.hexadecimal())
}

/// Returns the SHA-256 of a space as JSON.
pub(super) fn space_sha256(space: &ScenarioSpace) -> Result<String, RetrainError> {
    serde_json::to_string(space.spec())
        .map(sha256)
        .map_err(RetrainError::encoding)
}

pub(super) fn to_json(value: &impl Serialize) -> Result<String, RetrainError> {
    Ok(serde_json::to_string_pretty(value).map_err(RetrainError::encoding)? + "\n")
}

pub(super) fn write_json(
    work: &RunFolder,
    name: &str,
    value: &impl Serialize,
) -> Result<(), RetrainError> {
    Ok(work.write(name, to_json(value)?)?)
}

pub(super) fn read_json<T: DeserializeOwned>(
    work: &RunFolder,
    name: &str,
) -> Result<Option<T>, RetrainError> {
    let Some(bytes) = work.read(name)? else {
        return Ok(None);
    };
    serde_json::from_slice(&bytes).map(Some).map_err(|error| {
        let problem = format!("differs from what a retraining writes: {error}");
        RunFolderError::damaged(&work.path(name), problem).into()
    })
}
