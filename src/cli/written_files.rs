//! Checks the files that a command is to write before its work begins.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use clap::{Arg, ArgMatches, Command};

use super::error::CliError;
use super::output;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::built_in_scenario;
use crumple_spaces::built_in_space;

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

/// Checks that every file that a command is to write can be written, and is none of the files that it reads: those that
/// its arguments name, and those `opened` while they were read, such as the network of a controller file.
///
/// # Errors
/// [`CliError::Input`] names the file.
pub(super) fn check(
    command: &Command,
    matches: &ArgMatches,
    opened: &[PathBuf],
) -> Result<(), CliError> {
    if let Some((name, matches)) = matches.subcommand()
        && let Some(command) = command.find_subcommand(name)
    {
        return check(command, matches, opened);
    }
    let (outputs, inputs): (Vec<&Arg>, Vec<&Arg>) = command
        .get_arguments()
        .partition(|argument| OUTPUTS.contains(&argument.get_id().as_str()));
    let read: Vec<PathBuf> = inputs
        .into_iter()
        .flat_map(|argument| values(argument, matches))
        .flat_map(named_files)
        .collect();
    for argument in outputs.into_iter().filter(|argument| names_file(argument)) {
        for path in values(argument, matches).map(Path::new) {
            let target = output::resolve_output_path(path)?;
            let is_read = |target| read.contains(&target) || opened.contains(&target);
            if fs::canonicalize(target).is_ok_and(is_read) {
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

/// Returns the files that the value of an option names, also behind a shield as in `shield:my.toml`, and as words of
/// the command of `exec:`.
fn named_files(value: &OsStr) -> Vec<PathBuf> {
    let text = value.to_str();
    if text.is_some_and(is_built_in) {
        return Vec::new();
    }
    let words = text.into_iter().flat_map(|text| {
        let behind_shields = text.rsplit(':').next().unwrap_or_default();
        std::iter::once(behind_shields).chain(behind_shields.split_whitespace())
    });
    std::iter::once(value)
        .chain(words.map(OsStr::new))
        .filter_map(|name| fs::canonicalize(name).ok())
        .filter(|path| path.is_file())
        .collect()
}

/// Returns true for a name that crumple knows, whatever file has it.
fn is_built_in(name: &str) -> bool {
    built_in_scenario(name).is_some()
        || built_in_space(name).is_some()
        || BuiltInController::from_name(name).is_some()
}
