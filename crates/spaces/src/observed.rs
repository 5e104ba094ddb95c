//! Data of a fitted space: driving exposure and the values of each episode.

use serde::{Deserialize, Serialize};

use super::invalid::{InvalidSpace, reject};
use super::spec::SpaceSpec;
use crumple_core::digits::format_compact;
use crumple_core::text_file::is_default;

const MAX_SOURCES: usize = 1000;
const MAX_EPISODES: usize = 10_000;

/// Driving in which the scenarios of a space were observed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct DrivingExposure {
    /// Number of observed scenarios; at least 1.
    #[cfg_attr(feature = "schema", schemars(range(min = 1)))]
    pub episodes: u64,
    /// Hours of following, one vehicle behind another; above 0.
    pub hours: f64,
    /// Kilometres of the followers in these hours; above 0.
    pub kilometres: f64,
    /// Number of brakings in this driving that the space does not describe. Failures per hour count them with the
    /// failure rate of the episodes. Default 0.
    #[serde(default, skip_serializing_if = "is_default", alias = "left_out")]
    pub undescribed_brakings: u64,
    /// Exposure of each source, up to 1000; empty if unknown. The sums equal the numbers above.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub sources: Vec<SourceExposure>,
}

/// Exposure of one source.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct SourceExposure {
    /// Name, such as a file's; 1 to 200 characters.
    pub name: String,
    /// Number of observed scenarios.
    pub episodes: u64,
    /// Hours of following.
    pub hours: f64,
    /// Kilometres of following.
    pub kilometres: f64,
    /// Number of brakings that the space does not describe.
    #[serde(default, skip_serializing_if = "is_default", alias = "left_out")]
    pub undescribed_brakings: u64,
}

/// Values to which a distribution was fitted, for refits to resampled episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ObservedData {
    /// Number of the braking wave of each episode, from 0. Episodes of one wave are dependent and are resampled
    /// together.
    #[serde(alias = "waves")]
    pub braking_clusters: Vec<u32>,
    /// Share of the distribution in the likelihood region in which searches stay: from 0.5, below 1. Default: searches
    /// use the whole ranges.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 0.5)))]
    pub search_share: Option<f64>,
    /// All parameters, or some.
    pub parameters: Vec<ObservedParameter>,
}

/// Values of a parameter in the episodes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ObservedParameter {
    /// Name of the parameter.
    pub name: String,
    /// Smallest value of a scenario; fitted distributions are truncated there.
    pub low: f64,
    /// Largest value of a scenario.
    pub high: f64,
    /// Either `low` or `high`, if it has positive probability beside a density of the others, such as standstill.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<f64>,
    /// One value for each episode, within `low` and `high`.
    pub values: Vec<f64>,
}

impl DrivingExposure {
    pub(super) fn check(&self) -> Result<(), InvalidSpace> {
        let above = |field: &str, found: f64, least: bool| match found.is_finite()
            && (found > 0.0 || least && found == 0.0)
        {
            true => Ok(()),
            false => reject(
                field,
                format!(
                    "must be a finite number above 0, found {}",
                    format_compact(found)
                ),
            ),
        };
        if self.episodes == 0 {
            return reject("exposure.episodes", "must be at least 1, found 0");
        }
        above("exposure.hours", self.hours, false)?;
        above("exposure.kilometres", self.kilometres, false)?;
        if self.sources.len() > MAX_SOURCES {
            return reject(
                "exposure.sources",
                format!(
                    "must be at most {MAX_SOURCES}, found {}",
                    self.sources.len()
                ),
            );
        }
        for (index, source) in self.sources.iter().enumerate() {
            let at = |field: &str| format!("exposure.sources[{index}].{field}");
            let length = source.name.chars().count();
            if !(1..=200).contains(&length) || source.name.chars().any(char::is_control) {
                return reject(
                    at("name"),
                    "must have 1 to 200 characters, none of them a control character",
                );
            }
            above(&at("hours"), source.hours, true)?;
            above(&at("kilometres"), source.kilometres, true)?;
        }
        if self.sources.is_empty() {
            return Ok(());
        }
        let sum = |of: fn(&SourceExposure) -> f64| self.sources.iter().map(of).sum::<f64>();
        for (field, all, found) in [
            (
                "exposure.episodes",
                self.episodes as f64,
                sum(|source| source.episodes as f64),
            ),
            ("exposure.hours", self.hours, sum(|source| source.hours)),
            (
                "exposure.kilometres",
                self.kilometres,
                sum(|source| source.kilometres),
            ),
            (
                "exposure.undescribed_brakings",
                self.undescribed_brakings as f64,
                sum(|source| source.undescribed_brakings as f64),
            ),
        ] {
            if (all - found).abs() > 1e-6 * all {
                return reject(
                    field,
                    format!(
                        "is {}, and the sources add up to {}",
                        format_compact(all),
                        format_compact(found)
                    ),
                );
            }
        }
        Ok(())
    }
}

