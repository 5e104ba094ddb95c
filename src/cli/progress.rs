//! Progress bars on a terminal; nothing in a pipe.

use std::sync::Arc;
use std::time::Duration;

use crumple_core::observer::{Listener, Observer, RunProgress};
use crumple_exchange::recording::ReadProgress;
use indicatif::{HumanDuration, ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Creates a bar on standard error, shown only on a terminal.
fn progress_bar(template: &str, total: Option<u64>, quiet: bool) -> ProgressBar {
    let target = if quiet {
        ProgressDrawTarget::hidden()
    } else {
        ProgressDrawTarget::stderr()
    };
    let style =
        ProgressStyle::with_template(template).unwrap_or_else(|_| ProgressStyle::default_bar());
    ProgressBar::with_draw_target(total, target).with_style(style)
}

pub(super) fn run_bar(what: &'static str, total: u64, quiet: bool) -> ProgressBar {
    let template = "{msg} {bar:30} {human_pos}/{human_len} runs, {eta} left";
    progress_bar(template, Some(total), quiet).with_message(what)
}

pub(super) fn training_bar(total: u64, quiet: bool) -> ProgressBar {
    progress_bar(
        "training {bar:24} {human_pos}/{human_len} episodes, {per_sec}; {msg}",
        Some(total),
        quiet,
    )
}

pub(super) fn campaign_bar(total: u64, quiet: bool) -> ProgressBar {
    progress_bar(
        "{msg} {wide_bar} {human_pos}/{human_len} runs, {eta} left",
        Some(total),
        quiet,
    )
}

/// Replaces the bar by a spinner: for a step that follows the counted work and takes an unknown time.
pub(super) fn show_uncounted_step(bar: &ProgressBar, message: String) {
    let style = ProgressStyle::with_template("{msg} {spinner} {elapsed} in all");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_spinner()));
    bar.enable_steady_tick(Duration::from_millis(200));
    bar.set_message(message);
}

pub(super) fn counter(what: &'static str, quiet: bool) -> ProgressBar {
    progress_bar("{msg} {spinner} {human_pos} runs", None, quiet).with_message(what)
}

/// Returns a bar of the completed share of a stage, which the message names.
pub(super) fn share_bar(what: &'static str, quiet: bool) -> ProgressBar {
    progress_bar("{bar:30} {percent:>3} %  {msg}", Some(1), quiet).with_message(what)
}

pub(super) fn depth_line(what: &'static str, total: u64, quiet: bool) -> ProgressBar {
    progress_bar("{prefix} {spinner} {msg}", Some(total), quiet).with_prefix(what)
}

/// Returns a bar of the bytes of recordings, and the function that advances it; short recordings show none.
pub(super) fn read_bar(quiet: bool) -> (ProgressBar, ReadProgress) {
    const MIN_BYTES: u64 = 64 << 20;
    let bar = progress_bar(
        "reading {wide_bar} {bytes}/{total_bytes}, {eta} left",
        None,
        quiet,
    );
    let shown = bar.clone();
    let progress: ReadProgress = Arc::new(move |read: u64, total: u64| {
        if total >= MIN_BYTES {
            shown.set_length(total);
            shown.set_position(read);
        }
    });
    (bar, progress)
}

pub(super) fn replay_bar(quiet: bool) -> ProgressBar {
    progress_bar(
        "replay {wide_bar} {human_pos}/{human_len} s, {eta} left",
        Some(1),
        quiet,
    )
}

/// Returns a bar of imported scenarios. It shows the time, because one scenario may take seconds.
pub(super) fn import_bar(total: u64, quiet: bool) -> ProgressBar {
    let bar = progress_bar(
        "importing {spinner} {human_pos}/{human_len} scenarios ({elapsed})",
        Some(total),
        quiet,
    );
    if !bar.is_hidden() {
        bar.enable_steady_tick(Duration::from_millis(200));
    }
    bar
}

pub(super) fn status_line(quiet: bool) -> ProgressBar {
    progress_bar("{spinner} {msg} ({elapsed})", None, quiet)
}

/// Returns how long a step is expected to go on, to follow a message; empty before any of it is done.
pub(super) fn format_time_left(elapsed: Duration, done: f64, total: f64) -> String {
    if done <= 0.0 {
        return String::new();
    }
    // The limit prevents an overflow.
    format!(
        "; about {} left",
        HumanDuration(elapsed.mul_f64(((total - done) / done).clamp(0.0, 1e4)))
    )
}

/// Does work that advances a bar from its present position, and clears the bar.
pub(super) fn show<T>(bar: &ProgressBar, work: impl FnOnce(&dyn Observer<RunProgress>) -> T) -> T {
    let begin = bar.position();
    let done = work(&Listener(|progress: &RunProgress| {
        bar.set_position(begin + progress.done)
    }));
    bar.finish_and_clear();
    done
}
