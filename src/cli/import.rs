//! `crumple import`: converts recorded platoons and OpenSCENARIO files into scenarios.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fmt::Display;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use super::CliError;
use super::global_options::GlobalOptions;
use super::import_openscenario::{OpenScenarioArgs, is_openscenario};
use super::output::stage_unless_edited;
use super::output_format::OutputFormat;
use super::progress::read_bar;
use super::{args, feature, output, simulate, value_enums};
use crumple_controllers::Controllers;
use crumple_exchange::recording::guess::{guess, recognised_columns};
use crumple_exchange::recording::map::{BUILT_IN_MAPS, RecordingMap};
use crumple_exchange::recording::{
    FollowerDriver, ImportOptions, ImportReport, ImportResult, ImportScope, ImportedScenario,
    LeaderSelection, MinBrake, RecordingSummary, TextFormat, hardest_braking, import,
    load_first_part, preview,
};
use crumple_report::figures;
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::Driver;
use crumple_store::disk::{DiskError, StagedFiles};
use crumple_store::output_folder::OutputFolder;

/// Turn recordings (episodes or whole drives) or OpenSCENARIO files into scenarios
#[derive(Args)]
#[command(after_long_help = "\
Reads two formats, which it distinguishes by their first line: OpenACC CSV (speeds and bumper-to-bumper spacings of \
a platoon), and car-following events (event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps). \
For other formats, --map describes the columns, or names a built-in map. crumple detects how the text is written \
(encoding, separators, decimal commas, ISO 8601 time stamps), and prints it. Parquet files need a build with the \
feature `parquet`; ASAM MDF 4 files (also raw CAN frames, with a DBC file named in the map) need the feature `mdf`: \
`cargo install --locked --path . --features mdf,parquet`. In a braking episode, a \
vehicle's mean deceleration over one second exceeds --min-brake; that vehicle leads the scenario. \
Those behind it start at the recorded gaps and speeds and are under test, except that --follower drives the last of \
three or more vehicles. Without any episode the exit code is 1, and the hardest braking found is printed.

With --whole, each vehicle behind its leader makes a drive, from 30 s to an hour: the leader repeats its recorded \
speeds, the vehicle under test starts at the recorded gap and speed, and --follower drives the next vehicle from its \
recorded start. A drive ends where speeds or gaps are unknown. The file also contains the recorded gaps and speeds \
of the vehicle under test, so that `crumple assess --drives` can compare.

An OpenSCENARIO file F.xosc (1.0 to 1.3) becomes a scenario on the lane of the vehicle under test. \
--distribution makes a scenario of each combination of values (at most 10 000), or a space of random values. \
Unsupported content is an error with element, line and reason. The file, its road and its catalogues may have 64 MiB \
and a million tags and attributes, 1000 entities, 2000 events, 10 000 conditions and 400 000 samples of speeds; \
docs/exchange.md states the other limits.

Recordings of any length need less than 500 MB of memory: crumple reads them in overlapping parts of about 500 000 \
rows, and stores traffic in temporary files (in TMPDIR). A platoon may have 200 vehicles, a file a million events or \
vehicles. --preview reads the first part, --guess the first 100 000 rows. A map may have 64 KiB. An existing scenario \
file stays as it is if it is equal; if it differs, nothing is written without --force.

Examples:
  crumple import platoon.csv --out episodes
  crumple import 01_tracks.csv --map highd --preview 01.svg
  crumple import platoon.csv --whole --follower idm --out drives
  crumple import log.csv --guess > log.toml
  crumple import log.csv --map log.toml --min-brake 2 --out episodes
  crumple import cut-in.xosc --ego Ego --distribution speeds.xosc --out cut-ins")]
