//! Conversion of braking episodes to features, to which a space can be fitted.

use std::path::PathBuf;

use super::FitError;
use super::exclusions::ExclusionCounts;
use super::sizes::VehicleSizes;
use crumple_exchange::recording::{
    BrakingEpisode, HardestBrakingResult, HardestSearch, LeaderSelection, MAX_PLAUSIBLE_ACCEL_MPS2,
    MinBrake, Recording, braking_clusters, find_episodes, following_exposure,
};
use crumple_spaces::{DrivingExposure, ObservedData, ObservedParameter, SourceExposure};

/// Selection of episodes from recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExtractionConfig {
    /// Number of vehicles of a scenario, including the leader: 2 to [`MAX_VEHICLES`].
    pub vehicles: usize,
    /// Minimum braking of an episode.
    pub min_brake: MinBrake,
    /// Leaders whose braking makes an episode.
    pub leaders: LeaderSelection,
}

/// Maximum number of vehicles of a fitted scenario; each adds two features.
pub const MAX_VEHICLES: usize = 5;
const MAX_EPISODES: usize = 10_000;
const MAX_RECORDINGS: usize = 1000;
/// Share of a fitted distribution within the range that searches may use; the rest is in the tails.
const SEARCH_SHARE: f64 = 0.9999;
/// Speed below which a recorded vehicle stands, in m/s.
const STANDSTILL_MPS: f64 = 0.1;
const EPISODES_PER_FEATURE: usize = 4;

/// A feature of an episode, and the scenario field that it sets.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeFeature {
    /// Name of the feature.
    pub name: String,
    /// Path of the field.
    pub field: String,
    /// Unit of the field.
    pub unit: &'static str,
    /// Smallest and largest value in a scenario.
    pub range: [f64; 2],
    /// Value with a point mass, if it occurs.
    pub point_mass: Option<f64>,
    /// The two possible values, if the feature is discrete.
    pub choices: Option<[f64; 2]>,
}

impl EpisodeFeature {
    pub(super) fn new(name: &str, field: &str, unit: &'static str, range: [f64; 2]) -> Self {
        Self {
            name: name.to_owned(),
            field: field.to_owned(),
            unit,
            range,
            point_mass: None,
            choices: None,
        }
    }

    fn is_in_range(&self, value: f64) -> bool {
        (self.range[0]..=self.range[1]).contains(&value)
    }

    fn with_values(&self, values: Vec<f64>) -> ObservedParameter {
        ObservedParameter {
            name: self.name.clone(),
            low: self.range[0],
            high: self.range[1],
            point_mass: self.point_mass.filter(|point| values.contains(point)),
            values,
        }
    }
}

/// Returns the features of an episode in the order of [`EpisodeSample`], which appends vehicle sizes.
#[must_use]
pub(crate) fn features(extraction: &ExtractionConfig) -> Vec<EpisodeFeature> {
    let leader = leader_features(extraction.min_brake);
    let followers = (1..extraction.vehicles).flat_map(follower_features);
    leader.into_iter().chain(followers).collect()
}

fn leader_features(min_brake: MinBrake) -> [EpisodeFeature; 3] {
    [
        EpisodeFeature::new(
            "lead_speed_mps",
            "vehicles[*].speed_mps",
            "m/s",
            [1.0, 50.0],
        ),
        EpisodeFeature::new(
            "lead_brake_mps2",
            "vehicles[0].driver.brake-to-speed.rate_mps2",
            "m/s²",
            [min_brake.mps2(), MAX_PLAUSIBLE_ACCEL_MPS2],
        ),
        EpisodeFeature {
            point_mass: Some(0.0),
            ..EpisodeFeature::new(
                "lead_final_share",
                "vehicles[0].driver.brake-to-speed.final_share",
                "1",
                [0.0, 0.98],
            )
        },
    ]
}

fn follower_features(follower: usize) -> [EpisodeFeature; 2] {
    [
        EpisodeFeature::new(
            &format!("speed_share_{follower}"),
            &format!("vehicles[{follower}].speed_share"),
            "1",
            [0.2, 2.0],
        ),
        EpisodeFeature::new(
            &format!("time_gap_{follower}_s"),
            &format!("vehicles[{follower}].time_gap_s"),
            "s",
            [0.1, 20.0],
        ),
    ]
}

