//! Long work on a thread of its own, while the calling thread passes on progress and looks for signals.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use pyo3::types::PyTuple;

use crate::threads;

/// How often the calling thread looks for signals.
const LOOK_EVERY: Duration = Duration::from_millis(50);

/// Whether work is to end early. Clones are one and the same.
#[derive(Debug, Clone, Default)]
pub(crate) struct Stop(Arc<AtomicBool>);

impl Stop {
    pub(crate) fn is_asked(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn ask(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// How far work is: what is done, of how much, and how much of it failed.
pub(crate) type Progress = (u64, u64, u64);

/// Does `work` without the interpreter's lock. It says how far it is by the function that it is given, and ends soon
/// once `stop` is asked for: at a signal (Ctrl-C), and at an exception of `progress`.
pub(crate) fn watched<T: Send>(
    py: Python<'_>,
    stop: &Stop,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(&dyn Fn(Progress)) -> T + Send,
) -> PyResult<T> {
    // It would wait for the threads that wait for it.
    if rayon::current_thread_index().is_some() {
        return Err(PyRuntimeError::new_err("a controller cannot begin simulations of its own while it drives"));
    }
    threads::start(py);
    let (said, heard) = mpsc::channel::<Progress>();
    py.detach(move || {
        thread::scope(|scope| {
            let worker = scope.spawn(move || {
                work(&|state| {
                    // Nobody listens any more once an exception was raised.
                    let _ = said.send(state);
                })
            });
            let mut raised = None;
            loop {
                // The channel closes when the work is done.
                let looked = match heard.recv_timeout(LOOK_EVERY) {
                    Ok(state) => Python::attach(|py| tell(py, progress, state).and_then(|()| py.check_signals())),
                    Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals()),
                    Err(RecvTimeoutError::Disconnected) => break,
                };
                if let Err(error) = looked
                    && raised.is_none()
                {
                    stop.ask();
                    raised = Some(error);
                }
            }
            let done = worker.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised.map_or(Ok(done), Err)
        })
    })
}

fn tell(py: Python<'_>, progress: Option<&Py<PyAny>>, (done, total, failures): Progress) -> PyResult<()> {
    let Some(progress) = progress else { return Ok(()) };
    progress.call1(py, PyTuple::new(py, [done, total, failures])?).map(|_| ())
}
