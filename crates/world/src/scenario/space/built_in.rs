//! The built-in spaces.

use std::path::Path;

use super::{Space, file};

/// Name, one-line description and text of every built-in space.
pub const BUILT_IN_SPACES: [(&str, &str, &str); 3] = [
    ("paper", "the distribution the paper trains on: small spreads about scenarios 1 and 2", PAPER),
    ("high-risk", "speeds, gaps, lead braking, load, grip, reaction and sensors all over their ranges", HIGH_RISK),
    ("traffic", "everyday driving in which nobody need brake hard: what a controller is of use for", TRAFFIC),
];

const PAPER: &str = include_str!("built_in/paper.toml");
const HIGH_RISK: &str = include_str!("built_in/high-risk.toml");
const TRAFFIC: &str = include_str!("built_in/traffic.toml");

/// The built-in space of that name.
#[must_use]
pub fn built_in_space(name: &str) -> Option<Space> {
    let (_, _, text) = BUILT_IN_SPACES.iter().find(|(known, ..)| *known == name)?;
    file::from_toml(text, Path::new(name)).ok()
}
