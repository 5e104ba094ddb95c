//! Import of recordings as scenario files. A recording that cannot be read stops the import.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use crumple_measure::is_far_behind;
use crumple_sim::scenario::{Scenario, file::to_toml};

use super::distinct::ensure_distinct;
use super::dropped::{DroppedItem, EpisodeProblem, Omission};
use super::episodes::{FoundEpisodes, LeaderSelection, MinBrake, find_episodes};
use super::error::RecordingError;
use super::map::RecordingMap;
use super::preview::{HardestBrakingResult, HardestSearch};
use super::vehicle_line::FollowerDriver;
use super::whole_drives::find_drives;
use super::{ReadProgress, Recording, TextFormat, load_parts, merge_dropped};

const MAX_FILE_STEM_CHARS: usize = 100;

/// Options of an import.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImportOptions {
    /// Smallest braking of an episode.
    pub min_brake: MinBrake,
    /// Vehicles that lead scenarios.
    pub leaders: LeaderSelection,
    /// Driver of the vehicle behind those under test.
    pub follower: FollowerDriver,
    /// Parts of the recording that become scenarios.
    pub scope: ImportScope,
}

/// Parts of a recording that become scenarios.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ImportScope {
    /// Braking episodes, with all vehicles behind the leader.
    #[default]
    Episodes,
    /// Whole drives of at least half a minute of each vehicle behind its leader.
    WholeDrives,
}

/// Result of the import of a set of recordings.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct ImportResult {
    /// Imported recordings, in order.
    pub sources: Vec<ImportedRecording>,
    /// Dropped parts, in the order of the recordings.
    pub dropped: Vec<DroppedItem>,
}

/// A scenario and its file.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedScenario {
    /// Name of the file: the scenario's name and `.toml`, with only lower-case letters, digits, `-` and `.`.
    pub file_name: String,
    /// Text of the file.
    pub toml: String,
    /// Parsed scenario.
    pub scenario: Scenario,
}

/// Result of one recording.
#[derive(Debug, Clone, PartialEq)]
pub struct ImportedRecording {
    /// Path of the recording.
    pub path: PathBuf,
    /// Name of the map of the recording.
    pub format: String,
    /// Encoding, and format of columns, numbers and times.
    pub text: TextFormat,
    /// Number of scenarios.
    pub scenarios: usize,
    /// Number of those without a vehicle behind the one under test, in which no collision from behind can happen.
    pub without_vehicle_behind: usize,
    /// Number of whole drives whose vehicle is far behind its leader, see [`is_far_behind`].
    pub far_behind_leader: usize,
    /// Hardest braking of the recording, even if it makes no scenario.
    pub hardest: HardestBrakingResult,
}

/// Reads recordings, with a map if there is one, and passes the scenario of each braking episode or drive to `take`, in
/// the order of the recordings. The import ends early if `take` returns false.
///
/// Names are unique and consist of format, file and number, such as `openacc-long-setting-dynamic-part16-01`. Files
/// with the same name in different folders share one sequence of numbers.
///
/// # Errors
/// [`RecordingError`] for the first recording that cannot be read, see [`load`](super::load).
pub fn import(
    paths: &[PathBuf],
    map: Option<&RecordingMap>,
    options: &ImportOptions,
    progress: Option<&ReadProgress>,
    take: &mut dyn FnMut(ImportedScenario) -> bool,
) -> Result<ImportResult, RecordingError> {
    ensure_distinct(paths)?;
    let mut imported = ImportResult::default();
    let mut numbers = BTreeMap::new();
    for path in paths {
        let mut file = FileImport::default();
        load_parts(path, map, progress, &mut |part| {
            let number = numbers.entry(prefix(&part)).or_insert(0);
            file.add(part, options, number, take)?;
            Ok(!file.ends_early)
        })?;
        let ends_early = file.ends_early;
        file.finish(path, &mut imported);
        if ends_early {
            break;
        }
    }
    Ok(imported)
}

/// Import of the parts of one recording.
#[derive(Default)]
struct FileImport {
    /// Name of the map, and format of the text.
    formats: Option<(String, TextFormat)>,
    scenarios: usize,
    without_vehicle_behind: usize,
    far_behind_leader: usize,
    hardest: HardestSearch,
    dropped: Vec<DroppedItem>,
    /// Episodes without scenario.
    dropped_episodes: Vec<DroppedItem>,
    /// True if no more scenarios are wanted.
    ends_early: bool,
}

impl FileImport {
    /// Passes on the scenarios of a part, whose numbers follow `number`.
    fn add(
        &mut self,
        mut part: Recording,
        options: &ImportOptions,
        number: &mut usize,
        take: &mut dyn FnMut(ImportedScenario) -> bool,
    ) -> Result<(), RecordingError> {
        merge_dropped(&mut self.dropped, std::mem::take(&mut part.dropped));
        self.hardest.add(&part);
        let dropped = import_part(&part, options, number, &mut |scenario| {
            self.scenarios += 1;
            self.without_vehicle_behind += usize::from(scenario.scenario.ends_under_test());
            self.far_behind_leader += usize::from(is_far_behind_leader(&scenario.scenario));
            self.ends_early = !take(scenario);
            !self.ends_early
        })?;
        self.dropped_episodes.extend(dropped);
        self.formats = Some((part.format, part.text));
        Ok(())
    }

