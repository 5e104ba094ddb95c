//! crumple's own policies: the JSON text in the file that describes the network.

use serde::Deserialize;

use super::controller::{LinearLayer, NativePolicy, NeuralController, OBSERVATION_SIZE};
use super::safetensors::{MAX_LAYER_WIDTH, MAX_NUMBERS, SafetensorsFile};
use crate::canonical::UniqueKeys;

const VERSION: u32 = 1;
const METADATA_KEY: &str = "crumple_policy";
const ESTIMATORS: [&str; 2] = ["kalman", "truth"];
const MAX_LAYERS: usize = 16;

/// The description of a policy; all of its fields are read, as in the simulator.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PolicyFileHeader {
    version: u32,
    #[expect(dead_code, reason = "only its form is checked")]
    crumple: String,
    hidden: Vec<usize>,
    observation: Scaling,
    action: PolicyFileAction,
    decision_interval_s: f64,
    estimator: String,
    #[expect(dead_code, reason = "only its form is checked")]
    seed: u64,
    #[expect(dead_code, reason = "only its form is checked")]
    episode: u64,
    #[expect(dead_code, reason = "only its form is checked")]
    training: UniqueKeys,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scaling {
    offset: [f64; OBSERVATION_SIZE],
    scale: [f64; OBSERVATION_SIZE],
    limit: f64,
    empty_gap_m: f64,
    #[serde(default = "default_one")]
    history: usize,
    #[serde(default = "default_one")]
    history_every: usize,
    #[serde(default)]
    extra: Vec<serde::de::IgnoredAny>,
}

