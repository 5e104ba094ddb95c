//! Space files: TOML, with errors that name file, line and field.

use std::path::Path;

use super::built_in::{FOLLOWERS, FOLLOWERS_SUMMARY};
use super::{InvalidSpace, ScenarioSpace, SpaceProblem, SpaceSpec};
use crumple_core::old_names;
use crumple_core::text_file::{FileError, line_in_toml, parse_toml, read};
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_sim::scenario::{InvalidField, OpenDriver};

/// Reads and checks a space file.
///
/// # Errors
/// [`ScenarioFileError`] for a file that cannot be read, parsed or accepted.
pub fn load(path: &Path, opener: &dyn OpenDriver) -> Result<ScenarioSpace, ScenarioFileError> {
    let text = read(path)?;
    let space = from_toml(&text, path, opener)?;
    old_names::SPACE.warn(&text, path);
    Ok(space)
}

/// Reads a space from TOML text. `path` names it in errors; a base scenario in a file is relative to its folder.
///
/// # Errors
/// [`ScenarioFileError`] for text that is not a valid space.
pub fn from_toml(
    text: &str,
    path: &Path,
    opener: &dyn OpenDriver,
) -> Result<ScenarioSpace, ScenarioFileError> {
    let spec: SpaceSpec = parse_toml(text, path)?;
    let folder = path.parent().unwrap_or(Path::new(""));
    ScenarioSpace::new(spec, folder, opener).map_err(
        |InvalidSpace { field, problem }| match problem {
            SpaceProblem::StartRefused(refusal) => ScenarioFileError::Invalid {
                path: path.to_owned(),
                line: line_in_toml(text, &field),
                invalid: InvalidField::new(field, refusal),
            },
            problem => FileError::from_field(path, text, &field, problem).into(),
        },
    )
}

const TRAFFIC_FILE: &str = include_str!("built_in/traffic.toml");
/// Descriptions before they were reworded. Hashes still contain them, because trainings and certificates name a space
/// by its hash.
const FIRST_DESCRIPTION_OF_TRAFFIC: &str = include_str!("built_in/traffic-about-of-version-1.txt");
const FIRST_DESCRIPTION_OF_FOLLOWERS: &str =
    "the emergencies of high-risk, with each of seven kinds of follower in equal shares";

/// Returns the first description of a built-in space that was reworded.
fn first_description(spec: &SpaceSpec) -> Option<&'static str> {
    match spec.name.as_str() {
        "traffic" => {
            let built_in = toml::from_str::<SpaceSpec>(TRAFFIC_FILE).ok()?;
            (built_in.about == spec.about).then(|| FIRST_DESCRIPTION_OF_TRAFFIC.trim_end())
        }
        FOLLOWERS => (spec.about == FOLLOWERS_SUMMARY).then_some(FIRST_DESCRIPTION_OF_FOLLOWERS),
        _ => None,
    }
}

/// Returns the data of a space with the description that its hash contains.
fn identity_spec(space: &ScenarioSpace) -> SpaceSpec {
    let mut spec = space.spec().clone();
    if let Some(description) = first_description(&spec) {
        spec.about = description.to_owned();
    }
    spec
}

/// Serializes the space as TOML, with its base scenario inline.
///
/// # Errors
/// None for a valid space; passes on the error of the serializer.
pub fn to_toml(space: &ScenarioSpace) -> Result<String, toml::ser::Error> {
    toml::to_string(space.spec())
}

/// Returns the text that identifies a space in hashes, and that certificates contain: [`to_toml`] with the names and
/// descriptions of version 1, so that records of 0.3.0 name the same space.
///
/// # Errors
/// Those of [`to_toml`].
pub fn to_identity_toml(space: &ScenarioSpace) -> Result<String, toml::ser::Error> {
    let text = toml::to_string(&identity_spec(space))?;
    Ok(old_names::SPACE.restore_in_text(&text))
}

/// Returns the JSON that identifies a space in hashes, with the names and descriptions of
/// version 1.
///
/// # Errors
/// None for a valid space; passes on the error of the serializer.
pub fn to_identity_json(space: &ScenarioSpace) -> Result<String, serde_json::Error> {
    let text = serde_json::to_string(&identity_spec(space))?;
    Ok(old_names::SPACE.restore_in_text(&text))
}
