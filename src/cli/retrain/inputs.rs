//! Scenarios and spaces that the options of `crumple retrain` name.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::super::{CliError, args, output};
use crate::cli::global_options::GlobalOptions;
use crumple_controllers::Controllers;
use crumple_learn::rl::unsuitability;
use crumple_sim::scenario::{Scenario, built_in_scenario, built_in_scenario_names, file};
use crumple_spaces::{BUILT_IN_SPACES, ScenarioSpace, built_in_space};

/// Loads the scenarios of `--scenario`, by default those of the paper if the policy `imitates` an expert. Leaves out
/// scenarios of a folder that no policy can be trained on.
pub(super) fn load_attacked(
    names: &[PathBuf],
    imitates: bool,
    global: GlobalOptions,
) -> Result<Vec<Scenario>, CliError> {
    if names.is_empty() {
        let names = built_in_scenario_names()
            .map(|(name, _)| name)
            .into_iter()
            .filter(|_| imitates);
        return Ok(names
            .filter_map(built_in_scenario)
            .filter(|scenario| unsuitability(scenario).is_none())
            .collect());
    }
    if is_none("--scenario", "scenarios", names)? {
        return Ok(Vec::new());
    }
    let mut scenarios = Vec::new();
    for name in names {
        if name.is_dir() {
            scenarios.extend(load_suitable(name, global)?);
            continue;
        }
        let scenario = args::load_scenario(name, global.controllers)?;
        if let Some(reason) = unsuitability(&scenario) {
            return Err(CliError::Input(format!(
                "--scenario: `{}` cannot be trained on: {reason}",
                name.display()
            )));
        }
        scenarios.push(scenario);
    }
    Ok(scenarios)
}

/// Loads the scenarios of a folder that a policy can be trained on, and notes if others are left out.
fn load_suitable(folder: &Path, global: GlobalOptions) -> Result<Vec<Scenario>, CliError> {
    let all = file::load_all(folder, &global.controllers)?;
    if all.is_empty() {
        return Err(CliError::Input(format!(
            "--scenario: {}: the folder contains no scenario file",
            folder.display()
        )));
    }
    let mut suitable = Vec::new();
    let mut first_refusal = None;
    for (path, scenario) in &all {
        match unsuitability(scenario) {
            None => suitable.push(scenario.clone()),
            Some(reason) => {
                first_refusal.get_or_insert(format!(": {}: {reason}", path.display()));
            }
        }
    }
    if let Some(reason) = first_refusal {
        output::note(
            &format!(
                "{}: uses {} of {} scenarios{reason}",
                folder.display(),
                suitable.len(),
                all.len()
            ),
            global.quiet,
        );
    }
    Ok(suitable)
}

pub(super) fn load_regression_spaces(
    names: &[String],
    controllers: Controllers,
) -> Result<Vec<ScenarioSpace>, CliError> {
    if names.is_empty() {
        return Ok(BUILT_IN_SPACES
            .iter()
            .map(|(name, ..)| *name)
            .chain(["followers"])
            .filter_map(built_in_space)
            .collect());
    }
    if is_none("--regression", "spaces", names)? {
        return Ok(Vec::new());
    }
    load_spaces("--regression", names, controllers)
}

/// Returns true if the only value of a repeated option is `none`.
fn is_none<Name: AsRef<OsStr>>(
    option: &str,
    values: &str,
    names: &[Name],
) -> Result<bool, CliError> {
    let has_none = names.iter().any(|name| name.as_ref() == "none");
    if has_none && names.len() > 1 {
        return Err(CliError::Input(format!(
            "{option}: `none` cannot be combined with {values}"
        )));
    }
    Ok(has_none)
}

/// Loads the spaces of a repeated option.
pub(super) fn load_spaces(
    option: &str,
    names: &[String],
    controllers: Controllers,
) -> Result<Vec<ScenarioSpace>, CliError> {
    if names.len() > MAX_SPACES {
        return Err(CliError::Input(format!(
            "{option}: at most {MAX_SPACES} spaces"
        )));
    }
    let mut spaces: Vec<ScenarioSpace> = Vec::new();
    for name in names {
        let space = args::load_space(option, name, controllers)?;
        if spaces.iter().any(|earlier| earlier.name() == space.name()) {
            return Err(CliError::Input(format!(
                "{option}: two spaces have the name `{}`",
                space.name()
            )));
        }
        spaces.push(space);
    }
    Ok(spaces)
}

const MAX_SPACES: usize = 32;
