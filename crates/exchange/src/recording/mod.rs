//! Recorded traffic, and scenarios of its braking episodes.
//!
//! A [`RecordingMap`](map::RecordingMap) states the meaning of the columns of a file. Two maps are built in and
//! recognised by the first line: OpenACC (a platoon of instrumented cars: Makridis et al., "OpenACC. An open database
//! of car-following experiments to study the properties of commercial ACC systems", Transportation Research Part C 125
//! (2021) 103047),
//! and car-following events (pairs cut out of traffic recordings such as NGSIM). [`find_episodes`] finds the brakings
//! of a [`Recording`]; [`import()`] converts each episode to a scenario and lists the dropped parts.

mod acceleration;
mod behind;
#[cfg(test)]
mod behind_tests;
mod binary;
#[cfg(test)]
mod cases_tests;
mod consistency;
mod distinct;
mod drive;
mod dropped;
mod episode;
mod episodes;
#[cfg(test)]
mod episodes_tests;
mod error;
mod exposure;
pub mod guess;
mod import;
mod lead_vehicles;
#[cfg(any(feature = "mdf", feature = "parquet"))]
mod limits;
mod load;
pub mod map;
#[cfg(test)]
mod map_tests;
#[cfg(feature = "mdf")]
pub mod mdf;
mod motion;
#[cfg(test)]
mod motion_tests;
mod number;
mod pair_checks;
mod pairs;
#[cfg(feature = "parquet")]
pub mod parquet;
mod parts;
#[cfg(test)]
mod parts_tests;
mod platoon_columns;
mod platoons;
mod preview;
pub mod replay;
#[cfg(test)]
mod replay_tests;
mod report;
mod series;
#[cfg(feature = "mdf")]
mod signal_rows;
mod spill;
#[cfg(test)]
mod standing_tests;
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
#[cfg(test)]
mod traffic_tests;
mod vehicle_line;
mod vehicle_motion;
mod whole_drives;
#[cfg(test)]
mod whole_drives_tests;

use std::ops::Range;
use std::path::PathBuf;

pub use consistency::ColumnContradiction;
pub use distinct::ensure_distinct;
pub use dropped::{DroppedItem, EpisodeProblem, Omission};
pub use episode::{BrakingEpisode, CAR_LENGTH_M, EpisodeVehicle};
pub use episodes::{FoundEpisodes, LeaderSelection, MinBrake, find_episodes};
pub use error::{BinaryProblem, ColumnProblem, LineProblem, RecordingError};
pub use exposure::{FollowingExposure, braking_clusters, following_exposure};
pub use import::{
    ImportOptions, ImportResult, ImportScope, ImportedRecording, ImportedScenario, import,
};
pub use lead_vehicles::VehicleAhead;
pub use load::{ReadProgress, load, load_first_part, load_parts, read};
pub use parts::{PartSink, merge_dropped};
pub use preview::{
    HardestBraking, HardestBrakingResult, HardestSearch, Preview, SpeedLine, hardest_braking,
    preview,
};
pub use report::{ImportReport, RecordingImport, RecordingSummary};
pub use text::TextFormat;
pub use tracks::RecordedTraffic;
pub use vehicle_line::FollowerDriver;
pub use vehicle_motion::VehicleMotion;
pub use whole_drives::{MAX_DRIVE_S, MIN_DRIVE_S, WholeDrive, find_drives};

/// True if this build reads ASAM MDF 4.
pub const READS_MDF: bool = cfg!(feature = "mdf");
/// True if this build reads Parquet.
pub const READS_PARQUET: bool = cfg!(feature = "parquet");

/// Largest plausible acceleration, in m/s²; larger values are measurement errors. Tyres on a dry road give little more
/// than 1 g.
pub const MAX_PLAUSIBLE_ACCEL_MPS2: f64 = 12.0;

/// The platoons of one file, and its dropped parts.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Path of the file.
    pub path: PathBuf,
    /// Name of the map, which begins the names of imported scenarios.
    pub format: String,
    /// Encoding, and format of columns, numbers and times.
    pub text: TextFormat,
    /// Platoons of at least two vehicles without missing members.
    pub platoons: Vec<RecordedPlatoon>,
    /// Vehicles with changing neighbours, if the file holds tracks.
    pub traffic: Option<RecordedTraffic>,
    /// Parts dropped while reading.
    pub dropped: Vec<DroppedItem>,
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
    /// Number of vehicles, from the first on, that may lead a scenario. The vehicle behind a pair is no subject of a
    /// test, so that its leader does not lead.
    lead_count: usize,
    /// Times at which braking belongs to this part of the recording.
    core_ms: Range<i64>,
}

impl RecordedPlatoon {
    /// Returns the bumper gap ahead of vehicle `index` of the platoon at each sample: metres, positive, `None` if
    /// unknown. Empty for the first vehicle and for one that does not exist.
    #[must_use]
    pub fn gap_ahead_m(&self, index: usize) -> &[Option<f64>] {
        index
            .checked_sub(1)
            .and_then(|pair| self.gaps_m.get(pair))
            .map_or(&[], Vec::as_slice)
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