    /// Adds the result of the recording.
    fn finish(self, path: &Path, imported: &mut ImportResult) {
        imported.dropped.extend(self.dropped);
        imported.dropped.extend(self.dropped_episodes);
        if let Some((format, text)) = self.formats {
            imported.sources.push(ImportedRecording {
                path: path.to_owned(),
                format,
                text,
                scenarios: self.scenarios,
                without_vehicle_behind: self.without_vehicle_behind,
                far_behind_leader: self.far_behind_leader,
                hardest: self.hardest.finish(),
            });
        }
    }
}

/// Passes on the scenarios of a part of a recording. Returns the episodes without scenario.
fn import_part(
    recording: &Recording,
    options: &ImportOptions,
    number: &mut usize,
    take: &mut dyn FnMut(ImportedScenario) -> bool,
) -> Result<Vec<DroppedItem>, RecordingError> {
    match options.scope {
        ImportScope::Episodes => import_episodes(recording, options, number, take),
        ImportScope::WholeDrives => import_drives(recording, options, number, take),
    }
}

/// Passes on the scenarios of the braking episodes. Returns the episodes without scenario.
fn import_episodes(
    recording: &Recording,
    options: &ImportOptions,
    number: &mut usize,
    take: &mut dyn FnMut(ImportedScenario) -> bool,
) -> Result<Vec<DroppedItem>, RecordingError> {
    let FoundEpisodes {
        episodes,
        mut dropped,
    } = find_episodes(recording, options.min_brake, options.leaders);
    let file = file_name(recording);
    for episode in &episodes {
        let name = format!("{}-{:02}", prefix(recording), *number + 1);
        match episode.scenario(name.clone(), &file, &options.follower) {
            Ok(scenario) => {
                *number += 1;
                if !take(render(scenario, name, recording)?) {
                    break;
                }
            }
            Err(invalid) => dropped.push(DroppedItem {
                path: recording.path.clone(),
                line: episode.line,
                omission: Omission::Episode {
                    number: episode.vehicles.first().map_or(0, |leader| leader.number),
                    onset_s: episode.start_s + episode.onset_s,
                    reason: EpisodeProblem::Invalid(invalid),
                },
            }),
        }
    }
    Ok(dropped)
}

/// Passes on the scenarios of the whole drives. Returns the drives without scenario.
fn import_drives(
    recording: &Recording,
    options: &ImportOptions,
    number: &mut usize,
    take: &mut dyn FnMut(ImportedScenario) -> bool,
) -> Result<Vec<DroppedItem>, RecordingError> {
    let mut dropped = Vec::new();
    let file = file_name(recording);
    for drive in find_drives(recording, options.leaders) {
        let name = format!("{}-drive-{:02}", prefix(recording), *number + 1);
        match drive.scenario(name.clone(), &file, &options.follower) {
            Ok(scenario) => {
                *number += 1;
                if !take(render(scenario, name, recording)?) {
                    break;
                }
            }
            Err(reason) => dropped.push(DroppedItem {
                path: recording.path.clone(),
                line: drive.line,
                omission: Omission::Drive {
                    number: drive.vehicles.first().map_or(0, |leader| leader.number),
                    start_s: drive.start_s,
                    reason,
                },
            }),
        }
    }
    Ok(dropped)
}

/// True for a drive whose recorded vehicle is too far behind its leader to follow it.
fn is_far_behind_leader(scenario: &Scenario) -> bool {
    let mut motions = scenario
        .vehicles()
        .iter()
        .filter_map(|vehicle| vehicle.recorded.as_ref());
    motions.any(|motion| is_far_behind(motion))
}

fn file_name(recording: &Recording) -> Cow<'_, str> {
    recording
        .path
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
}

/// Returns a scenario with its file.
fn render(
    scenario: Scenario,
    name: String,
    recording: &Recording,
) -> Result<ImportedScenario, RecordingError> {
    let file_name = format!("{name}.toml");
    let toml = to_toml(&scenario).map_err(|source| RecordingError::Render {
        path: recording.path.clone(),
        name,
        source,
    })?;
    Ok(ImportedScenario {
        file_name,
        toml,
        scenario,
    })
}

/// Returns format and file name in lower-case letters, digits and single hyphens, without repeating the format.
fn prefix(recording: &Recording) -> String {
    let format = &recording.format;
    let stem = slug(
        recording
            .path
            .file_stem()
            .map(Path::new)
            .unwrap_or(Path::new("")),
    );
    if stem.is_empty() {
        format.to_owned()
    } else if stem == *format || stem.starts_with(&format!("{format}-")) {
        stem
    } else {
        format!("{format}-{stem}")
    }
}

fn slug(stem: &Path) -> String {
    let lower = stem.to_string_lossy().to_ascii_lowercase();
    let words = lower
        .split(|c: char| !c.is_ascii_alphanumeric())
        .filter(|word| !word.is_empty());
    let mut slug = words.collect::<Vec<_>>().join("-");
    slug.truncate(MAX_FILE_STEM_CHARS);
    slug
}