/// Returns the features of an episode without its rear vehicles; `None` with fewer vehicles.
fn feature_values(episode: &BrakingEpisode, vehicles: usize) -> Option<Vec<f64>> {
    let line = episode.vehicles.get(..vehicles)?;
    let lead_mps = line.first()?.speed_mps;
    let lowest_mps = Some(lowest_mps(episode))
        .filter(|lowest_mps| *lowest_mps >= STANDSTILL_MPS)
        .unwrap_or(0.0);
    // The largest loss of speed in one second, so a deceleration.
    let mut all = vec![lead_mps, episode.largest_drop_mps, lowest_mps / lead_mps];
    for follower in line.iter().skip(1) {
        all.push(follower.speed_mps / lead_mps);
        all.push(follower.gap_ahead_m / follower.speed_mps);
    }
    Some(
        all.into_iter()
            .map(|value| (value * 1e6).round() / 1e6)
            .collect(),
    )
}

/// Returns the lowest speed of the braking leader, which may accelerate between two phases.
fn lowest_mps(episode: &BrakingEpisode) -> f64 {
    let braking = episode.onset_s..=episode.braking_end_s;
    let samples = episode
        .leader_motion
        .time_s
        .iter()
        .zip(&episode.leader_motion.speed_mps)
        .filter(|(time_s, _)| braking.contains(*time_s));
    samples
        .map(|(_, speed_mps)| *speed_mps)
        .fold(episode.end_speed_mps, f64::min)
}

#[must_use]
pub(crate) fn min_episodes(features: usize) -> usize {
    EPISODES_PER_FEATURE * features
}

/// Features of episodes, with the exposure of the recordings.
#[derive(Debug, Clone, PartialEq)]
pub struct EpisodeSample {
    /// Selection of the episodes.
    pub extraction: ExtractionConfig,
    /// Features of each episode.
    pub features: Vec<EpisodeFeature>,
    /// Values of the features.
    pub observed: ObservedData,
    /// Exposure of the recordings.
    pub exposure: DrivingExposure,
    /// Sizes of the vehicles, front to rear.
    pub sizes: Vec<VehicleSizes>,
    /// Brakings without a place among the episodes.
    pub exclusions: ExclusionCounts,
    /// Feature that was most often the first outside its range.
    pub most_out_of_range: Option<String>,
}

impl EpisodeSample {
    /// Extracts the episodes of recordings.
    ///
    /// # Errors
    /// [`FitError::TooFew`] or [`FitError::TooMany`] for the number of episodes; [`FitError::Vehicles`];
    /// [`FitError::MinBrake`].
    pub fn from_recordings(
        recordings: &[Recording],
        extraction: ExtractionConfig,
    ) -> Result<Self, FitError> {
        let mut collector = EpisodeCollector::new(extraction)?;
        recordings
            .iter()
            .try_for_each(|recording| collector.add(recording))?;
        collector.finish()
    }

    /// Returns the values of a feature; none if there is no such feature.
    pub(super) fn observed_values(&self, feature: usize) -> &[f64] {
        self.observed
            .parameters
            .get(feature)
            .map_or(&[], |parameter| parameter.values.as_slice())
    }
}

/// Episodes of recordings, or of their parts.
#[derive(Debug)]
pub struct EpisodeCollector {
    extraction: ExtractionConfig,
    features: Vec<EpisodeFeature>,
    clusters: Vec<u32>,
    columns: Vec<Vec<f64>>,
    /// Recorded lengths of each vehicle, front to rear.
    lengths: Vec<Vec<Option<f64>>>,
    sources: Vec<SourceExposure>,
    /// Hardest braking of each source.
    hardest: Vec<HardestSearch>,
    last_path: Option<PathBuf>,
    exclusions: ExclusionCounts,
    out_of_range: Vec<usize>,
}

