//! Prints the scenario in an input of `cargo fuzz run scenario`, with the command that runs it:
//!
//! ```text
//! cargo run --release -p crumple-experiments -- scenario_of_input fuzz/artifacts/scenario/crash-1234 > found.toml
//! ```
//!
//! `CRUMPLE_CONTROLLER` must have the fuzzer's value: `baseline` by default, `any` if the input chooses.

use crate::ExperimentError;
use crumple_fuzzing::CollisionSearch;

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let path = arguments
        .first()
        .ok_or("name the input, a file under fuzz/artifacts or fuzz/corpus")?;
    let bytes = std::fs::read(path).map_err(|error| format!("{path}: {error}"))?;
    let controller = std::env::var("CRUMPLE_CONTROLLER").unwrap_or_else(|_| "baseline".to_owned());
    print!(
        "{}",
        CollisionSearch::new(&controller, None)?
            .test_case(&bytes)
            .reproducer()
    );
    Ok(())
}
