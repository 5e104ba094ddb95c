//! `crumple show`: what is built in, as files.

use clap::{Args, ValueEnum};

use super::preset::RETRAIN;
use super::reach::BOXES;
use super::{Failure, output};
use crumple_learn::retrain::TRAINING_PRESET_TEXT;
use crumple_learn::rl::PRESETS;
use crumple_search::suite::SHIPPED;
use crumple_world::recording::map::BUILT_IN_MAPS;
use crumple_world::scenario::space::BUILT_IN_SPACES;
use crumple_world::scenario::{VehicleClass, built_in, built_in_names, file};

/// Print something built in as the file that a user could write
#[derive(Args)]
#[command(after_long_help = "\
Save what is printed, change it, and pass the file where the name was passed. A vehicle class is printed as the lines of a vehicle in a \
scenario file. If several kinds have something of one name, the first in the order of --kind is printed, and a note names the others.

Examples:
  crumple show paper-1 > mine.toml && crumple simulate mine.toml
  crumple show high-risk > mine.toml && crumple falsify --controller idm --space mine.toml --budget 100
  crumple show fast > mine.toml && crumple train --preset mine.toml --episodes 10
  crumple show openacc > mine.toml && crumple import platoon.csv --map mine.toml")]
pub(super) struct Show {
    /// Name of something built in; an unknown name is answered with all there are
    #[arg(value_name = "NAME")]
    name: String,
    /// Kind of what is shown
    #[arg(long, value_enum)]
    kind: Option<BuiltInKind>,
}

/// A kind of things that are built in and could be files.
#[derive(Debug, Clone, Copy, PartialEq, ValueEnum)]
enum BuiltInKind {
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
    const ALL: [Self; 7] =
        [Self::Scenario, Self::Space, Self::Preset, Self::Suite, Self::Map, Self::Box, Self::VehicleClass];

    fn word(self) -> &'static str {
        match self {
            Self::Scenario => "scenario",
            Self::Space => "space",
            Self::Preset => "preset",
            Self::Suite => "suite",
            Self::Map => "map",
            Self::Box => "box",
            Self::VehicleClass => "vehicle-class",
        }
    }

    /// The names that there are of the kind.
    fn names(self) -> Vec<&'static str> {
        match self {
            Self::Scenario => built_in_names().map(|(name, _)| name).into(),
            Self::Space => BUILT_IN_SPACES.map(|(name, ..)| name).into(),
            Self::Preset => PRESETS.iter().map(|(name, _)| *name).chain([RETRAIN[0]]).collect(),
            Self::Suite => SHIPPED.map(|(name, _)| name).into(),
            Self::Map => BUILT_IN_MAPS.map(|(name, _)| name).into(),
            Self::Box => BOXES.map(|(name, _)| name).into(),
            Self::VehicleClass => VehicleClass::ALL.iter().map(|class| class.name()).collect(),
        }
    }

    /// The text of the file of one; none of an unknown name.
    fn text(self, name: &str) -> Result<Option<String>, Failure> {
        let text_of =
            |all: &[(&str, &str)]| all.iter().find(|(known, _)| *known == name).map(|(_, text)| (*text).to_owned());
        Ok(match self {
            Self::Scenario => {
                built_in(name).map(|scenario| file::to_toml(&scenario)).transpose().map_err(Failure::input)?
            }
            Self::Space => text_of(&BUILT_IN_SPACES.map(|(name, _, text)| (name, text))),
            Self::Preset if name == RETRAIN[0] => Some(TRAINING_PRESET_TEXT.to_owned()),
            Self::Preset => text_of(&PRESETS),
            Self::Suite => text_of(&SHIPPED),
            Self::Map => text_of(&BUILT_IN_MAPS),
            Self::Box => text_of(&BOXES),
            Self::VehicleClass => {
                VehicleClass::ALL.iter().find(|class| class.name() == name).map(|class| lines_of(*class))
            }
        })
    }
}

/// A vehicle class as the lines of a vehicle in a scenario file.
fn lines_of(class: VehicleClass) -> String {
    format!(
        "# A vehicle of class `{name}` has these numbers, and a scenario file may state others.\n[[vehicles]]\nclass = \"{name}\"\nlength_m = {:?}\n\
         mass_kg = {:?}\nmax_brake_mps2 = {:?}\nmax_accel_mps2 = {:?}\nposition_m = 0.0\nspeed_mps = 0.0\ndriver = \"under-test\"\n",
        class.length_m(),
        class.mass_kg(),
        class.max_brake_mps2(),
        class.max_accel_mps2(),
        name = class.name()
    )
}

impl Show {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let name = self.name.as_str();
        let wanted = |kind: &BuiltInKind| self.kind.is_none_or(|wanted| wanted == *kind);
        let kinds: Vec<_> =
            BuiltInKind::ALL.into_iter().filter(wanted).filter(|kind| kind.names().contains(&name)).collect();
        let Some((first, others)) = kinds.split_first() else { return Err(self.unknown()) };
        let text = first.text(name)?.ok_or_else(|| self.unknown())?;
        for other in others {
            let note = format!(
                "note: this is the {}; --kind {} shows the {} `{name}`",
                first.word(),
                other.word(),
                other.word()
            );
            output::note(&note, quiet);
        }
        output::print(&text)
    }

    fn unknown(&self) -> Failure {
        let of = |kind: BuiltInKind| format!("{}: {}", kind.word(), kind.names().join(", "));
        let kinds = BuiltInKind::ALL.into_iter().filter(|kind| self.kind.is_none_or(|wanted| wanted == *kind));
        let known: Vec<_> = kinds.map(of).collect();
        Failure::Input(format!("there is nothing built in of the name `{}`; there are {}", self.name, known.join("; ")))
    }
}
