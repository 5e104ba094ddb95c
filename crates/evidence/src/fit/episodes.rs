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
}

/// Returns the features of an episode in the order of [`EpisodeSample`], which appends vehicle sizes.
#[must_use]
pub(crate) fn features(taken: &ExtractionConfig) -> Vec<EpisodeFeature> {
    let number = EpisodeFeature::new;
    let mut all = vec![
        number(
            "lead_speed_mps",
            "vehicles[*].speed_mps",
            "m/s",
            [1.0, 50.0],
        ),
        number(
            "lead_brake_mps2",
            "vehicles[0].driver.brake-to-speed.rate_mps2",
            "m/s²",
            [taken.min_brake.mps2(), MAX_PLAUSIBLE_ACCEL_MPS2],
        ),
        EpisodeFeature {
            point_mass: Some(0.0),
            ..number(
                "lead_final_share",
                "vehicles[0].driver.brake-to-speed.final_share",
                "1",
                [0.0, 0.98],
            )
        },
    ];
    for follower in 1..taken.vehicles {
        let of = |field: &str| format!("vehicles[{follower}].{field}");
        all.push(number(
            &format!("speed_share_{follower}"),
            &of("speed_share"),
            "1",
            [0.2, 2.0],
        ));
        all.push(number(
            &format!("time_gap_{follower}_s"),
            &of("time_gap_s"),
            "s",
            [0.1, 20.0],
        ));
    }
    all
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
        .time_s
        .iter()
        .zip(&episode.speed_mps)
        .filter(|(time_s, _)| braking.contains(*time_s));
    samples
        .map(|(_, speed_mps)| *speed_mps)
        .fold(episode.end_speed_mps, f64::min)
}

