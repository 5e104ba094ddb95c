//! crumple from Python: the native half of the package `crumple`.
//!
//! What a Python user sees is in `python/crumple`; this module is private to it. Work of any length is done without the
//! interpreter's lock, on threads of its own, while the calling thread looks for signals ([`watched`]).

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
mod simulation;
mod table;
mod threads;
mod values;
mod worst_case;

use pyo3::prelude::*;

/// The native half of the package `crumple`.
#[pymodule]
mod _crumple {
    use std::path::PathBuf;

    use pyo3::prelude::*;

    #[pymodule_export]
    use crate::assessment::{PyAssessment, assess};
    #[pymodule_export]
    use crate::campaign::falsify;
    #[pymodule_export]
    use crate::controller::{PyObservation, allow_external};
    #[pymodule_export]
    use crate::episodes::{Episodes, training_preset};
    #[pymodule_export]
    use crate::figure::PyFigure;
    #[pymodule_export]
    use crate::monitor::monitor;
    #[pymodule_export]
    use crate::rate::rate;
    #[pymodule_export]
    use crate::scenario::{PyScenario, PySpace};
    #[pymodule_export]
    use crate::simulation::{PyTrace, PyTrack, Simulation, simulate};
    #[pymodule_export]
    use crate::worst_case::worst_case;

    /// Half-done work is gone on with by the same build alone: that of this file, not of the interpreter.
    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        let leave = wrap_pyfunction!(crate::interruptible::stop_all_work, module)?;
        module.py().import("atexit")?.call_method1("register", (leave,))?;
        crumple_store::program::set_library_path(module.filename()?.extract::<PathBuf>()?);
        Ok(())
    }
}
