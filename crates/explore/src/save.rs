//! A scenario as a file for the browser.

use crumple_core::quoting::{ShellWord, TerminalText};
use crumple_sim::scenario::{Scenario, file};
use serde::Serialize;

use crate::error::RequestError;

const MAX_STEM_CHARS: usize = 60;

#[derive(Debug, Serialize)]
pub(crate) struct SaveResponse {
    file_name: String,
    toml: String,
    command: String,
}

impl SaveResponse {
    pub(crate) fn new(
        scenario: &Scenario,
        controller: &str,
        estimator: &str,
    ) -> Result<Self, RequestError> {
        let toml =
            file::to_toml(scenario).map_err(|error| RequestError::Internal(error.to_string()))?;
        let file_name = format!("{}.toml", file_stem(&scenario.spec().name));
        let command = format!(
            "crumple simulate {file_name} --controller {} --estimator {estimator}",
            ShellWord(controller)
        );
        Ok(Self {
            file_name,
            toml,
            command: TerminalText(&command).to_string(),
        })
    }
}

/// Returns a file name of letters, digits and hyphens. The name cannot point to another folder, and is not one that
/// Windows reserves, such as `con`.
fn file_stem(name: &str) -> String {
    let words = name
        .split(|letter: char| !letter.is_ascii_alphanumeric())
        .filter(|word| !word.is_empty());
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
    use crumple_sim::scenario::NoDriverFiles;
    use std::path::Path;

    use super::*;
    use crumple_sim::scenario::built_in_scenario;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// The file of a scenario with any name has the scenario, and a file name that is no path.
        #[test]
        fn file_names_contain_no_path(name in "(\\.\\./)?[ -~äß/\\\\]{1,40}") {
            let scenario = built_in_scenario("paper-1").unwrap().edited(|spec| spec.name = name.clone()).unwrap();
            let saved = SaveResponse::new(&scenario, "idm", "truth").unwrap();
            let stem = saved.file_name.strip_suffix(".toml").unwrap();
            let is_plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '-';
            prop_assert!(!stem.is_empty() && stem.chars().all(is_plain));
            let path = Path::new(&saved.file_name);
            prop_assert_eq!(file::from_toml(&saved.toml, path, &NoDriverFiles).unwrap(), scenario);
        }
    }
}
