//! Suites that a configuration names, and the controllers they test.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::AssessConfig;
use super::claims::ContentId;
use super::plan::not_among_controllers;
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
    /// Loads the suites of a configuration; an error is a field and its problem. `place_of` also makes a name
    /// canonical.
    pub(super) fn from_config(
        config: &mut AssessConfig,
        folder: &Path,
        controllers: &[NamedController],
        place_of: impl Fn(&mut String) -> Option<usize>,
    ) -> Result<Vec<Self>, (String, String)> {
        if config.suites.len() > MAX_SUITES {
            return Err((
                "suites".to_owned(),
                format!(
                    "must be at most {MAX_SUITES}, found {}",
                    config.suites.len()
                ),
            ));
        }
        let mut planned: Vec<Self> = Vec::new();
        for (index, asked) in config.suites.iter_mut().enumerate() {
            let field = format!("suites[{index}].suite");
            let suite =
                find_suite(&asked.suite, folder).map_err(|problem| (field.clone(), problem))?;
            if planned
                .iter()
                .any(|known| known.suite.spec().name == suite.spec().name)
            {
                return Err((
                    field,
                    format!(
                        "another suite has the name `{}`; rename one of them",
                        suite.spec().name
                    ),
                ));
            }
            let mut controller_indices: Vec<_> = match &mut asked.controllers {
                None => (0..controllers.len()).collect(),
                Some(names) if names.is_empty() => {
                    let problem = "must name at least one controller".to_owned();
                    return Err((format!("suites[{index}].controllers"), problem));
                }
                Some(names) => {
                    let find = |(place, name): (usize, &mut String)| {
                        let field = format!("suites[{index}].controllers[{place}]");
                        place_of(name).ok_or_else(|| (field, not_among_controllers(name)))
                    };
                    names
                        .iter_mut()
                        .enumerate()
                        .map(find)
                        .collect::<Result<Vec<_>, _>>()?
                }
            };
            controller_indices.sort_unstable();
            controller_indices.dedup();
            let text =
                serde_json::to_string(suite.spec()).map_err(|error| (field, error.to_string()))?;
            let content_id = ContentId::new(suite.spec().name.as_str(), text);
            planned.push(Self {
                config_name: asked.suite.clone(),
                suite,
                content_id,
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

fn find_suite(name: &str, folder: &Path) -> Result<TestSuite, String> {
    if let Some(suite) = TestSuite::shipped(name) {
        return suite.map_err(|error| error.to_string());
    }
    if Path::new(name)
        .extension()
        .is_none_or(|ending| ending != "toml")
    {
        let known: Vec<_> = SHIPPED_SUITES.iter().map(|(name, _)| *name).collect();
        return Err(format!(
            "`{name}` is neither a built-in suite ({}) nor a .toml file",
            known.join(", ")
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
