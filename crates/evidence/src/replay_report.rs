//! Report of an open-loop replay of a controller on recorded drives, as text and as JSON.

use serde::Serialize;

use crumple_core::quoting::TerminalText;
use crumple_exchange::recording::replay::{ReplayedBraking, ReplayedDrive};

use crate::exposure::IntervalEstimate;

/// Maximum number of brakings that the text lists; the hardest ones.
const MAX_LISTED: usize = 20;

/// Report of an open-loop replay.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ReplayReport {
    /// Name of the controller.
    controller: String,
    /// Deceleration from which braking of the controller counts, in m/s².
    min_brake_mps2: f64,
    /// Number of drives.
    drives: usize,
    hours: f64,
    kilometres: f64,
    /// Brakings of the controller.
    brakings: Vec<BrakingReport>,
    /// Unnecessary braking of the controller.
    unnecessary: UnnecessaryReport,
    /// Of the recorded drivers, for comparison.
    unnecessary_of_drivers: UnnecessaryReport,
}

/// Braking that the controller would have begun.
#[derive(Debug, Clone, PartialEq, Serialize)]
struct BrakingReport {
    recording: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<String>,
    vehicle: usize,
    from_s: f64,
    duration_s: f64,
    brake_mps2: f64,
    driver_brake_mps2: f64,
    speed_mps: f64,
    gap_m: f64,
}

/// Unnecessary brakings, with their rates and the exact intervals at 95 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
struct UnnecessaryReport {
    count: u64,
    seconds: f64,
    per_hour: IntervalEstimate,
    /// None if the vehicles stand.
    #[serde(skip_serializing_if = "Option::is_none")]
    per_100_km: Option<IntervalEstimate>,
}

/// A replayed drive with the name of its recording.
#[derive(Debug, Clone)]
pub struct DriveOfRecording {
    /// Path of the recording.
    pub recording: String,
    /// The drive.
    pub drive: ReplayedDrive,
}

impl ReplayReport {
    /// Creates the report of drives with a controller, whose braking counts from `min_brake_mps2`.
    #[must_use]
    pub fn new(controller: &str, min_brake_mps2: f64, drives: &[DriveOfRecording]) -> Self {
        let replayed = drives.iter().map(|recorded| &recorded.drive);
        let hours = replayed.clone().map(|drive| drive.duration_s).sum::<f64>() / 3600.0;
        let kilometres = replayed.clone().map(|drive| drive.distance_m).sum::<f64>() / 1000.0;
        let [unnecessary, unnecessary_of_drivers] = [0, 1].map(|subject: usize| {
            let brakings = replayed.clone().map(|drive| &drive.unnecessary[subject]);
            let count = brakings.clone().map(|braking| braking.count as u64).sum();
            let seconds = brakings.map(|braking| braking.time_s).sum();
            UnnecessaryReport::new(count, seconds, hours, kilometres)
        });
        Self {
            controller: controller.to_owned(),
            min_brake_mps2,
            drives: drives.len(),
            hours,
            kilometres,
            brakings: drives.iter().flat_map(BrakingReport::list).collect(),
            unnecessary,
            unnecessary_of_drivers,
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let drives = self.drives as u64;
        let mut text = format!(
            "{drives} drive{} behind a leader: {:.3} h, {:.2} km\n",
            plural(drives),
            self.hours,
            self.kilometres
        );
        text += &format!(
            "{} would have braked {}, by at least {} m/s² (--min-brake)\n",
            TerminalText(&self.controller),
            times(self.brakings.len() as u64),
            self.min_brake_mps2
        );
        text += &self.table();
        text += &self.unnecessary.describe("controller");
        text + &self.unnecessary_of_drivers.describe("drivers")
    }

    /// Returns the table of the hardest brakings; empty without brakings.
    fn table(&self) -> String {
        let mut hardest: Vec<_> = self.brakings.iter().collect();
        hardest.sort_by(|a, b| b.brake_mps2.total_cmp(&a.brake_mps2));
        let mut text = String::new();
        if !hardest.is_empty() {
            text += &format!(
                "  {:>12} {:>14} {:>10} {:>9} {:>7} {:>7}  vehicle\n",
                "braking m/s²", "of driver m/s²", "duration s", "speed m/s", "gap m", "start s"
            );
        }
        text.extend(hardest.iter().take(MAX_LISTED).map(|braking| braking.row()));
        if hardest.len() > MAX_LISTED {
            let more = hardest.len() - MAX_LISTED;
            text += &format!("  {more} more with --format json\n");
        }
        text
    }
}

impl BrakingReport {
    fn list(of_recording: &DriveOfRecording) -> impl Iterator<Item = Self> {
        let DriveOfRecording { recording, drive } = of_recording;
        drive
            .brakings
            .iter()
            .map(|braking| Self::new(recording, drive, braking))
    }

    fn new(recording: &str, drive: &ReplayedDrive, braking: &ReplayedBraking) -> Self {
        Self {
            recording: recording.to_owned(),
            event: drive.event.clone(),
            vehicle: drive.vehicle.number,
            from_s: braking.from_s,
            duration_s: braking.duration_s,
            brake_mps2: braking.brake_mps2,
            driver_brake_mps2: braking.driver_brake_mps2,
            speed_mps: braking.speed_mps,
            gap_m: braking.gap_m,
        }
    }

    fn row(&self) -> String {
        let event = match &self.event {
            Some(event) => format!(", event {event}"),
            None => String::new(),
        };
        let origin = format!("{}{event} of {}", self.vehicle, self.recording);
        format!(
            "  {:>12.2} {:>14.2} {:>10.2} {:>9.2} {:>7.2} {:>7.2}  {}\n",
            self.brake_mps2,
            self.driver_brake_mps2,
            self.duration_s,
            self.speed_mps,
            self.gap_m,
            self.from_s,
            TerminalText(&origin)
        )
    }
}

impl UnnecessaryReport {
    fn new(count: u64, seconds: f64, hours: f64, kilometres: f64) -> Self {
        let is_moving = kilometres > 0.0;
        Self {
            count,
            seconds,
            per_hour: IntervalEstimate::poisson_rate(count, hours),
            per_100_km: is_moving
                .then(|| IntervalEstimate::poisson_rate(count, kilometres / 100.0)),
        }
    }

    fn describe(&self, who: &str) -> String {
        let per_hour = self.per_hour;
        let per_100_km = match &self.per_100_km {
            Some(rate) => rate.to_string(),
            None => "not defined".to_owned(),
        };
        format!(
            "unnecessary braking of the {who} (independent of --min-brake): {}, {:.2} s in all\n  \
             per hour {per_hour}, per 100 km {per_100_km}, at 95 %\n",
            times(self.count),
            self.seconds
        )
    }
}

fn times(count: u64) -> String {
    format!("{count} time{}", plural(count))
}

pub(crate) fn plural(count: u64) -> &'static str {
    if count == 1 { "" } else { "s" }
}
