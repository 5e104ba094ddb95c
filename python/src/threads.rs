//! The threads that simulate.

use std::sync::{Arc, Mutex, PoisonError};
use std::{process, thread};

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rayon::{ThreadBuilder, ThreadPool, ThreadPoolBuilder};

/// The threads that simulate in this process, started when they are first asked for: as many as `RAYON_NUM_THREADS` says. Work is to
/// be handed to them without the interpreter's lock.
///
/// A process that was forked has none of its parent's threads, and gets its own. Each is known to the interpreter as long as it lives,
/// though it seldom holds its lock: to introduce itself for every call of a controller in Python would take longer than a small one does.
///
/// # Errors
/// `RuntimeError` if the system has no threads left.
pub(crate) fn pool() -> PyResult<Arc<ThreadPool>> {
    static POOL: Mutex<Option<(u32, Arc<ThreadPool>)>> = Mutex::new(None);
    let run = |thread: ThreadBuilder| Python::attach(|py| py.detach(|| thread.run()));
    let mut pool = POOL.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((process, threads)) = &*pool
        && *process == process::id()
    {
        return Ok(Arc::clone(threads));
    }
    let builder = ThreadPoolBuilder::new();
    let builder = builder.spawn_handler(|thread| thread::Builder::new().spawn(move || run(thread)).map(drop));
    let started =
        builder.build().map_err(|error| PyRuntimeError::new_err(format!("no threads to simulate: {error}")))?;
    let started = Arc::new(started);
    // What is left of a parent's has no threads that could be told to end.
    std::mem::forget(pool.replace((process::id(), Arc::clone(&started))));
    Ok(started)
}
