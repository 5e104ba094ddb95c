//! Printing: a reader that has gone changes nothing of what a command says by its exit code.

use std::io::{self, Write};
use std::path::Path;

use super::Failure;
use crumple_search::disk::DiskError;

/// Prints to standard output. If its reader has gone, nobody misses the rest.
pub(super) fn print(text: &str) -> Result<(), Failure> {
    let mut out = io::stdout().lock();
    match out.write_all(text.as_bytes()).and_then(|()| out.flush()) {
        Ok(()) => Ok(()),
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        Err(source) => Err(DiskError::at(Path::new("standard output"))(source).into()),
    }
}

/// Says something on standard error, unless told to be quiet.
pub(super) fn note(text: &str, quiet: bool) {
    if !quiet {
        // A closed standard error leaves nowhere to complain.
        let _ = writeln!(io::stderr(), "{text}");
    }
}
