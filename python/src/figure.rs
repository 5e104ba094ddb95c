//! Figures for a notebook or a file.

use std::path::PathBuf;

use crumple_report::draw::{self, MotionFigure, PanelArrangement};
use crumple_sim::engine::{Impact, Trace};
use crumple_sim::scenario::Scenario;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;

use crate::values::parse_choice;

/// Figure as SVG.
#[pyclass(name = "Figure", frozen, module = "crumple")]
pub(crate) struct PyFigure {
    /// Complete SVG file.
    #[pyo3(get)]
    svg: String,
}

impl PyFigure {
    /// Draws position, speed and gap of one run over time.
    pub(crate) fn from_motion(
        scenario: &Scenario,
        title: &str,
        trace: &Trace,
        impacts: &[Impact],
        layout: &str,
    ) -> PyResult<Self> {
        let layouts = [
            ("wide", PanelArrangement::Wide),
            ("stacked", PanelArrangement::Stacked),
            ("column", PanelArrangement::Column),
        ];
        let labels = draw::vehicle_names(scenario);
        let figure = MotionFigure {
            prefix: "motion",
            title,
            labels: &labels,
            trace,
            impacts,
        };
        Ok(Self {
            svg: draw::draw_motion(&figure, parse_choice("layout", layout, &layouts)?).document(),
        })
    }
}

#[pymethods]
impl PyFigure {
    /// Writes the figure to a file that ends in `.svg`.
    fn save(&self, path: PathBuf) -> PyResult<()> {
        if path.extension().is_none_or(|extension| extension != "svg") {
            return Err(PyValueError::new_err(format!(
                "{}: a figure is saved as .svg",
                path.display()
            )));
        }
        Ok(crumple_store::disk::write(&path, &self.svg).map_err(std::io::Error::other)?)
    }

    fn _repr_svg_(&self) -> &str {
        &self.svg
    }

    fn __repr__(&self) -> String {
        format!("<crumple.Figure, {} bytes of SVG>", self.svg.len())
    }
}
