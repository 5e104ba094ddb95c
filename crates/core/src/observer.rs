//! Progress of long work, and the decision to stop it.

use std::fmt;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

/// A receiver of progress that may stop the work.
///
/// Work completes its batch of simulations after an observer returns [`ControlFlow::Break`], then ends with an error
/// that holds [`Stopped`]. Run folders keep all earlier batches, so that the work can be resumed.
///
/// ```
/// use crumple_core::observer::{Observer, Quiet, RunProgress, Stopped};
/// use std::ops::ControlFlow;
///
/// let limited = |p: &RunProgress| if p.done < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
/// assert_eq!(limited.notify(&RunProgress { done: 3, total: None }), Err(Stopped));
/// assert_eq!(Quiet.notify(&RunProgress { done: 3, total: None }), Ok(()));
/// ```
pub trait Observer<P: ?Sized>: Sync {
    /// Receives progress, and decides whether the work continues. Several threads may call this function.
    fn observe(&self, progress: &P) -> ControlFlow<()>;

    /// Passes progress on, and returns an error if the work must stop.
    ///
    /// # Errors
    /// [`Stopped`] if the observer stops the work.
    fn notify(&self, progress: &P) -> Result<(), Stopped> {
        if self.observe(progress).is_break() {
            Err(Stopped)
        } else {
            Ok(())
        }
    }
}

impl<P: ?Sized, F: Fn(&P) -> ControlFlow<()> + Sync> Observer<P> for F {
    fn observe(&self, progress: &P) -> ControlFlow<()> {
        self(progress)
    }
}

/// An observer that ignores all progress.
#[derive(Debug, Clone, Copy)]
pub struct Quiet;

impl<P: ?Sized> Observer<P> for Quiet {
    fn observe(&self, _: &P) -> ControlFlow<()> {
        ControlFlow::Continue(())
    }
}

/// An observer that calls a function and never stops the work.
#[derive(Debug, Clone, Copy)]
pub struct Listener<F>(pub F);

impl<P: ?Sized, F: Fn(&P) + Sync> Observer<P> for Listener<F> {
    fn observe(&self, progress: &P) -> ControlFlow<()> {
        self.0(progress);
        ControlFlow::Continue(())
    }
}

/// Progress in completed units, in most cases simulations.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunProgress {
    /// Completed units.
    pub done: u64,
    /// Total number of units, if known.
    pub total: Option<u64>,
}

/// A count of completed units, shared by the threads that complete them.
pub struct ProgressCounter<'o> {
    observer: &'o dyn Observer<RunProgress>,
    done: AtomicU64,
    total: Option<u64>,
}

impl<'o> ProgressCounter<'o> {
    /// Creates a counter at 0.
    #[must_use]
    pub fn new(observer: &'o dyn Observer<RunProgress>, total: Option<u64>) -> Self {
        Self {
            observer,
            done: AtomicU64::new(0),
            total,
        }
    }

    /// Adds completed units, and reports the new count.
    ///
    /// # Errors
    /// [`Stopped`] if the observer stops the work.
    pub fn add(&self, units: u64) -> Result<(), Stopped> {
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        self.observer.notify(&RunProgress {
            done,
            total: self.total,
        })
    }
}

/// The error of work that its observer stopped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stopped;

impl fmt::Display for Stopped {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("stopped by its observer")
    }
}

impl std::error::Error for Stopped {}
