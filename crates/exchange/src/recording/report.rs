//! Reports of an import and of a preview, as text and as JSON.

use std::path::Path;

use crumple_core::quoting::TerminalText;
use crumple_measure::FAR_TIME_GAP_S;
use serde::Serialize;

use super::{
    ImportResult, ImportScope, ImportedRecording, MIN_DRIVE_S, MinBrake, Preview, Recording,
};

/// Report of a preview.
#[derive(Debug, Serialize)]
pub struct RecordingSummary<'a> {
    /// Path of the recording.
    pub recording: &'a str,
    /// Name of the map of the recording.
    pub format: &'a str,
    /// Detected encoding, and format of columns, numbers and times; empty for the defaults.
    pub text: String,
    /// Number of vehicles that may have a follower.
    pub lead_vehicles: usize,
    /// Number of samples of these with known speed.
    pub samples: usize,
    /// First and last time, in seconds.
    pub time_s: [f64; 2],
    /// Median time between two samples of a vehicle, in seconds.
    pub step_s: Option<f64>,
    /// Minimum, median and maximum speed, in m/s.
    pub speed_mps: [f64; 3],
    /// Minimum, median and maximum bumper gap, in metres.
    pub gap_m: Option<[f64; 3]>,
    /// Hardest braking, as text.
    pub hardest_braking: String,
    /// Dropped parts, as text.
    pub dropped: Vec<String>,
}

impl<'a> RecordingSummary<'a> {
    /// Describes the recording of a path.
    #[must_use]
    pub fn new(path: &'a str, recording: &'a Recording, preview: &Preview) -> Self {
        Self {
            recording: path,
            format: &recording.format,
            text: recording.text.to_string(),
            lead_vehicles: preview.lead_vehicles,
            samples: preview.samples,
            time_s: preview.time_s,
            step_s: preview.step_s,
            speed_mps: preview.speed_mps,
            gap_m: preview.gap_m,
            hardest_braking: preview.hardest.to_string(),
            dropped: recording.dropped.iter().map(ToString::to_string).collect(),
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let [from_s, to_s] = self.time_s;
        let step = match self.step_s {
            Some(step_s) => format!("one each {step_s:.3} s"),
            None => "one per vehicle".to_owned(),
        };
        let [slowest, median, fastest] = self.speed_mps;
        let gaps = match self.gap_m {
            Some([nearest, median, farthest]) => {
                format!("bumper gap {nearest:.2} to {farthest:.2} m, median {median:.2}")
            }
            None => "no vehicle follows another".to_owned(),
        };
        [
            format!("{}: {}\n", TerminalText(self.recording), self.format),
            format!(
                "  {} vehicles that may lead, {} samples, from {from_s:.2} to {to_s:.2} s, {step}\n",
                self.lead_vehicles, self.samples
            ),
            format!("  speed {slowest:.2} to {fastest:.2} m/s, median {median:.2}\n"),
            format!("  {gaps}\n"),
            format!("  {}\n", TerminalText(&self.hardest_braking)),
        ]
        .concat()
    }
}

/// Report of an import.
#[derive(Debug, Serialize)]
pub struct ImportReport {
    /// Paths of the scenario files.
    pub scenarios: Vec<String>,
    /// Imported recordings, in order.
    pub recordings: Vec<RecordingImport>,
    /// Dropped parts, as text.
    pub dropped: Vec<String>,
}

/// Report of one recording of an import.
#[derive(Debug, Serialize)]
pub struct RecordingImport {
    /// Path of the recording.
    pub recording: String,
    /// Name of the map of the recording.
    pub format: String,
    /// Detected encoding, and format of columns, numbers and times; empty for the defaults.
    pub text: String,
    /// Number of scenarios.
    pub scenarios: usize,
    /// Number of those without a vehicle behind the one under test, in which no collision from behind can happen.
    pub without_vehicle_behind: usize,
    /// Number of drives far behind the leader, see [`FAR_TIME_GAP_S`]; 0 for episodes.
    #[serde(skip_serializing_if = "is_zero")]
    pub far_behind_leader: usize,
    /// Hardest braking, as text.
    pub hardest_braking: String,
    /// Reason why every drive has holes, as text.
    #[serde(skip)]
    holes: Option<String>,
}

#[allow(
    clippy::trivially_copy_pass_by_ref,
    reason = "serde passes a reference"
)]
fn is_zero(count: &usize) -> bool {
    *count == 0
}

impl ImportReport {
    /// Describes an import that wrote files of these names into a folder.
    #[must_use]
    pub fn new(imported: &ImportResult, folder: &Path, names: &[String]) -> Self {
        Self {
            scenarios: names
                .iter()
                .map(|name| folder.join(name).display().to_string())
                .collect(),
            recordings: imported.sources.iter().map(RecordingImport::new).collect(),
            dropped: imported.dropped.iter().map(ToString::to_string).collect(),
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        self.recordings.iter().map(RecordingImport::line).collect()
    }

    /// Describes the reason why there is no scenario.
    #[must_use]
    pub fn describe_absence(&self, scope: ImportScope, min_brake: MinBrake) -> String {
        if scope == ImportScope::WholeDrives {
            let reasons = self.recordings.iter().filter_map(|source| {
                let holes = source.holes.as_ref()?;
                Some(format!("; {}: {holes}", source.recording))
            });
            return format!(
                "no vehicle follows its leader for at least {MIN_DRIVE_S} s with known speeds and gaps{}",
                reasons.collect::<String>()
            );
        }
        let hardest: Vec<_> = self
            .recordings
            .iter()
            .map(|source| format!("{}: {}", source.recording, source.hardest_braking))
            .collect();
        format!(
            "no braking episode of at least {} m/s² gives a scenario; {}",
            min_brake.mps2(),
            hardest.join("; ")
        )
    }
}

impl RecordingImport {
    fn new(source: &ImportedRecording) -> Self {
        Self {
            recording: source.path.display().to_string(),
            format: source.format.clone(),
            text: source.text.to_string(),
            scenarios: source.scenarios,
            without_vehicle_behind: source.without_vehicle_behind,
            far_behind_leader: source.far_behind_leader,
            hardest_braking: source.hardest.to_string(),
            holes: source.hardest.describe_holes(),
        }
    }

    fn line(&self) -> String {
        let noun = if self.scenarios == 1 {
            "scenario"
        } else {
            "scenarios"
        };
        let without = match self.without_vehicle_behind {
            0 => String::new(),
            count if count == self.scenarios => {
                ", no vehicle behind: collisions from behind cannot happen".to_owned()
            }
            count => {
                format!(", {count} without a vehicle behind: collisions from behind cannot happen")
            }
        };
        let far = match self.far_behind_leader {
            0 => String::new(),
            count => format!(
                ", {count} with a median time gap above {FAR_TIME_GAP_S} s: a vehicle that is not recorded may be \
                 between"
            ),
        };
        format!(
            "{}: {} {noun} ({}){without}{far}\n",
            TerminalText(&self.recording),
            self.scenarios,
            self.format
        )
    }
}
