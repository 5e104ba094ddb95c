//! Signals: Ctrl-C, with a hint how to resume, and the file size limit.

use std::path::Path;

/// Sets an exit message for results in `folder` that the same command with `--resume` continues.
pub(super) fn set_resume_message(what: &str, folder: &Path, quiet: bool) {
    set_exit_message(
        format!(
            "{what} {}: the same command with --resume continues",
            folder.display()
        ),
        quiet,
    );
}

/// Makes Ctrl-C end the program immediately with exit code 130 and a message on standard error. Only for commands whose
/// results are on disk at any time. If no handler can be set, the default action ends the program without the message.
pub(super) fn set_exit_message(message: String, quiet: bool) {
    #[cfg(unix)]
    {
        use signal_hook::consts::SIGINT;
        use signal_hook::iterator::Signals;

        let Ok(mut signals) = Signals::new([SIGINT]) else {
            return;
        };
        std::thread::spawn(move || {
            if signals.forever().next().is_some() {
                // Ends the line of a progress bar.
                super::output::note("", quiet);
                super::output::note(&format!("interrupted: {message}"), quiet);
                std::process::exit(INTERRUPTED_EXIT_CODE);
            }
        });
    }
    #[cfg(not(unix))]
    let _ = (message, quiet);
}

/// Turns exceeding the file size limit (`ulimit -f`) into an I/O error instead of ending the program.
pub(super) fn ignore_file_size_signal() {
    #[cfg(unix)]
    {
        let unread = std::sync::Arc::default();
        // On failure the default action ends the program, which loses nothing.
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, unread);
    }
}

#[cfg(unix)]
const INTERRUPTED_EXIT_CODE: i32 = 130;
