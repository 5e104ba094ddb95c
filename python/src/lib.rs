//! Native half of the Python package `crumple`.
//!
//! The public API is in `python/crumple`; this module is private to it. Long work runs without the interpreter's lock
//! on other threads, while the calling thread checks for signals ([`interruptible`]).

mod assessment;
mod campaign;
mod controller;
mod episodes;
mod errors;
mod figure;
mod interruptible;
mod monitor;
mod rate;
mod scenario;
mod search_method;
mod simulation;
mod table;
mod testing;
mod threads;
mod train;
mod values;
mod warnings;
mod worst_case;

use pyo3::prelude::*;

/// Native half of the Python package `crumple`.
#[pymodule]
mod _crumple {
    use std::path::PathBuf;

    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::{
        assessment::{PyAssessment, assess},
        campaign::{compare, falsify, join_comparisons},
        controller::{PyObservation, allow_external},
        episodes::{Episodes, training_preset},
        figure::PyFigure,
        monitor::monitor,
        rate::{count_blocks, pool, rate},
        scenario::{PyScenario, PySpace},
        simulation::{PyTrace, PyTrack, Simulation, simulate},
        testing::{PyFamily, PyProperty},
        train::train,
        worst_case::worst_case,
    };

    /// Only the same build resumes incomplete work. The build is identified by this library, not by the interpreter.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let leave = wrap_pyfunction!(crate::interruptible::stop_all_work, module)?;
        module
            .py()
            .import("atexit")?
            .call_method1("register", (leave,))?;
        crate::warnings::show_logged_warnings();
        module.add("__version__", env!("CARGO_PKG_VERSION"))?;
        crumple_store::program::set_library_path(module.filename()?.extract::<PathBuf>()?);
        Ok(())
    }
}
