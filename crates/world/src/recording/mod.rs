//! Recorded traffic, and scenarios of its braking episodes.
//!
//! A [`RecordingMap`] states the meaning of the columns of a file. Two maps are built in and recognised by the first
//! line: OpenACC (a platoon of instrumented cars: Makridis et al., "OpenACC. An open database of car-following
//! experiments to study the properties of commercial ACC systems", Transportation Research Part C 125 (2021) 103047)
//! and car-following events (pairs cut out of traffic recordings such as NGSIM). [`find_episodes`] finds the brakings
//! of a [`Recording`]; [`import()`] converts each episode to a scenario and lists the dropped parts.

mod binary;
mod consistency;
mod dropped;
mod episode;
mod episodes;
mod error;
mod exposure;
pub mod guess;
mod import;
mod lead_vehicles;
pub mod map;
#[cfg(test)]
mod map_tests;
#[cfg(feature = "mdf")]
pub mod mdf;
mod motion;
#[cfg(test)]
mod motion_tests;
mod number;
mod pairs;
#[cfg(feature = "parquet")]
mod parquet_rows;
mod parts;
#[cfg(test)]
mod parts_tests;
mod platoons;
mod preview;
pub mod replay;
mod series;
#[cfg(feature = "mdf")]
mod signal_rows;
mod spill;
mod table;
mod target_switches;
#[cfg(test)]
mod tests;
mod text;
mod text_rows;
#[cfg(test)]
mod text_tests;
mod tracks;
mod traffic;

use std::io::{Cursor, Read};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

pub use consistency::ColumnContradiction;
pub use dropped::{DroppedItem, EpisodeProblem, Omission};
pub use episode::{BrakingEpisode, CAR_LENGTH_M, EpisodeVehicle};
pub use episodes::{FoundEpisodes, LeaderSelection, MinBrake, find_episodes};
pub use error::{BinaryProblem, ColumnProblem, LineProblem, RecordingError};
pub use exposure::{FollowingExposure, braking_clusters, following_exposure};
pub use import::{ImportOptions, ImportResult, ImportedRecording, ImportedScenario, import};
pub use lead_vehicles::VehicleAhead;

use lead_vehicles::{LeadVehicle, PlatoonLead};
use map::{LayoutSpec, RecordingMap, RecordingMapSpec};
pub use parts::{PartSink, merge_dropped};
pub use preview::{HardestBraking, HardestBrakingResult, HardestSearch, Preview, SpeedLine, hardest_braking, preview};
use table::{CsvRow, RowReader};
pub use text::TextFormat;
pub use tracks::RecordedTraffic;

/// Largest plausible acceleration, in m/s²; larger values are measurement errors. Tyres on a dry road give little more
/// than 1 g.
pub const MAX_PLAUSIBLE_ACCEL_MPS2: f64 = 12.0;

/// The platoons of one file, and its dropped parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Path of the file.
    pub path: PathBuf,
    /// Format of the file.
    pub format: RecordingFormat,
    /// Encoding, and format of columns, numbers and times.
    pub text: TextFormat,
    /// Platoons of at least two vehicles without missing members.
    pub platoons: Vec<RecordedPlatoon>,
    /// Vehicles with changing neighbours, if the file holds tracks.
    pub traffic: Option<RecordedTraffic>,
    /// Parts dropped while reading.
    pub dropped: Vec<DroppedItem>,
}

impl Recording {
    /// Returns all vehicles with a follower, front to rear.
    fn lead_vehicles(&self) -> Vec<Box<dyn LeadVehicle + '_>> {
        let in_platoons = self.platoons.iter().flat_map(|platoon| {
            let leads = 0..platoon.vehicles.len().saturating_sub(1);
            leads.map(move |index| Box::new(PlatoonLead { platoon, index }) as Box<dyn LeadVehicle>)
        });
        in_platoons.chain(self.traffic.iter().flat_map(RecordedTraffic::lead_vehicles)).collect()
    }
}

/// Format of a recording: the name of its map.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RecordingFormat(String);