pub(super) struct Import {
    /// Recordings, or one OpenSCENARIO file
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Meanings of the columns: a file (docs/exchange.md), or openacc, car-following, highd, ngsim or sumo-fcd
    #[arg(long, value_name = "MAP.toml|NAME")]
    map: Option<PathBuf>,
    /// Print and plot the interpretation of one recording; writes no scenario and ignores thresholds
    #[arg(
        long,
        value_name = "F.svg|F.png",
        value_parser = simulate::path_ending_in(["svg", "png"]),
        conflicts_with_all = ["out", "leaders", "min_brake"]
    )]
    preview: Option<PathBuf>,
    /// Print a draft of a map for one recording, from the names, units and consistency of its columns; imports nothing
    #[arg(long, conflicts_with_all = ["map", "preview", "out", "leaders", "min_brake"])]
    guess: bool,
    /// Vehicles that lead scenarios [default: any]
    #[arg(long, value_parser = value_enums::one_of(value_enums::LEADERS))]
    leaders: Option<LeaderSelection>,
    /// Driver of the vehicle behind those under test, the last of three or more: human (with a reaction time that
    /// differs in each scenario), idm, baseline (holds its speed until the time to collision is below 1.4 s, then
    /// brakes fully), recorded (its speeds; a collision with it does not count against the controller), none, or any
    /// built-in controller or file [default: human]
    #[arg(long, value_name = "NAME|FILE", conflicts_with_all = ["preview", "guess"])]
    follower: Option<PathBuf>,
    /// Write whole drives of at least 30 s instead of braking episodes: each vehicle behind its leader, with the next
    /// vehicle behind it
    #[arg(long, conflicts_with_all = ["preview", "guess", "min_brake"])]
    whole: bool,
    /// Mean deceleration over one second that makes a braking episode, in m/s² [default: 1.3]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = args::number)]
    min_brake: Option<f64>,
    #[command(flatten)]
    openscenario: OpenScenarioArgs,
    /// Folder for the scenario files, created if missing
    #[arg(long, value_name = "DIR", default_value = "episodes")]
    out: PathBuf,
    /// Overwrite existing scenario files or plots with other contents, such as edited ones
    #[arg(long)]
    force: bool,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// Returns the built-in map of a name, or that of a file.
pub(super) fn load_map(map: &Path) -> Result<RecordingMap, CliError> {
    let built_in = map.to_str().and_then(RecordingMap::built_in);
    if built_in.is_none() && map.extension().is_none() && !map.exists() {
        let names: Vec<_> = BUILT_IN_MAPS.iter().map(|(name, _)| *name).collect();
        let problem = format!(
            "is neither a file nor a built-in map ({})",
            names.join(", ")
        );
        return Err(CliError::at(map, problem));
    }
    Ok(built_in.unwrap_or_else(|| RecordingMap::load(map))?)
}

/// Returns the driver of a name, a built-in controller, or that in a file.
fn load_follower(named: &Path, controllers: Controllers) -> Result<FollowerDriver, CliError> {
    let unusable = |problem: &dyn Display| CliError::Input(format!("--follower: {problem}"));
    if let Some(driver) = named.to_str().and_then(FollowerDriver::from_name) {
        return Ok(driver);
    }
    if let Some(built_in) = named.to_str().and_then(BuiltInController::parse) {
        let built_in = built_in.map_err(|error| unusable(&error))?;
        return Ok(FollowerDriver::Controller(Box::new(Driver::Controller(
            built_in,
        ))));
    }
    if !named.is_file() {
        let names = FollowerDriver::NAMES.join(", ");
        let problem = format!(
            "{} is neither a file, nor a built-in controller, nor one of {names}",
            named.display()
        );
        return Err(unusable(&problem));
    }
    FollowerDriver::from_file(named, &controllers).map_err(|problem| unusable(&problem))
}

pub(super) fn parse_min_brake(asked_mps2: Option<f64>) -> Result<MinBrake, CliError> {
    let Some(mps2) = asked_mps2 else {
        return Ok(MinBrake::default());
    };
    MinBrake::new(mps2).map_err(|error| CliError::Input(format!("--min-brake: {error}")))
}

/// Prints how a recording is written, as far as crumple detected it.
pub(super) fn note_text_format(path: &Path, text: &TextFormat, quiet: bool) {
    let text = text.to_string();
    if !text.is_empty() {
        output::note(&format!("{}: detected {text}", path.display()), quiet);
    }
}

/// Returns a note about columns that a draft does not read; `None` without such columns.
fn unread_columns(names: &[String]) -> Option<String> {
    const MAX_NAMED: usize = 10;
    let named: Vec<&str> = names.iter().take(MAX_NAMED).map(String::as_str).collect();
    let others = match names.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        count => format!(" and {count} more"),
    };
    let named = named.join(", ");
    (!names.is_empty()).then(|| {
        format!("note: the draft does not read these columns, which look like spacings or speeds: {named}{others}")
    })
}

