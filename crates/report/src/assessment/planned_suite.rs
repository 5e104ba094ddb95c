//! Suites that a configuration names, and the controllers they test.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::AssessConfig;
use super::claims::ContentId;
use super::plan::not_among_controllers;
use crumple_core::field_error::FieldError;
use crumple_sim::engine::NamedController;
use crumple_suites::{SHIPPED_SUITES, TestSuite};

const MAX_SUITES: usize = 20;

/// A suite of tests that is modelled on a regulation.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    deny_unknown_fields,
    expecting = "a suite: a table of `suite` and `controllers`"
)]
#[non_exhaustive]
pub struct SuiteConfig {
    /// Name of a shipped suite (see `crumple suite list`), or a file, relative to the configuration.
    pub suite: String,
    /// Controllers to test, some of `controllers`. Default: all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub controllers: Option<Vec<String>>,
}

#[derive(Debug, Clone)]
pub(super) struct PlannedSuite {
    /// Name in the configuration.
    pub(super) config_name: String,
    pub(super) suite: TestSuite,
    /// Hash of the suite, under its own name.
    pub(super) content_id: ContentId,
    /// Indices of the controllers in the plan, in its order.
    pub(super) controller_indices: Vec<usize>,
}

impl PlannedSuite {
    /// Loads the suites of a configuration. `find_controller` returns the
    /// index of a controller and makes its name canonical.
    pub(super) fn from_config(
        config: &mut AssessConfig,
        folder: &Path,
        controllers: &[NamedController],
        find_controller: impl Fn(&mut String) -> Option<usize>,
    ) -> Result<Vec<Self>, FieldError> {
        let count = config.suites.len();
        if count > MAX_SUITES {
            let problem = format!("must be at most {MAX_SUITES}, found {count}");
            return Err(FieldError::new("suites", problem));
        }
        let mut planned: Vec<Self> = Vec::new();
        for (index, suite_config) in config.suites.iter_mut().enumerate() {
            let field = format!("suites[{index}].suite");
            let suite = find_suite(&suite_config.suite, folder)
                .map_err(|problem| FieldError::new(&field, problem))?;
            let name = suite.spec().name.clone();
            if planned.iter().any(|other| other.suite.spec().name == name) {
                let problem = format!("another suite has the name `{name}`; rename one of them");
                return Err(FieldError::new(field, problem));
            }
            let controller_indices = match &mut suite_config.controllers {
                None => (0..controllers.len()).collect(),
                Some(names) => {
                    let field = format!("suites[{index}].controllers");
                    find_controllers(names, &field, &find_controller)?
                }
            };
            let text = serde_json::to_string(suite.spec())
                .map_err(|error| FieldError::new(field, error.to_string()))?;
            planned.push(Self {
                config_name: suite_config.suite.clone(),
                suite,
                content_id: ContentId::new(name, text),
                controller_indices,
            });
        }
        Ok(planned)
    }

    /// Returns the number of runs, without searches and margins.
    pub(super) fn run_count(&self) -> u64 {
        let tests = self
            .suite
            .spec()
            .clauses
            .iter()
            .flat_map(|clause| &clause.tests);
        let points: usize = tests
            .filter(|test| test.lead.is_some())
            .map(|test| test.grid().len())
            .sum();
        (points * self.controller_indices.len()) as u64
    }
}

/// Returns the sorted indices of named controllers, each once.
fn find_controllers(
    names: &mut [String],
    field: &str,
    find_controller: &impl Fn(&mut String) -> Option<usize>,
) -> Result<Vec<usize>, FieldError> {
    if names.is_empty() {
        return Err(FieldError::new(field, "must name at least one controller"));
    }
    let mut indices = Vec::new();
    for (position, name) in names.iter_mut().enumerate() {
        let index = find_controller(name).ok_or_else(|| {
            let field = format!("{field}[{position}]");
            FieldError::new(field, not_among_controllers(name))
        })?;
        indices.push(index);
    }
    indices.sort_unstable();
    indices.dedup();
    Ok(indices)
}

fn find_suite(name: &str, folder: &Path) -> Result<TestSuite, String> {
    if let Some(suite) = TestSuite::shipped(name) {
        return suite.map_err(|error| error.to_string());
    }
    if Path::new(name)
        .extension()
        .is_none_or(|ending| ending != "toml")
    {
        let shipped: Vec<_> = SHIPPED_SUITES.iter().map(|(name, _)| *name).collect();
        return Err(format!(
            "`{name}` is neither a built-in suite ({}) nor a .toml file",
            shipped.join(", ")
        ));
    }
    let suite = TestSuite::load(&folder.join(name)).map_err(|error| error.to_string())?;
    match TestSuite::shipped(&suite.spec().name) {
        Some(Ok(shipped)) if shipped != suite => Err(format!(
            "a built-in suite with other contents has the name `{}`; rename this one",
            suite.spec().name
        )),
        _ => Ok(suite),
    }
}
