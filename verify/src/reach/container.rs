//! The policy file: eight bytes that say how long the header is, a header in JSON, and then little-endian numbers.
//!
//! The header lists tensors by name with their type, shape and place, and holds in its metadata the JSON text that says how
//! observations are scaled and what is done with the answer. Only what is needed to drive is read.

use serde::Deserialize;
use serde_json::Value;

use super::actor::{Actor, Layer, OBSERVED};

/// Deepest and widest network that is read, and most numbers between its layers: bounds on rounding rely on the last two.
const MOST_LAYERS: usize = 16;
const WIDEST_LAYER: usize = 4096;
const MOST_NUMBERS: usize = 8192;
/// Longest header, in bytes: what is read of it takes some twenty times as many.
const LONGEST_HEADER: usize = 1 << 20;

#[derive(Deserialize)]
struct Header {
    hidden: Vec<usize>,
    observation: Scaling,
    action: Bounds,
    decision_interval_s: f64,
}

#[derive(Deserialize)]
struct Scaling {
    offset: [f64; OBSERVED],
    scale: [f64; OBSERVED],
    limit: f64,
    empty_gap_m: f64,
}

#[derive(Deserialize)]
struct Bounds {
    low_mps2: f64,
    high_mps2: f64,
}

impl Actor {
    /// Reads a policy file.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let (length, rest) = bytes.split_first_chunk::<8>().ok_or("is too short")?;
        let length = usize::try_from(u64::from_le_bytes(*length)).map_err(|error| error.to_string())?;
        let (listing, data) = rest.split_at_checked(length).ok_or("is shorter than it says")?;
        if length > LONGEST_HEADER {
            return Err("has too long a header".to_owned());
        }
        let listing: Value = serde_json::from_slice(listing).map_err(|error| error.to_string())?;
        let text = listing.pointer("/__metadata__/crumple_policy").and_then(Value::as_str);
        let header: Header = serde_json::from_str(text.ok_or("describes no policy")?).map_err(|e| e.to_string())?;
        let sizes = [&[OBSERVED], header.hidden.as_slice(), &[1]].concat();
        let numbers = header.hidden.iter().fold(0_usize, |sum, size| sum.saturating_add(*size));
        if sizes.len() > MOST_LAYERS + 2
            || numbers > MOST_NUMBERS
            || sizes.iter().any(|size| !(1..=WIDEST_LAYER).contains(size))
        {
            return Err("describes too large a network".to_owned());
        }
        let layers = sizes.windows(2).enumerate().map(|(index, pair)| {
            let (inputs, outputs) = (pair[0], pair[1]);
            let weights = tensor(&listing, data, &format!("actor.{index}.weight"), &[inputs, outputs])?;
            let biases = tensor(&listing, data, &format!("actor.{index}.bias"), &[outputs])?;
            Ok(Layer { inputs, outputs, weights, biases })
        });
        let layers = layers.collect::<Result<Vec<_>, String>>()?;
        let Scaling { offset, scale, limit, empty_gap_m } = header.observation;
        let action_mps2 = [header.action.low_mps2, header.action.high_mps2];
        let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
        let positive = scale.iter().chain([&limit, &empty_gap_m, &header.decision_interval_s]).all(is_positive);
        if !positive || !offset.iter().chain(&action_mps2).all(|value| value.is_finite()) {
            return Err("has a scaling that makes no sense".to_owned());
        }
        let decision_interval_s = header.decision_interval_s;
        let actor = Self { layers, offset, scale, limit, empty_gap_m, action_mps2, decision_interval_s };
        match actor.overflowing_layer() {
            None => Ok(actor),
            Some(layer) => Err(format!("can leave single precision in layer {layer}")),
        }
    }

    /// The first layer whose sums could leave single precision, by the bound |h W + b| <= |h| |W| + |b|, which holds for every
    /// partial sum too. Everything that is said of the network's rounding is said of sums that do not.
    fn overflowing_layer(&self) -> Option<usize> {
        // Half of the range is left for rounding.
        let highest = 0.5 * f64::from(f32::MAX);
        let mut bounds = vec![self.limit; OBSERVED];
        self.layers.iter().position(|layer| {
            let mut sums: Vec<f64> = layer.biases.iter().map(|bias| bias.abs()).collect();
            for (bound, row) in bounds.iter().zip(layer.weights.chunks_exact(layer.outputs)) {
                sums.iter_mut().zip(row).for_each(|(sum, weight)| *sum += bound * weight.abs());
            }
            bounds = sums;
            !bounds.iter().all(|&bound| bound <= highest)
        })
    }
}

/// The numbers of a tensor of single-precision numbers, all finite.
fn tensor(listing: &Value, data: &[u8], name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
    #[derive(Deserialize)]
    struct Entry {
        dtype: String,
        shape: Vec<usize>,
        data_offsets: [usize; 2],
    }
    let entry = listing.get(name).cloned().ok_or_else(|| format!("has no tensor {name}"))?;
    let entry: Entry = serde_json::from_value(entry).map_err(|error| format!("tensor {name}: {error}"))?;
    let [from, to] = entry.data_offsets;
    let numbers = data.get(from..to).filter(|_| entry.dtype == "F32" && entry.shape == shape);
    let numbers = numbers.filter(|bytes| bytes.len() == 4 * shape.iter().product::<usize>());
    let (numbers, _) = numbers.ok_or_else(|| format!("tensor {name} is not what it should be"))?.as_chunks::<4>();
    let numbers: Vec<f64> = numbers.iter().map(|&bytes| f32::from_le_bytes(bytes).into()).collect();
    if numbers.iter().all(|value| value.is_finite()) {
        Ok(numbers)
    } else {
        Err(format!("tensor {name} is not finite"))
    }
}
