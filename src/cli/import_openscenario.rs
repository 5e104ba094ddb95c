//! `crumple import F.xosc`: converts an OpenSCENARIO file to a scenario, to its variations or to a space.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use clap::Args;

use super::CliError;
use super::output_format::OutputFormat;
use super::progress::{import_bar, show};
use super::{export, output};
use crumple_core::observer::{Observer, ProgressCounter, RunProgress};
use crumple_core::text_file;
use crumple_exchange::openscenario::{
    ImportedLaneScenario, OpenScenarioReport, OpenScenarioSource, ParameterDistributionFile,
    ScenarioImportError, Variation,
};
use crumple_sim::scenario::Scenario;
use crumple_sim::scenario::file::{self, MAX_FOLDER_BYTES};
use crumple_spaces::ScenarioSpace;
use crumple_store::output_folder::{EarlierFiles, OutputFolder};

/// Maximum number of refused combinations that are printed.
const MAX_PRINTED_REFUSALS: usize = 10;

/// Options of OpenSCENARIO files.
#[derive(Args)]
pub(super) struct OpenScenarioArgs {
    /// Vehicle under test of an OpenSCENARIO file [default: entities with the controller `under-test`, or the entity
    /// with the only controller of the file, if this has no built-in name]
    #[arg(long, value_name = "NAME")]
    ego: Option<String>,
    /// Values of the parameters of an OpenSCENARIO file: writes a scenario for each combination
    #[arg(long, value_name = "D.xosc")]
    distribution: Option<PathBuf>,
}

impl From<ScenarioImportError> for CliError {
    fn from(error: ScenarioImportError) -> Self {
        match error {
            ScenarioImportError::Read { path, source } => Self::from_read_error(path, source),
            other => Self::from_cause(other),
        }
    }
}

/// Returns true if a file is OpenSCENARIO by its extension.
pub(super) fn is_openscenario(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension.eq_ignore_ascii_case("xosc"))
}

impl OpenScenarioArgs {
    pub(super) fn is_used(&self) -> bool {
        self.ego.is_some() || self.distribution.is_some()
    }

    /// Imports a file to a folder.
    pub(super) fn import(
        &self,
        path: &Path,
        (out, force): (&Path, bool),
        format: OutputFormat,
        quiet: bool,
    ) -> Result<(), CliError> {
        let ConvertedFiles {
            files,
            violating,
            refused,
            notes,
        } = self.convert(path, quiet)?;
        OutputFolder::without_listing(out, force).write(&files, EarlierFiles::Keep)?;
        for note in &notes {
            output::note(&format!("note: {note}"), quiet);
        }
        if violating > 0 {
            let combinations = count_combinations(violating);
            let verb = if violating == 1 {
                "violates"
            } else {
                "violate"
            };
            let problem = format!("{combinations} {verb} the constraints of the parameters");
            output::note(&format!("note: {}: {problem}", path.display()), quiet);
        }
        note_refused(path, &refused, quiet);
        let names = files.iter().map(|(name, _)| name.as_str());
        let report = OpenScenarioReport::new(out, names, violating, refused, notes);
        output::print_result(format, &report, || report.to_text())
    }

    /// Converts a file to a scenario, to all variations, or to a space.
    fn convert(&self, path: &Path, quiet: bool) -> Result<ConvertedFiles, CliError> {
        let source = OpenScenarioSource::load(path)?;
        let ego = self.ego.as_deref();
        let Some(distribution) = &self.distribution else {
            let imported = show(&import_bar(1, quiet), |_| source.scenario(ego, &[]));
            let imported = imported?;
            return Ok(ConvertedFiles::single(
                scenario_file(path, &imported.scenario, &imported.largest_motion)?,
                imported.notes,
            ));
        };
        let distributions = ParameterDistributionFile::load(distribution, path)?;
        if !distributions.is_random() {
            let variations = distributions.variations()?;
            let bar = import_bar(variations.len() as u64, quiet);
            return show(&bar, |progress| {
                import_variations((path, &source), ego, &variations, progress)
            });
        }
        let bar = import_bar(1 + 3 * distributions.random_count() as u64, quiet);
        let (space, notes) = show(&bar, |progress| source.space(ego, &distributions, progress))?;
        Ok(ConvertedFiles::single(
            space_file(distribution, &space)?,
            notes,
        ))
    }
}

/// Files of an import, each with its name.
struct ConvertedFiles {
    files: Vec<(String, Vec<u8>)>,
    /// Number of combinations of values that violate constraints.
    violating: usize,
    /// Errors of combinations that cannot be imported, each with the values.
    refused: Vec<String>,
    notes: Vec<String>,
}