/// Returns a note about other units and signs with which a draft fits as well; `None` if there are none.
fn other_readings(readings: &[String]) -> Option<String> {
    const MAX_NAMED: usize = 3;
    let named = readings.iter().take(MAX_NAMED);
    let named: Vec<&str> = named.map(String::as_str).collect();
    let others = match readings.len().saturating_sub(MAX_NAMED) {
        0 => String::new(),
        count => format!("; and {count} more"),
    };
    let named = named.join("; ");
    (!readings.is_empty())
        .then(|| format!("note: other units or signs fit as well: {named}{others}"))
}

fn note_dropped(report: &ImportReport, quiet: bool) {
    for dropped in &report.dropped {
        output::note(dropped, quiet);
    }
}

/// Result of an import whose files are not yet in place.
struct StagedImport {
    imported: ImportResult,
    files: StagedFiles,
    names: Vec<String>,
}

impl Import {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let quiet = global.quiet;
        if let Some(file) = self.recordings.iter().find(|path| is_openscenario(path)) {
            let is_alone =
                self.recordings.len() == 1 && self.map.is_none() && self.preview.is_none();
            let has_options = self.min_brake.is_some()
                || self.guess
                || self.whole
                || self.leaders.is_some()
                || self.follower.is_some();
            if !is_alone || has_options {
                let problem = "give an OpenSCENARIO file alone, with --ego, --distribution, --out and --force only";
                return Err(CliError::at(file, problem));
            }
            return self
                .openscenario
                .import(file, (&self.out, self.force), self.format, quiet);
        }
        if self.openscenario.is_used() {
            return Err(CliError::Input(
                "--ego and --distribution apply only to a file F.xosc".to_owned(),
            ));
        }
        if self.guess {
            return self.draft_map(quiet);
        }
        let map = self.map.as_deref().map(load_map).transpose()?;
        if let Some(picture) = &self.preview {
            return self.show_preview(picture, map.as_ref(), quiet);
        }
        let follower = self.follower.as_deref().unwrap_or(Path::new("human"));
        let follower = load_follower(follower, global.controllers)?;
        self.import(map.as_ref(), follower, quiet)
    }

    /// Prints the map that fits a recording.
    fn draft_map(&self, quiet: bool) -> Result<(), CliError> {
        let [path] = self.recordings.as_slice() else {
            return Err(CliError::Input(
                "--guess: give only one recording".to_owned(),
            ));
        };
        let Some(draft) = guess(path)? else {
            return Err(CliError::at(path, why_no_draft(path)?));
        };
        note_text_format(path, &draft.recording.text, quiet);
        draft
            .recording
            .dropped
            .iter()
            .for_each(|dropped| output::note(&dropped.to_string(), quiet));
        if let Some(name) = draft.built_in {
            output::note(
                &format!("note: this is the built-in map {name}: `--map {name}` names it"),
                quiet,
            );
        }
        output::note(
            "note: check the draft: the columns do not show bumpers, lengths and ids",
            quiet,
        );
        let notes = [
            other_readings(&draft.other_readings),
            unread_columns(&draft.unread),
        ];
        for note in notes.iter().flatten() {
            output::note(note, quiet);
        }
        let text = draft.map.to_toml().map_err(CliError::input)?;
        output::print_result(self.format, &draft.map, || text)
    }

    /// Prints and plots the interpretation of a recording.
    fn show_preview(
        &self,
        picture: &Path,
        map: Option<&RecordingMap>,
        quiet: bool,
    ) -> Result<(), CliError> {
        let [path] = self.recordings.as_slice() else {
            return Err(CliError::Input(
                "--preview: give only one recording".to_owned(),
            ));
        };
        let recording = load_first_part(path, map)?;
        note_text_format(path, &recording.text, quiet);
        for dropped in &recording.dropped {
            output::note(&dropped.to_string(), quiet);
        }
        let name = path.display().to_string();
        let Some(preview_text) = preview(&recording) else {
            return Err(CliError::NothingFound(format!(
                "{name}: {}",
                hardest_braking(&recording)
            )));
        };
        let drawn =
            feature::encode_figure(picture, &figures::draw_recording(&preview_text, &name))?;
        let mut files = StagedFiles::default();
        stage_unless_edited(&mut files, picture, &drawn, self.force)?;
        files.commit()?;
        let summary = RecordingSummary::new(&name, &recording, &preview_text);
        match self.format {
            OutputFormat::Json => output::print_json(&summary),
            OutputFormat::Text => output::print(&summary.to_text()),
        }
    }

    fn import(
        &self,
        map: Option<&RecordingMap>,
        follower: FollowerDriver,
        quiet: bool,
    ) -> Result<(), CliError> {
        let min_brake = parse_min_brake(self.min_brake)?;
        let options = ImportOptions {
            min_brake,
            leaders: self.leaders.unwrap_or_default(),
            follower,
            scope: self.scope(),
        };
        let StagedImport {
            imported,
            files,
            names,
        } = self.stage_scenarios(map, &options, quiet)?;
        let report = ImportReport::new(&imported, &self.out, &names);
        for source in &imported.sources {
            note_text_format(&source.path, &source.text, quiet);
        }
        if names.is_empty() {
            note_dropped(&report, quiet);
            let printed = match self.format {
                OutputFormat::Json => output::print_json(&report),
                OutputFormat::Text => Ok(()),
            };
            let absence = report.describe_absence(self.scope(), min_brake);
            let absence = CliError::NothingFound(absence);
            return CliError::verdict_first(Err(absence), printed);
        }
        files.commit()?;
        let others = self.count_other_scenarios(&names)?;
        if others > 0 {
            let out = self.out.display();
            output::note(
                &format!("note: {out} also contains {others} scenario files of other origin"),
                quiet,
            );
        }
        note_dropped(&report, quiet);
        output::print_result(self.format, &report, || report.to_text())
    }

    fn scope(&self) -> ImportScope {
        if self.whole {
            ImportScope::WholeDrives
        } else {
            ImportScope::Episodes
        }
    }

    /// Converts the recordings, and stages each scenario at once: a long recording may have more than memory holds.
    fn stage_scenarios(
        &self,
        map: Option<&RecordingMap>,
        options: &ImportOptions,
        quiet: bool,
    ) -> Result<StagedImport, CliError> {
        let folder = OutputFolder::without_listing(&self.out, self.force);
        let is_new = !self.out.exists();
        let mut files = StagedFiles::default();
        let mut names = Vec::new();
        let mut refused = None;
        let mut take = |scenario: ImportedScenario| {
            let staged = folder.stage(&mut files, &scenario.file_name, scenario.toml.as_bytes());
            refused = staged.err().map(CliError::from);
            names.push(scenario.file_name);
            refused.is_none()
        };
        let (bar, progress) = read_bar(quiet);
        let imported = import(&self.recordings, map, options, Some(&progress), &mut take);
        bar.finish_and_clear();
        let imported = refused.map_or_else(|| Ok(imported?), Err);
        if imported.is_err() {
            drop(std::mem::take(&mut files));
            if is_new {
                // Staging created it. A folder that is not empty stays.
                let _ = fs::remove_dir(&self.out);
            }
        }
        Ok(StagedImport {
            imported: imported?,
            files,
            names,
        })
    }

    /// Counts scenario files in the folder that this import did not write, such as those of an earlier threshold.
    fn count_other_scenarios(&self, written: &[String]) -> Result<usize, CliError> {
        let entries = fs::read_dir(&self.out).map_err(DiskError::at(&self.out))?;
        let written: HashSet<_> = written.iter().map(OsStr::new).collect();
        let others = entries.flatten().map(|entry| entry.path()).filter(|path| {
            path.extension()
                .is_some_and(|extension| extension == "toml")
        });
        Ok(others
            .filter(|path| path.file_name().is_some_and(|name| !written.contains(name)))
            .count())
    }
}

/// Returns what the names of columns show, and what a draft needs.
fn why_no_draft(path: &Path) -> Result<String, CliError> {
    let recognised = recognised_columns(path)?;
    let columns: Vec<String> = recognised
        .iter()
        .map(|(role, column)| format!("{role} `{column}`"))
        .collect();
    let columns = match columns.is_empty() {
        true => "no time".to_owned(),
        false => columns.join(", "),
    };
    Ok(format!(
        "no draft: the names of the columns show {columns}. A draft needs times, and spacings with two speeds, or \
         positions with speeds and vehicles: write a map by hand (`crumple show openacc` or `highd` prints one)"
    ))
}
