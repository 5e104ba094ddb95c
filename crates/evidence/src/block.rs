//! Blocks of counted runs with a hash of their results, for confirmation.

use serde::{Deserialize, Serialize};

use crumple_core::digest::Sha256;
use crumple_sim::engine::{FailedController, FailedControllerRuns, Outcome, SimulationResult};

const HASH_PREFIX: &str = "crumple runs 2\n";

/// Results of a block of runs.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CountedBlock {
    /// Runs in which the controller failed; with two controllers, both, unless the second gave no answer.
    pub failures: u64,
    /// Runs in which only the first of two controllers failed.
    pub only_first_failed: u64,
    /// Runs in which only the second failed.
    pub only_second_failed: u64,
    /// SHA-256 of the result of each run, known only to a program that simulates them: see `docs/certificates.md`.
    pub sha256: String,
    /// Runs without an answer of the controller, or of the first of two; they count as failures, unless the second gave
    /// no answer either.
    #[serde(default, skip_serializing_if = "Option::is_none", alias = "unanswered")]
    pub missing_answers: Option<FailedControllerRuns>,
    /// Runs without an answer of the second controller; they count for neither controller.
    #[serde(
        default,
        skip_serializing_if = "Option::is_none",
        alias = "other_unanswered"
    )]
    pub second_missing_answers: Option<FailedControllerRuns>,
}

/// Result of a run, for hashing: outcome, time and smallest gap as bits.
pub(super) struct RunFingerprint {
    failed: bool,
    failure_reason: Option<String>,
    bytes: [u8; 17],
}

impl RunFingerprint {
    pub(super) fn new(result: &SimulationResult) -> Self {
        let (kind, at_s) = match &result.outcome {
            Outcome::NoCollision => (0, 0.0),
            Outcome::Collision(collision) => (1, collision.time_s),
            Outcome::ControllerFailed(failed) => (2, failed.time_s),
        };
        let smallest_m = result
            .vehicles
            .iter()
            .filter_map(|vehicle| vehicle.min_gap_m)
            .fold(f64::INFINITY, f64::min);
        let mut bytes = [kind; 17];
        bytes[1..9].copy_from_slice(&at_s.to_bits().to_le_bytes());
        bytes[9..].copy_from_slice(&smallest_m.to_bits().to_le_bytes());
        let failure_reason = result
            .outcome
            .failed_controller()
            .map(FailedController::reason);
        Self {
            failed: kind != 0,
            failure_reason,
            bytes,
        }
    }
}

impl RunFingerprint {
    pub(super) fn is_failure(&self) -> bool {
        self.failed
    }
}

impl CountedBlock {
    /// Counts runs from number `first` of a registration, each with a result per controller.
    pub(super) fn from_runs<'a>(
        registered: &str,
        first: u64,
        runs: impl Iterator<Item = Vec<&'a RunFingerprint>>,
    ) -> Self {
        let mut block = Self::default();
        let mut hash = Sha256::default()
            .with(HASH_PREFIX)
            .with(registered)
            .with(first.to_le_bytes());
        for endings in runs {
            endings.iter().for_each(|ending| hash.update(ending.bytes));
            let missing = [
                &mut block.missing_answers,
                &mut block.second_missing_answers,
            ];
            for (merged, ending) in missing.into_iter().zip(&endings) {
                let reason = ending.failure_reason.clone();
                FailedControllerRuns::merge(
                    merged,
                    reason.map(|reason| FailedControllerRuns { runs: 1, reason }),
                );
            }
            match endings.as_slice() {
                [run] if run.failed => block.failures += 1,
                // A second controller without an answer is not known to be worse: such a run does not count.
                [_, second] if second.failure_reason.is_some() => {}
                [first, second] => match (first.failed, second.failed) {
                    (true, true) => block.failures += 1,
                    (true, false) => block.only_first_failed += 1,
                    (false, true) => block.only_second_failed += 1,
                    (false, false) => {}
                },
                _ => {}
            }
        }
        block.sha256 = hash.hexadecimal();
        block
    }
}
