//! Counts of a controller on recorded drives, with their rates, as text and as JSON.

use serde::{Deserialize, Serialize};

use super::drives::{DriveEnd, DriveRun, DriveSet, MeasuredDrive};
use super::exposure::{CONFIDENCE, IntervalEstimate};
use super::replay_report::plural;
use crumple_core::digits::format_or_hyphen;
use crumple_core::interval::RateInterval;
use crumple_core::quoting::TerminalText;
use crumple_measure::{CollisionRole, FAR_TIME_GAP_S, HARD_BRAKE_MPS2};
use crumple_sim::engine::FailedControllerRuns;

/// Number of events on drives, with their rates and exact intervals at 95 %.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EventRate {
    /// Number of events.
    pub count: u64,
    /// Events per hour.
    pub per_hour: IntervalEstimate,
    /// Events per 100 km; absent if the vehicles stand.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub per_100_km: Option<IntervalEstimate>,
}

impl EventRate {
    pub(super) fn new(count: u64, [hours, kilometres]: [f64; 2]) -> Self {
        Self {
            count,
            per_hour: IntervalEstimate::poisson_rate(count, hours),
            per_100_km: (kilometres > 0.0)
                .then(|| IntervalEstimate::poisson_rate(count, kilometres / 100.0)),
        }
    }

    /// Returns the events per hour, and the ends of their interval.
    #[must_use]
    pub fn per_hour_interval(&self) -> [f64; 3] {
        let rate = &self.per_hour;
        [rate.estimate, rate.lower, rate.upper]
    }

    /// Returns count and rates as a row of the text.
    pub(super) fn row(&self, what: &str) -> String {
        let per_100_km = self.per_100_km.as_ref();
        let per_100_km = per_100_km.map_or_else(|| "-".to_owned(), ToString::to_string);
        format!(
            "  {what:<34} {:>5}  {:<26} {per_100_km}\n",
            self.count,
            self.per_hour.to_string(),
        )
    }
}

/// Comfort and distance on drives.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DriveComfort {
    /// Number of drives.
    pub drives: u64,
    /// Hours until the end of the drives or a collision.
    pub hours: f64,
    /// Kilometres in these hours.
    pub kilometres: f64,
    /// Unnecessary braking, without that which only a vehicle behind causes.
    pub unnecessary_braking: EventRate,
    /// Number of drives with such braking.
    pub unnecessary_braking_drives: u64,
    /// Number of drives with an answer and braking above 4 m/s².
    pub hard_braking_drives: u64,
    /// Root mean square of the jerk, in m/s³; mean of the drives.
    pub rms_jerk_mps3: Option<f64>,
    /// Jerk from speeds at the recorded intervals, with accelerations averaged over half a second.
    pub rms_jerk_sampled_mps3: Option<f64>,
    /// Time gap while moving, in seconds; mean of the drives.
    pub time_gap_s: Option<f64>,
}

impl DriveComfort {
    /// Summarises drives, with the number of unnecessary brakings that count in each.
    fn new<'a>(drives: impl Iterator<Item = (&'a MeasuredDrive, usize)> + Clone) -> Self {
        let brakings = drives.clone().map(|(_, count)| count as u64);
        let drives = drives.map(|(drive, _)| drive);
        let [hours, kilometres] = exposure(drives.clone());
        let is_hard = |drive: &&MeasuredDrive| drive.peak_brake_mps2 > HARD_BRAKE_MPS2;
        Self {
            drives: drives.clone().count() as u64,
            hours,
            kilometres,
            unnecessary_braking: EventRate::new(brakings.clone().sum(), [hours, kilometres]),
            unnecessary_braking_drives: brakings.filter(|count| *count > 0).count() as u64,
            hard_braking_drives: drives.clone().filter(is_hard).count() as u64,
            rms_jerk_mps3: mean(drives.clone().map(|drive| drive.measures.rms_jerk_mps3)),
            rms_jerk_sampled_mps3: mean(drives.clone().map(|drive| drive.sampled.rms_jerk_mps3)),
            time_gap_s: mean(drives.map(|drive| drive.measures.following?.mean_time_gap_s)),
        }
    }

    /// Summarises the drives of a controller. Those without an answer are no evidence about its comfort; hours,
    /// kilometres and events include them.
    fn from_runs(runs: &[DriveRun]) -> Self {
        let driven = |run| {
            let [counted, _] = DriveRun::unnecessary_by_cause(run);
            (&run.drive, counted)
        };
        let answered = Self::new(runs.iter().filter(|run| run.is_answered()).map(driven));
        Self {
            hard_braking_drives: answered.hard_braking_drives,
            rms_jerk_mps3: answered.rms_jerk_mps3,
            rms_jerk_sampled_mps3: answered.rms_jerk_sampled_mps3,
            time_gap_s: answered.time_gap_s,
            ..Self::new(runs.iter().map(driven))
        }
    }

    /// Summarises the recorded cars in the places of the vehicles under test.
    #[must_use]
    pub fn of_recorded_cars(drives: &DriveSet) -> Self {
        Self {
            // Their accelerations are known at the recorded intervals only.
            rms_jerk_mps3: None,
            ..Self::new(
                drives
                    .recorded()
                    .map(|drive| (drive, drive.measures.unnecessary.count)),
            )
        }
    }
}

