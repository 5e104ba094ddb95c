//! Simulation threads.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::{process, thread};

use crumple_core::threads::{MAX_THREADS, thread_count};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use rayon::{ThreadPool, ThreadPoolBuilder};

/// Threads of a process.
struct Pools {
    process: u32,
    by_count: BTreeMap<usize, Arc<ThreadPool>>,
    /// Number of threads of calls that request none, once it is known. Finding it takes longer than a small call.
    default_count: Option<usize>,
}

/// Parses the argument `threads`.
///
/// # Errors
/// `ValueError` for anything else than None and a whole number in range.
pub(crate) fn parse_threads(argument: &Bound<'_, PyAny>) -> PyResult<Option<usize>> {
    if argument.is_none() {
        return Ok(None);
    }
    let count: Option<usize> = argument.extract().ok();
    match count.filter(|count| (1..=MAX_THREADS).contains(count)) {
        Some(count) => Ok(Some(count)),
        None => Err(PyValueError::new_err(format!(
            "threads: must be a whole number from 1 to {MAX_THREADS}, found {}",
            argument.repr()?
        ))),
    }
}

static POOLS: Mutex<Pools> = Mutex::new(Pools {
    process: 0,
    by_count: BTreeMap::new(),
    default_count: None,
});

/// Returns the simulation threads of this process, and starts them at the first call: `requested` of them, or else as
/// many as [`thread_count`] finds. Release the interpreter's lock before passing work to them.
///
/// A forked process has none of its parent's threads and starts its own. Each thread keeps its interpreter state,
/// because creating one takes longer than a small controller.
///
/// # Errors
/// `ValueError` if the environment has no usable number; `RuntimeError` if the system cannot start threads.
pub(crate) fn pool(requested: Option<usize>) -> PyResult<Arc<ThreadPool>> {
    let mut pools = POOLS.lock().unwrap_or_else(PoisonError::into_inner);
    if pools.process != process::id() {
        // The pools of a parent process have no threads here, so dropping one would wait forever.
        std::mem::forget(std::mem::take(&mut pools.by_count));
        pools.process = process::id();
        pools.default_count = None;
    }
    let count = match requested.or(pools.default_count) {
        Some(count) => count,
        None => {
            let count = thread_count(None);
            *pools
                .default_count
                .insert(count.map_err(|invalid| PyValueError::new_err(invalid.to_string()))?)
        }
    };
    if let Some(threads) = pools.by_count.get(&count) {
        return Ok(Arc::clone(threads));
    }
    let started = Arc::new(start(count)?);
    pools.by_count.insert(count, Arc::clone(&started));
    // The new threads need the interpreter's lock, for which another caller may wait for the pools.
    drop(pools);
    wait_for_all(&started);
    Ok(started)
}

/// Waits until all threads have their interpreter state. A thread that creates it while the interpreter ends crashes
/// the process, and a call can be done before the last thread has started.
fn wait_for_all(threads: &ThreadPool) {
    Python::attach(|py| py.detach(|| threads.broadcast(|_| ())));
}

fn start(count: usize) -> PyResult<ThreadPool> {
    ThreadPoolBuilder::new()
        .num_threads(count)
        .spawn_handler(|thread| {
            let run = move || Python::attach(|py| py.detach(|| thread.run()));
            thread::Builder::new().spawn(run).map(drop)
        })
        .build()
        .map_err(|error| PyRuntimeError::new_err(format!("no threads to simulate: {error}")))
}
