//! Arguments that several subcommands share: which scenario, which controller.

use std::path::Path;
use std::sync::Arc;

use super::Failure;
use crate::policy::Policy;
use crate::scenario::{ControllerSpec, Scenario, built_in, built_in_names, file};
use crate::sim::UnderTest;

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

/// A controller as the command line names it.
#[derive(Clone)]
pub(super) struct Subject {
    /// A built-in name, or the path of a policy file.
    pub(super) name: String,
    /// What it is.
    pub(super) controller: UnderTest,
}

/// A built-in controller or a policy file, for clap.
pub(super) fn controller(name: &str) -> Result<Subject, String> {
    let controller = if let Some(spec) = ControllerSpec::named(name) {
        UnderTest::BuiltIn(spec)
    } else if Path::new(name).extension().is_some() {
        UnderTest::Policy(Arc::new(Policy::load(Path::new(name)).map_err(|error| error.to_string())?))
    } else {
        let known: Vec<_> = ControllerSpec::built_in().iter().map(ControllerSpec::name).collect();
        return Err(format!("no such controller; there are {}, and policy files", known.join(", ")));
    };
    Ok(Subject { name: name.to_owned(), controller })
}
