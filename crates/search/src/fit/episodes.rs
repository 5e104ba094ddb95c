//! From braking episodes to numbers, from which a space can draw them again.

use crumple_world::recording::{Episode, Leaders, MinBrake, Recording, episodes, followed, waves};
use crumple_world::scenario::space::{Exposure, Observed, ObservedParameter, SourceExposure};

use super::FitError;

/// What is taken of recordings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Taken {
    /// Vehicles of a scenario, the leader among them: 2 to [`MOST_VEHICLES`].
    pub vehicles: usize,
    /// The least braking that makes an episode.
    pub min_brake: MinBrake,
    /// Whose braking makes one.
    pub leaders: Leaders,
}

/// The most vehicles of a scenario that is fitted: two numbers more each.
pub const MOST_VEHICLES: usize = 5;
/// The most episodes, and the most recordings.
const MOST_EPISODES: usize = 10_000;
const MOST_RECORDINGS: usize = 1000;

/// A number of an episode, and the field of a scenario that it sets.
#[derive(Debug, Clone, PartialEq)]
pub struct Number {
    /// Its name.
    pub name: String,
    /// The field.
    pub field: String,
    /// The field's unit.
    pub unit: &'static str,
    /// Smallest and largest value that a scenario may have.
    pub range: [f64; 2],
}

/// The numbers of an episode with so many vehicles, in their order in [`Sample`].
#[must_use]
pub fn numbers(taken: &Taken) -> Vec<Number> {
    let number =
        |name: &str, field: &str, unit, range| Number { name: name.to_owned(), field: field.to_owned(), unit, range };
    let mut all = vec![
        number("lead_speed_mps", "vehicles[*].speed_mps", "m/s", [1.0, 50.0]),
        number(
            "lead_brake_mps2",
            "vehicles[0].driver.brake-to-speed.rate_mps2",
            "m/s²",
            [taken.min_brake.mps2().min(11.0), crumple_world::recording::HARDEST_CHANGE_MPS2],
        ),
        number("lead_final_share", "vehicles[0].driver.brake-to-speed.final_share", "1", [0.0, 0.98]),
    ];
    for follower in 1..taken.vehicles {
        let of = |field: &str| format!("vehicles[{follower}].{field}");
        all.push(number(&format!("speed_share_{follower}"), &of("speed_share"), "1", [0.2, 2.0]));
        all.push(number(&format!("time_gap_{follower}_s"), &of("time_gap_s"), "s", [0.1, 20.0]));
    }
    all
}

/// The numbers of an episode, none if fewer vehicles were recorded. Vehicles further back are left out.
fn numbers_of(episode: &Episode, vehicles: usize) -> Option<Vec<f64>> {
    let line = episode.vehicles.get(..vehicles)?;
    let lead_mps = line.first()?.speed_mps;
    // In one second, so that a loss of speed is a deceleration.
    let mut all = vec![lead_mps, episode.largest_drop_mps, lowest_mps(episode) / lead_mps];
    for follower in line.iter().skip(1) {
        all.push(follower.speed_mps / lead_mps);
        all.push(follower.gap_ahead_m / follower.speed_mps);
    }
    Some(all.into_iter().map(|value| (value * 1e6).round() / 1e6).collect())
}

/// The leader's lowest speed while it brakes: between two phases of braking it may speed up again.
fn lowest_mps(episode: &Episode) -> f64 {
    let braking = episode.onset_s..=episode.braking_end_s;
    let samples = episode.time_s.iter().zip(&episode.speed_mps).filter(|(time_s, _)| braking.contains(*time_s));
    samples.map(|(_, speed_mps)| *speed_mps).fold(episode.end_speed_mps, f64::min)
}

/// Episodes as numbers, and in how much driving they were.
#[derive(Debug, Clone, PartialEq)]
pub struct Sample {
    /// What was taken.
    pub taken: Taken,
    /// The numbers.
    pub observed: Observed,
    /// In how much driving.
    pub exposure: Exposure,
    /// Episodes with fewer vehicles.
    pub shorter: usize,
    /// Episodes with a number that no scenario of the space may have: they are not described.
    pub outside: usize,
    /// Which number that was most often the first.
    pub outside_by: Option<String>,
}

