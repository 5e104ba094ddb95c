//! Learning curves of policies: evaluation reward over training episodes.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

/// Reward of an episode without collision (paper, section "DDPG training result").
pub const COLLISION_FREE_REWARD: f64 = 22_500.0;

/// Mean and standard deviation over trainings of the evaluation reward. Ended trainings keep their best reward.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LearningCurve {
    /// Name of the training configuration.
    pub preset: String,
    /// Number of trainings.
    pub seeds: usize,
    /// Points, one per evaluation, in order.
    pub points: Vec<CurvePoint>,
}

/// One evaluation over all trainings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Number of episodes.
    pub episode: u64,
    /// Mean reward.
    pub mean_reward: f64,
    /// Standard deviation of the reward over trainings.
    pub deviation: f64,
}

impl LearningCurve {
    /// Computes the curve from the evaluation rewards of each training, by episode.
    #[must_use]
    pub fn from_evaluations(preset: &str, curves: &[BTreeMap<u64, f64>]) -> Self {
        let episodes: BTreeSet<u64> = curves
            .iter()
            .flat_map(|curve| curve.keys().copied())
            .collect();
        Self {
            preset: preset.to_owned(),
            seeds: curves.len(),
            points: episodes
                .into_iter()
                .map(|episode| CurvePoint::new(episode, curves))
                .collect(),
        }
    }
}

impl CurvePoint {
    /// Computes mean and standard deviation over trainings, rounded to tenths.
    fn new(episode: u64, curves: &[BTreeMap<u64, f64>]) -> Self {
        let rewards: Vec<f64> = curves
            .iter()
            .filter_map(|curve| reward_at(curve, episode))
            .collect();
        let n = rewards.len() as f64;
        let mean_reward = rewards.iter().sum::<f64>() / n;
        let variance = rewards
            .iter()
            .map(|reward| (reward - mean_reward).powi(2))
            .sum::<f64>()
            / n;
        Self {
            episode,
            mean_reward: round_to_tenth(mean_reward),
            deviation: round_to_tenth(variance.sqrt()),
        }
    }
}

fn round_to_tenth(reward: f64) -> f64 {
    (10.0 * reward).round() / 10.0
}

/// Returns the reward of the last evaluation up to an episode, or the best reward if the training ended earlier.
fn reward_at(curve: &BTreeMap<u64, f64>, episode: u64) -> Option<f64> {
    let (&end, _) = curve.last_key_value()?;
    if episode > end {
        curve.values().copied().reduce(f64::max)
    } else {
        curve
            .range(..=episode)
            .next_back()
            .map(|(_, &reward)| reward)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_finished_training_counts_with_its_best_reward() {
        let curve = BTreeMap::from([(5, 22_500.0), (10, 100.0)]);
        let at = [4, 5, 9, 10, 11].map(|episode| reward_at(&curve, episode));
        assert_eq!(
            at,
            [
                None,
                Some(22_500.0),
                Some(22_500.0),
                Some(100.0),
                Some(22_500.0)
            ]
        );
    }
}
