//! Scenario files keep scenarios.

use super::{Checked, Finding, Question, must};
use crate::{FileFormat, Law};

/// A scenario survives both file formats, to the last bit of every number.
///
/// # Errors
/// [`Law::Files`].
pub fn files_round_trip(question: &Question<'_>) -> Finding {
    let scenario = &question.test_case.scenario;
    for format in FileFormat::ALL {
        let back = question.system.through_file(scenario, format);
        let back = back.map_err(|error| (Law::Files, format!("{format:?}: {error}")))?;
        must(back == *scenario, Law::Files, || format!("{format:?}: it came back as {:?}", back.spec()))?;
    }
    Ok(Checked::Holds)
}
