//! Long work on other threads, while the calling thread reports progress and checks for signals.

use std::ops::ControlFlow;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;

use crate::threads;

/// Interval at which the calling thread checks for signals.
const SIGNAL_CHECK_INTERVAL: Duration = Duration::from_millis(50);

/// Time for which the exit of the interpreter waits for work to end.
const EXIT_TIMEOUT: Duration = Duration::from_secs(5);

/// Flag that work must stop early. Clones share it.
#[derive(Debug, Clone, Default)]
pub(crate) struct StopFlag(Arc<AtomicBool>);

impl StopFlag {
    pub(crate) fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Progress of work: number done, total, and failures.
pub(crate) type ProgressCounts = (u64, u64, u64);

/// Work in progress, and the condition that signals its end.
struct WorkList {
    flags: Mutex<Vec<StopFlag>>,
    ended: Condvar,
}

static ACTIVE_WORK: WorkList = WorkList {
    flags: Mutex::new(Vec::new()),
    ended: Condvar::new(),
};

/// Guard that removes work from [`ACTIVE_WORK`] when it is dropped.
struct ActiveWork(StopFlag);

impl Drop for ActiveWork {
    fn drop(&mut self) {
        ACTIVE_WORK
            .flags
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .retain(|stop| !Arc::ptr_eq(&stop.0, &self.0.0));
        ACTIVE_WORK.ended.notify_all();
    }
}

/// Stops all work before the interpreter exits; a call of a Python controller afterwards would crash.
#[pyfunction]
pub(crate) fn stop_all_work(py: Python<'_>) {
    py.detach(|| {
        let flags = ACTIVE_WORK
            .flags
            .lock()
            .unwrap_or_else(PoisonError::into_inner);
        flags.iter().for_each(StopFlag::set);
        // A callable may be slow, but must not block the exit forever.
        drop(
            ACTIVE_WORK
                .ended
                .wait_timeout_while(flags, EXIT_TIMEOUT, |flags| !flags.is_empty()),
        );
    });
}

/// Function that work reports progress to; it ends the work once the work's [`StopFlag`] is set.
pub(crate) type ReportProgress<'a> = &'a (dyn Fn(ProgressCounts) -> ControlFlow<()> + Sync);

/// Runs `work` on the simulation threads, without the interpreter's lock. The function that `work` reports progress to
/// ends it once `stop` is set: at a signal (Ctrl-C), and at an exception of `progress`.
pub(crate) fn run_interruptible<T: Send>(
    py: Python<'_>,
    stop: &StopFlag,
    progress: Option<&Py<PyAny>>,
    threads: Option<usize>,
    work: impl FnOnce(ReportProgress<'_>) -> T + Send,
) -> PyResult<T> {
    refuse_nested_work()?;
    let pool = threads::pool(threads)?;
    run_beside(py, stop, progress, move |say| {
        pool.install(move || work(say))
    })
}

/// Runs `work`, which mostly waits, on a thread of its own, and otherwise like [`run_interruptible`].
pub(crate) fn wait_interruptible<T: Send>(
    py: Python<'_>,
    stop: &StopFlag,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(ReportProgress<'_>) -> T + Send,
) -> PyResult<T> {
    refuse_nested_work()?;
    run_beside(py, stop, progress, work)
}

/// Refuses work of a controller that drives: it can deadlock with the threads that wait for it.
fn refuse_nested_work() -> PyResult<()> {
    if rayon::current_thread_index().is_some() {
        return Err(PyRuntimeError::new_err(
            "a controller cannot begin simulations of its own while it drives",
        ));
    }
    Ok(())
}

/// Runs `work` on another thread, while this one reports progress and checks for signals.
fn run_beside<T: Send>(
    py: Python<'_>,
    stop: &StopFlag,
    progress: Option<&Py<PyAny>>,
    work: impl FnOnce(ReportProgress<'_>) -> T + Send,
) -> PyResult<T> {
    ACTIVE_WORK
        .flags
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(stop.clone());
    let _under_way = ActiveWork(stop.clone());
    let (sender, receiver) = mpsc::channel::<ProgressCounts>();
    py.detach(move || {
        thread::scope(|scope| {
            let worker = scope.spawn(move || {
                work(&|state| {
                    // After an exception the channel has no receiver.
                    let _ = sender.send(state);
                    if stop.is_set() {
                        ControlFlow::Break(())
                    } else {
                        ControlFlow::Continue(())
                    }
                })
            });
            let raised = report_progress(&receiver, stop, progress);
            let result = worker
                .join()
                .unwrap_or_else(|panic| std::panic::resume_unwind(panic));
            raised.map_or(Ok(result), Err)
        })
    })
}

/// Reports progress to Python until the channel closes. Returns the first exception, at which it sets `stop`.
fn report_progress(
    receiver: &mpsc::Receiver<ProgressCounts>,
    stop: &StopFlag,
    progress: Option<&Py<PyAny>>,
) -> Option<PyErr> {
    let mut raised = None;
    loop {
        // The channel closes when the work is done.
        let checked = match receiver.recv_timeout(SIGNAL_CHECK_INTERVAL) {
            Ok(counts) => Python::attach(|py| {
                progress.map_or(Ok(()), |progress| progress.call1(py, counts).map(drop))?;
                py.check_signals()
            }),
            Err(RecvTimeoutError::Timeout) => Python::attach(|py| py.check_signals()),
            Err(RecvTimeoutError::Disconnected) => return raised,
        };
        if let Err(error) = checked
            && raised.is_none()
        {
            stop.set();
            raised = Some(error);
        }
    }
}