impl RecordingFormat {
    fn from_map(map: &RecordingMapSpec) -> Self {
        Self(map.name.clone())
    }

    /// Returns the name, which begins the names of imported scenarios.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0
    }
}

/// A line of recorded vehicles with the gaps between them, on one time base.
///
/// Speeds and gaps may be missing, but every list has one entry for each sample.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedPlatoon {
    /// Event, if the file names events, truncated to 40 characters.
    pub event: Option<String>,
    /// Time of each sample in seconds, increasing by a millisecond or more.
    pub time_s: Vec<f64>,
    /// Line of each sample in the file, from 1.
    pub line: Vec<u64>,
    /// Vehicles, front to rear.
    pub vehicles: Vec<RecordedVehicle>,
    gaps_m: Vec<Vec<Option<f64>>>,
    /// Times at which braking belongs to this part of the recording.
    core_ms: Range<i64>,
}

impl RecordedPlatoon {
    /// Returns the bumper gap ahead of vehicle `index` of the platoon at each sample: metres, positive, `None` if
    /// unknown. Empty for the first vehicle and for one that does not exist.
    #[must_use]
    pub fn gap_ahead_m(&self, index: usize) -> &[Option<f64>] {
        index.checked_sub(1).and_then(|pair| self.gaps_m.get(pair)).map_or(&[], Vec::as_slice)
    }

    /// Returns gap ahead and speed of vehicle `index` at one sample, if both are known.
    fn gap_and_speed(&self, index: usize, sample: usize) -> Option<(f64, f64)> {
        let gap_m = *self.gap_ahead_m(index).get(sample)?;
        Some((gap_m?, self.vehicles.get(index)?.speed_at_mps(sample)?))
    }
}

/// A vehicle of a platoon.
#[derive(Debug, Clone, PartialEq)]
pub struct RecordedVehicle {
    /// Number in the file, from 1 at the front of the platoon.
    pub number: usize,
    /// Make or role, if recorded.
    pub name: Option<String>,
    /// Speed at each sample, from 0 to 100 m/s; `None` if unknown.
    pub speed_mps: Vec<Option<f64>>,
}

impl RecordedVehicle {
    fn speed_at_mps(&self, sample: usize) -> Option<f64> {
        self.speed_mps.get(sample).copied().flatten()
    }
}

/// Receives the number of bytes of a file that were read, and their total.
pub type ReadProgress = Arc<dyn Fn(u64, u64) + Send + Sync>;

/// Reads a recording file with any extension: text, or Parquet or MDF 4 if the build has the features `parquet` and
/// `mdf`. The columns are those of `map`, or of the built-in map that matches the first line.
///
/// # Errors
/// [`RecordingError`] for a file that cannot be read, is of neither built-in format, lacks a column of its map, is
/// truncated, or holds a field that is not a number. Missing and impossible values are no errors: they are in
/// [`Recording::dropped`]. A file of several parts is an error, see [`load_parts`].
pub fn load(path: &Path, map: Option<&RecordingMap>) -> Result<Recording, RecordingError> {
    only_part(path, |each| load_parts(path, map, None, each))
}

/// Reads the first part of a recording file, as [`load_parts`].
///
/// # Errors
/// Those of [`load`].
pub fn load_first_part(path: &Path, map: Option<&RecordingMap>) -> Result<Recording, RecordingError> {
    let mut first = None;
    load_parts(path, map, None, &mut |part| {
        first = Some(part);
        Ok(false)
    })?;
    first.ok_or_else(|| RecordingError::Empty { path: path.to_owned() })
}

