//! From recordings to scenario files, all or nothing.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crate::scenario::{Scenario, file::to_toml};

use super::dropped::{DroppedItem, EpisodeProblem, Omission};
use super::episodes::{LeaderSelection, MinBrake, find_episodes};
use super::error::RecordingError;
use super::map::RecordingMap;
use super::preview::{HardestBrakingResult, hardest_braking};
use super::{Recording, RecordingFormat, load};

/// Longest part of a file's name that goes into a scenario's.
const MAX_STEM: usize = 100;

/// What to import.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImportOptions {
    /// The least braking that makes an episode.
    pub min_brake: MinBrake,
    /// Whose braking makes one.
    pub leaders: LeaderSelection,
}

/// The scenarios of a set of recordings, nothing written yet.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImportResult {
    /// One scenario an episode, in the order of the recordings. No two have the same name.
    pub scenarios: Vec<ImportedScenario>,
    /// What was read, one entry a recording.
    pub sources: Vec<ImportedRecording>,
    /// What was left out, in the order of the recordings.
    pub dropped: Vec<DroppedItem>,
}

/// A scenario and its file.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedScenario {
    /// The file's name: the scenario's with `.toml` behind it; lower-case letters, digits, `-` and `.` only.
    pub file_name: String,
    /// The file's text.
    pub toml: String,
    /// The scenario in it.
    pub scenario: Scenario,
}

/// What one recording yielded.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedRecording {
    /// The recording.
    pub path: PathBuf,
    /// Its format.
    pub format: RecordingFormat,
    /// Scenarios made of it.
    pub scenarios: usize,
    /// The hardest braking in it, whether it made a scenario or not.
    pub hardest: HardestBrakingResult,
}

/// Reads recordings, by a map if there is one, and renders one scenario file for each braking episode. Writes nothing: a caller that gets a result
/// has all of it.
///
/// Scenarios are named after format, file and a number, such as `openacc-long-setting-dynamic-part16-01`; files of one
/// name in different folders are numbered on.
///
/// # Errors
/// [`RecordingError`] for the first recording that cannot be read, see [`load`].
pub fn import(
    paths: &[PathBuf],
    map: Option<&RecordingMap>,
    options: &ImportOptions,
) -> Result<ImportResult, RecordingError> {
    let mut imported = ImportResult::default();
    let mut numbers = BTreeMap::new();
    for path in paths {
        let recording = load(path, map)?;
        let number = numbers.entry(prefix(&recording)).or_insert(0);
        imported.add_recording(&recording, options, number)?;
    }
    Ok(imported)
}

impl ImportResult {
    fn add_recording(
        &mut self,
        recording: &Recording,
        options: &ImportOptions,
        number: &mut usize,
    ) -> Result<(), RecordingError> {
        let found = find_episodes(recording, options.min_brake, options.leaders);
        self.dropped.extend(recording.dropped.iter().cloned().chain(found.dropped));
        let file = recording.path.file_name().unwrap_or_default().to_string_lossy();
        let before = self.scenarios.len();
        for episode in &found.episodes {
            let name = format!("{}-{:02}", prefix(recording), *number + 1);
            match episode.scenario(name.clone(), &file) {
                Ok(scenario) => {
                    *number += 1;
                    let file_name = format!("{name}.toml");
                    let path = || recording.path.clone();
                    let toml =
                        to_toml(&scenario).map_err(|source| RecordingError::Render { path: path(), name, source })?;
                    self.scenarios.push(ImportedScenario { file_name, toml, scenario });
                }
                Err(invalid) => {
                    let number = episode.vehicles.first().map_or(0, |leader| leader.number);
                    let onset_s = episode.start_s + episode.onset_s;
                    let what = Omission::Episode { number, onset_s, reason: EpisodeProblem::Invalid(invalid) };
                    self.dropped.push(DroppedItem { path: recording.path.clone(), line: episode.line, omission: what });
                }
            }
        }
        self.sources.push(ImportedRecording {
            path: recording.path.clone(),
            format: recording.format.clone(),
            scenarios: self.scenarios.len() - before,
            hardest: hardest_braking(recording),
        });
        Ok(())
    }
}

/// Format and file in lower-case letters, digits and single hyphens; a file already named after its format is not named
/// after it twice.
fn prefix(recording: &Recording) -> String {
    let format = recording.format.name();
    let stem = slug(recording.path.file_stem().map(Path::new).unwrap_or(Path::new("")));
    if stem.is_empty() {
        format.to_owned()
    } else if stem == format || stem.starts_with(&format!("{format}-")) {
        stem
    } else {
        format!("{format}-{stem}")
    }
}

fn slug(stem: &Path) -> String {
    let lower = stem.to_string_lossy().to_ascii_lowercase();
    let words = lower.split(|c: char| !c.is_ascii_alphanumeric()).filter(|word| !word.is_empty());
    let mut slug = words.collect::<Vec<_>>().join("-");
    slug.truncate(MAX_STEM);
    slug
}
