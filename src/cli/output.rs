//! Printing: a reader that has gone changes nothing of what a command says by its exit code, and nothing that a user or a file
//! named reaches a terminal but as text.

use std::fs;
use std::io::{self, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;

use super::Failure;
use crumple_search::disk::DiskError;
use crumple_world::quoted::{Lines, Terminal};

/// Prints to standard output. If its reader has gone, nobody misses the rest.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::BufWriter::new(io::stdout().lock());
    match write!(out, "{}", Lines(text)).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(DiskError::at(Path::new("standard output"))(source).into()),
    }
}

/// Prints one JSON object in a line.
pub(super) fn print_json(object: &impl Serialize) -> Result<(), Failure> {
    print(&(serde_json::to_string(object).map_err(Failure::input)? + "\n"))
}

/// Says something on standard error, in one line, unless told to be quiet.
pub(super) fn note(text: &str, quiet: bool) {
    if !quiet {
        warn(&Terminal(text).to_string());
    }
}

/// Says that there is nothing to go on with, where `--resume` asks for it: a typing error in `--out` would begin everything anew.
pub(super) fn note_beginning(resume: bool, folder: &Path, quiet: bool) {
    let is_empty = fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_none());
    if resume && (is_empty || !folder.exists()) {
        note(&format!("{}: nothing to go on with is there, so it begins anew", folder.display()), quiet);
    }
}

/// Says something of several lines on standard error.
pub(super) fn warn(text: &str) {
    // A closed standard error leaves nowhere to complain.
    let _ = writeln!(io::stderr(), "{}", Lines(text));
}

/// Where a single file goes that the user named. A symbolic link stays, and what it leads to is written; what is no file, such as
/// a terminal or `/dev/null`, is refused, for files are moved into their places whole and one would be in its place.
pub(super) fn place(path: &Path) -> Result<PathBuf, Failure> {
    let Ok(there) = fs::symlink_metadata(path) else { return Ok(path.to_owned()) };
    let place = match there.is_symlink() {
        true => fs::canonicalize(path).map_err(|error| {
            Failure::Input(format!("{}: a symbolic link that leads nowhere: {error}", path.display()))
        })?,
        false => path.to_owned(),
    };
    let found = fs::metadata(&place).map_err(DiskError::at(path))?;
    if !found.is_file() && !found.is_dir() {
        return Err(Failure::Input(format!("{}: is no file, and results are files", path.display())));
    }
    Ok(place)
}

/// An upper bound with four digits, never below what it was: rounded to the nearest, it would claim more than was shown.
pub(super) fn rounded_up(bound: f64) -> String {
    let nearest = format!("{bound:.3e}");
    match nearest.parse::<f64>() {
        Ok(shown) if shown < bound => {
            let last_digit = 10f64.powi(bound.abs().log10().floor() as i32 - 3);
            format!("{:.3e}", shown + last_digit)
        }
        _ => nearest,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bounds_are_rounded_away_from_what_they_claim() {
        for (bound, shown) in [
            (0.260_149, "2.602e-1"),
            (0.469_700_7, "4.698e-1"),
            (0.25, "2.500e-1"),
            (9.9999e-7, "1.000e-6"),
            (0.0, "0.000e0"),
        ] {
            assert_eq!(rounded_up(bound), shown);
        }
    }
}