/// Returns the number of drives without an answer, and the reason of the first.
fn count_unanswered(runs: &[DriveRun]) -> Option<FailedControllerRuns> {
    let mut unanswered = None;
    for run in runs {
        if let DriveEnd::NoAnswer(failed) = &run.end {
            FailedControllerRuns::add(&mut unanswered, failed);
        }
    }
    unanswered
}

/// Returns the hours and kilometres of drives.
pub(super) fn exposure<'a>(drives: impl Iterator<Item = &'a MeasuredDrive> + Clone) -> [f64; 2] {
    let hours = drives.clone().map(|drive| drive.duration_s).sum::<f64>() / 3600.0;
    let kilometres = drives.map(|drive| drive.distance_m).sum::<f64>() / 1000.0;
    [hours, kilometres]
}

/// Returns the mean of the known values.
fn mean(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let (sum, count) = values
        .flatten()
        .fold((0.0, 0_u64), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / count as f64)
}

/// Counts of a controller on recorded drives, each of which it drove once.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DriveReport {
    /// Name of the controller.
    pub controller: String,
    /// Comfort, distance and unnecessary braking.
    #[serde(flatten)]
    pub comfort: DriveComfort,
    /// Collisions and missing answers that count against the controller.
    pub failures: EventRate,
    /// Collisions with the leader.
    pub hits_leader: u64,
    /// Collisions from behind with a vehicle that can react.
    pub hit_from_behind: u64,
    /// Drives in which the controller gave no answer.
    pub no_answer: u64,
    /// Number of these drives, and the reason of the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Collisions from behind with a vehicle that repeats recorded speeds. They do not count against the controller.
    pub hit_by_recording: u64,
    /// Collisions of other vehicles: no evidence about the controller.
    pub others_collide: u64,
    /// Unnecessary braking that the same drive does not have without the vehicle behind. It does not count against the
    /// controller.
    pub caused_by_vehicle_behind: EventRate,
    /// Number of drives with such braking.
    pub caused_by_vehicle_behind_drives: u64,
    /// Drives that a collision ended before any unnecessary braking that counts against the controller. They decide
    /// nothing about the rest of the drive.
    pub ended_before_unnecessary_braking: u64,
    /// Drives without a vehicle behind, in which no collision from behind can happen.
    pub without_vehicle_behind: u64,
    /// Drives whose recorded vehicle is far behind its leader, see [`FAR_TIME_GAP_S`].
    pub far_behind_leader: u64,
    /// Root mean square of the difference to the recorded gaps, in metres; mean of the drives.
    pub rms_spacing_error_m: Option<f64>,
    /// The recorded drivers in the same places.
    pub recorded: DriveComfort,
}

impl DriveReport {
    /// Summarises the runs of a controller on a set of drives.
    #[must_use]
    pub fn new(controller: &str, runs: &[DriveRun], drives: &DriveSet) -> Self {
        let comfort = DriveComfort::from_runs(runs);
        let driven = [comfort.hours, comfort.kilometres];
        let caused_behind = || runs.iter().map(|run| run.unnecessary_by_cause()[1] as u64);
        let ended_before_unnecessary_braking = |run: &&DriveRun| {
            matches!(run.end, DriveEnd::Collision(..)) && run.unnecessary_by_cause()[0] == 0
        };
        let count = |is_counted: &dyn Fn(&DriveEnd) -> bool| {
            runs.iter().filter(|run| is_counted(&run.end)).count() as u64
        };
        let collisions = |role: CollisionRole| {
            count(&|end| matches!(end, DriveEnd::Collision(found, _) if *found == role))
        };
        Self {
            controller: controller.to_owned(),
            failures: EventRate::new(count(&DriveEnd::is_failure), driven),
            comfort,
            hits_leader: collisions(CollisionRole::Hits),
            hit_from_behind: collisions(CollisionRole::HitFromBehind),
            no_answer: count(&|end| matches!(end, DriveEnd::NoAnswer(_))),
            unanswered: count_unanswered(runs),
            hit_by_recording: collisions(CollisionRole::HitByRecording),
            others_collide: collisions(CollisionRole::Bystander),
            caused_by_vehicle_behind: EventRate::new(caused_behind().sum(), driven),
            caused_by_vehicle_behind_drives: caused_behind().filter(|count| *count > 0).count()
                as u64,
            ended_before_unnecessary_braking: runs
                .iter()
                .filter(ended_before_unnecessary_braking)
                .count() as u64,
            without_vehicle_behind: drives.without_vehicle_behind() as u64,
            far_behind_leader: drives.far_behind_leader() as u64,
            rms_spacing_error_m: mean(
                runs.iter()
                    .filter(|run| run.is_answered())
                    .map(|run| run.rms_spacing_error_m),
            ),
            recorded: DriveComfort::of_recorded_cars(drives),
        }
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let DriveComfort {
            drives,
            hours,
            kilometres,
            ..
        } = self.comfort;
        let plural = plural(drives);
        let mut text = format!(
            "{}: {drives} recorded drive{plural}, each once: {hours:.2} h, {kilometres:.1} km\n  {:<34} {:>5}  \
             {:<26} {}\n",
            TerminalText(&self.controller),
            "",
            "count",
            "per hour, at 95 %",
            "per 100 km",
        );
        text += &self.failures.row("collisions and missing answers");
        for (rate, what) in [
            (&self.comfort.unnecessary_braking, "unnecessary braking"),
            (
                &self.caused_by_vehicle_behind,
                "  only with the vehicle behind",
            ),
            (&self.recorded.unnecessary_braking, "  of the recorded cars"),
        ] {
            text += &rate.row(what);
        }
        text += &self.describe_failures();
        text += &self.comfort_rows();
        text + &self.notes()
    }

