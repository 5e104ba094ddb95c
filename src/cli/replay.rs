//! `crumple replay`: the commands of a controller on recorded drives, beside what the drivers did.

use std::path::{Path, PathBuf};

use clap::Args;

use super::import::{load_map, note_text_format, parse_min_brake};
use super::output_format::OutputFormat;
use super::{CliError, args, output, progress};
use crumple_evidence::{DriveOfRecording, ReplayReport};
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::replay::{OpenLoopError, ReplayedDrive, replay};
use crumple_exchange::recording::{
    DroppedItem, HardestSearch, Recording, TextFormat, ensure_distinct, load_parts, merge_dropped,
};
use crumple_sim::engine::{NamedController, RunOptions};
use crumple_sim::observation::EstimatorKind;

/// Run a controller open loop on recorded drives: where and how hard it would brake
#[derive(Args)]
#[command(after_long_help = "\
Reads the same recordings as `crumple import`. The controller takes the place of each vehicle that has a recorded \
leader. It observes the recorded gaps, speeds and accelerations, and its commands change nothing. crumple lists the 20 \
hardest brakings that the controller would have begun (all with --format json), and the recorded driver's hardest \
braking from the start of each to 1 s after its end. Unnecessary braking is defined as in assessments \
(docs/glossary.md): more than 2 m/s² harder than the vehicle ahead justifies. Rates have exact 95 % intervals of \
Poisson counts, which assume that unnecessary brakings are independent. The gaps are those of the recorded driver. So \
replay does not show whether the controller, by its own earlier braking, would have avoided a situation, or whether it \
brakes unnecessarily at the gaps that it would keep.

Examples:
  crumple replay platoon.csv --controller acc-aeb
  crumple replay log.mf4 --map log.toml --controller aeb.toml --format json")]
pub(super) struct LogReplay {
    /// Recordings
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Controller: built-in (see `crumple list controllers`), a policy file, a network, an FMU (F.fmu), a controller
    /// file (F.toml), or a command after `exec:`
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Meanings of the columns: a file (docs/exchange.md), or openacc, car-following, highd, ngsim or sumo-fcd
    #[arg(long, value_name = "MAP.toml|NAME")]
    map: Option<PathBuf>,
    /// Deceleration that counts as braking of the controller, in m/s² [default: 1.3]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = args::number)]
    min_brake: Option<f64>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Drives of one recording, and its dropped parts.
#[derive(Default)]
struct ReplayedRecording {
    drives: Vec<ReplayedDrive>,
    dropped: Vec<DroppedItem>,
    text: TextFormat,
    hardest: HardestSearch,
}

/// Options of a replay.
struct ReplaySettings {
    options: RunOptions,
    min_brake_mps2: f64,
    quiet: bool,
}

impl LogReplay {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let map = self.map.as_deref().map(load_map).transpose()?;
        let options =
            RunOptions::new(self.controller.source.clone()).with_estimator(EstimatorKind::Truth);
        let settings = ReplaySettings {
            options,
            min_brake_mps2: parse_min_brake(self.min_brake)?.mps2(),
            quiet,
        };
        ensure_distinct(&self.recordings)?;
        let mut drives = Vec::new();
        let mut empty = Vec::new();
        for path in &self.recordings {
            let recording = path.display().to_string();
            let replayed = settings.replay_recording(path, map.as_ref())?;
            if replayed.drives.is_empty() {
                empty.push(format!("{recording}: {}", replayed.hardest.finish()));
            }
            drives.extend(replayed.drives.into_iter().map(|drive| DriveOfRecording {
                recording: recording.clone(),
                drive,
            }));
        }
        args::ensure_trusted()?;
        if drives.is_empty() {
            let problem = format!(
                "no vehicle follows another for a second; {}",
                empty.join("; ")
            );
            return Err(CliError::NothingFound(problem));
        }
        let report = ReplayReport::new(&self.controller.name, settings.min_brake_mps2, &drives);
        output::print_result(self.format, &report, || report.to_text())
    }
}

impl ReplaySettings {
    /// Replays the drives of a file, part by part, and notes what was dropped.
    fn replay_recording(
        &self,
        path: &Path,
        map: Option<&RecordingMap>,
    ) -> Result<ReplayedRecording, CliError> {
        let (bar, read_progress) = progress::read_bar(self.quiet);
        let mut replayed = ReplayedRecording::default();
        let mut refusal = Ok(());
        let read = load_parts(path, map, Some(&read_progress), &mut |part| {
            refusal = self.replay_part(part, &mut replayed);
            Ok(refusal.is_ok())
        });
        bar.finish_and_clear();
        read?;
        note_text_format(path, &replayed.text, self.quiet);
        replayed
            .dropped
            .iter()
            .for_each(|dropped| output::note(&dropped.to_string(), self.quiet));
        refusal.map_err(|error| CliError::at(path, error))?;
        Ok(replayed)
    }

    fn replay_part(
        &self,
        mut part: Recording,
        replayed: &mut ReplayedRecording,
    ) -> Result<(), OpenLoopError> {
        merge_dropped(&mut replayed.dropped, std::mem::take(&mut part.dropped));
        replayed.hardest.add(&part);
        replayed.text = part.text.clone();
        let bar = progress::replay_bar(self.quiet);
        let drives = replay(
            &part,
            &self.options,
            self.min_brake_mps2,
            &|done_s: f64, total_s: f64| {
                bar.set_length(total_s as u64);
                bar.set_position(done_s as u64);
            },
        );
        bar.finish_and_clear();
        replayed.drives.extend(drives?);
        Ok(())
    }
}
