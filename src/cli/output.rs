//! Printing. A closed output stream does not change the exit code, and text from users and files is escaped.

use std::collections::BTreeSet;
use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use anstream::{AutoStream, ColorChoice};
use anstyle::{AnsiColor, Style};
use serde::Serialize;

use super::CliError;
use super::output_format::OutputFormat;
use crumple_core::quoting::{TerminalLines, TerminalMessage, shorten_message};
use crumple_store::disk::{DiskError, StagedFiles};
use crumple_store::output_folder::{EXISTING_FILE_PROBLEM, stage};

/// Maximum number of lines of a warning.
const MAX_WARNING_LINES: usize = 200;

/// Prints to standard output. Ignores a closed pipe.
pub(super) fn print(text: &str) -> Result<(), CliError> {
    emit(&TerminalLines(text).to_string())
}

fn emit(text: &str) -> Result<(), CliError> {
    let mut out = io::BufWriter::new(io::stdout().lock());
    check_written(out.write_all(text.as_bytes()).and_then(|()| out.flush()))
}

/// Prints the help or the version, with colours on a terminal. Ignores a closed pipe.
pub(super) fn print_help(help: &clap::Error) -> Result<(), CliError> {
    check_written(help.print().and_then(|()| io::stdout().flush()))
}

/// Converts an error of standard output. A closed pipe is none.
fn check_written(result: io::Result<()>) -> Result<(), CliError> {
    match result {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(DiskError::at(Path::new("standard output"))(source).into()),
    }
}

/// Prints a result, with coloured verdicts on a terminal that supports colours.
pub(super) fn print_coloured(format: OutputFormat, text: &str) -> Result<(), CliError> {
    let has_colour = AutoStream::choice(&io::stdout()) != ColorChoice::Never;
    if format == OutputFormat::Json || !has_colour {
        return print(text);
    }
    let safe = TerminalLines(text).to_string();
    emit(
        &safe
            .lines()
            .map(|line| colour_verdict(line) + "\n")
            .collect::<String>(),
    )
}

/// Words that are a verdict if they stand alone, and their colours. Of those that begin at one position the first
/// counts.
const VERDICTS: &[(&str, AnsiColor)] = &[
    ("CONTROLLER FAILED", AnsiColor::Red),
    ("COLLISION", AnsiColor::Red),
    ("VIOLATED", AnsiColor::Red),
    ("PASSED", AnsiColor::Green),
    ("FAILED", AnsiColor::Red),
    ("FALSIFIED", AnsiColor::Red),
    ("INCOMPLETE", AnsiColor::Yellow),
    ("DT-FRAGILE", AnsiColor::Yellow),
    ("no collision", AnsiColor::Green),
    ("no failure found", AnsiColor::Yellow),
    ("accepted", AnsiColor::Green),
    ("rejected", AnsiColor::Red),
    ("NOT about", AnsiColor::Red),
    ("REFUTED", AnsiColor::Red),
    ("unavoidable", AnsiColor::Yellow),
    ("avoidable", AnsiColor::Red),
    ("undecided", AnsiColor::Yellow),
    ("holds", AnsiColor::Green),
    ("passed", AnsiColor::Green),
    ("failed", AnsiColor::Red),
];

fn colour_verdict(line: &str) -> String {
    let verdicts = VERDICTS.iter().filter_map(|(word, colour)| {
        let at = line
            .match_indices(word)
            .map(|(at, _)| at)
            .find(|at| is_whole_word(line, *at, word.len()))?;
        Some((at, *word, *colour))
    });
    match verdicts.min_by_key(|(at, ..)| *at) {
        None => line.to_owned(),
        Some((at, word, colour)) => {
            let before = line.get(..at).unwrap_or_default();
            let after = line.get(at + word.len()..).unwrap_or_default();
            // A good verdict about some of several results is not one about all.
            let is_partial = colour == AnsiColor::Green
                && share_in(before).is_some_and(|[count, all]| count < all);
            let colour = if is_partial {
                AnsiColor::Yellow
            } else {
                colour
            };
            let style = Style::new().fg_color(Some(colour.into())).bold();
            format!("{before}{style}{word}{style:#}{after}")
        }
    }
}

/// Returns true if a part of a line is not part of a longer word.
fn is_whole_word(line: &str, start: usize, length: usize) -> bool {
    let before = line
        .get(..start)
        .and_then(|before| before.chars().next_back());
    let after = line
        .get(start + length..)
        .and_then(|after| after.chars().next());
    [before, after]
        .into_iter()
        .flatten()
        .all(|letter| !(letter.is_alphanumeric() || letter == '-' || letter == '_'))
}

/// Returns the last share `COUNT of ALL` in a text.
fn share_in(text: &str) -> Option<[u64; 2]> {
    let words: Vec<&str> = text.split_whitespace().collect();
    words.windows(3).rev().find_map(|words| match words {
        [count, "of", all] => Some([count.parse().ok()?, all.parse().ok()?]),
        _ => None,
    })
}

pub(super) fn print_result(
    format: OutputFormat,
    object: &impl Serialize,
    words: impl FnOnce() -> String,
) -> Result<(), CliError> {
    match format {
        OutputFormat::Json => print_json(object),
        OutputFormat::Text => print_coloured(format, &words()),
    }
}

pub(super) fn print_json(object: &impl Serialize) -> Result<(), CliError> {
    print(&(serde_json::to_string(object).map_err(CliError::input)? + "\n"))
}

/// Prints a note of one line on standard error, unless `quiet`.
pub(super) fn note(text: &str, quiet: bool) {
    if !quiet {
        emit_to_stderr(TerminalMessage(text).to_string());
    }
}

