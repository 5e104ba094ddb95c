//! The policy file: eight bytes that say how long the header is, a header in JSON, and then little-endian numbers.
//!
//! The header lists tensors by name with their type, shape and place, and holds in its metadata the JSON text that says how
//! observations are scaled and what is done with the answer. What the simulator refuses is refused here too, or a certificate would
//! speak of what nobody can drive with: other versions, unknown fields, names that occur twice, tensors that are missing, superfluous,
//! overlapping or not of the described shape, bytes that belong to none, numbers that are not finite.

use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::actor::{Actor, Layer, OBSERVED};
use crate::canonical::NoNameTwice;

/// The only version of the text that describes a policy.
const VERSION: u32 = 1;
/// Its place in the metadata.
const KEY: &str = "crumple_policy";
/// What a policy may have looked through in training.
const ESTIMATORS: [&str; 2] = ["kalman", "truth"];
/// Deepest and widest network that is read, and most numbers between its layers: bounds on rounding rely on the last two.
const MOST_LAYERS: usize = 16;
const WIDEST_LAYER: usize = 4096;
const MOST_NUMBERS: usize = 8192;
/// Longest header, in bytes: what is read of it takes some twenty times as many.
const LONGEST_HEADER: usize = 1 << 20;

/// The header of the file.
struct Listing {
    description: String,
    tensors: BTreeMap<String, Entry>,
}

/// Where a tensor is.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    crumple_policy: String,
}

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
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bounds {
    low_mps2: f64,
    high_mps2: f64,
}

impl<'de> Deserialize<'de> for Listing {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(ListingReader)
    }
}

struct ListingReader;

impl<'de> Visitor<'de> for ListingReader {
    type Value = Listing;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("tensors by name, and `__metadata__`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<Listing, A::Error> {
        let (mut description, mut tensors) = (None, BTreeMap::new());
        let twice = |name: &str| A::Error::custom(format_args!("duplicate key {name:?}"));
        while let Some(name) = entries.next_key::<String>()? {
            if name == "__metadata__" {
                let Metadata { crumple_policy } = entries.next_value()?;
                if description.replace(crumple_policy).is_some() {
                    return Err(twice(&name));
                }
            } else if tensors.insert(name.clone(), entries.next_value::<Entry>()?).is_some() {
                return Err(twice(&name));
            }
        }
        let description = description.ok_or_else(|| A::Error::custom("describes no policy"))?;
        Ok(Listing { description, tensors })
    }
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
        let Scaling { offset, scale, limit, empty_gap_m } = observation;
        let is_positive = |value: &f64| *value > 0.0 && value.is_finite();
        let positive = scale.iter().chain([limit, empty_gap_m, decision_interval_s]).all(is_positive);
        if !positive || !offset.iter().all(|value| value.is_finite()) {
            return Err("has a scaling that makes no sense".to_owned());
        }
        let Bounds { low_mps2: low, high_mps2: high } = action;
        if low < high && (low - high).is_finite() && (low + high).is_finite() {
            Ok(())
        } else {
            Err("has bounds of its action that are not finite and in order".to_owned())
        }
    }
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
        let Listing { description, mut tensors } =
            serde_json::from_slice(listing).map_err(|error| format!("header: {error}"))?;
        let header: Header = serde_json::from_str(&description).map_err(|error| format!("{KEY}: {error}"))?;
        header.check()?;
        check_places(&tensors, data.len())?;
        let sizes = [&[OBSERVED], header.hidden.as_slice(), &[1]].concat();
        let layers = sizes.windows(2).enumerate().map(|(index, pair)| {
            let (inputs, outputs) = (pair[0], pair[1]);
            let weights = tensor(&mut tensors, data, &format!("actor.{index}.weight"), &[inputs, outputs])?;
            let biases = tensor(&mut tensors, data, &format!("actor.{index}.bias"), &[outputs])?;
            Ok(Layer { inputs, outputs, weights, biases })
        });
        let layers = layers.collect::<Result<Vec<_>, String>>()?;
        if let Some(name) = tensors.keys().next() {
            return Err(format!("tensor {name:?} is not part of the network that is described"));
        }
        let Scaling { offset, scale, limit, empty_gap_m } = header.observation;
        let action_mps2 = [header.action.low_mps2, header.action.high_mps2];
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
        if self.limit > highest {
            return Some(0);
        }
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

/// Whether tensors lie one after the other, without a gap, and up to the end.
fn check_places(tensors: &BTreeMap<String, Entry>, length: usize) -> Result<(), String> {
    let mut places: Vec<[usize; 2]> = tensors.values().map(|entry| entry.data_offsets).collect();
    places.sort_unstable();
    let end = places.iter().try_fold(0, |end, &[from, to]| (from == end && to >= from).then_some(to));
    if end == Some(length) { Ok(()) } else { Err("has tensors that overlap, or bytes that belong to none".to_owned()) }
}

/// The numbers of a tensor of single-precision numbers, all finite; it is taken out of the list.
fn tensor(tensors: &mut BTreeMap<String, Entry>, data: &[u8], name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
    let entry = tensors.remove(name).ok_or_else(|| format!("has no tensor {name}"))?;
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
