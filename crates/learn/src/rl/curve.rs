//! Learning curve of one or more trainings from their logs.

use std::collections::BTreeMap;

use crumple_sim::policy::LearningCurve;
use serde::Deserialize;

#[derive(Deserialize)]
#[serde(rename_all = "snake_case")]
enum LogLine {
    Imitation {},
    Episode {
        episode: u64,
    },
    Evaluation {
        episode: u64,
        result: LoggedEvaluation,
    },
}

#[derive(Deserialize)]
struct LoggedEvaluation {
    mean_reward: f64,
}

/// Returns the episode of a log line.
#[must_use]
pub fn parse_episode(line: &str) -> Option<u64> {
    match serde_json::from_str(line).ok()? {
        LogLine::Episode { episode } | LogLine::Evaluation { episode, .. } => Some(episode),
        LogLine::Imitation {} => Some(0),
    }
}

/// Returns the episode and the mean reward of an evaluation; none for other log lines.
pub(super) fn parse_evaluation(line: &str) -> Option<(u64, f64)> {
    match serde_json::from_str(line).ok()? {
        LogLine::Evaluation { episode, result } => Some((episode, result.mean_reward)),
        LogLine::Episode { .. } | LogLine::Imitation {} => None,
    }
}

/// Computes the learning curve of trainings from their logs.
#[must_use]
pub fn learning_curve(preset: &str, logs: &[String]) -> LearningCurve {
    let evaluations = logs.iter().map(|log| {
        log.lines()
            .filter_map(parse_evaluation)
            .collect::<BTreeMap<_, _>>()
    });
    LearningCurve::from_evaluations(preset, &evaluations.collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_log_has_evaluations_and_episodes() {
        let log = "{\"episode\":{\"episode\":1,\"reward\":3}}\n\
                   {\"evaluation\":{\"episode\":5,\"best\":true,\"result\":{\"mean_reward\":22500.0}}}\n\
                   {\"evaluation\":{\"episode\":10,\"best\":false,\"result\":{\"mean_reward\":100.0}}}\n";
        assert_eq!(
            log.lines().filter_map(parse_evaluation).collect::<Vec<_>>(),
            [(5, 22_500.0), (10, 100.0)]
        );
        assert_eq!(
            log.lines().map(parse_episode).collect::<Vec<_>>(),
            [Some(1), Some(5), Some(10)]
        );
    }
}
