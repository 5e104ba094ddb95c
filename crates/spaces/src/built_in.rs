//! Built-in spaces.

use std::path::Path;

use super::spec::{ChoiceSpec, DistributionSpec, DriverName, FollowerVariant, ParameterValue};
use super::{Base, ParameterSpec, ScenarioSpace, SpaceSpec, file};
use crumple_sim::control::{BuiltInController, HumanSettings};
use crumple_sim::scenario::file::ScenarioFileError;
use crumple_sim::scenario::{Driver, NoDriverFiles, OpenDriver};

/// Name, one-line description and text of every built-in space.
pub const BUILT_IN_SPACES: [(&str, &str, &str); 9] = [
    (
        "paper",
        "training distribution of the paper: small variations of scenarios 1 and 2",
        PAPER,
    ),
    (
        "high-risk",
        "wide ranges of speeds, gaps, leader braking, friction and follower's load; baseline drives the follower",
        HIGH_RISK,
    ),
    (
        "traffic",
        "everyday driving without hard braking; idm or acc-aeb drives the follower",
        TRAFFIC,
    ),
    (
        "everyday",
        "everyday driving with stops and starts; a follower of any kind, near, far or faster, or none",
        EVERYDAY,
    ),
    (
        "standing",
        "a standing vehicle ahead, 2 to 12 s away at 10 to 130 km/h",
        STANDING,
    ),
    (
        "slower",
        "a vehicle ahead at 0.1 to 0.9 times the speed, time to collision 2 to 12 s",
        SLOWER,
    ),
    (
        "alone",
        "no follower, and a leader that brakes to any fraction of its speed",
        ALONE,
    ),
    (
        "assisted",
        "the emergencies of high-risk, with a follower that idm or acc-aeb drives",
        ASSISTED,
    ),
    (
        "steady",
        "a leader that never brakes, 15 to 100 m ahead; baseline, idm or acc-aeb drives the follower",
        STEADY,
    ),
];

/// Description of the space `followers`.
pub(crate) const FOLLOWERS_SUMMARY: &str =
    "the emergencies of high-risk, with each of six kinds of follower, and none, in equal shares";

/// Name, one-line description and base of each variant of a built-in space with another follower. Variants are not in
/// [`BUILT_IN_SPACES`], so that no default includes them.
pub const VARIANT_SPACES: [(&str, &str, &str); 3] = [
    (FOLLOWERS, FOLLOWERS_SUMMARY, "high-risk"),
    (
        "high-risk-human",
        "the emergencies of high-risk, with a human as the follower",
        "high-risk",
    ),
    (
        "traffic-human",
        "the everyday driving of traffic, with a human as the follower",
        "traffic",
    ),
];

const PAPER: &str = include_str!("built_in/paper.toml");
const HIGH_RISK: &str = include_str!("built_in/high-risk.toml");
/// Name of the variant whose follower is drawn.
pub(crate) const FOLLOWERS: &str = "followers";
const EVERYDAY: &str = include_str!("built_in/everyday.toml");
const TRAFFIC: &str = include_str!("built_in/traffic.toml");
const STANDING: &str = include_str!("built_in/standing.toml");
const SLOWER: &str = include_str!("built_in/slower.toml");
const ALONE: &str = include_str!("built_in/alone.toml");
const ASSISTED: &str = include_str!("built_in/assisted.toml");
const STEADY: &str = include_str!("built_in/steady.toml");

/// An error of a space name.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FindSpaceError {
    /// Neither a built-in space nor a file.
    #[error(
        "`{name}` is neither a built-in space ({}) nor a file",
        built_in_space_names().collect::<Vec<_>>().join(", ")
    )]
    Name {
        /// The name.
        name: String,
    },
    /// An invalid file.
    #[error(transparent)]
    File(#[from] ScenarioFileError),
}

/// Returns the built-in space `name`, or loads the file `name`, which needs an extension.
///
/// # Errors
/// [`FindSpaceError`] if there is no such space.
pub fn find_space(name: &str, opener: &dyn OpenDriver) -> Result<ScenarioSpace, FindSpaceError> {
    match built_in_space(name) {
        Some(space) => Ok(space),
        None if Path::new(name).extension().is_none() => Err(FindSpaceError::Name {
            name: name.to_owned(),
        }),
        None => Ok(file::load(Path::new(name), opener)?),
    }
}

/// Returns the names of all built-in spaces and their variants.
pub fn built_in_space_names() -> impl Iterator<Item = &'static str> {
    BUILT_IN_SPACES
        .into_iter()
        .chain(VARIANT_SPACES)
        .map(|(name, ..)| name)
}

/// Returns the one-line description of a built-in space; `None` for any other space, also one with the same name.
#[must_use]
pub fn built_in_space_summary(space: &ScenarioSpace) -> Option<&'static str> {
    let (name, summary, _) = BUILT_IN_SPACES
        .iter()
        .chain(&VARIANT_SPACES)
        .find(|(name, ..)| *name == space.name())?;
    (built_in_space(name)?.spec() == space.spec()).then_some(*summary)
}

/// Returns the built-in space `name`.
#[must_use]
pub fn built_in_space(name: &str) -> Option<ScenarioSpace> {
    if let Some((_, _, text)) = BUILT_IN_SPACES.iter().find(|space| space.0 == name) {
        return file::from_toml(text, Path::new(name), &NoDriverFiles).ok();
    }
    let variant = VARIANT_SPACES.iter().find(|space| space.0 == name)?;
    ScenarioSpace::new(variant_spec(variant)?, Path::new(""), &NoDriverFiles).ok()
}

/// Returns the data of a variant: its base with another name and another follower.
fn variant_spec((name, summary, base): &(&str, &str, &str)) -> Option<SpaceSpec> {
    let mut spec = built_in_space(base)?.spec().clone();
    (spec.name, spec.about) = ((*name).to_owned(), (*summary).to_owned());
    let Base::Inline(scenario) = &mut spec.base else {
        return None;
    };
    (scenario.name, scenario.about) = (
        (*name).to_owned(),
        format!("A scenario of the space `{name}`."),
    );
    if *name == FOLLOWERS {
        spec.parameters.push(follower_parameter()?);
        return Some(spec);
    }
    let human = BuiltInController::Human(HumanSettings::default());
    scenario.vehicles.last_mut()?.driver = Driver::Controller(human);
    spec.parameters
        .retain(|parameter| parameter.name != "follower");
    Some(spec)
}

/// Returns the parameter that draws the kind of the follower: each kind with the same probability.
fn follower_parameter() -> Option<ParameterSpec> {
    let drivers = ["baseline", "human", "idm", "acc-aeb"].map(DriverName::find);
    let drivers = drivers.into_iter().collect::<Option<Vec<_>>>()?;
    let variants = FollowerVariant::ALL.map(ParameterValue::Follower);
    let values = drivers.into_iter().map(ParameterValue::Driver);
    Some(ParameterSpec {
        name: "follower".to_owned(),
        field: "vehicles[2].follower".to_owned(),
        unit: String::new(),
        distribution: DistributionSpec::Choice(ChoiceSpec {
            values: values.chain(variants).collect(),
            weights: None,
        }),
        nominal: None,
    })
}