#[must_use]
pub(crate) fn min_episodes(numbers: usize) -> usize {
    EPISODES_PER_FEATURE * numbers
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
        taken: ExtractionConfig,
    ) -> Result<Self, FitError> {
        let mut collector = EpisodeCollector::new(taken)?;
        recordings
            .iter()
            .try_for_each(|recording| collector.add(recording))?;
        collector.finish()
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
    pub fn new(taken: ExtractionConfig) -> Result<Self, FitError> {
        let (vehicles, found) = (taken.vehicles, taken.min_brake.mps2());
        if !(2..=MAX_VEHICLES).contains(&vehicles) {
            return Err(FitError::Vehicles { found: vehicles });
        }
        if found >= MAX_PLAUSIBLE_ACCEL_MPS2 {
            return Err(FitError::MinBrake {
                found,
                limit: MAX_PLAUSIBLE_ACCEL_MPS2,
            });
        }
        let numbers = features(&taken);
        Ok(Self {
            extraction: taken,
            clusters: Vec::new(),
            columns: vec![Vec::new(); numbers.len()],
            lengths: vec![Vec::new(); taken.vehicles],
            sources: Vec::new(),
            hardest: Vec::new(),
            last_path: None,
            exclusions: ExclusionCounts::default(),
            out_of_range: vec![0; numbers.len()],
            features: numbers,
        })
    }

    /// Returns the sample.
    ///
    /// # Errors
    /// [`FitError::TooFew`] or [`FitError::TooMany`] for the number of episodes.
    pub fn finish(self) -> Result<EpisodeSample, FitError> {
        let EpisodeCollector {
            mut features,
            clusters,
            mut columns,
            lengths,
            sources,
            hardest,
            exclusions,
            out_of_range,
            ..
        } = self;
        let taken = self.extraction;
        let most_out_of_range = features
            .iter()
            .zip(&out_of_range)
            .max_by_key(|(_, count)| **count)
            .filter(|(_, count)| **count > 0);
        let most_out_of_range = most_out_of_range.map(|(feature, _)| feature.name.clone());
        let sizes: Vec<VehicleSizes> = lengths
            .iter()
            .map(|lengths| VehicleSizes::new(lengths))
            .collect();
        for (index, (sizes, lengths)) in sizes.iter().zip(&lengths).enumerate() {
            if let Some(feature) = sizes.feature(index) {
                features.push(feature);
                columns.push(sizes.scenario_lengths_m(lengths));
            }
        }
        let (found, needed) = (clusters.len(), min_episodes(features.len()));
        if found < needed {
            let mut most = most_out_of_range
                .map(|name| format!(", most of them {name}"))
                .unwrap_or_default();
            if exclusions.impossible_speeds + exclusions.no_follower > 0 {
                let ExclusionCounts {
                    no_follower,
                    impossible_speeds,
                    ..
                } = exclusions;
                most += &format!(
                    ", {no_follower} have no known follower, {impossible_speeds} have impossible speeds"
                );
            }
            // A recording in which no braking is detectable looks like one without braking.
            let mut evaluated = sources
                .iter()
                .zip(hardest.into_iter().map(HardestSearch::finish));
            if let Some((source, why)) =
                evaluated.find(|(_, hardest)| !matches!(hardest, HardestBrakingResult::Braking(_)))
            {
                most += &format!("; {}: {why}", source.name);
            }
            return Err(FitError::TooFew {
                found,
                needed,
                vehicles: taken.vehicles,
                too_few_vehicles: exclusions.too_few_vehicles,
                out_of_range: exclusions.out_of_range,
                details: most,
            });
        }
        if found > MAX_EPISODES {
            return Err(FitError::TooMany {
                found,
                max: MAX_EPISODES,
                what: "episodes",
            });
        }
        let parameter = |(feature, values): (&EpisodeFeature, Vec<f64>)| ObservedParameter {
            name: feature.name.clone(),
            low: feature.range[0],
            high: feature.range[1],
            point_mass: feature.point_mass.filter(|point| values.contains(point)),
            values,
        };
        let exposure = DrivingExposure {
            episodes: found as u64,
            hours: sources.iter().map(|source| source.hours).sum(),
            kilometres: sources.iter().map(|source| source.kilometres).sum(),
            undescribed_brakings: exclusions.count_in_exposure() as u64,
            sources,
        };
        let observed = ObservedData {
            braking_clusters: renumber_clusters(&clusters),
            search_share: Some(SEARCH_SHARE),
            parameters: features.iter().zip(columns).map(parameter).collect(),
        };
        Ok(EpisodeSample {
            extraction: taken,
            features,
            observed,
            exposure,
            sizes,
            exclusions,
            most_out_of_range,
        })
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
        let found = find_episodes(recording, min_brake, leaders);
        if found.episodes.len() > MAX_EPISODES {
            return Err(FitError::TooMany {
                found: found.episodes.len(),
                max: MAX_EPISODES,
                what: "episodes",
            });
        }
        let (before, left_out) = (self.clusters.len(), self.exclusions.count_in_exposure());
        let first_wave = self.clusters.iter().max().map_or(0, |last| last + 1);
        found
            .dropped
            .iter()
            .for_each(|dropped| self.exclusions.add(dropped));
        for (episode, cluster) in found.episodes.iter().zip(braking_clusters(&found.episodes)) {
            let Some(values) = feature_values(episode, vehicles) else {
                self.exclusions.too_few_vehicles += 1;
                continue;
            };
            let is_outside = |(number, value): (&EpisodeFeature, &f64)| {
                !(number.range[0]..=number.range[1]).contains(value)
            };
            if let Some(which) = self.features.iter().zip(&values).position(is_outside) {
                self.exclusions.out_of_range += 1;
                self.out_of_range[which] += 1;
                continue;
            }
            self.clusters.push(first_wave + cluster);
            self.columns
                .iter_mut()
                .zip(values)
                .for_each(|(column, value)| column.push(value));
            let lengths = episode.vehicles.iter().map(|placed| placed.length_m);
            self.lengths
                .iter_mut()
                .zip(lengths)
                .for_each(|(known, length_m)| known.push(length_m));
        }
        let driven = following_exposure(recording, leaders, vehicles - 1);
        let new = SourceExposure {
            name: source_name(recording),
            episodes: (self.clusters.len() - before) as u64,
            hours: driven.hours,
            kilometres: driven.kilometres,
            undescribed_brakings: (self.exclusions.count_in_exposure() - left_out) as u64,
        };
        let (is_same, count) = (
            self.last_path.as_ref() == Some(&recording.path),
            self.sources.len(),
        );
        match self.sources.last_mut().filter(|_| is_same) {
            Some(source) => {
                source.episodes += new.episodes;
                source.hours += new.hours;
                source.kilometres += new.kilometres;
                source.undescribed_brakings += new.undescribed_brakings;
            }
            None if count >= MAX_RECORDINGS => {
                return Err(FitError::TooMany {
                    found: count + 1,
                    max: MAX_RECORDINGS,
                    what: "recordings",
                });
            }
            None => {
                self.last_path = Some(recording.path.clone());
                self.sources.push(new);
                self.hardest.push(HardestSearch::default());
            }
        }
        self.hardest
            .iter_mut()
            .last()
            .into_iter()
            .for_each(|search| search.add(recording));
        Ok(())
    }
}

fn renumber_clusters(waves: &[u32]) -> Vec<u32> {
    let mut known: Vec<u32> = waves.to_vec();
    known.sort_unstable();
    known.dedup();
    waves
        .iter()
        .map(|cluster| known.partition_point(|other| other < cluster) as u32)
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
