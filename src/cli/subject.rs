//! Arguments that several subcommands share: which scenario, which controller.

use std::path::Path;

use super::Failure;
use crate::estimate::EstimatorKind;
use crate::scenario::{ControllerSpec, Scenario, built_in, built_in_names, file};
use crate::sim::{Contender, Keep, Run, RunOptions, Simulated, simulate};

/// A built-in scenario, or the one in a file.
pub(super) fn scenario(name_or_path: &str) -> Result<Scenario, Failure> {
    if let Some(scenario) = built_in(name_or_path) {
        return Ok(scenario);
    }
    let path = Path::new(name_or_path);
    if path.extension().is_none() && !path.exists() {
        let known: Vec<_> = built_in_names().iter().map(|(name, _)| *name).collect();
        return Err(Failure::Input(format!(
            "`{name_or_path}` is neither a built-in scenario ({}) nor a file",
            known.join(", ")
        )));
    }
    Ok(file::load(path)?)
}

/// A built-in controller or a policy file, for clap.
pub(super) fn controller(name: &str) -> Result<Contender, String> {
    Contender::find(name, Path::new("")).map_err(|error| error.to_string())
}

/// What a scenario of scripts and fixed drivers does.
pub(super) fn replay(scenario: &Scenario) -> Result<Simulated, Failure> {
    let run = Run::new(scenario, RunOptions::new(ControllerSpec::MatchLeader).with_estimator(EstimatorKind::Truth))?;
    Ok(simulate(&run, Keep::Trace))
}
