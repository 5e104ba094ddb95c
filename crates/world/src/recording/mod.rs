//! What did happen: recorded platoons, and the scenarios their braking episodes make.
//!
//! Two formats are read, told apart by their first line: OpenACC (a platoon of instrumented cars: Makridis et al.,
//! "OpenACC. An open database of car-following experiments to study the properties of commercial ACC systems",
//! Transportation Research Part C 125 (2021) 103047) and car-following events (pairs cut out of traffic recordings such
//! as NGSIM). Both become a [`Recording`]; [`episodes()`] finds where a leader brakes, and [`import()`] turns each
//! episode into a scenario and says what it dropped.

mod car_following;
mod dropped;
mod episode;
mod episodes;
mod error;
mod import;
mod motion;
#[cfg(test)]
mod motion_tests;
mod openacc;
mod series;
mod table;
#[cfg(test)]
mod tests;

use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

pub use dropped::{Dropped, NoScenario, Omission, Place};
pub use episode::{Episode, Placed};
pub use episodes::{FoundEpisodes, MinBrake, episodes};
pub use error::{ColumnProblem, RecordingError, ValueProblem};
pub use import::{ImportOptions, Imported, ImportedScenario, Source, import};

use table::Table;

/// Fastest change of speed that is taken for motion and not for an error of measurement, in m/s²: tyres on a dry road
/// give little more than 1 g.
pub const HARDEST_CHANGE_MPS2: f64 = 12.0;

/// A recording: the platoons of one file, and what of the file is not in them.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// The file.
    pub path: PathBuf,
    /// Its format.
    pub format: Format,
    /// Unbroken lines of vehicles, at least two in each.
    pub platoons: Vec<Platoon>,
    /// What was dropped while reading.
    pub dropped: Vec<Dropped>,
}

/// The formats of recordings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Format {
    /// OpenACC: five header lines, then one row for each instant with every vehicle in it.
    OpenAcc,
    /// Car-following events: one row for each instant of an event, with one pair in it.
    CarFollowing,
}

impl Format {
    /// A short name, the first part of the names of imported scenarios.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::OpenAcc => "openacc",
            Self::CarFollowing => "car-following",
        }
    }
}

/// Vehicles that were recorded one behind the other, with the gaps between them, on one time base.
///
/// Speeds and gaps may be missing at any sample, but every list has one entry for each sample.
#[derive(Debug, Clone, PartialEq)]
pub struct Platoon {
    event: Option<String>,
    time_s: Vec<f64>,
    line: Vec<u64>,
    vehicles: Vec<Vehicle>,
    gaps_m: Vec<Vec<Option<f64>>>,
}

impl Platoon {
    /// The event it was recorded in, where the file names events; a long name is cut after 40 characters, for display.
    #[must_use]
    pub fn event(&self) -> Option<&str> {
        self.event.as_deref()
    }

    /// Time of each sample in seconds, increasing by a millisecond or more.
    #[must_use]
    pub fn time_s(&self) -> &[f64] {
        &self.time_s
    }

    /// Line of the file that each sample stands on, from 1.
    #[must_use]
    pub fn line(&self) -> &[u64] {
        &self.line
    }

    /// The vehicles, front to rear.
    #[must_use]
    pub fn vehicles(&self) -> &[Vehicle] {
        &self.vehicles
    }

    /// Bumper gap ahead of vehicle `index`, counted within the platoon, at each sample: metres, positive, none where
    /// it is not known. Empty for the first vehicle and for one that does not exist.
    #[must_use]
    pub fn gap_ahead_m(&self, index: usize) -> &[Option<f64>] {
        index.checked_sub(1).and_then(|above| self.gaps_m.get(above)).map_or(&[], Vec::as_slice)
    }

    /// Gap ahead and speed of vehicle `index` at one sample, if both are known.
    fn following(&self, index: usize, sample: usize) -> Option<(f64, f64)> {
        let gap_m = *self.gap_ahead_m(index).get(sample)?;
        Some((gap_m?, self.vehicles.get(index)?.speed_at_mps(sample)?))
    }
}

/// A vehicle of a platoon.
#[derive(Debug, Clone, PartialEq)]
pub struct Vehicle {
    number: usize,
    name: Option<String>,
    speed_mps: Vec<Option<f64>>,
}

impl Vehicle {
    /// Its number in the file, from 1 at the front of the platoon that drove.
    #[must_use]
    pub fn number(&self) -> usize {
        self.number
    }

    /// Its make or role, where the file says so.
    #[must_use]
    pub fn name(&self) -> Option<&str> {
        self.name.as_deref()
    }

    /// Speed at each sample, from 0 to 100 m/s; none where it is not known.
    #[must_use]
    pub fn speed_mps(&self) -> &[Option<f64>] {
        &self.speed_mps
    }

    fn speed_at_mps(&self, sample: usize) -> Option<f64> {
        self.speed_mps.get(sample).copied().flatten()
    }
}

/// Reads a recording, whatever its extension.
///
/// # Errors
/// [`RecordingError`] for a file that cannot be read, is of neither format, is cut short, or holds a field that is not
/// a number. Missing and impossible values are no error: they are in [`Recording::dropped`].
pub fn load(path: &Path) -> Result<Recording, RecordingError> {
    let file = File::open(path).map_err(|source| RecordingError::Read { path: path.to_owned(), source })?;
    read(file, path)
}

/// Reads a recording from a stream; `path` only names it.
///
/// Memory is bounded: a line of more than a mebibyte, and more than 5 million rows, 20 million speeds and gaps, 200
/// vehicles or 100 000 events are refused. A byte order mark and carriage returns before line feeds are no part of the
/// text.
///
/// # Errors
/// As [`load`].
pub fn read(from: impl Read, path: &Path) -> Result<Recording, RecordingError> {
    let mut table = Table::new(from, path);
    let Some(first) = table.next_row()?.cloned() else {
        return Err(RecordingError::Empty { path: path.to_owned() });
    };
    match first.text(0) {
        "Date" => openacc::read(&mut table),
        "event" => car_following::read(&mut table, &first),
        other => {
            Err(RecordingError::UnknownFormat { path: path.to_owned(), line: first.line, found: table::excerpt(other) })
        }
    }
}
