//! Built-in spaces.

use std::path::Path;

use super::{ScenarioSpace, file};
use crate::scenario::file::FileError;

/// Name, one-line description and text of every built-in space.
pub const BUILT_IN_SPACES: [(&str, &str, &str); 8] = [
    ("paper", "the distribution the paper trains on: small spreads about scenarios 1 and 2", PAPER),
    ("high-risk", "speeds, gaps, lead braking, load, grip, reaction and sensors all over their ranges", HIGH_RISK),
    ("traffic", "everyday driving in which nobody need brake hard: what a controller is of use for", TRAFFIC),
    ("standing", "a standing vehicle ahead, 2 to 12 s away at 10 to 130 km/h", STANDING),
    ("slower", "a vehicle ahead at a tenth to nine tenths of the speed, 2 to 12 s away", SLOWER),
    ("alone", "nobody behind, and a leader that brakes down to any share of its speed", ALONE),
    ("assisted", "the emergencies of high-risk, with a follower that drives idm or acc-aeb", ASSISTED),
    ("steady", "a leader that never brakes, 15 to 100 m ahead, and any follower", STEADY),
];

const PAPER: &str = include_str!("built_in/paper.toml");
const HIGH_RISK: &str = include_str!("built_in/high-risk.toml");
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
    #[error("`{name}` is neither a built-in space ({}) nor a file", BUILT_IN_SPACES.map(|(known, ..)| known).join(", "))]
    Name {
        /// The name.
        name: String,
    },
    /// An invalid file.
    #[error(transparent)]
    File(#[from] FileError),
}

/// Returns the built-in space `name`, or loads the file `name`, which needs an extension.
///
/// # Errors
/// [`FindSpaceError`] if there is no such space.
pub fn find_space(name: &str) -> Result<ScenarioSpace, FindSpaceError> {
    match built_in_space(name) {
        Some(space) => Ok(space),
        None if Path::new(name).extension().is_none() => Err(FindSpaceError::Name { name: name.to_owned() }),
        None => Ok(file::load(Path::new(name))?),
    }
}

/// Returns the built-in space `name`.
#[must_use]
pub fn built_in_space(name: &str) -> Option<ScenarioSpace> {
    let (_, _, text) = BUILT_IN_SPACES.iter().find(|(known, ..)| *known == name)?;
    file::from_toml(text, Path::new(name)).ok()
}
