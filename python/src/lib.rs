//! crumple from Python: the native half of the package `crumple`.
//!
//! What a Python user sees is in `python/crumple`; this module is private to it. Work of any length is done without the
//! interpreter's lock, on threads of its own, while the calling thread looks for signals ([`watched`]).

mod campaign;
mod controller;
mod episodes;
mod errors;
mod scenario;
mod simulation;
mod values;
mod watched;

use pyo3::prelude::*;

/// The native half of the package `crumple`.
#[pymodule]
mod _crumple {
    #[pymodule_export]
    use crate::campaign::falsify;
    #[pymodule_export]
    use crate::controller::Observation;
    #[pymodule_export]
    use crate::episodes::Episodes;
    #[pymodule_export]
    use crate::scenario::{Scenario, Space};
    #[pymodule_export]
    use crate::simulation::{Simulation, Trace, Track, simulate};
}
