//! Recorded drives on the page, and what controllers would command there.

mod figure;

use std::path::Path;

use crumple_core::quoting::TerminalText;
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::replay::{OpenLoopDrive, ReplayedDrive, open_loop_drives};
use crumple_exchange::recording::{MinBrake, RecordingError, load_first_part};
use crumple_report::draw::format_number;
use crumple_sim::engine::{NamedController, RunOptions};
use crumple_sim::observation::EstimatorKind;
use maud::{Markup, html};
use serde::{Deserialize, Serialize};

use crate::catalog::{self, Catalog};
use crate::error::RequestError;
use crate::render::{escape_markup, escape_text};
use crate::request::MAX_VEHICLE_STEPS;

/// Maximum number of steps that are kept of a recording: 14 h of drives.
const MAX_KEPT_STEPS: usize = 1_000_000;
/// Maximum number of drives in the list.
const MAX_LISTED: usize = 200;
/// Time before and after a braking that the figure shows, in seconds.
const AROUND_BRAKING_S: f64 = 8.0;

/// Drives of a recording file.
#[derive(Debug)]
pub(crate) struct CatalogRecording {
    pub(crate) name: String,
    drives: Vec<OpenLoopDrive>,
    /// Number of drives beyond [`MAX_KEPT_STEPS`] or [`MAX_LISTED`].
    omitted_drives: usize,
    /// Parts dropped while reading, as sentences.
    dropped: Vec<String>,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RecordingRequest {
    recording: usize,
}

#[derive(Debug, Serialize)]
pub(crate) struct RecordingResponse {
    summaries: Vec<String>,
    /// Table of the drives.
    drives: String,
    count: usize,
}

#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ReplayRequest {
    recording: usize,
    drive: usize,
    controllers: Vec<String>,
    /// Shown part of the drive, in seconds of the recording; the whole drive without it.
    #[serde(default)]
    window_s: Option<[f64; 2]>,
    /// False for the counts alone.
    #[serde(default)]
    figure: bool,
    #[serde(default)]
    narrow: bool,
}

#[derive(Debug, Serialize)]
pub(crate) struct ReplayResponse {
    /// Describes the braking of each controller.
    counts: Vec<String>,
    /// Diagrams of the drive; empty unless the request asks for them.
    figure: String,
    /// Table of the brakings of all controllers; empty unless the request asks for the figure.
    brakings: String,
}

/// A controller on a drive.
struct ReplayedController<'c> {
    name: &'c str,
    commands_mps2: Vec<f64>,
    replayed: ReplayedDrive,
}

impl CatalogRecording {
    /// Reads the first part of a recording: about 500 000 rows.
    pub(crate) fn read(path: &Path, map: Option<&RecordingMap>) -> Result<Self, RecordingError> {
        let recording = load_first_part(path, map)?;
        let mut drives = open_loop_drives(&recording);
        let recorded = drives.len();
        let mut steps = 0;
        let kept = drives.iter().take(MAX_LISTED).take_while(|drive| {
            steps += drive.steps().len();
            steps <= MAX_KEPT_STEPS
        });
        let kept = kept.count();
        drives.truncate(kept);
        Ok(Self {
            name: path.display().to_string(),
            drives,
            omitted_drives: recorded - kept,
            dropped: recording.dropped.iter().map(ToString::to_string).collect(),
        })
    }

    fn summaries(&self) -> Vec<String> {
        let steps: usize = self.drives.iter().map(|drive| drive.steps().len()).sum();
        let hours = steps as f64 * OpenLoopDrive::STEP_S / 3600.0;
        let mut summaries = vec![format!(
            "{}: drives of a vehicle behind its leader: {}, {hours:.3} h",
            self.name,
            self.drives.len()
        )];
        if self.omitted_drives > 0 {
            summaries.push(format!("{} more drives are not shown", self.omitted_drives));
        }
        summaries.extend(self.dropped.iter().cloned());
        summaries.iter().map(|line| escape_text(line)).collect()
    }
}

/// Lists the drives of a recording.
pub(crate) fn show_recording(
    request: &RecordingRequest,
    recordings: &[CatalogRecording],
) -> Result<RecordingResponse, RequestError> {
    let recording = catalog::find(recordings, request.recording, "recording", "recordings")?;
    Ok(RecordingResponse {
        summaries: recording.summaries(),
        drives: escape_markup(&drives_table(recording)),
        count: recording.drives.len(),
    })
}

fn drives_table(recording: &CatalogRecording) -> Markup {
    html! { div.scroll tabindex="0" { table {
        caption { "Recorded drives" }
        thead { tr {
            th scope="col" { "vehicle" } th.number scope="col" { "from (s)" } th.number scope="col" { "for (s)" }
            th.number scope="col" { "smallest gap (m)" } th.number scope="col" { "hardest braking (m/s²)" }
            th scope="col" { "braking that the controllers command" }
        } }
        tbody { @for (index, drive) in recording.drives.iter().enumerate() { tr {
            th scope="row" { a href={ "#drive-" (index) } data-drive=(index) {
                (drive.vehicle())
                @if let Some(event) = drive.event() { ", event " (TerminalText(event)) }
            } }
            @let range = DriveSummary::new(drive);
            td.number { (format_number(range.from_s, 2)) } td.number { (format_number(range.duration_s, 2)) }
            td.number { (format_number(range.min_gap_m, 1)) } td.number { (format_number(range.max_brake_mps2, 1)) }
            td.commanded {}
        } } }
    } } }
}

