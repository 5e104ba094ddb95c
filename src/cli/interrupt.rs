//! Ctrl-C: commands that keep what they have done say how to go on with it.

/// From now on an interruption ends the program at once, with exit code 130 and a message on standard error. Only for commands
/// that lose nothing by that: whatever they have done is on disk.
///
/// Where no handler can be set, an interruption ends the program without a word, and as safely.
pub(super) fn says(message: String, quiet: bool) {
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
                std::process::exit(INTERRUPTED);
            }
        });
    }
    #[cfg(not(unix))]
    let _ = (message, quiet);
}

/// Exit code of a command that was interrupted.
#[cfg(unix)]
const INTERRUPTED: i32 = 130;
