//! Report of an export, as text and as JSON.

use std::path::Path;

use crumple_core::quoting::TerminalText;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use serde::Serialize;

use super::OpenScenario;

/// Report of an export.
#[derive(Debug, Clone, Default, Serialize)]
#[serde(transparent)]
pub struct ExportReport {
    /// Exported scenarios.
    pub scenarios: Vec<ExportedScenario>,
}

/// Controller and estimator of the vehicles under test of an exported scenario.
#[derive(Debug, Clone, Copy)]
pub struct ExportedController<'a> {
    /// Name of the controller.
    pub name: &'a str,
    /// Estimator.
    pub estimator: EstimatorKind,
}

/// A scenario that was written for other simulators.
#[derive(Debug, Clone, Serialize)]
pub struct ExportedScenario {
    /// Name of the scenario.
    pub scenario: String,
    /// Path of the OpenSCENARIO file.
    pub openscenario: String,
    /// Path of the OpenDRIVE file.
    pub opendrive: String,
    /// Number of vehicles.
    pub vehicles: usize,
    /// Number of vertices of polylines, or of entries of speed profiles.
    pub vertices: usize,
    /// Controller of the vehicles under test; `None` without such a vehicle, or if the user supplies the controller.
    pub controller: Option<String>,
    /// Estimator of the vehicles under test; `None` without a controller.
    pub estimator: Option<&'static str>,
}

impl ExportReport {
    /// Returns the report for a reader, one line per scenario.
    #[must_use]
    pub fn to_text(&self) -> String {
        self.scenarios
            .iter()
            .map(ExportedScenario::to_line)
            .collect()
    }
}

impl ExportedScenario {
    /// Describes a scenario whose documents are written to an OpenSCENARIO file and an OpenDRIVE file.
    #[must_use]
    pub fn new(
        scenario: &Scenario,
        documents: &OpenScenario,
        [openscenario, opendrive]: [&Path; 2],
        controller: Option<ExportedController<'_>>,
    ) -> Self {
        Self {
            scenario: scenario.spec().name.clone(),
            openscenario: openscenario.display().to_string(),
            opendrive: opendrive.display().to_string(),
            vehicles: scenario.vehicles().len(),
            vertices: documents.vertices,
            controller: controller.map(|controller| controller.name.to_owned()),
            estimator: controller.map(|controller| controller.estimator.name()),
        }
    }

    fn to_line(&self) -> String {
        let controller = match (&self.controller, self.estimator) {
            (Some(controller), Some(estimator)) => {
                format!(
                    ", under {}, estimator {estimator}",
                    TerminalText(controller)
                )
            }
            _ => String::new(),
        };
        format!(
            "{}: {} vehicles, {} vertices{controller}\n",
            TerminalText(&self.openscenario),
            self.vehicles,
            self.vertices
        )
    }
}
