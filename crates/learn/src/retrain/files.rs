//! Files of a retraining.

use crumple_core::digest::{Sha256, sha256};
use crumple_sim::scenario::Scenario;
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::RunFolderError;

pub(super) const REPORT_JSON: &str = "report.json";
pub(super) const REPORT_MARKDOWN: &str = "report.md";
/// Record that completes a round.
pub(super) const ROUND_RECORD: &str = "round.json";
pub(super) const POLICY: &str = "policy.safetensors";
pub(super) const TRAINING_CASES: &str = "retrained-on.json";
pub(super) const TEST_SET: &str = "test-set.json";
pub(super) const VALIDATION_SET: &str = "validation-set.json";
pub(super) const SELECTION_SET: &str = "selection.json";
pub(super) const LEARNER: &str = "learner.safetensors";
/// Evaluated checkpoints of a training in progress.
pub(super) const CHECKPOINTS: &str = "checkpoints.json";
pub(super) const PLAN: &str = "retrain.toml";

/// Returns the SHA-256 over the JSON of scenarios, one after the other.
pub(super) fn scenarios_sha256(scenarios: &[Scenario]) -> Result<String, RunFolderError> {
    let mut digest = Sha256::default();
    for scenario in scenarios {
        digest.update(serde_json::to_string(scenario.spec()).map_err(encoding_error)?);
    }
    Ok(digest.hexadecimal())
}

/// Returns the SHA-256 of a space as JSON.
pub(super) fn space_sha256(space: &ScenarioSpace) -> Result<String, RunFolderError> {
    Ok(sha256(space_json(space)?))
}

/// Returns a space as JSON.
pub(super) fn space_json(space: &ScenarioSpace) -> Result<String, RunFolderError> {
    crumple_spaces::file::to_identity_json(space).map_err(encoding_error)
}

/// Returns the error about a scenario or space that cannot be encoded.
fn encoding_error(problem: impl std::fmt::Display) -> RunFolderError {
    RunFolderError::encoding(PLAN, problem)
}