impl EpisodeCollector {
    /// Creates a collector without episodes.
    ///
    /// # Errors
    /// [`FitError::Vehicles`] and [`FitError::MinBrake`].
    pub fn new(extraction: ExtractionConfig) -> Result<Self, FitError> {
        let vehicles = extraction.vehicles;
        let min_brake_mps2 = extraction.min_brake.mps2();
        if !(2..=MAX_VEHICLES).contains(&vehicles) {
            return Err(FitError::Vehicles { found: vehicles });
        }
        if min_brake_mps2 >= MAX_PLAUSIBLE_ACCEL_MPS2 {
            return Err(FitError::MinBrake {
                found: min_brake_mps2,
                limit: MAX_PLAUSIBLE_ACCEL_MPS2,
            });
        }
        let features = features(&extraction);
        Ok(Self {
            extraction,
            clusters: Vec::new(),
            columns: vec![Vec::new(); features.len()],
            lengths: vec![Vec::new(); vehicles],
            sources: Vec::new(),
            hardest: Vec::new(),
            last_path: None,
            exclusions: ExclusionCounts::default(),
            out_of_range: vec![0; features.len()],
            features,
        })
    }

    /// Returns the sample.
    ///
    /// # Errors
    /// [`FitError::TooFew`] or [`FitError::TooMany`] for the number of episodes.
    pub fn finish(mut self) -> Result<EpisodeSample, FitError> {
        let most_out_of_range = self.most_out_of_range();
        let sizes = self.append_sizes();
        let episodes = self.clusters.len();
        let needed = min_episodes(self.features.len());
        if episodes < needed {
            return Err(self.too_few_episodes_error(needed, most_out_of_range));
        }
        check_episode_count(episodes)?;
        let sources = &self.sources;
        let exposure = DrivingExposure {
            episodes: episodes as u64,
            hours: sources.iter().map(|source| source.hours).sum(),
            kilometres: sources.iter().map(|source| source.kilometres).sum(),
            undescribed_brakings: self.exclusions.count_in_exposure() as u64,
            sources: self.sources,
        };
        let columns = self.features.iter().zip(self.columns);
        let observed = ObservedData {
            braking_clusters: renumber_clusters(&self.clusters),
            search_share: Some(SEARCH_SHARE),
            parameters: columns
                .map(|(feature, values)| feature.with_values(values))
                .collect(),
        };
        Ok(EpisodeSample {
            extraction: self.extraction,
            features: self.features,
            observed,
            exposure,
            sizes,
            exclusions: self.exclusions,
            most_out_of_range,
        })
    }

    /// Returns the feature that was most often the first outside its range.
    fn most_out_of_range(&self) -> Option<String> {
        self.features
            .iter()
            .zip(&self.out_of_range)
            .max_by_key(|(_, count)| **count)
            .filter(|(_, count)| **count > 0)
            .map(|(feature, _)| feature.name.clone())
    }

    /// Appends the features of the vehicles' sizes, and returns the sizes.
    fn append_sizes(&mut self) -> Vec<VehicleSizes> {
        let mut all_sizes = Vec::new();
        for (index, lengths) in self.lengths.iter().enumerate() {
            let sizes = VehicleSizes::new(lengths);
            if let Some(feature) = sizes.feature(index) {
                self.features.push(feature);
                self.columns.push(sizes.scenario_lengths_m(lengths));
            }
            all_sizes.push(sizes);
        }
        all_sizes
    }

    fn too_few_episodes_error(self, needed: usize, most_out_of_range: Option<String>) -> FitError {
        let ExclusionCounts {
            no_follower,
            impossible_speeds,
            too_few_vehicles,
            out_of_range,
        } = self.exclusions;
        let mut details = most_out_of_range
            .map(|name| format!(", most of them {name}"))
            .unwrap_or_default();
        if impossible_speeds + no_follower > 0 {
            details += &format!(
                ", {no_follower} have no known follower, {impossible_speeds} have impossible speeds"
            );
        }
        // A recording in which no braking is detectable looks like one without braking.
        let mut hardest = self
            .sources
            .iter()
            .zip(self.hardest.into_iter().map(HardestSearch::finish));
        if let Some((source, why)) =
            hardest.find(|(_, result)| !matches!(result, HardestBrakingResult::Braking(_)))
        {
            details += &format!("; {}: {why}", source.name);
        }
        FitError::TooFew {
            found: self.clusters.len(),
            needed,
            vehicles: self.extraction.vehicles,
            too_few_vehicles,
            out_of_range,
            details,
        }
    }

