//! Storage of a scenario as a file.

use std::fs::OpenOptions;
use std::io::{ErrorKind, Write};
use std::path::{Path, PathBuf};

use crumple_core::quoting::{ShellWord, TerminalText};
use crumple_world::scenario::{Scenario, file};
use serde::Serialize;

use crate::error::RequestError;

const MAX_STEM_CHARS: usize = 60;
const MAX_SAME_NAME_FILES: usize = 1000;

#[derive(Debug, Serialize)]
pub(crate) struct SaveResponse {
    file_name: String,
    toml: String,
    /// Path of the saved file; none without a folder.
    path: Option<String>,
    command: String,
}

/// Writes a scenario into a folder, if given, under an unused name. Overwrites nothing.
pub(crate) fn save_scenario(
    scenario: &Scenario,
    controller: &str,
    estimator: &str,
    out: Option<&Path>,
) -> Result<SaveResponse, RequestError> {
    let toml = file::to_toml(scenario).map_err(|error| RequestError::Internal(error.to_string()))?;
    let plain = file_stem(&scenario.spec().name);
    let path = out.map(|folder| write_new_file(folder, &plain, &toml)).transpose()?;
    let file_name = path
        .as_ref()
        .and_then(|path| path.file_name())
        .map_or(format!("{plain}.toml"), |name| name.to_string_lossy().into_owned());
    let place = path.as_ref().map_or(file_name.clone(), |path| path.display().to_string());
    let command = format!(
        "crumple simulate {} --controller {} --estimator {estimator}",
        ShellWord(&place),
        ShellWord(controller)
    );
    Ok(SaveResponse {
        file_name,
        toml,
        path: path.map(|path| TerminalText(&path.display().to_string()).to_string()),
        command: TerminalText(&command).to_string(),
    })
}

fn write_new_file(folder: &Path, plain: &str, toml: &str) -> Result<PathBuf, RequestError> {
    for number in 1..=MAX_SAME_NAME_FILES {
        let name = if number == 1 { format!("{plain}.toml") } else { format!("{plain}-{number}.toml") };
        let path = folder.join(name);
        let failed = |error: std::io::Error| RequestError::Internal(format!("{}: {error}", path.display()));
        // Fails for any existing entry, links included.
        let mut file = match OpenOptions::new().write(true).create_new(true).open(&path) {
            Ok(file) => file,
            Err(error) if error.kind() == ErrorKind::AlreadyExists => continue,
            Err(error) => return Err(failed(error)),
        };
        return match file.write_all(toml.as_bytes()).and_then(|()| file.sync_all()) {
            Ok(()) => Ok(path),
            Err(error) => {
                // Remove an incomplete file.
                let _ = std::fs::remove_file(&path);
                Err(failed(error))
            }
        };
    }
    Err(RequestError::invalid("edits.name", format!("there are already {MAX_SAME_NAME_FILES} scenarios of this name")))
}

/// Returns a file name of letters, digits and hyphens. The name cannot point outside the folder, and is not one that
/// Windows reserves, such as `con`.
fn file_stem(name: &str) -> String {
    let words = name.split(|letter: char| !letter.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let mut plain = words.collect::<Vec<_>>().join("-").to_ascii_lowercase();
    plain.truncate(MAX_STEM_CHARS);
    let plain = plain.trim_end_matches('-');
    let is_reserved = ["con", "prn", "aux", "nul"].contains(&plain)
        || plain.len() == 4 && (plain.starts_with("com") || plain.starts_with("lpt"));
    match plain {
        "" => "scenario".to_owned(),
        _ if is_reserved => format!("scenario-{plain}"),
        _ => plain.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::scenario::built_in_scenario;
    use proptest::prelude::*;

    proptest! {
        /// A scenario with any name is saved in the folder, is valid, and replaces nothing.
        #[test]
        fn a_scenario_is_saved_in_the_folder_and_nowhere_else(name in "(\\.\\./)?[ -~äß/\\\\]{1,40}") {
            let parent = tempfile::tempdir().unwrap();
            let out = parent.path().join("out");
            std::fs::create_dir(&out).unwrap();
            let scenario = built_in_scenario("paper-1").unwrap().edited(|spec| spec.name = name.clone()).unwrap();
            for times in 1..4 {
                let saved = save_scenario(&scenario, "idm", "truth", Some(&out)).unwrap();
                prop_assert_eq!(std::fs::read_dir(&out).unwrap().count(), times);
                prop_assert_eq!(file::load(&out.join(&saved.file_name)).unwrap(), scenario.clone());
            }
            prop_assert_eq!(std::fs::read_dir(parent.path()).unwrap().count(), 1);
        }
    }
}