/// Extreme values of a recorded drive.
struct DriveSummary {
    from_s: f64,
    duration_s: f64,
    min_gap_m: f64,
    max_brake_mps2: f64,
}

impl DriveSummary {
    fn new(drive: &OpenLoopDrive) -> Self {
        let steps = drive.steps();
        let gaps_m = steps
            .iter()
            .filter_map(|step| step.observed.ahead.map(|ahead| ahead.gap_m));
        let brakings_mps2 = steps.iter().map(|step| -step.observed.acceleration_mps2);
        Self {
            from_s: steps.first().map_or(0.0, |step| step.time_s),
            duration_s: steps.len() as f64 * OpenLoopDrive::STEP_S,
            min_gap_m: gaps_m.fold(f64::INFINITY, f64::min),
            max_brake_mps2: brakings_mps2.fold(0.0, f64::max),
        }
    }
}

/// Replays controllers on a drive as `crumple replay` does.
pub(crate) fn show_replay(
    request: &ReplayRequest,
    catalog: &Catalog,
) -> Result<ReplayResponse, RequestError> {
    let recording = catalog::find(
        &catalog.recordings,
        request.recording,
        "recording",
        "recordings",
    )?;
    let drive = catalog::find(&recording.drives, request.drive, "drive", "drives")?;
    let controllers = catalog.find_controllers(&request.controllers)?;
    let vehicle_steps = drive.steps().len().saturating_mul(controllers.len());
    if vehicle_steps > MAX_VEHICLE_STEPS {
        let problem = format!(
            "the drive has {vehicle_steps} steps over all controllers, and at most {MAX_VEHICLE_STEPS} are allowed: \
             choose fewer controllers"
        );
        return Err(RequestError::invalid("controllers", problem));
    }
    let replayed = controllers
        .into_iter()
        .map(|controller| replay(drive, controller))
        .collect::<Result<Vec<_>, RequestError>>()?;
    let counts = replayed.iter().map(ReplayedController::describe).collect();
    if !request.figure {
        return Ok(ReplayResponse {
            counts,
            figure: String::new(),
            brakings: String::new(),
        });
    }
    let markup = figure::draw_replay(drive, &replayed, request.window_s, request.narrow);
    Ok(ReplayResponse {
        counts,
        figure: escape_markup(&markup),
        brakings: escape_markup(&brakings_table(&replayed)),
    })
}

fn replay<'c>(
    drive: &OpenLoopDrive,
    controller: &'c NamedController,
) -> Result<ReplayedController<'c>, RequestError> {
    // A recording has no sensors: its values are observed as they are.
    let options = RunOptions::new(controller.source.clone()).with_estimator(EstimatorKind::Truth);
    let refused = |error: &dyn std::fmt::Display| {
        RequestError::invalid("controllers", format!("{}: {error}", controller.name))
    };
    let commands_mps2 = drive
        .commands_mps2(&options, &|_| ())
        .map_err(|error| refused(&error))?;
    controller
        .ensure_trusted()
        .map_err(|error| refused(&error))?;
    Ok(ReplayedController {
        name: &controller.name,
        replayed: drive.evaluate(&commands_mps2, MinBrake::default().mps2()),
        commands_mps2,
    })
}

impl ReplayedController<'_> {
    /// Describes how often and how hard the controller brakes.
    fn describe(&self) -> String {
        let brakings = &self.replayed.brakings;
        let hardest = brakings
            .iter()
            .fold(0.0, |hardest: f64, braking| hardest.max(braking.brake_mps2));
        let count = match brakings.len() {
            0 => "never".to_owned(),
            1 => format!("once, {hardest:.1} m/s²"),
            count => format!("{count} times, at most {hardest:.1} m/s²"),
        };
        let [unnecessary, _] = &self.replayed.unnecessary;
        let unnecessarily = match unnecessary.count {
            0 => String::new(),
            count => format!(", {count} unnecessarily"),
        };
        escape_text(&format!("{}: {count}{unnecessarily}", self.name))
    }
}

fn brakings_table(replayed: &[ReplayedController<'_>]) -> Markup {
    let is_empty = replayed
        .iter()
        .all(|controller| controller.replayed.brakings.is_empty());
    html! { @if is_empty {
        p.hint { "No controller commands a braking of " (MinBrake::default().mps2()) " m/s² in this drive." }
    } @else { div.scroll tabindex="0" { table {
        caption { "Commanded braking of at least " (MinBrake::default().mps2()) " m/s²" }
        thead { tr {
            th scope="col" { "controller" } th.number scope="col" { "from (s)" } th.number scope="col" { "for (s)" }
            th.number scope="col" { "hardest (m/s²)" } th.number scope="col" { "the driver's hardest (m/s²)" }
            th.number scope="col" { "speed (m/s)" } th.number scope="col" { "gap (m)" }
        } }
        tbody { @for controller in replayed { @for braking in &controller.replayed.brakings { tr {
            th scope="row" { (TerminalText(controller.name)) }
            td.number {
                a href="#figures" data-from=(braking.from_s - AROUND_BRAKING_S)
                    data-until=(braking.from_s + braking.duration_s + AROUND_BRAKING_S) {
                    (format_number(braking.from_s, 2))
                }
            }
            td.number { (format_number(braking.duration_s, 2)) } td.number { (format_number(braking.brake_mps2, 2)) }
            td.number { (format_number(braking.driver_brake_mps2, 2)) }
            td.number { (format_number(braking.speed_mps, 1)) } td.number { (format_number(braking.gap_m, 1)) }
        } } } }
    } } } }
}
