//! Scenario spaces of a retraining.

use super::files::space_json;
use crate::rl::ScenarioSource;
use crumple_core::digest::sha256;
use crumple_sim::control::ControllerSource;
use crumple_sim::scenario::{DriverProblem, NoDriverFiles, OpenDriver};
use crumple_sim::scenario::{InvalidField, Scenario};
use crumple_spaces::ScenarioSpace;
use crumple_store::run_folder::RunFolderError;
use std::path::Path;
use std::sync::Arc;

/// One or more scenario spaces that are searched and drawn from in turn.
#[derive(Debug, Clone)]
pub struct SearchedSpaces(Vec<ScenarioSpace>);

/// Opens the drivers that the spaces have read already.
impl OpenDriver for SearchedSpaces {
    fn open_driver(&self, path: &Path) -> Result<Arc<dyn ControllerSource>, DriverProblem> {
        let opened = self.0.iter().find_map(|space| {
            let nominal = space.scenario_at(&space.nominal()).ok()?;
            nominal.open_driver(path).ok()
        });
        opened.map_or_else(|| NoDriverFiles.open_driver(path), Ok)
    }
}

impl SearchedSpaces {
    /// Creates the list; `None` if it is empty.
    #[must_use]
    pub fn new(spaces: Vec<ScenarioSpace>) -> Option<Self> {
        (!spaces.is_empty()).then_some(Self(spaces))
    }

    /// Returns the names of all spaces.
    #[must_use]
    pub fn name(&self) -> String {
        self.0
            .iter()
            .map(ScenarioSpace::name)
            .collect::<Vec<_>>()
            .join(", ")
    }

    /// Returns the SHA-256 of all spaces as JSON.
    pub(super) fn sha256(&self) -> Result<String, RunFolderError> {
        let each = self.0.iter().map(space_json);
        Ok(sha256(each.collect::<Result<String, _>>()?))
    }

    /// Returns the number of random scenarios that contain `of_each` of every space.
    pub(super) fn total(&self, of_each: u64) -> u64 {
        of_each.saturating_mul(self.0.len() as u64)
    }

    pub(super) fn as_slice(&self) -> &[ScenarioSpace] {
        &self.0
    }
}

impl From<ScenarioSpace> for SearchedSpaces {
    fn from(space: ScenarioSpace) -> Self {
        Self(vec![space])
    }
}

impl ScenarioSource for SearchedSpaces {
    /// Draws scenario `index` from the space with the number `index` modulo the number of spaces.
    fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        self.0[(index % self.0.len() as u64) as usize].draw(seed, index)
    }

    fn identity(&self) -> Result<Option<String>, serde_json::Error> {
        let each = self
            .0
            .iter()
            .map(|space| Ok(space.identity()?.unwrap_or_default()));
        Ok(Some(each.collect::<Result<Vec<_>, _>>()?.join(", ")))
    }
}