impl Sample {
    /// The numbers of the episodes in recordings.
    ///
    /// # Errors
    /// [`FitError::TooFew`] and [`FitError::TooMany`] for a number of episodes that cannot be fitted, [`FitError::Vehicles`].
    pub fn of(recordings: &[Recording], taken: Taken) -> Result<Self, FitError> {
        if !(2..=MOST_VEHICLES).contains(&taken.vehicles) {
            return Err(FitError::Vehicles { found: taken.vehicles });
        }
        if recordings.len() > MOST_RECORDINGS {
            return Err(FitError::TooMany { found: recordings.len(), most: MOST_RECORDINGS, what: "recordings" });
        }
        let numbers = numbers(&taken);
        let (mut wave_numbers, mut columns) = (Vec::new(), vec![Vec::new(); numbers.len()]);
        let (mut sources, mut shorter, mut outside) = (Vec::new(), 0, vec![0; numbers.len()]);
        for recording in recordings {
            let found = episodes(recording, taken.min_brake, taken.leaders).episodes;
            if found.len() > MOST_EPISODES {
                return Err(FitError::TooMany { found: found.len(), most: MOST_EPISODES, what: "episodes" });
            }
            let (before, first_wave) = (wave_numbers.len(), wave_numbers.iter().max().map_or(0, |last| last + 1));
            for (episode, wave) in found.iter().zip(waves(&found)) {
                let Some(values) = numbers_of(episode, taken.vehicles) else {
                    shorter += 1;
                    continue;
                };
                let is_outside =
                    |(number, value): (&Number, &f64)| !(number.range[0]..=number.range[1]).contains(value);
                if let Some(which) = numbers.iter().zip(&values).position(is_outside) {
                    outside[which] += 1;
                    continue;
                }
                wave_numbers.push(first_wave + wave);
                columns.iter_mut().zip(values).for_each(|(column, value)| column.push(value));
            }
            let driven = followed(recording, taken.leaders, taken.vehicles - 1);
            sources.push(SourceExposure {
                name: source_name(recording),
                episodes: (wave_numbers.len() - before) as u64,
                hours: driven.hours,
                kilometres: driven.kilometres,
            });
        }
        let (found, needed) = (wave_numbers.len(), super::least_episodes(numbers.len()));
        let outside_by = numbers.iter().zip(&outside).max_by_key(|(_, count)| **count).filter(|(_, count)| **count > 0);
        let outside_by = outside_by.map(|(number, _)| number.name.clone());
        if found < needed {
            let (vehicles, outside) = (taken.vehicles, outside.iter().sum());
            let most = outside_by.map(|name| format!(", most of them {name}")).unwrap_or_default();
            return Err(FitError::TooFew { found, needed, vehicles, shorter, outside, most });
        }
        if found > MOST_EPISODES {
            return Err(FitError::TooMany { found, most: MOST_EPISODES, what: "episodes" });
        }
        let parameter = |(number, values): (&Number, Vec<f64>)| ObservedParameter {
            name: number.name.clone(),
            low: number.range[0],
            high: number.range[1],
            values,
        };
        let exposure = Exposure {
            episodes: found as u64,
            hours: sources.iter().map(|source| source.hours).sum(),
            kilometres: sources.iter().map(|source| source.kilometres).sum(),
            sources,
        };
        let observed = Observed {
            waves: renumbered(&wave_numbers),
            parameters: numbers.iter().zip(columns).map(parameter).collect(),
        };
        Ok(Self { taken, observed, exposure, shorter, outside: outside.iter().sum(), outside_by })
    }
}

/// Waves numbered from 0 without holes, in their order.
fn renumbered(waves: &[u32]) -> Vec<u32> {
    let mut known: Vec<u32> = waves.to_vec();
    known.sort_unstable();
    known.dedup();
    waves.iter().map(|wave| known.partition_point(|other| other < wave) as u32).collect()
}

/// The file's name; of the format where it has none.
fn source_name(recording: &Recording) -> String {
    let name = recording.path.file_name().map(|name| name.to_string_lossy()).unwrap_or_default();
    let plain: String = name.chars().map(|letter| if letter.is_control() { '?' } else { letter }).take(200).collect();
    if plain.is_empty() { recording.format.name().to_owned() } else { plain }
}