    /// Describes the failures by kind.
    fn describe_failures(&self) -> String {
        let kinds = format!(
            "  {} hit the leader, {} hit from behind, {} without an answer",
            self.hits_leader, self.hit_from_behind, self.no_answer
        );
        // Drives that another vehicle ended decide nothing about the controller.
        let ended_by_others = self.hit_by_recording + self.others_collide;
        let decided = self.comfort.drives.saturating_sub(ended_by_others);
        if decided == 0 {
            return format!("{kinds}: no drive was decided\n");
        }
        let share = RateInterval::clopper_pearson(self.failures.count, decided, CONFIDENCE);
        let of_drives = match ended_by_others {
            0 => "drives".to_owned(),
            _ => format!("{decided} drives that no other vehicle ended"),
        };
        let percent = share.to_percent_text(2);
        format!("{kinds}: {percent} % of {of_drives} at 95 %\n")
    }

    /// Returns the table of comfort, beside the recorded cars.
    fn comfort_rows(&self) -> String {
        let name = TerminalText(&self.controller).to_string();
        let mut text = format!(
            "  {:<24} {:>14} {:>14} {:>14} {:>20}\n",
            "", "rms jerk m/s³", "as recorded", "time gap s", "drives above 4 m/s²"
        );
        let is_answered = self.no_answer < self.comfort.drives;
        let rows = [
            (name.as_str(), &self.comfort, is_answered),
            ("recorded cars", &self.recorded, true),
        ];
        for (name, comfort, is_answered) in rows {
            let hard = is_answered.then(|| comfort.hard_braking_drives.to_string());
            text += &format!(
                "  {name:<24} {:>14} {:>14} {:>14} {:>20}\n",
                format_or_hyphen(comfort.rms_jerk_mps3, 2),
                format_or_hyphen(comfort.rms_jerk_sampled_mps3, 2),
                format_or_hyphen(comfort.time_gap_s, 2),
                hard.as_deref().unwrap_or("-")
            );
        }
        if let Some(error_m) = self.rms_spacing_error_m {
            text += &format!("  spacing error (rms, mean of drives) {error_m:.2} m\n");
        }
        text
    }

    fn notes(&self) -> String {
        let far_behind = format!(
            "with a recorded median time gap above {FAR_TIME_GAP_S} s: a vehicle that is not recorded may be \
             between"
        );
        let notes = [
            (
                self.hit_by_recording,
                "collision",
                "from behind with a vehicle that repeats recorded speeds: not counted against the controller",
            ),
            (
                self.others_collide,
                "collision",
                "of other vehicles: no evidence about the controller",
            ),
            (
                self.without_vehicle_behind,
                "drive",
                "without a vehicle behind: collisions from behind cannot happen",
            ),
            (self.far_behind_leader, "drive", &far_behind),
        ];
        let shown = notes.into_iter().filter(|(count, ..)| *count > 0);
        let notes =
            shown.map(|(count, noun, note)| format!("{count} {noun}{} {note}", plural(count)));
        self.note_vehicle_behind()
            .into_iter()
            .chain(notes)
            .map(|note| format!("  {note}\n"))
            .collect()
    }

    /// Returns the note about unnecessary braking that only the vehicle behind causes; `None` without such braking.
    #[must_use]
    pub fn note_vehicle_behind(&self) -> Option<String> {
        let drives = self.caused_by_vehicle_behind_drives;
        let note = || {
            let plural = plural(drives);
            format!(
                "{drives} drive{plural} with unnecessary braking that the same drive does not have without the vehicle \
                 behind: not counted against the controller"
            )
        };
        (drives > 0).then(note)
    }
}
