//! Recorded drives of cars behind a leader.

use std::path::{Path, PathBuf};

use crumple::exchange::recording::{MIN_DRIVE_S, RecordedPlatoon, load, map::RecordingMap};
use crumple_core::digest::sha256;
use crumple_core::regular_file;
use crumple_measure::{FAR_TIME_GAP_S, MIN_FOLLOWING_MPS};

use crate::ExperimentError;

/// Longest time between two samples of a drive, in seconds.
const MAX_HOLE_S: f64 = 0.55;
/// Time over which changes of gaps are compared with speeds, in seconds.
const DRIFT_S: f64 = 10.0;
/// Largest recording, in bytes.
const MAX_FILE_BYTES: u64 = 64 << 20;
/// Period of the recorded gaps of a drive, in seconds: that of the recordings.
pub(super) const SAMPLE_S: f64 = 0.1;

/// The half of the files that a drive belongs to: settings are fitted to one half, errors are reported for the other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Half {
    /// Files with an odd number in the list.
    Fit,
    /// Files with an even number in the list.
    HeldOut,
}

/// Distance setting of the cruise controls of a file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum DistanceSetting {
    Short,
    Long,
}

impl DistanceSetting {
    pub(super) const ALL: [Self; 2] = [Self::Short, Self::Long];

    /// Reads the five lines before the column names. `None` for manual driving, the medium setting, and files whose
    /// cars have different settings.
    fn from_header(text: &str) -> Option<Self> {
        match [
            header_value(text, "ACC"),
            header_value(text, "Distance_setting"),
        ] {
            [Some("1"), Some("S")] => Some(Self::Short),
            [Some("1"), Some("L")] => Some(Self::Long),
            _ => None,
        }
    }

    pub(super) fn name(self) -> &'static str {
        match self {
            Self::Short => "short",
            Self::Long => "long",
        }
    }
}

fn header_value<'t>(text: &'t str, name: &str) -> Option<&'t str> {
    let mut lines = text.lines().take(5).map(|line| line.trim_end().split(','));
    lines.find_map(|mut fields| {
        let is_named = fields.next() == Some(name);
        fields.next().filter(|_| is_named)
    })
}

/// A drive of a car behind its leader, without holes.
#[derive(Debug, Clone)]
pub(super) struct Drive {
    pub(super) source: DriveSource,
    /// Times of the leader's speeds from the start of the drive, in seconds.
    pub(super) time_s: Vec<f64>,
    /// Speeds of the leader, in m/s.
    pub(super) leader_mps: Vec<f64>,
    /// Initial speed of the car, in m/s.
    pub(super) speed_mps: f64,
    /// Bumper gap every [`SAMPLE_S`], in metres.
    pub(super) gap_m: Vec<f64>,
    /// Median time gap above [`MIN_FOLLOWING_MPS`], in seconds; 0 below it.
    median_time_gap_s: f64,
    /// Changes of the gap within [`DRIFT_S`] that the speeds do not explain, in metres.
    pub(super) drifts_m: Vec<f64>,
}

/// Car and file of a drive.
#[derive(Debug, Clone)]
pub(super) struct DriveSource {
    pub(super) car: String,
    pub(super) setting: DistanceSetting,
    pub(super) half: Half,
}

impl Drive {
    /// Returns true if the median time gap is that of a car that follows its recorded leader. In some drives a car
    /// without a receiver is between them.
    pub(super) fn follows(&self) -> bool {
        self.median_time_gap_s <= FAR_TIME_GAP_S
    }
}

/// State of leader and car at a sample.
#[derive(Debug, Clone, Copy)]
struct PairSample {
    time_s: f64,
    leader_mps: f64,
    speed_mps: f64,
    gap_m: f64,
}

impl PairSample {
    fn opening_mps(&self) -> f64 {
        self.leader_mps - self.speed_mps
    }
}

/// Drives of the files of a list, and the names of missing files.
#[derive(Default)]
pub(super) struct ReadDrives {
    pub(super) drives: Vec<Drive>,
    pub(super) missing: Vec<String>,
}

/// Returns the paths of all files of a list (lines `SHA-256  PATH`) in a folder.
///
/// # Errors
/// A missing file, or one with another digest.
pub(crate) fn listed_files(folder: &Path, list: &str) -> Result<Vec<PathBuf>, ExperimentError> {
    let mut files = Vec::new();
    for (index, line) in list.lines().enumerate() {
        let (digest, name) = digest_and_name(line, index)?;
        let file = folder.join(name);
        read_listed(&file, digest)?;
        files.push(file);
    }
    Ok(files)
}

/// Returns digest and file name of a line of a list.
fn digest_and_name(line: &str, index: usize) -> Result<(&str, &str), ExperimentError> {
    let (digest, path) = line
        .split_once("  ")
        .ok_or_else(|| format!("line {}: no digest and path", index + 1))?;
    Ok((digest, path.rsplit('/').next().unwrap_or(path)))
}

/// Reads a file with a digest.
fn read_listed(file: &Path, digest: &str) -> Result<Vec<u8>, ExperimentError> {
    let bytes = regular_file::read(file, MAX_FILE_BYTES)
        .map_err(|error| format!("{}: {error}", file.display()))?;
    match sha256(&bytes) == digest {
        true => Ok(bytes),
        false => Err(format!("{} differs from the file of the list", file.display()).into()),
    }
}

