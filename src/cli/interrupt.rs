//! Signals: Ctrl-C, on which commands that keep what they have done say how to go on with it; and a limit on the size of files.

/// From now on an interruption ends the program at once, with exit code 130 and a message on standard error. Only for commands
/// that lose nothing by that: whatever they have done is on disk.
///
/// Where no handler can be set, an interruption ends the program without a word, and as safely.
pub(super) fn set_exit_message(message: String, quiet: bool) {
    #[cfg(unix)]
    {
        use signal_hook::consts::SIGINT;
        use signal_hook::iterator::Signals;

        let Ok(mut signals) = Signals::new([SIGINT]) else { return };
        std::thread::spawn(move || {
            if signals.forever().next().is_some() {
                // A progress bar may be in the line.
                super::output::note("", quiet);
                super::output::note(&format!("interrupted: {message}"), quiet);
                std::process::exit(INTERRUPTED_EXIT_CODE);
            }
        });
    }
    #[cfg(not(unix))]
    let _ = (message, quiet);
}

/// From now on a file that grows beyond what the system allows (`ulimit -f`) is an error, as a full disk is, and not the end of the
/// program.
pub(super) fn ignore_file_size_signal() {
    #[cfg(unix)]
    {
        let unread = std::sync::Arc::default();
        // Where it cannot be set, the program ends as the system has it, and loses nothing either.
        let _ = signal_hook::flag::register(signal_hook::consts::SIGXFSZ, unread);
    }
}

/// Exit code of a command that was interrupted.
#[cfg(unix)]
const INTERRUPTED_EXIT_CODE: i32 = 130;