/// Notes that `--resume` found nothing to resume: with a misspelt `--out` the work would restart unnoticed.
pub(super) fn note_nothing_to_resume(resume: bool, folder: &Path, quiet: bool) {
    let is_empty = fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if resume && (is_empty || !folder.exists()) {
        note(
            &format!(
                "{}: found nothing to resume, so the work starts from the beginning",
                folder.display()
            ),
            quiet,
        );
    }
}

/// Prints several lines on standard error, each of limited length.
pub(super) fn warn(text: &str) {
    let lines: Vec<_> = text
        .lines()
        .take(MAX_WARNING_LINES)
        .map(shorten_message)
        .collect();
    emit_to_stderr(TerminalLines(&lines.join("\n")).to_string());
}

/// Prints warnings of the libraries on standard error, each once.
struct WarningLog(Mutex<BTreeSet<String>>);

static WARNING_LOG: WarningLog = WarningLog(Mutex::new(BTreeSet::new()));

impl log::Log for WarningLog {
    fn enabled(&self, metadata: &log::Metadata<'_>) -> bool {
        metadata.level() <= log::Level::Warn && metadata.target().starts_with("crumple")
    }

    fn log(&self, record: &log::Record<'_>) {
        let text = format!("warning: {}", record.args());
        let mut printed = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        if self.enabled(record.metadata()) && printed.insert(text.clone()) {
            warn(&text);
        }
    }

    fn flush(&self) {}
}

/// Shows the warnings that libraries log.
pub(super) fn show_logged_warnings() {
    // Fails only if another logger is set, as in a test that runs two commands in one process.
    let _ = log::set_logger(&WARNING_LOG);
    log::set_max_level(log::LevelFilter::Warn);
}

/// Writes a line at once: standard error has no buffer, and other programs may write to it.
fn emit_to_stderr(mut line: String) {
    line.push('\n');
    let _ = io::stderr().write_all(line.as_bytes());
}

/// Returns the file to write for a path that the user named. Follows a symbolic link, which stays. Refuses anything but
/// a plain file, such as a terminal or `/dev/null`, since writing moves a whole file into place. Refuses a path in a
/// folder that does not exist.
pub(super) fn resolve_output_path(path: &Path) -> Result<PathBuf, CliError> {
    let Ok(metadata) = fs::symlink_metadata(path) else {
        let folder = path
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty());
        let is_missing = folder.is_some_and(|folder| match fs::metadata(folder) {
            Ok(metadata) => !metadata.is_dir(),
            Err(error) => matches!(
                error.kind(),
                io::ErrorKind::NotFound | io::ErrorKind::NotADirectory
            ),
        });
        return match (is_missing, folder) {
            (true, Some(folder)) => Err(CliError::Input(format!(
                "{}: there is no folder {}",
                path.display(),
                folder.display()
            ))),
            _ => Ok(path.to_owned()),
        };
    };
    let target = match metadata.is_symlink() {
        true => fs::canonicalize(path).map_err(|error| {
            CliError::at(
                path,
                format!("the target of this symbolic link cannot be resolved: {error}"),
            )
        })?,
        false => path.to_owned(),
    };
    let metadata = fs::metadata(&target).map_err(DiskError::at(path))?;
    if !metadata.is_file() && !metadata.is_dir() {
        return Err(CliError::at(
            path,
            "is not a regular file; choose the name of a new or regular file",
        ));
    }
    Ok(target)
}

/// Stages a file that the user named. With `force` it may replace a file with other contents.
pub(super) fn stage_unless_edited(
    files: &mut StagedFiles,
    path: &Path,
    bytes: &[u8],
    force: bool,
) -> Result<(), CliError> {
    let path = resolve_output_path(path)?;
    Ok(stage(
        files,
        &path,
        bytes,
        |_| force,
        EXISTING_FILE_PROBLEM,
    )?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// "No collision" is good news only if it holds for all results.
    #[test]
    fn a_verdict_about_some_of_several_results_is_a_warning() {
        for (line, colour) in [
            (
                "  with the multi-body plant, 2 of 8 escapes have no collision (25.0 %)",
                AnsiColor::Yellow,
            ),
            (
                "  with the multi-body plant, 0 of 8 escapes have no collision (0.0 %)",
                AnsiColor::Yellow,
            ),
            (
                "  with the multi-body plant, 8 of 8 escapes have no collision (100.0 %)",
                AnsiColor::Green,
            ),
            ("  no collision", AnsiColor::Green),
            ("2 of 8 runs: COLLISION", AnsiColor::Red),
        ] {
            let style = Style::new()
                .fg_color(Some(colour.into()))
                .bold()
                .to_string();
            assert!(colour_verdict(line).contains(&style), "{line}");
        }
    }

    #[test]
    fn the_first_whole_verdict_of_a_line_is_coloured() {
        for (line, word) in [
            (
                "  COLLISION at 1.23 s: vehicle 2 hits vehicle 1",
                Some("COLLISION"),
            ),
            ("  no collision", Some("no collision")),
            ("proof.json: accepted: no gap", Some("accepted")),
            (
                "proof.json: is NOT about paper-2: its scenario is paper-1; the certificate itself is accepted: no gap",
                Some("NOT about"),
            ),
            (
                "      unavoidable: proved for every controller",
                Some("unavoidable"),
            ),
            (
                "  FALSIFIED: 3 distinct failures, one failed",
                Some("FALSIFIED"),
            ),
            ("counterexamples/01-failed_runs.toml", None),
            ("  threshold", None),
        ] {
            let shown = colour_verdict(line);
            let plain = anstream::adapter::strip_str(&shown).to_string();
            assert_eq!(plain, line);
            assert_eq!(word.is_some(), shown != line, "{shown}");
            word.iter()
                .for_each(|word| assert!(shown.contains(&format!("m{word}\u{1b}[")), "{shown:?}"));
        }
    }
}
