//! `crumple show`: built-in items as files.

use clap::{Args, ValueEnum};

use super::preset::RETRAIN_PRESET_NAMES;
use super::reach::BUILT_IN_BOXES;
use super::{CliError, output};
use crumple_controllers::find_built_in;
use crumple_exchange::recording::map::BUILT_IN_MAPS;
use crumple_learn::retrain::TRAINING_PRESET_TEXT;
use crumple_learn::rl::PRESETS;
use crumple_report::assessment::default_configuration;
use crumple_sim::scenario::{VehicleClass, built_in_scenario, built_in_scenario_names, file};
use crumple_spaces::{BUILT_IN_SPACES, VARIANT_SPACES, built_in_space, file as space_file};
use crumple_suites::SHIPPED_SUITES;

/// Print a built-in item as a file that a user could write
#[derive(Args)]
#[command(after_long_help = "\
Save the output, change it, and pass the file instead of the name. A vehicle class is printed as the lines of a \
vehicle in a scenario file. A name may stand for several kinds, such as a scenario and a box. crumple prints the first \
in the order of --kind, and a note names the others.

Examples:
  crumple show assessment > mine.toml && crumple assess mine.toml
  crumple show paper-1 > mine.toml && crumple simulate mine.toml
  crumple show high-risk > mine.toml
  crumple falsify --controller idm --space mine.toml --budget 100
  crumple show fast > mine.toml && crumple train --preset mine.toml --episodes 10
  crumple show openacc > mine.toml && crumple import platoon.csv --map mine.toml")]
pub(super) struct Show {
    /// Name of a built-in item; for an unknown name, crumple lists all names
    #[arg(value_name = "NAME")]
    name: String,
    /// Print only a file of this kind
    #[arg(long, value_enum)]
    kind: Option<BuiltInKind>,
}

/// A kind of built-in items that have a file format.
#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum BuiltInKind {
    /// Configurations of reports, for `assess`
    Assessment,
    /// Scenarios, for `simulate`
    Scenario,
    /// Spaces of scenarios, for `falsify --space`
    Space,
    /// Presets of trainings, for `train --preset`
    Preset,
    /// Suites of tests, for `suite run`
    Suite,
    /// Maps of the columns of recordings, for `import --map`
    Map,
    /// Boxes of initial states, for `verify reach --box`
    Box,
    /// Vehicle classes, for the vehicles of a scenario
    VehicleClass,
}

impl BuiltInKind {
    fn name(self) -> String {
        self.to_possible_value()
            .map_or_else(String::new, |value| value.get_name().to_owned())
    }

    /// Returns the name and the text of each built-in file of this kind.
    fn files(self) -> Result<Vec<(&'static str, String)>, CliError> {
        match self {
            Self::Assessment => Ok(vec![("assessment", default_configuration())]),
            Self::Scenario => built_in_scenario_names()
                .into_iter()
                .filter_map(|(name, _)| Some((name, built_in_scenario(name)?)))
                .map(|(name, scenario)| {
                    Ok((name, file::to_toml(&scenario).map_err(CliError::input)?))
                })
                .collect(),
            Self::Space => {
                let shipped = BUILT_IN_SPACES.map(|(name, _, text)| Ok((name, text.to_owned())));
                let human = VARIANT_SPACES.map(|(name, ..)| Ok((name, space_toml(name)?)));
                shipped.into_iter().chain(human).collect()
            }
            Self::Preset => Ok(owned(
                PRESETS
                    .into_iter()
                    .chain([(RETRAIN_PRESET_NAMES[0], TRAINING_PRESET_TEXT)]),
            )),
            Self::Suite => Ok(owned(SHIPPED_SUITES)),
            Self::Map => Ok(owned(BUILT_IN_MAPS)),
            Self::Box => Ok(owned(BUILT_IN_BOXES)),
            Self::VehicleClass => Ok(VehicleClass::ALL
                .iter()
                .map(|class| (class.name(), vehicle_class_toml(*class)))
                .collect()),
        }
    }
}

fn owned(
    files: impl IntoIterator<Item = (&'static str, &'static str)>,
) -> Vec<(&'static str, String)> {
    files
        .into_iter()
        .map(|(name, text)| (name, text.to_owned()))
        .collect()
}

/// Returns the file of a built-in space that is another one with changes.
fn space_toml(name: &str) -> Result<String, CliError> {
    Ok(built_in_space(name)
        .map(|space| space_file::to_toml(&space))
        .transpose()
        .map_err(CliError::input)?
        .unwrap_or_default())
}

/// Returns the names of all built-in files, each once.
pub(super) fn built_in_file_names() -> Vec<&'static str> {
    let mut names: Vec<&str> = Vec::new();
    let files = BuiltInKind::value_variants()
        .iter()
        .filter_map(|kind| kind.files().ok());
    for (name, _) in files.flatten() {
        if !names.contains(&name) {
            names.push(name);
        }
    }
    names
}

fn vehicle_class_toml(class: VehicleClass) -> String {
    format!(
        "# Default values of a vehicle of class `{name}`; a scenario file may state others.\n[[vehicles]]\nclass = \
         \"{name}\"\nlength_m = {:?}\nmass_kg = {:?}\nmax_brake_mps2 = {:?}\nmax_accel_mps2 = {:?}\nposition_m = \
         0.0\nspeed_mps = 0.0\ndriver = \"under-test\"\n",
        class.length_m(),
        class.mass_kg(),
        class.max_brake_mps2(),
        class.max_accel_mps2(),
        name = class.name()
    )
}

impl Show {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let mut matching = Vec::new();
        let mut names_by_kind = Vec::new();
        for kind in BuiltInKind::value_variants() {
            if self.kind.is_none_or(|wanted| wanted == *kind) {
                let files = kind.files()?;
                let names: Vec<_> = files.iter().map(|(name, _)| *name).collect();
                names_by_kind.push(format!("{}: {}", kind.name(), names.join(", ")));
                matching.extend(
                    files
                        .into_iter()
                        .filter(|(name, _)| *name == self.name)
                        .map(|(_, text)| (kind.name(), text)),
                );
            }
        }
        let Some(((first, text), others)) = matching.split_first() else {
            return Err(self.no_file_error(&names_by_kind));
        };
        for (other, _) in others {
            output::note(
                &format!(
                    "note: this is the {first}; --kind {other} shows the {other} `{}`",
                    self.name
                ),
                quiet,
            );
        }
        output::print(text)
    }

    fn no_file_error(&self, names_by_kind: &[String]) -> CliError {
        CliError::Input(match find_built_in(&self.name) {
            Some(_) => format!(
                "`{}` is a built-in controller, which has no file (see `crumple list`)",
                self.name
            ),
            None => format!(
                "there is no built-in {} `{}`. Names: {}",
                self.kind
                    .map_or_else(|| "file".to_owned(), BuiltInKind::name),
                self.name,
                names_by_kind.join("; ")
            ),
        })
    }
}
