//! The threads that simulate.

use std::sync::Once;
use std::thread;

use pyo3::prelude::*;
use rayon::ThreadPoolBuilder;

/// Starts the threads that simulate, unless they run already: not when the package is imported, since a process that forks would lose them.
///
/// Each is known to the interpreter as long as it lives, though it seldom holds its lock. To introduce itself for every call of a controller
/// in Python would take longer than a small one does.
pub(crate) fn start(py: Python<'_>) {
    static STARTED: Once = Once::new();
    let run = |thread: rayon::ThreadBuilder| Python::attach(|py| py.detach(|| thread.run()));
    // Without the lock, for which each waits first.
    py.detach(|| {
        STARTED.call_once(|| {
            let pool = ThreadPoolBuilder::new()
                .spawn_handler(|thread| thread::Builder::new().spawn(move || run(thread)).map(drop));
            // Where they run already, or none can be had, the work itself finds what there is.
            let _ = pool.build_global();
        });
    });
}