impl ObservedData {
    pub(super) fn check(&self, space: &SpaceSpec) -> Result<(), InvalidSpace> {
        let episodes = self.braking_clusters.len();
        if !(2..=MAX_EPISODES).contains(&episodes) {
            return reject(
                "observed.braking_clusters",
                format!("must be of 2 to {MAX_EPISODES} episodes, found {episodes}"),
            );
        }
        if let Some(cluster) = self
            .braking_clusters
            .iter()
            .find(|cluster| **cluster as usize >= episodes)
        {
            return reject(
                "observed.braking_clusters",
                format!("must be below the number of episodes, {episodes}, found {cluster}"),
            );
        }
        if let Some(found) = self
            .search_share
            .filter(|share| !(0.5..1.0).contains(share))
        {
            return reject(
                "observed.search_share",
                format!("must be from 0.5, below 1, found {}", format_compact(found)),
            );
        }
        if let Some(exposure) = &space.exposure
            && exposure.episodes != episodes as u64
        {
            let found = exposure.episodes;
            return reject(
                "exposure.episodes",
                format!("is {found}, and {episodes} are observed"),
            );
        }
        if self.parameters.is_empty() {
            return reject("observed.parameters", "must have at least one");
        }
        for (index, parameter) in self.parameters.iter().enumerate() {
            let at = |field: &str| format!("observed.parameters[{index}].{field}");
            let ObservedParameter {
                name,
                low,
                high,
                point_mass,
                values,
            } = parameter;
            if !space.parameters.iter().any(|known| known.name == *name) {
                return reject(at("name"), format!("there is no parameter `{name}`"));
            }
            if self
                .parameters
                .iter()
                .take(index)
                .any(|known| known.name == *name)
            {
                return reject(at("name"), format!("`{name}` is named twice"));
            }
            if !(low.is_finite() && high.is_finite() && low < high) {
                let problem = format!(
                    "must be a number below high, found {} and {}",
                    format_compact(*low),
                    format_compact(*high)
                );
                return reject(at("low"), problem);
            }
            if let Some(found) = point_mass.filter(|point| point != low && point != high) {
                let (low, high, found) = (
                    format_compact(*low),
                    format_compact(*high),
                    format_compact(found),
                );
                return reject(
                    at("point_mass"),
                    format!("must be {low} or {high}, found {found}"),
                );
            }
            if values.len() != episodes {
                return reject(
                    at("values"),
                    format!("must be {episodes}, one an episode, found {}", values.len()),
                );
            }
            if let Some(found) = values.iter().find(|value| !(low..=high).contains(value)) {
                let (low, high, found) = (
                    format_compact(*low),
                    format_compact(*high),
                    format_compact(*found),
                );
                return reject(
                    at("values"),
                    format!("must be from {low} to {high}, found {found}"),
                );
            }
        }
        Ok(())
    }
}
