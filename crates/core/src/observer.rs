//! Progress of long work, and the decision to stop it.

use std::fmt;
use std::ops::ControlFlow;
use std::sync::atomic::{AtomicU64, Ordering};

/// A receiver of progress that may stop the work.
///
/// Work ends soon after an observer returns [`ControlFlow::Break`], with an error that holds [`Stopped`]. It completes the batch of runs in
/// progress first. Run folders keep the batches before it, so that the work can be resumed.
///
/// ```
/// use crumple_core::observer::{Observer, Progress, Quiet, Stopped};
/// use std::ops::ControlFlow;
///
/// let limited = |progress: &Progress| if progress.done < 3 { ControlFlow::Continue(()) } else { ControlFlow::Break(()) };
/// assert_eq!(limited.notify(&Progress { done: 3, total: None }), Err(Stopped));
/// assert_eq!(Quiet.notify(&Progress { done: 3, total: None }), Ok(()));
/// ```
pub trait Observer<P: ?Sized>: Sync {
    /// Receives progress, and decides whether the work continues. May be called from several threads.
    fn observe(&self, progress: &P) -> ControlFlow<()>;

    /// Passes progress on, for work that returns an error when it is stopped.
    ///
    /// # Errors
    /// [`Stopped`] if the observer stops the work.
    fn notify(&self, progress: &P) -> Result<(), Stopped> {
        if self.observe(progress).is_break() { Err(Stopped) } else { Ok(()) }
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

/// Progress of work that counts its units, in most cases simulation runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct RunProgress {
    /// Completed units.
    pub done: u64,
    /// Units in all, if that is known.
    pub total: Option<u64>,
}

/// A count of completed units, shared by the threads that complete them.
pub struct ProgressCounter<'o> {
    observer: &'o dyn Observer<RunProgress>,
    done: AtomicU64,
    total: Option<u64>,
}

impl<'o> ProgressCounter<'o> {
    /// Starts at 0.
    #[must_use]
    pub fn new(observer: &'o dyn Observer<RunProgress>, total: Option<u64>) -> Self {
        Self { observer, done: AtomicU64::new(0), total }
    }

    /// Adds completed units, and reports the new count.
    ///
    /// # Errors
    /// [`Stopped`] if the observer stops the work.
    pub fn add(&self, units: u64) -> Result<(), Stopped> {
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        self.observer.notify(&RunProgress { done, total: self.total })
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