    /// Adds a recording, or its next part.
    ///
    /// # Errors
    /// [`FitError::TooMany`].
    pub fn add(&mut self, recording: &Recording) -> Result<(), FitError> {
        let ExtractionConfig {
            vehicles,
            min_brake,
            leaders,
        } = self.extraction;
        let extracted = find_episodes(recording, min_brake, leaders);
        check_episode_count(extracted.episodes.len())?;
        let episodes_before = self.clusters.len();
        let undescribed_before = self.exclusions.count_in_exposure();
        let first_cluster = self.clusters.iter().max().map_or(0, |last| last + 1);
        for dropped in &extracted.dropped {
            self.exclusions.add(dropped);
        }
        let clusters = braking_clusters(&extracted.episodes);
        for (episode, cluster) in extracted.episodes.iter().zip(clusters) {
            self.add_episode(episode, first_cluster + cluster);
        }
        let exposure = following_exposure(recording, leaders, vehicles - 1);
        self.add_exposure(
            recording,
            SourceExposure {
                name: source_name(recording),
                episodes: (self.clusters.len() - episodes_before) as u64,
                hours: exposure.hours,
                kilometres: exposure.kilometres,
                undescribed_brakings: (self.exclusions.count_in_exposure() - undescribed_before)
                    as u64,
            },
        )?;
        if let Some(search) = self.hardest.last_mut() {
            search.add(recording);
        }
        Ok(())
    }

    /// Adds an episode, or counts the reason why it is excluded.
    fn add_episode(&mut self, episode: &BrakingEpisode, cluster: u32) {
        let Some(values) = feature_values(episode, self.extraction.vehicles) else {
            self.exclusions.too_few_vehicles += 1;
            return;
        };
        let mut features = self.features.iter().zip(&values);
        if let Some(index) = features.position(|(feature, value)| !feature.is_in_range(*value)) {
            self.exclusions.out_of_range += 1;
            self.out_of_range[index] += 1;
            return;
        }
        self.clusters.push(cluster);
        for (column, value) in self.columns.iter_mut().zip(values) {
            column.push(value);
        }
        for (lengths, vehicle) in self.lengths.iter_mut().zip(&episode.vehicles) {
            lengths.push(vehicle.length_m);
        }
    }

    /// Adds the exposure of a recording, or of the next part of the last one.
    fn add_exposure(
        &mut self,
        recording: &Recording,
        exposure: SourceExposure,
    ) -> Result<(), FitError> {
        if self.last_path.as_ref() == Some(&recording.path)
            && let Some(source) = self.sources.last_mut()
        {
            source.episodes += exposure.episodes;
            source.hours += exposure.hours;
            source.kilometres += exposure.kilometres;
            source.undescribed_brakings += exposure.undescribed_brakings;
            return Ok(());
        }
        if self.sources.len() >= MAX_RECORDINGS {
            return Err(FitError::TooMany {
                found: self.sources.len() + 1,
                max: MAX_RECORDINGS,
                what: "recordings",
            });
        }
        self.last_path = Some(recording.path.clone());
        self.sources.push(exposure);
        self.hardest.push(HardestSearch::default());
        Ok(())
    }
}

fn check_episode_count(episodes: usize) -> Result<(), FitError> {
    if episodes > MAX_EPISODES {
        return Err(FitError::TooMany {
            found: episodes,
            max: MAX_EPISODES,
            what: "episodes",
        });
    }
    Ok(())
}

/// Numbers the clusters without gaps, in their order.
fn renumber_clusters(clusters: &[u32]) -> Vec<u32> {
    let mut sorted: Vec<u32> = clusters.to_vec();
    sorted.sort_unstable();
    sorted.dedup();
    clusters
        .iter()
        .map(|cluster| sorted.partition_point(|smaller| smaller < cluster) as u32)
        .collect()
}

fn source_name(recording: &Recording) -> String {
    let name = recording
        .path
        .file_name()
        .map(|name| name.to_string_lossy())
        .unwrap_or_default();
    let plain: String = name
        .chars()
        .map(|letter| if letter.is_control() { '?' } else { letter })
        .take(200)
        .collect();
    if plain.is_empty() {
        recording.format.clone()
    } else {
        plain
    }
}