/// Reads a recording file in parts, so that memory stays bounded: a part has about 500 000 rows, and overlaps the next
/// by a minute. Braking at each time belongs to one part. Omissions in rows are in the last part, or the first one of
/// traffic; see [`merge_dropped`].
///
/// # Errors
/// Those of [`load`], except for the number of parts, and of `each`.
pub fn load_parts(
    path: &Path,
    map: Option<&RecordingMap>,
    progress: Option<&ReadProgress>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let error = |source| RecordingError::Read { path: path.to_owned(), source };
    let mut file = binary::Source::open(path, progress).map_err(error)?;
    let mut start = Vec::new();
    file.by_ref().take(binary::START_BYTES).read_to_end(&mut start).map_err(error)?;
    let spec = map.map(RecordingMap::spec);
    let table = match binary::BinaryFormat::detect(&start) {
        Some(format) => binary::open(format, binary::Input::File(file), path, spec)?,
        None => RowReader::new(Cursor::new(start).chain(file), path, spec)?,
    };
    read_rows(table, path, map, each)
}

/// Returns the only part of a recording.
fn only_part(
    path: &Path,
    read: impl FnOnce(&mut PartSink<'_>) -> Result<(), RecordingError>,
) -> Result<Recording, RecordingError> {
    let mut only = None;
    read(&mut |part| match only.replace(part) {
        None => Ok(true),
        Some(_) => Err(RecordingError::TooLong { path: path.to_owned() }),
    })?;
    only.ok_or_else(|| RecordingError::Empty { path: path.to_owned() })
}

/// Reads the bytes of a recording file; `path` only names it.
///
/// # Errors
/// Those of [`load`], except for reading the file.
pub fn read_bytes(bytes: &[u8], path: &Path, map: Option<&RecordingMap>) -> Result<Recording, RecordingError> {
    match binary::BinaryFormat::detect(bytes) {
        Some(format) => {
            let bytes = binary::Input::Bytes(bytes.to_vec());
            let table = binary::open(format, bytes, path, map.map(RecordingMap::spec))?;
            only_part(path, |each| read_rows(table, path, map, each))
        }
        None => read(bytes, path, map),
    }
}

/// Reads a text recording from a stream; `path` only names it.
///
/// Fails for lines above a mebibyte, 200 vehicles of a platoon or a million events. Ignores a byte order mark and
/// carriage returns before line feeds.
///
/// # Errors
/// As [`load`].
pub fn read(from: impl Read, path: &Path, map: Option<&RecordingMap>) -> Result<Recording, RecordingError> {
    let table = RowReader::new(from, path, map.map(RecordingMap::spec))?;
    only_part(path, |each| read_rows(table, path, map, each))
}

fn read_rows(
    mut table: RowReader<'_>,
    path: &Path,
    map: Option<&RecordingMap>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let Some(first) = table.next_header()? else {
        return Err(RecordingError::Empty { path: path.to_owned() });
    };
    let built_in;
    let map = match map {
        Some(map) => map,
        None => {
            let name = match first.text(0) {
                "Date" => "openacc",
                "event" => "car-following",
                other => match RecordingMap::recognise(first.fields.iter()) {
                    Some(map) => return first.reject_line(LineProblem::NeedsMap { map }),
                    None => return first.reject_line(LineProblem::UnknownFormat { found: table::excerpt(other) }),
                },
            };
            let map = RecordingMap::built_in(name).transpose();
            built_in = map.map_err(|error| RecordingError::Map(Box::new(error)))?;
            match &built_in {
                Some(map) => map,
                None => return first.reject_line(LineProblem::NeedsMap { map: name }),
            }
        }
    };
    read_with_map(&mut table, map.spec(), first, each)
}

fn read_with_map(
    table: &mut RowReader<'_>,
    map: &RecordingMapSpec,
    first: CsvRow<'_>,
    each: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let (mut lines, mut names) = (Vec::new(), first);
    while lines.len() < map.lines_before_names {
        lines.push(names.fields);
        let expected = if lines.len() < map.lines_before_names {
            "the end of its header lines"
        } else {
            "the names of its columns"
        };
        let Some(next) = table.next_header()? else { return table.reject_cut_short(expected) };
        names = next;
    }
    match &map.layout {
        LayoutSpec::Platoon(platoon) => platoons::read(table, (map, platoon), &lines, &names, each),
        LayoutSpec::Pairs(pairs) => pairs::read(table, (map, pairs), &names, each),
        LayoutSpec::Tracks(tracks) => traffic::read(table, (map, tracks), &names, each),
    }
}
