//! Errors of arguments that are not UTF-8. The errors of clap do not name the argument.

use std::ffi::OsString;

use clap::error::ErrorKind;

use super::build_command;

/// Describes the first argument that must be UTF-8 and is not, in arguments that clap refuses for this reason.
///
/// Names of most files may be any bytes. clap parses values in the order of the arguments, so the first one up to
/// which it refuses them is the wrong one.
pub(super) fn describe_first(arguments: &[OsString]) -> String {
    let ends = (1..=arguments.len()).filter(|end| {
        let last = end.checked_sub(1).and_then(|index| arguments.get(index));
        last.is_some_and(|argument| argument.to_str().is_none())
    });
    let Some(end) = ends.into_iter().find(|end| {
        let parsed = build_command().try_get_matches_from(arguments.iter().take(*end));
        parsed.is_err_and(|error| error.kind() == ErrorKind::InvalidUtf8)
    }) else {
        return "an argument is not UTF-8".to_owned();
    };
    let [.., before, argument] = arguments.get(..end).unwrap_or_default() else {
        return "the name of the program is not UTF-8".to_owned();
    };
    let [argument, before] = [argument, before].map(|word| word.to_string_lossy());
    let (option, value) = match argument.split_once('=') {
        Some((option, value)) if option.starts_with("--") => (option, value),
        _ if takes_value(&before, arguments) => (&*before, &*argument),
        _ => ("argument", &*argument),
    };
    format!("{option}: `{value}` must be UTF-8; if it is the name of a file, rename the file")
}

/// Returns true if a word is an option of the subcommand, and needs a value.
fn takes_value(word: &str, arguments: &[OsString]) -> bool {
    let Some(name) = word.strip_prefix("--") else {
        return false;
    };
    let mut command = &build_command();
    for word in arguments.iter().skip(1) {
        command = command.find_subcommand(word).unwrap_or(command);
    }
    command
        .get_arguments()
        .any(|option| option.get_long() == Some(name) && option.get_action().takes_values())
}
