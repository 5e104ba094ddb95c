//! `crumple import`: converts recorded platoons and OpenSCENARIO files into scenarios.

use std::collections::HashSet;
use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use super::CliError;
use super::fit::ensure_distinct;
use super::import_openscenario::{OpenScenarioArgs, is_openscenario};
use super::output_folder::{OutputFolder, stage_unless_edited};
use super::output_format::OutputFormat;
use super::progress::read_bar;
use super::{args, feature, output, simulate, value_enums};
use crumple_exchange::recording::guess::guess;
use crumple_exchange::recording::map::{BUILT_IN_MAPS, RecordingMap};
use crumple_exchange::recording::{
    ImportOptions, ImportReport, ImportResult, ImportedScenario, LeaderSelection, MinBrake,
    RecordingSummary, TextFormat, hardest_braking, import, load_first_part, preview,
};
use crumple_report::draw::Svg;
use crumple_report::figures;
use crumple_store::disk::{DiskError, StagedFiles};

/// Turn recorded braking episodes, or OpenSCENARIO files, into scenario files
#[derive(Args)]
#[command(after_long_help = "\
Reads two formats, which it distinguishes by their first line: OpenACC CSV (speeds and bumper-to-bumper spacings of \
a platoon), and car-following events (event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps). \
For other formats, --map describes the columns, or names a built-in map. crumple detects how the text is written \
(encoding, separators, decimal commas, ISO 8601 time stamps), and prints it. Parquet files need a build with the \
feature `parquet`; ASAM MDF 4 files (also raw CAN frames, with a DBC file named in the map) need the feature `mdf`: \
`cargo install --locked --path . --features mdf,parquet`. In a braking episode, a \
vehicle's mean deceleration over one second exceeds --min-brake; that vehicle leads the scenario. \
Those behind it start at the recorded gaps and speeds and are under test, except that the baseline drives the last of \
three or more vehicles. Without any episode the exit code is 1, and the hardest braking found is printed.

An OpenSCENARIO file F.xosc (1.0 to 1.3) becomes a scenario on the lane of the vehicle under test. \
--distribution makes a scenario of each combination of values (at most 10 000), or a space of random values. \
Unsupported content is an error with element, line and reason. The file, its road and its catalogues may have 64 MiB \
and a million tags and attributes, 1000 entities, 2000 events, 10 000 conditions and 400 000 samples of speeds; \
docs/exchange.md states the other limits.

Recordings of any length need less than 500 MB of memory: crumple reads them in overlapping parts of about 500 000 \
rows, and traffic through temporary files (in TMPDIR). A platoon may have 200 vehicles, a file a million events or \
vehicles. --preview reads the first part, --guess the first 100 000 rows. A map may have 64 KiB. An existing \
scenario file stays as it is if it is equal; if it differs, nothing is written without --force.

Examples:
  crumple import platoon.csv --out episodes
  crumple import 01_tracks.csv --map highd --preview 01.svg
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
    /// Print a draft of a map for one recording, by names, units and consistency of its columns; imports nothing
    #[arg(long, conflicts_with_all = ["map", "preview", "out", "leaders", "min_brake"])]
    guess: bool,
    /// Vehicles whose braking makes an episode
    #[arg(long, default_value = "any", value_parser = value_enums::one_of(value_enums::LEADERS))]
    leaders: LeaderSelection,
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

pub(super) fn render_figure(drawn: &Svg, path: &Path) -> Result<Vec<u8>, CliError> {
    match path.extension() {
        Some(png) if png == "png" => feature::render_png(drawn),
        _ => Ok(drawn.document().into_bytes()),
    }
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
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        if let Some(file) = self.recordings.iter().find(|path| is_openscenario(path)) {
            let is_alone =
                self.recordings.len() == 1 && self.map.is_none() && self.preview.is_none();
            if !is_alone || self.min_brake.is_some() || self.guess {
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
        ensure_distinct(&self.recordings)?;
        if self.guess {
            return self.draft_map(quiet);
        }
        let map = self.map.as_deref().map(load_map).transpose()?;
        if let Some(picture) = &self.preview {
            return self.show_preview(picture, map.as_ref(), quiet);
        }
        self.import(map.as_ref(), quiet)
    }

    /// Prints the map that fits a recording.
    fn draft_map(&self, quiet: bool) -> Result<(), CliError> {
        let [path] = self.recordings.as_slice() else {
            return Err(CliError::Input(
                "--guess: give only one recording".to_owned(),
            ));
        };
        let Some(draft) = guess(path)? else {
            let problem = "the columns do not look like times, speeds, and spacings or positions: write a map by hand";
            return Err(CliError::at(path, format!("{problem} (docs/exchange.md)")));
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
        let drawn = self::render_figure(&figures::draw_recording(&preview_text, &name), picture)?;
        let mut files = StagedFiles::default();
        stage_unless_edited(&mut files, picture, &drawn, self.force)?;
        files.commit()?;
        let summary = RecordingSummary::new(&name, &recording, &preview_text);
        match self.format {
            OutputFormat::Json => output::print_json(&summary),
            OutputFormat::Text => output::print(&summary.to_text()),
        }
    }

    fn import(&self, map: Option<&RecordingMap>, quiet: bool) -> Result<(), CliError> {
        let min_brake = parse_min_brake(self.min_brake)?;
        let StagedImport {
            imported,
            files,
            names,
        } = self.stage_scenarios(map, min_brake, quiet)?;
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
            let absence = CliError::NothingFound(report.describe_absence(min_brake));
            return CliError::gate_first(Err(absence), printed);
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

    /// Converts the recordings, and stages each scenario at once: a long recording may have more than memory holds.
    fn stage_scenarios(
        &self,
        map: Option<&RecordingMap>,
        min_brake: MinBrake,
        quiet: bool,
    ) -> Result<StagedImport, CliError> {
        let folder = OutputFolder::without_listing(&self.out, self.force);
        let is_new = !self.out.exists();
        let mut files = StagedFiles::default();
        let mut names = Vec::new();
        let mut refused = None;
        let mut take = |scenario: ImportedScenario| {
            let staged = folder.stage(&mut files, &scenario.file_name, scenario.toml.as_bytes());
            refused = staged.err();
            names.push(scenario.file_name);
            refused.is_none()
        };
        let (bar, progress) = read_bar(quiet);
        let options = ImportOptions {
            min_brake,
            leaders: self.leaders,
        };
        let imported = import(&self.recordings, map, &options, Some(&progress), &mut take);
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
