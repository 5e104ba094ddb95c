//! Oracle: scenario files preserve scenarios.

use super::{OracleContext, OracleOutcome, OracleResult, ensure};
use crate::{Invariant, ScenarioFormat};

/// Checks that a scenario survives both file formats, to the last bit of every number.
///
/// # Errors
/// [`Invariant::Files`].
pub fn files_round_trip(question: &OracleContext<'_>) -> OracleResult {
    let scenario = &question.test_case.scenario;
    for format in ScenarioFormat::ALL {
        let back = question.system.file_round_trip(scenario, format);
        let back = back.map_err(|error| (Invariant::Files, format!("{format:?}: {error}")))?;
        ensure(back == *scenario, Invariant::Files, || {
            format!("{format:?}: it reads back as {:?}", back.spec())
        })?;
    }
    Ok(OracleOutcome::Holds)
}
