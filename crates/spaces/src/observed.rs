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
    /// Number of the cluster of each braking episode, from 0. Episodes of one cluster are dependent and are resampled
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
        if self.episodes == 0 {
            return reject("exposure.episodes", "must be at least 1, found 0");
        }
        check_positive("exposure.hours", self.hours, self.hours > 0.0)?;
        check_positive(
            "exposure.kilometres",
            self.kilometres,
            self.kilometres > 0.0,
        )?;
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
            source.check(&format!("exposure.sources[{index}]"))?;
        }
        if self.sources.is_empty() {
            return Ok(());
        }
        self.check_sum("exposure.episodes", self.episodes as f64, |source| {
            source.episodes as f64
        })?;
        self.check_sum("exposure.hours", self.hours, |source| source.hours)?;
        self.check_sum("exposure.kilometres", self.kilometres, |source| {
            source.kilometres
        })?;
        let undescribed = self.undescribed_brakings as f64;
        self.check_sum("exposure.undescribed_brakings", undescribed, |source| {
            source.undescribed_brakings as f64
        })
    }

    /// Checks that a number is the sum of that of the sources.
    fn check_sum(
        &self,
        field: &str,
        all: f64,
        of_source: fn(&SourceExposure) -> f64,
    ) -> Result<(), InvalidSpace> {
        let sum = self.sources.iter().map(of_source).sum::<f64>();
        if (all - sum).abs() > 1e-6 * all {
            return reject(
                field,
                format!(
                    "is {}, and the sources add up to {}",
                    format_compact(all),
                    format_compact(sum)
                ),
            );
        }
        Ok(())
    }
}

impl SourceExposure {
    fn check(&self, path: &str) -> Result<(), InvalidSpace> {
        let length = self.name.chars().count();
        if !(1..=200).contains(&length) || self.name.chars().any(char::is_control) {
            return reject(
                format!("{path}.name"),
                "must have 1 to 200 characters, none of them a control character",
            );
        }
        check_positive(&format!("{path}.hours"), self.hours, self.hours >= 0.0)?;
        check_positive(
            &format!("{path}.kilometres"),
            self.kilometres,
            self.kilometres >= 0.0,
        )
    }
}

fn check_positive(field: &str, value: f64, is_positive: bool) -> Result<(), InvalidSpace> {
    if value.is_finite() && is_positive {
        return Ok(());
    }
    reject(
        field,
        format!(
            "must be a finite number above 0, found {}",
            format_compact(value)
        ),
    )
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
        if let Some(share) = self
            .search_share
            .filter(|share| !(0.5..1.0).contains(share))
        {
            return reject(
                "observed.search_share",
                format!("must be from 0.5, below 1, found {}", format_compact(share)),
            );
        }
        if let Some(exposure) = &space.exposure
            && exposure.episodes != episodes as u64
        {
            let stated = exposure.episodes;
            return reject(
                "exposure.episodes",
                format!("is {stated}, and {episodes} are observed"),
            );
        }
        self.check_parameters(space)
    }

    /// Checks that the observed parameters are different ones of the space, with one value for each episode.
    fn check_parameters(&self, space: &SpaceSpec) -> Result<(), InvalidSpace> {
        if self.parameters.is_empty() {
            return reject("observed.parameters", "must have at least one");
        }
        for (index, parameter) in self.parameters.iter().enumerate() {
            let name = &parameter.name;
            let path = format!("observed.parameters[{index}]");
            if !space.parameters.iter().any(|spec| spec.name == *name) {
                return reject(
                    format!("{path}.name"),
                    format!("there is no parameter `{name}`"),
                );
            }
            let mut earlier = self.parameters.iter().take(index);
            if earlier.any(|earlier| earlier.name == *name) {
                return reject(format!("{path}.name"), format!("`{name}` is named twice"));
            }
            parameter.check_values(&path, self.braking_clusters.len())?;
        }
        Ok(())
    }
}

impl ObservedParameter {
    /// Checks the range and the values of the parameter at `path`.
    fn check_values(&self, path: &str, episodes: usize) -> Result<(), InvalidSpace> {
        let Self {
            low, high, values, ..
        } = self;
        let [low_text, high_text] = [*low, *high].map(format_compact);
        if !(low.is_finite() && high.is_finite() && low < high) {
            return reject(
                format!("{path}.low"),
                format!("must be a number below high, found {low_text} and {high_text}"),
            );
        }
        if let Some(point) = self
            .point_mass
            .filter(|point| point != low && point != high)
        {
            let point = format_compact(point);
            return reject(
                format!("{path}.point_mass"),
                format!("must be {low_text} or {high_text}, found {point}"),
            );
        }
        if values.len() != episodes {
            return reject(
                format!("{path}.values"),
                format!("must be {episodes}, one an episode, found {}", values.len()),
            );
        }
        if let Some(value) = values.iter().find(|value| !(low..=high).contains(value)) {
            let value = format_compact(*value);
            return reject(
                format!("{path}.values"),
                format!("must be from {low_text} to {high_text}, found {value}"),
            );
        }
        Ok(())
    }
}
