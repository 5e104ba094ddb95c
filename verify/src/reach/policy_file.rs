//! crumple's own policies: what the text in the file says of the network.

use serde::Deserialize;
use serde::de::IgnoredAny;

use super::actor::{Actor, Layer, OBSERVED, Own};
use super::container::{Container, MOST_NUMBERS, WIDEST_LAYER};
use crate::canonical::NoNameTwice;

/// The only version of the text that describes a policy.
const VERSION: u32 = 1;
/// Its place in the metadata.
const KEY: &str = "crumple_policy";
/// What a policy may have looked through in training.
const ESTIMATORS: [&str; 2] = ["kalman", "truth"];
/// Deepest network that is read.
const MOST_LAYERS: usize = 16;

/// The text that describes a policy; all of its fields are read, as the simulator wants them.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Header {
    version: u32,
    #[serde(rename = "crumple")]
    _crumple: String,
    hidden: Vec<usize>,
    observation: Scaling,
    action: Bounds,
    decision_interval_s: f64,
    estimator: String,
    #[serde(rename = "seed")]
    _seed: u64,
    #[serde(rename = "episode")]
    _episode: u64,
    #[serde(rename = "training")]
    _training: NoNameTwice,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Scaling {
    offset: [f64; OBSERVED],
    scale: [f64; OBSERVED],
    limit: f64,
    empty_gap_m: f64,
    history: Option<usize>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bounds {
    low_mps2: f64,
    high_mps2: f64,
    departs_from: Option<IgnoredAny>,
}

impl Header {
    fn check(&self) -> Result<(), String> {
        let Self { version, hidden, observation, action, decision_interval_s, estimator, .. } = self;
        if *version != VERSION {
            return Err(format!("{KEY}: version {version} is not known, only {VERSION}"));
        }
        if !ESTIMATORS.contains(&estimator.as_str()) {
            return Err(format!("{KEY}: estimator: {estimator:?} is not known"));
        }
        let numbers = hidden.iter().fold(0_usize, |sum, size| sum.saturating_add(*size));
        let is_too_wide = hidden.iter().any(|size| !(1..=WIDEST_LAYER).contains(size));
        if hidden.len() > MOST_LAYERS || numbers > MOST_NUMBERS || is_too_wide {
            return Err("describes too large a network".to_owned());
        }
        let Scaling { offset, scale, limit, empty_gap_m, history } = observation;
        let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
        let positive = scale.iter().chain([limit, empty_gap_m, decision_interval_s]).all(is_positive);
        if !positive || !offset.iter().all(|value| value.is_finite()) {
            return Err("has a scaling that makes no sense".to_owned());
        }
        if history.is_some_and(|history| history != 1) {
            let is_not = "only a network that sees nothing but the present can be followed";
            return Err(format!("{KEY}: observation: history: {is_not}"));
        }
        let Bounds { low_mps2: low, high_mps2: high, departs_from } = action;
        if departs_from.is_some() {
            let is_not = "its acceleration is not the network's answer alone, and of that law nothing is proved here";
            return Err(format!("{KEY}: action: departs from a law of driving: {is_not}"));
        }
        if low < high && (low - high).is_finite() && (low + high).is_finite() {
            Ok(())
        } else {
            Err("has bounds of its action that are not finite and in order".to_owned())
        }
    }
}

/// The policy that a text describes, of the tensors of a file.
pub(super) fn read(text: &str, file: &mut Container<'_>) -> Result<Actor, String> {
    let header: Header = serde_json::from_str(text).map_err(|error| format!("{KEY}: {error}"))?;
    header.check()?;
    let sizes = [&[OBSERVED], header.hidden.as_slice(), &[1]].concat();
    let layers = sizes.windows(2).enumerate().map(|(index, pair)| {
        let (inputs, outputs) = (pair[0], pair[1]);
        let weights = file.tensor(&format!("actor.{index}.weight"), &[inputs, outputs])?;
        let biases = file.tensor(&format!("actor.{index}.bias"), &[outputs])?;
        Ok(Layer { inputs, outputs, weights, biases })
    });
    let layers = layers.collect::<Result<Vec<_>, String>>()?;
    let Scaling { offset, scale, limit, empty_gap_m, history: _ } = header.observation;
    let action_mps2 = [header.action.low_mps2, header.action.high_mps2];
    let decision_interval_s = header.decision_interval_s;
    Ok(Own { layers, offset, scale, limit, empty_gap_m, action_mps2, decision_interval_s }.into())
}