/// Reads the files of a list (lines `SHA-256  PATH`) from a folder, and leaves out files without a distance setting.
pub(super) fn read(folder: &Path, list: &str) -> Result<ReadDrives, ExperimentError> {
    let mut read = ReadDrives::default();
    for (index, line) in list.lines().enumerate() {
        let (digest, name) = digest_and_name(line, index)?;
        let half = match index % 2 {
            0 => Half::Fit,
            _ => Half::HeldOut,
        };
        let file = folder.join(name);
        if file.is_file() {
            read.drives.extend(drives_of_file(&file, digest, half)?);
        } else {
            read.missing.push(name.to_owned());
        }
    }
    Ok(read)
}

fn drives_of_file(file: &Path, digest: &str, half: Half) -> Result<Vec<Drive>, ExperimentError> {
    let bytes = read_listed(file, digest)?;
    let Some(setting) = DistanceSetting::from_header(&String::from_utf8_lossy(&bytes)) else {
        return Ok(Vec::new());
    };
    let map = RecordingMap::built_in("openacc").ok_or("there is no map `openacc`")??;
    let mut drives = Vec::new();
    for platoon in load(file, Some(&map))?.platoons {
        for (index, vehicle) in platoon.vehicles.iter().enumerate().skip(1) {
            let source = DriveSource {
                car: vehicle.name.clone().ok_or("a car has no name")?,
                setting,
                half,
            };
            let parts = following_parts(&platoon, index);
            drives.extend(parts.iter().filter_map(|part| drive(part, &source)));
        }
    }
    Ok(drives)
}

/// Returns the samples of a vehicle of a platoon behind its leader, in parts without holes.
fn following_parts(platoon: &RecordedPlatoon, index: usize) -> Vec<Vec<PairSample>> {
    let mut parts: Vec<Vec<PairSample>> = Vec::new();
    let mut last_s = f64::NEG_INFINITY;
    let samples = 0..platoon.time_s.len();
    for sample in samples.filter_map(|sample| pair_sample(platoon, index, sample)) {
        match parts.last_mut() {
            Some(part) if sample.time_s - last_s <= MAX_HOLE_S => part.push(sample),
            _ => parts.push(vec![sample]),
        }
        last_s = sample.time_s;
    }
    parts
}

fn pair_sample(platoon: &RecordedPlatoon, index: usize, sample: usize) -> Option<PairSample> {
    let speed_mps = |vehicle: usize| platoon.vehicles[vehicle].speed_mps[sample];
    Some(PairSample {
        time_s: platoon.time_s[sample],
        leader_mps: speed_mps(index - 1)?,
        speed_mps: speed_mps(index)?,
        gap_m: platoon.gap_ahead_m(index)[sample]?,
    })
}

/// Returns the drive of samples without holes, if it is long enough.
fn drive(samples: &[PairSample], source: &DriveSource) -> Option<Drive> {
    let (first, last) = (samples.first()?, samples.last()?);
    let duration_s = last.time_s - first.time_s;
    if duration_s < MIN_DRIVE_S {
        return None;
    }
    let count = (duration_s / SAMPLE_S + 1e-6) as usize;
    let gap_m = (0..=count).map(|step| gap_at(samples, first.time_s + step as f64 * SAMPLE_S));
    let times_s = samples.iter().map(|sample| sample.time_s - first.time_s);
    Some(Drive {
        source: source.clone(),
        time_s: times_s.collect(),
        leader_mps: samples.iter().map(|sample| sample.leader_mps).collect(),
        speed_mps: first.speed_mps,
        gap_m: gap_m.collect(),
        median_time_gap_s: median_time_gap_s(samples),
        drifts_m: drifts_m(samples),
    })
}

fn drifts_m(samples: &[PairSample]) -> Vec<f64> {
    let mut drifts_m = Vec::new();
    let Some(mut start) = samples.first() else {
        return drifts_m;
    };
    let mut opening_m = 0.0;
    for (before, after) in samples.iter().zip(samples.iter().skip(1)) {
        let opening_mps = 0.5 * (before.opening_mps() + after.opening_mps());
        opening_m += opening_mps * (after.time_s - before.time_s);
        if after.time_s - start.time_s >= DRIFT_S {
            drifts_m.push(after.gap_m - start.gap_m - opening_m);
            (start, opening_m) = (after, 0.0);
        }
    }
    drifts_m
}

fn median_time_gap_s(samples: &[PairSample]) -> f64 {
    let moving = samples
        .iter()
        .filter(|sample| sample.speed_mps > MIN_FOLLOWING_MPS);
    let mut gaps_s: Vec<f64> = moving
        .map(|sample| sample.gap_m / sample.speed_mps)
        .collect();
    gaps_s.sort_by(f64::total_cmp);
    gaps_s.get(gaps_s.len() / 2).copied().unwrap_or(0.0)
}

/// Returns the gap at a time between two samples, in metres.
fn gap_at(samples: &[PairSample], time_s: f64) -> f64 {
    let next = samples.partition_point(|sample| sample.time_s <= time_s);
    let before = &samples[next.saturating_sub(1)];
    let after = &samples[next.min(samples.len() - 1)];
    let span_s = after.time_s - before.time_s;
    if span_s <= 0.0 {
        return before.gap_m;
    }
    before.gap_m + (after.gap_m - before.gap_m) * (time_s - before.time_s) / span_s
}
