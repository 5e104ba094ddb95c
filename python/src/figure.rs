//! Figures for a notebook or a file.

use std::path::PathBuf;

use crumple_report::draw::{self, MotionFigure, PanelArrangement};
use crumple_sim::engine::{Impact, Trace};
use crumple_sim::scenario::Scenario;
use pyo3::exceptions::{PyImportError, PyValueError};
use pyo3::intern;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::values::parse_choice;

/// Figure as SVG.
#[pyclass(name = "Figure", frozen, module = "crumple")]
pub(crate) struct PyFigure {
    /// Complete SVG file.
    #[pyo3(get)]
    svg: String,
}

impl PyFigure {
    /// Draws one run over time: position, speed, gap, acceleration and time to collision.
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

/// Pixels of a PNG for each unit of the SVG.
const PNG_SCALE: f64 = 2.0;

impl PyFigure {
    /// Converts the figure to `pdf` or `png`.
    fn convert(&self, py: Python<'_>, format: &str) -> PyResult<Vec<u8>> {
        let converter = py.import("vl_convert").map_err(|_| {
            PyImportError::new_err(format!(
                "a figure is saved as .{format} by the package vl-convert-python: pip install \"crumple[figures]\""
            ))
        })?;
        let options = PyDict::new(py);
        if format == "png" {
            options.set_item(intern!(py, "scale"), PNG_SCALE)?;
        }
        converter
            .call_method(format!("svg_to_{format}"), (&self.svg,), Some(&options))
            .map_err(|error| invalid_svg(py, &error))?
            .extract()
    }
}

/// Returns the error about an SVG that cannot be converted, without the stack of the converter.
fn invalid_svg(py: Python<'_>, error: &PyErr) -> PyErr {
    let text = error.value(py).to_string();
    let problem = text.lines().next().unwrap_or_default();
    PyValueError::new_err(format!("the figure cannot be converted: {problem}"))
}

#[pymethods]
impl PyFigure {
    #[new]
    fn from_svg(svg: String) -> Self {
        Self { svg }
    }

    /// Returns the argument of the constructor, for pickles.
    fn __getnewargs__(&self) -> (&str,) {
        (&self.svg,)
    }

    /// Writes the figure to a file that ends in `.svg`, `.pdf` or `.png` (two pixels per unit of the SVG). PDF and PNG
    /// need the package `vl-convert-python`.
    fn save(&self, py: Python<'_>, path: PathBuf) -> PyResult<()> {
        let converted;
        let contents = match path.extension().and_then(|extension| extension.to_str()) {
            Some("svg") => self.svg.as_bytes(),
            Some(format @ ("pdf" | "png")) => {
                converted = self.convert(py, format)?;
                &converted
            }
            _ => {
                return Err(PyValueError::new_err(format!(
                    "{}: a figure is saved as .svg, .pdf or .png",
                    path.display()
                )));
            }
        };
        Ok(crumple_store::disk::write(&path, contents).map_err(std::io::Error::other)?)
    }

    fn _repr_svg_(&self) -> &str {
        &self.svg
    }

    fn __repr__(&self) -> String {
        format!("<crumple.Figure, {} bytes of SVG>", self.svg.len())
    }
}
