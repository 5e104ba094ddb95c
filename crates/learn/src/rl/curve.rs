//! The learning curve of one or more trainings, from their logs.

use std::collections::{BTreeMap, BTreeSet};

use serde::{Deserialize, Serialize};

/// The reward of an episode without contact (paper, section "DDPG training result").
pub const PERFECT: f64 = 22_500.0;

/// The parts of a log line that the curve needs.
#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum Line {
    Episode { episode: u64 },
    Evaluation { episode: u64, result: Judged },
}

#[derive(Deserialize)]
struct Judged {
    mean_reward: f64,
}

/// The episode a log line is about.
#[must_use]
pub fn episode_of(line: &str) -> Option<u64> {
    match serde_json::from_str(line).ok()? {
        Line::Episode { episode } | Line::Evaluation { episode, .. } => Some(episode),
    }
}

/// The episode after which a log line says how the actor was judged; none of other lines.
pub(super) fn judged_after(line: &str) -> Option<u64> {
    match serde_json::from_str(line).ok()? {
        Line::Evaluation { episode, .. } => Some(episode),
        Line::Episode { .. } => None,
    }
}

/// Mean and standard deviation over trainings of the reward in evaluation. A training that has ended keeps its best.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct LearningCurve {
    /// Name of the training configuration.
    pub preset: String,
    /// Trainings.
    pub seeds: usize,
    /// One entry an evaluation, in order.
    pub points: Vec<CurvePoint>,
}

/// One evaluation over all trainings.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CurvePoint {
    /// Episodes done.
    pub episode: u64,
    /// Mean reward.
    pub mean_reward: f64,
    /// Standard deviation of the reward over trainings.
    pub deviation: f64,
}

impl LearningCurve {
    /// The curve of trainings with these logs.
    #[must_use]
    pub fn from_logs(preset: &str, logs: &[String]) -> Self {
        Self::from_evaluations(preset, &logs.iter().map(|log| evaluations(log)).collect::<Vec<_>>())
    }

    /// The curve of trainings with these rewards in evaluation, by episode.
    #[must_use]
    pub fn from_evaluations(preset: &str, curves: &[BTreeMap<u64, f64>]) -> Self {
        let episodes: BTreeSet<u64> = curves.iter().flat_map(|curve| curve.keys().copied()).collect();
        let point = |episode| {
            let rewards: Vec<f64> = curves.iter().filter_map(|curve| reward_at(curve, episode)).collect();
            let n = rewards.len() as f64;
            let mean_reward = rewards.iter().sum::<f64>() / n;
            let variance = rewards.iter().map(|reward| (reward - mean_reward).powi(2)).sum::<f64>() / n;
            let tenth = |reward: f64| (10.0 * reward).round() / 10.0;
            CurvePoint { episode, mean_reward: tenth(mean_reward), deviation: tenth(variance.sqrt()) }
        };
        Self { preset: preset.to_owned(), seeds: curves.len(), points: episodes.into_iter().map(point).collect() }
    }
}

fn evaluations(log: &str) -> BTreeMap<u64, f64> {
    log.lines()
        .filter_map(|line| match serde_json::from_str(line).ok()? {
            Line::Evaluation { episode, result } => Some((episode, result.mean_reward)),
            Line::Episode { .. } => None,
        })
        .collect()
}

/// The reward at an episode: of the last evaluation before it, or, after the training's end, the best of all.
fn reward_at(curve: &BTreeMap<u64, f64>, episode: u64) -> Option<f64> {
    let (&end, _) = curve.last_key_value()?;
    if episode > end {
        curve.values().copied().reduce(f64::max)
    } else {
        curve.range(..=episode).next_back().map(|(_, &reward)| reward)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn curves_hold_their_last_value_and_then_their_best() {
        let log = "{\"episode\":{\"episode\":1,\"reward\":3}}\n\
                   {\"evaluation\":{\"episode\":5,\"best\":true,\"result\":{\"mean_reward\":22500.0}}}\n\
                   {\"evaluation\":{\"episode\":10,\"best\":false,\"result\":{\"mean_reward\":100.0}}}\n";
        let curve = evaluations(log);
        let at = [4, 5, 9, 10, 11].map(|episode| reward_at(&curve, episode));
        assert_eq!(at, [None, Some(22_500.0), Some(22_500.0), Some(100.0), Some(22_500.0)]);
        assert_eq!(log.lines().map(episode_of).collect::<Vec<_>>(), [Some(1), Some(5), Some(10)]);
    }
}