fn default_one() -> usize {
    1
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct PolicyFileAction {
    low_mps2: f64,
    high_mps2: f64,
}

impl PolicyFileHeader {
    fn check(&self) -> Result<(), String> {
        if self.version != VERSION {
            return Err(format!(
                "{METADATA_KEY}: version {} is not supported: this release reads {VERSION}",
                self.version
            ));
        }
        if !ESTIMATORS.contains(&self.estimator.as_str()) {
            return Err(format!(
                "{METADATA_KEY}: estimator: {:?} is not known",
                self.estimator
            ));
        }
        self.check_size()?;
        self.observation.check(self.decision_interval_s)?;
        self.action.check()
    }

    fn check_size(&self) -> Result<(), String> {
        let numbers = self
            .hidden
            .iter()
            .fold(0_usize, |sum, size| sum.saturating_add(*size));
        let is_too_wide = self
            .hidden
            .iter()
            .any(|size| !(1..=MAX_LAYER_WIDTH).contains(size));
        if self.hidden.len() > MAX_LAYERS || numbers > MAX_NUMBERS || is_too_wide {
            return Err("describes too large a network".to_owned());
        }
        Ok(())
    }
}

impl Scaling {
    fn check(&self, decision_interval_s: f64) -> Result<(), String> {
        let is_positive = self
            .scale
            .iter()
            .chain([&self.limit, &self.empty_gap_m, &decision_interval_s])
            .all(|value| *value > 0.0 && value.is_finite());
        if !is_positive || !self.offset.iter().all(|value| value.is_finite()) {
            return Err("has a scaling outside its range".to_owned());
        }
        // The spacing of a history of length one has no meaning and must not suggest one.
        if [self.history, self.history_every] != [1, 1] {
            let problem = "only a network without history can be analysed";
            return Err(format!("{METADATA_KEY}: observation: history: {problem}"));
        }
        if !self.extra.is_empty() {
            let problem = "only a network with the paper's eight inputs can be analysed";
            return Err(format!("{METADATA_KEY}: observation: extra: {problem}"));
        }
        Ok(())
    }
}

impl PolicyFileAction {
    fn check(&self) -> Result<(), String> {
        let Self {
            low_mps2: low,
            high_mps2: high,
        } = self;
        if low < high && (low - high).is_finite() && (low + high).is_finite() {
            Ok(())
        } else {
            Err("has action bounds that are not finite and in order".to_owned())
        }
    }
}

fn read_layers(
    hidden: &[usize],
    file: &mut SafetensorsFile<'_>,
) -> Result<Vec<LinearLayer>, String> {
    let sizes = [&[OBSERVATION_SIZE], hidden, &[1]].concat();
    sizes
        .windows(2)
        .enumerate()
        .map(|(index, pair)| {
            let inputs = pair[0];
            let outputs = pair[1];
            let weights = file.take_tensor(&format!("actor.{index}.weight"), &[inputs, outputs])?;
            let biases = file.take_tensor(&format!("actor.{index}.bias"), &[outputs])?;
            Ok(LinearLayer {
                inputs,
                outputs,
                weights,
                biases,
            })
        })
        .collect()
}

pub(super) fn read(text: &str, file: &mut SafetensorsFile<'_>) -> Result<NeuralController, String> {
    let header: PolicyFileHeader = serde_json::from_str(text).map_err(|error| {
        let hint = if text.contains("\"departs_from\"") {
            ": residual policies were removed in crumple 0.3.0"
        } else {
            ""
        };
        format!("{METADATA_KEY}: {error}{hint}")
    })?;
    header.check()?;
    let layers = read_layers(&header.hidden, file)?;
    let Scaling {
        offset,
        scale,
        limit,
        empty_gap_m,
        ..
    } = header.observation;
    Ok(NativePolicy {
        layers,
        offset,
        scale,
        limit,
        empty_gap_m,
        action_bounds_mps2: [header.action.low_mps2, header.action.high_mps2],
        decision_interval_s: header.decision_interval_s,
    }
    .into())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn header_json() -> serde_json::Value {
        serde_json::json!({
            "version": 1, "crumple": "0.1.0", "hidden": [64, 64],
            "observation": {
                "offset": vec![0; OBSERVATION_SIZE], "scale": vec![1; OBSERVATION_SIZE], "limit": 1.5, "empty_gap_m": 80
            },
            "action": {"low_mps2": -7.5, "high_mps2": 3}, "decision_interval_s": 0.1, "estimator": "truth", "seed": 1,
            "episode": 2, "training": {}
        })
    }

    fn header() -> PolicyFileHeader {
        serde_json::from_value(header_json()).unwrap()
    }

    /// Checks that an absent value means one, as in the simulator, and that null is rejected.
    #[test]
    fn a_history_is_a_number_or_absent() {
        for field in ["history", "history_every"] {
            for (value, is_read) in [
                (serde_json::json!(1), true),
                (serde_json::Value::Null, false),
            ] {
                let mut stated = header_json();
                stated["observation"][field] = value;
                assert_eq!(
                    serde_json::from_value::<PolicyFileHeader>(stated).is_ok(),
                    is_read,
                    "{field}"
                );
            }
            assert!(check_modified(|header| header.observation.history = 2).is_err());
            assert!(check_modified(|header| header.observation.history_every = 5).is_err());
        }
    }

    #[test]
    fn further_inputs_are_refused() {
        let mut further = header_json();
        further["observation"]["extra"] =
            serde_json::json!([{ "quantity": "last_answer_mps2", "offset": 0, "scale": 5 }]);
        let refused = serde_json::from_value::<PolicyFileHeader>(further)
            .unwrap()
            .check();
        assert!(
            refused
                .unwrap_err()
                .contains("only a network with the paper's eight inputs")
        );
    }

    fn check_modified(change: impl FnOnce(&mut PolicyFileHeader)) -> Result<(), String> {
        let mut header = header();
        change(&mut header);
        header.check()
    }

    #[test]
    fn limits_of_depth_and_width_are_exact() {
        for hidden in [
            vec![],
            vec![1; MAX_LAYERS],
            vec![MAX_LAYER_WIDTH, MAX_LAYER_WIDTH],
            vec![1, MAX_NUMBERS / 2],
        ] {
            assert_eq!(
                check_modified(|header| header.hidden.clone_from(&hidden)),
                Ok(()),
                "{hidden:?}"
            );
        }
        for hidden in [
            vec![1; MAX_LAYERS + 1],
            vec![1; MAX_LAYERS + 2],
            vec![MAX_LAYER_WIDTH, MAX_LAYER_WIDTH, 1],
            vec![MAX_LAYER_WIDTH, MAX_LAYER_WIDTH, 2],
            vec![MAX_LAYER_WIDTH + 1],
            vec![64, 0],
            vec![usize::MAX, usize::MAX],
        ] {
            let refused = Err("describes too large a network".to_owned());
            assert_eq!(
                check_modified(|header| header.hidden.clone_from(&hidden)),
                refused,
                "{hidden:?}"
            );
        }
    }

    #[test]
    fn scales_are_positive_and_all_numbers_finite() {
        let refused = Err("has a scaling outside its range".to_owned());
        for wrong in [0.0, -1.0, f64::INFINITY, f64::NAN] {
            assert_eq!(
                check_modified(|header| header.observation.scale[7] = wrong),
                refused,
                "scale {wrong}"
            );
            assert_eq!(
                check_modified(|header| header.observation.limit = wrong),
                refused,
                "limit {wrong}"
            );
            assert_eq!(
                check_modified(|header| header.observation.empty_gap_m = wrong),
                refused,
                "empty gap {wrong}"
            );
            assert_eq!(
                check_modified(|header| header.decision_interval_s = wrong),
                refused,
                "interval {wrong}"
            );
        }
        for wrong in [f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(
                check_modified(|header| header.observation.offset[0] = wrong),
                refused,
                "offset {wrong}"
            );
        }
        assert_eq!(
            check_modified(|header| header.observation.offset = [-1e300; OBSERVATION_SIZE]),
            Ok(())
        );
        assert_eq!(
            check_modified(
                |header| header.observation.scale = [f64::MIN_POSITIVE; OBSERVATION_SIZE]
            ),
            Ok(())
        );
    }

    #[test]
    fn action_bounds_must_have_a_finite_difference_and_sum() {
        let with = |low, high| {
            let evaluated = check_modified(|header| {
                (header.action.low_mps2, header.action.high_mps2) = (low, high)
            });
            evaluated
                .inspect_err(|error| {
                    assert_eq!(error, "has action bounds that are not finite and in order")
                })
                .is_ok()
        };
        for (low, high) in [
            (-7.5, 3.0),
            (0.0, f64::MIN_POSITIVE),
            (-1.0, 0.0),
            (-1e200, 1e200),
            (1e200, 1e201),
        ] {
            assert!(with(low, high), "{low} {high}");
        }
        for (low, high) in [
            (3.0, 3.0),
            (3.0, -7.5),
            (-1.5e308, 1.5e308),
            (1e308, 1.7e308),
            (-1.7e308, -1e308),
            (0.0, f64::INFINITY),
            (f64::NAN, 1.0),
        ] {
            assert!(!with(low, high), "{low} {high}");
        }
    }
}
