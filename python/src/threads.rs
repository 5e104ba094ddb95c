//! Simulation threads.

use std::sync::{Arc, Mutex, PoisonError};
use std::{process, thread};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Returns the simulation threads of this process, and starts them at the first call: `RAYON_NUM_THREADS` of them.
/// Release the interpreter's lock before passing work to them.
///
/// A forked process has none of its parent's threads and starts its own. Each thread keeps its interpreter state,
/// because creating one takes longer than a small controller.
///
/// # Errors
/// `RuntimeError` if the system cannot start threads.
pub(crate) fn pool() -> PyResult<Arc<ThreadPool>> {
    static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((process, threads)) = &*pool
        && *process == process::id()
    {
        return Ok(Arc::clone(threads));
    }
    let started = ThreadPoolBuilder::new()
        .spawn_handler(|thread| {
            let run = move || Python::attach(|py| py.detach(|| thread.run()));
            thread::Builder::new().spawn(run).map(drop)
        })
        .build()
        .map_err(|error| PyRuntimeError::new_err(format!("no threads to simulate: {error}")))?;
    let started = Arc::new(started);
    // The pool of a parent process has no threads here, so dropping it would wait forever.
    std::mem::forget(pool.replace((process::id(), Arc::clone(&started))));
    Ok(started)
}