impl ConvertedFiles {
    fn empty() -> Self {
        Self {
            files: Vec::new(),
            violating: 0,
            refused: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Refuses variations of a file of which none can be imported, with the first error.
    fn ensure_any(self, path: &Path) -> Result<Self, CliError> {
        if !self.files.is_empty() {
            return Ok(self);
        }
        let first = self.refused.into_iter().next();
        Err(first.map_or_else(
            || {
                let problem =
                    "all combinations of values violate the constraints of the parameters";
                CliError::at(path, problem)
            },
            CliError::Input,
        ))
    }

    fn single(file: (String, Vec<u8>), notes: Vec<String>) -> Self {
        Self {
            files: vec![file],
            violating: 0,
            refused: Vec::new(),
            notes,
        }
    }
}

fn space_file(path: &Path, space: &ScenarioSpace) -> Result<(String, Vec<u8>), CliError> {
    let text = crumple_spaces::file::to_toml(space);
    let text = text.map_err(|error| CliError::at(path, error))?;
    let text = readable(path.display(), text)?;
    let stem = export::file_stem(space.name());
    Ok((format!("{stem}-space.toml"), text.into_bytes()))
}

/// Returns the file of a scenario. `largest_motion` is the place of most of its samples.
fn scenario_file(
    path: &Path,
    scenario: &Scenario,
    largest_motion: &str,
) -> Result<(String, Vec<u8>), CliError> {
    let text = file::to_toml(scenario);
    let text = text.map_err(|error| CliError::at(path, error))?;
    let text = readable(largest_motion, text)?;
    Ok((
        format!("{}.toml", export::file_stem(&scenario.spec().name)),
        text.into_bytes(),
    ))
}

/// Refuses a scenario or space that crumple could not read again. `origin` is the place that makes it large.
fn readable(origin: impl Display, text: String) -> Result<String, CliError> {
    if text.len() as u64 <= text_file::MAX_TOML_BYTES {
        return Ok(text);
    }
    let most = text_file::MAX_TOML_BYTES >> 20;
    let problem = "as its speeds have too many samples: shorten trajectories, speed profiles or curved transitions";
    let problem = format!("the written file would have more than {most} MiB, {problem}");
    Err(CliError::Input(format!("{origin}: {problem}")))
}

fn count_combinations(count: usize) -> String {
    let noun = if count == 1 {
        "combination"
    } else {
        "combinations"
    };
    format!("{count} {noun} of values")
}

fn describe_values(variation: &Variation) -> String {
    let values: Vec<_> = variation
        .iter()
        .map(|(name, value)| format!("{name} = {value}"))
        .collect();
    values.join(", ")
}

fn too_many_variations(path: &Path) -> CliError {
    let most = MAX_FOLDER_BYTES >> 20;
    let problem =
        format!("the scenarios of all variations have more than {most} MiB: give fewer values");
    CliError::at(path, problem)
}

/// Prints the errors of combinations that cannot be imported.
fn note_refused(path: &Path, refused: &[String], quiet: bool) {
    if refused.is_empty() {
        return;
    }
    let count = refused.len();
    let combinations = count_combinations(count);
    let problem = format!("{combinations} cannot be imported");
    output::note(&format!("note: {}: {problem}", path.display()), quiet);
    for error in refused.iter().take(MAX_PRINTED_REFUSALS) {
        output::note(&format!("note: refused: {error}"), quiet);
    }
    if count > MAX_PRINTED_REFUSALS {
        let more = count - MAX_PRINTED_REFUSALS;
        let text = format!("note: and {more} more, which --format json lists");
        output::note(&text, quiet);
    }
}

/// Returns the files of all variations that can be imported, with the notes of the first.
fn import_variations(
    (path, source): (&Path, &OpenScenarioSource),
    ego: Option<&str>,
    variations: &[Variation],
    progress: &dyn Observer<RunProgress>,
) -> Result<ConvertedFiles, CliError> {
    let mut converted = ConvertedFiles::empty();
    let mut bytes_left = MAX_FOLDER_BYTES;
    let counter = ProgressCounter::new(progress, Some(variations.len() as u64));
    for (index, variation) in variations.iter().enumerate() {
        let values = describe_values(variation);
        counter.add(1).map_err(CliError::input)?;
        let imported = match source.scenario(ego, variation) {
            Ok(imported) => imported,
            Err(ScenarioImportError::Constraint { .. }) => {
                converted.violating += 1;
                continue;
            }
            Err(
                error @ (ScenarioImportError::Refused { .. } | ScenarioImportError::Invalid { .. }),
            ) => {
                converted.refused.push(format!("{error} (with `{values}`)"));
                continue;
            }
            Err(error) => return Err(CliError::Input(format!("{error} (with `{values}`)"))),
        };
        let file = variation_file(path, &imported, index, values)?;
        bytes_left = bytes_left
            .checked_sub(file.1.len() as u64)
            .ok_or_else(|| too_many_variations(path))?;
        converted.files.push(file);
        if converted.files.len() == 1 {
            converted.notes = imported.notes;
        }
    }
    converted.ensure_any(path)
}

/// Returns the file of a variation, with its number in the name.
fn variation_file(
    path: &Path,
    imported: &ImportedLaneScenario,
    index: usize,
    values: String,
) -> Result<(String, Vec<u8>), CliError> {
    let named = imported.scenario.edited(|spec| {
        let stem: String = spec.name.chars().take(190).collect();
        (spec.name, spec.about) = (format!("{stem}-{:05}", index + 1), values);
    });
    let named = named.map_err(|invalid| CliError::at(path, invalid))?;
    scenario_file(path, &named, &imported.largest_motion)
}
