//! `crumple import F.xosc`: converts an OpenSCENARIO file to a scenario, to its variations or to a space.

use std::path::{Path, PathBuf};

use clap::Args;

use super::CliError;
use super::output_folder::{EarlierFiles, OutputFolder};
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

/// Options of OpenSCENARIO files.
#[derive(Args)]
pub(super) struct OpenScenarioArgs {
    /// Vehicle under test of an OpenSCENARIO file [default: the only entity with a controller]
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
            notes,
        } = self.convert(path, quiet)?;
        OutputFolder::without_listing(out, force).write(&files, EarlierFiles::Keep)?;
        for note in &notes {
            output::note(&format!("note: {note}"), quiet);
        }
        if violating > 0 {
            let problem = format!(
                "{violating} combinations of values violate the constraints of the parameters"
            );
            output::note(&format!("note: {}: {problem}", path.display()), quiet);
        }
        let names = files.iter().map(|(name, _)| name.as_str());
        let report = OpenScenarioReport::new(out, names, violating, notes);
        output::print_result(format, &report, || report.to_text())
    }

    /// Converts a file to a scenario, to all variations, or to a space.
    fn convert(&self, path: &Path, quiet: bool) -> Result<ConvertedFiles, CliError> {
        let source = OpenScenarioSource::load(path)?;
        let ego = self.ego.as_deref();
        let Some(distribution) = &self.distribution else {
            let imported = show(&import_bar(1, quiet), |_| source.scenario(ego, &[]));
            let ImportedLaneScenario { scenario, notes } = imported?;
            return Ok(ConvertedFiles::single(scenario_file(&scenario)?, notes));
        };
        let distributions = ParameterDistributionFile::load(distribution, path)?;
        if !distributions.is_random() {
            let variations = distributions.variations()?;
            let bar = import_bar(variations.len() as u64, quiet);
            return show(&bar, |progress| {
                import_variations(&source, ego, &variations, progress)
            });
        }
        let bar = import_bar(1 + 3 * distributions.random_count() as u64, quiet);
        let (space, notes) = show(&bar, |progress| source.space(ego, &distributions, progress))?;
        Ok(ConvertedFiles::single(space_file(&space)?, notes))
    }
}

/// Files of an import, each with its name.
struct ConvertedFiles {
    files: Vec<(String, Vec<u8>)>,
    /// Number of combinations of values that violate constraints.
    violating: usize,
    notes: Vec<String>,
}

impl ConvertedFiles {
    fn single(file: (String, Vec<u8>), notes: Vec<String>) -> Self {
        Self {
            files: vec![file],
            violating: 0,
            notes,
        }
    }
}

fn space_file(space: &ScenarioSpace) -> Result<(String, Vec<u8>), CliError> {
    let text = crumple_spaces::file::to_toml(space).map_err(CliError::input)?;
    let text = readable(text, space.name())?;
    let stem = export::file_stem(space.name());
    Ok((format!("{stem}-space.toml"), text.into_bytes()))
}

fn scenario_file(scenario: &Scenario) -> Result<(String, Vec<u8>), CliError> {
    let text = readable(
        file::to_toml(scenario).map_err(CliError::input)?,
        &scenario.spec().name,
    )?;
    Ok((
        format!("{}.toml", export::file_stem(&scenario.spec().name)),
        text.into_bytes(),
    ))
}

/// Refuses a file that crumple could not read again.
fn readable(text: String, name: &str) -> Result<String, CliError> {
    if text.len() as u64 <= text_file::MAX_TOML_BYTES {
        return Ok(text);
    }
    let most = text_file::MAX_TOML_BYTES >> 20;
    let problem = "as its speeds have too many samples: shorten trajectories, speed profiles or curved transitions";
    Err(CliError::Input(format!(
        "the file of `{name}` would have more than {most} MiB, {problem}"
    )))
}

fn describe_values(variation: &Variation) -> String {
    let values: Vec<_> = variation
        .iter()
        .map(|(name, value)| format!("{name} = {value}"))
        .collect();
    values.join(", ")
}

fn too_many_variations() -> CliError {
    let most = MAX_FOLDER_BYTES >> 20;
    CliError::Input(format!(
        "the scenarios of all variations have more than {most} MiB: give fewer values"
    ))
}

/// Returns the files of all variations, with the notes of the first.
fn import_variations(
    source: &OpenScenarioSource,
    ego: Option<&str>,
    variations: &[Variation],
    progress: &dyn Observer<RunProgress>,
) -> Result<ConvertedFiles, CliError> {
    let mut files = Vec::new();
    let mut violating = 0;
    let mut notes = Vec::new();
    let mut bytes_left = MAX_FOLDER_BYTES;
    let counter = ProgressCounter::new(progress, Some(variations.len() as u64));
    for (index, variation) in variations.iter().enumerate() {
        let values = describe_values(variation);
        counter.add(1).map_err(CliError::input)?;
        let imported = match source.scenario(ego, variation) {
            Ok(imported) => imported,
            Err(ScenarioImportError::Constraint { .. }) => {
                violating += 1;
                continue;
            }
            Err(error) => return Err(CliError::Input(format!("{error} (with `{values}`)"))),
        };
        let named = imported.scenario.edited(|spec| {
            let stem: String = spec.name.chars().take(190).collect();
            (spec.name, spec.about) = (format!("{stem}-{:05}", index + 1), values);
        });
        let file = scenario_file(&named.map_err(CliError::input)?)?;
        bytes_left = bytes_left
            .checked_sub(file.1.len() as u64)
            .ok_or_else(too_many_variations)?;
        files.push(file);
        if files.len() == 1 {
            notes = imported.notes;
        }
    }
    if files.is_empty() {
        return Err(CliError::Input(
            "all combinations of values violate the constraints of the parameters".to_owned(),
        ));
    }
    Ok(ConvertedFiles {
        files,
        violating,
        notes,
    })
}
