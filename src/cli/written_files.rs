//! Checks the files that a command is to write before its work begins.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Arg, ArgMatches, Command};

use super::error::CliError;
use super::output;

/// Options that name a file or folder to write.
const OUTPUTS: &[&str] = &[
    "out",
    "certificate",
    "bound_certificate",
    "table",
    "plot",
    "trace",
    "preview",
];

/// Checks that every file that a command is to write can be written, and is none of the files that it reads.
///
/// # Errors
/// [`CliError::Input`] names the file.
pub(super) fn check(command: &Command, matches: &ArgMatches) -> Result<(), CliError> {
    if let Some((name, matches)) = matches.subcommand()
        && let Some(command) = command.find_subcommand(name)
    {
        return check(command, matches);
    }
    let (outputs, inputs): (Vec<&Arg>, Vec<&Arg>) = command
        .get_arguments()
        .partition(|argument| OUTPUTS.contains(&argument.get_id().as_str()));
    let read: Vec<PathBuf> = inputs
        .into_iter()
        .flat_map(|argument| values(argument, matches))
        .filter_map(named_file)
        .collect();
    for argument in outputs.into_iter().filter(|argument| names_file(argument)) {
        for path in values(argument, matches).map(Path::new) {
            let target = output::resolve_output_path(path)?;
            if fs::canonicalize(target).is_ok_and(|target| read.contains(&target)) {
                return Err(CliError::at(
                    path,
                    "is an input of this command, which would be lost: write to another file",
                ));
            }
        }
    }
    Ok(())
}

/// Returns true if an output is one file.
fn names_file(argument: &Arg) -> bool {
    let names = argument.get_value_names().unwrap_or_default();
    !names.iter().any(|name| name == "DIR" || name == "FOLDER")
}

fn values<'m>(
    argument: &Arg,
    matches: &'m ArgMatches,
) -> impl Iterator<Item = &'m OsStr> + use<'m> {
    let raw = matches.try_get_raw(argument.get_id().as_str());
    raw.ok().flatten().into_iter().flatten()
}

/// Returns the file that the value of an option names, also behind a shield as in `shield:my.toml`.
fn named_file(value: &OsStr) -> Option<PathBuf> {
    let behind_shields = value.to_str().and_then(|text| text.rsplit(':').next());
    [Some(value), behind_shields.map(OsStr::new)]
        .into_iter()
        .flatten()
        .find_map(|name| fs::canonicalize(name).ok().filter(|path| path.is_file()))
}
