//! The file of a network: eight bytes with the length of the header, a JSON header, and little-endian numbers.
//!
//! The header lists tensors by name with type, shape and offsets. Its metadata holds a JSON text that describes one of
//! crumple's [own policies](super::policy_file) or an [imported network](super::network_file). The reader rejects what
//! the simulator rejects, so that every accepted certificate is about a usable file: other versions, unknown fields,
//! duplicate names, tensors that are missing, superfluous, overlapping or not of the described shape, unused bytes, and
//! numbers that are not finite.

use std::collections::BTreeMap;
use std::fmt;

use serde::Deserialize;
use serde::de::{Deserializer, Error, MapAccess, Visitor};

use super::controller::{LinearLayer, NetworkLayer, NeuralController};
use super::{network_file, policy_file};

/// Maximum width of a layer, and of numbers between layers: bounds on rounding rely on them.
pub(super) const MAX_LAYER_WIDTH: usize = 4096;
pub(super) const MAX_NUMBERS: usize = 8192;
/// Maximum size of a header in bytes; reading it takes about twenty times as much memory.
const MAX_HEADER_BYTES: usize = 1 << 20;

struct SafetensorsHeader {
    description: Metadata,
    tensors: BTreeMap<String, TensorInfo>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct TensorInfo {
    dtype: String,
    shape: Vec<usize>,
    data_offsets: [usize; 2],
}

/// Metadata, with exactly one of the two.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Metadata {
    crumple_policy: Option<String>,
    crumple_network: Option<String>,
}

pub(super) struct SafetensorsFile<'a> {
    tensors: BTreeMap<String, TensorInfo>,
    data: &'a [u8],
}

impl<'de> Deserialize<'de> for SafetensorsHeader {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        from.deserialize_map(SafetensorsHeaderVisitor)
    }
}

struct SafetensorsHeaderVisitor;

impl<'de> Visitor<'de> for SafetensorsHeaderVisitor {
    type Value = SafetensorsHeader;

    fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        formatter.write_str("tensors by name, and `__metadata__`")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut entries: A) -> Result<SafetensorsHeader, A::Error> {
        let mut description = None;
        let mut tensors = BTreeMap::new();
        while let Some(name) = entries.next_key::<String>()? {
            let is_duplicate = if name == "__metadata__" {
                description
                    .replace(entries.next_value::<Metadata>()?)
                    .is_some()
            } else {
                tensors
                    .insert(name.clone(), entries.next_value::<TensorInfo>()?)
                    .is_some()
            };
            if is_duplicate {
                return Err(A::Error::custom(format_args!("duplicate key {name:?}")));
            }
        }
        let description =
            description.ok_or_else(|| A::Error::custom("does not describe a network"))?;
        Ok(SafetensorsHeader {
            description,
            tensors,
        })
    }
}

impl SafetensorsFile<'_> {
    /// Checks that tensors lie one after the other, without a gap, and up to the end.
    fn check_offsets(&self) -> Result<(), String> {
        let mut offsets: Vec<[usize; 2]> = self
            .tensors
            .values()
            .map(|entry| entry.data_offsets)
            .collect();
        offsets.sort_unstable();
        let end = offsets.iter().try_fold(0, |end, &[from, to]| {
            (from == end && to >= from).then_some(to)
        });
        let is_whole = end == Some(self.data.len());
        if is_whole {
            Ok(())
        } else {
            Err("has tensors that overlap, or bytes outside all tensors".to_owned())
        }
    }

    /// Takes the numbers of a single-precision tensor, all finite; each can be taken once.
    pub(super) fn take_tensor(&mut self, name: &str, shape: &[usize]) -> Result<Vec<f64>, String> {
        let entry = self
            .tensors
            .remove(name)
            .ok_or_else(|| format!("has no tensor {name}"))?;
        let [from, to] = entry.data_offsets;
        let numbers = self
            .data
            .get(from..to)
            .filter(|_| entry.dtype == "F32" && entry.shape == shape);
        let length = shape
            .iter()
            .try_fold(4_usize, |bytes, &size| bytes.checked_mul(size));
        let numbers = numbers.filter(|bytes| Some(bytes.len()) == length);
        let numbers: Vec<f64> = numbers
            .ok_or_else(|| format!("tensor {name} has a wrong type or shape"))?
            .as_chunks::<4>()
            .0
            .iter()
            .map(|&bytes| f32::from_le_bytes(bytes).into())
            .collect();
        if numbers.iter().all(|value| value.is_finite()) {
            Ok(numbers)
        } else {
            Err(format!(
                "tensor {name} contains a number that is not finite"
            ))
        }
    }
}

impl LinearLayer {
    /// Bounds the magnitudes of the outputs for magnitudes of the inputs up to `bounds`.
    fn max_magnitudes(&self, bounds: &[f64]) -> Vec<f64> {
        let mut sums: Vec<f64> = self.biases.iter().map(|bias| bias.abs()).collect();
        for (bound, row) in bounds
            .iter()
            .zip(self.weights.chunks_exact(self.outputs.max(1)))
        {
            sums.iter_mut()
                .zip(row)
                .for_each(|(sum, weight)| *sum += bound * weight.abs());
        }
        sums
    }
}

impl NeuralController {
    /// Reads the file of a policy or of a network.
    ///
    /// # Errors
    /// A description of the problem.
    pub fn from_bytes(bytes: &[u8]) -> Result<Self, String> {
        let (length, rest) = bytes.split_first_chunk::<8>().ok_or("is too short")?;
        let length =
            usize::try_from(u64::from_le_bytes(*length)).map_err(|error| error.to_string())?;
        let (listing, data) = rest
            .split_at_checked(length)
            .ok_or("is shorter than its header states")?;
        if length > MAX_HEADER_BYTES {
            return Err("has a header that is too long".to_owned());
        }
        let SafetensorsHeader {
            description,
            tensors,
        } = serde_json::from_slice(listing).map_err(|error| format!("header: {error}"))?;
        let mut file = SafetensorsFile { tensors, data };
        file.check_offsets()?;
        let controller = match (description.crumple_policy, description.crumple_network) {
            (Some(text), None) => policy_file::read(&text, &mut file)?,
            (None, Some(text)) => network_file::read(&text, &mut file)?,
            _ => return Err("must describe exactly one network".to_owned()),
        };
        if let Some(name) = file.tensors.keys().next() {
            return Err(format!(
                "tensor {name:?} is not part of the described network"
            ));
        }
        match controller.max_output_magnitude() {
            Ok(_) => Ok(controller),
            Err(layer) => Err(format!("can exceed single precision in layer {layer}")),
        }
    }

    /// Bounds the magnitude of the output, or returns the first layer in which a number could leave single precision.
    /// The bound |h W + b| <= |h| |W| + |b| holds for every partial sum too. All rounding bounds assume that no number
    /// leaves single precision.
    pub(super) fn max_output_magnitude(&self) -> Result<f64, usize> {
        // Half of the range is left for rounding.
        let highest = 0.5 * f64::from(f32::MAX);
        let mut bounds: Vec<f64> = self
            .inputs
            .iter()
            .map(|input| input.low.abs().max(input.high.abs()))
            .collect();
        let mut layers = 0;
        if !bounds.iter().all(|&bound| bound <= highest) {
            return Err(layers);
        }
        for step in &self.layers {
            match step {
                NetworkLayer::Linear(layer) => {
                    bounds = layer.max_magnitudes(&bounds);
                    layers += 1;
                }
                NetworkLayer::Activation(activation) => {
                    bounds.iter_mut().enumerate().for_each(|(number, bound)| {
                        *bound = activation.max_magnitude(number, *bound)
                    });
                }
            }
            if !bounds.iter().all(|&bound| bound <= highest) {
                return Err(layers.saturating_sub(1));
            }
        }
        bounds.get(self.output_index).copied().ok_or(layers)
    }
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{affine_input, constant_controller};
    use super::*;
    use crate::reach::{Activation, ControllerInput, LinearLayer, OBSERVATION_SIZE};

    fn two_input_controller(steps: Vec<NetworkLayer>, answer: usize) -> NeuralController {
        let input = |low, high| ControllerInput {
            low,
            high,
            ..affine_input([0.0; OBSERVATION_SIZE], 0.0)
        };
        NeuralController {
            inputs: vec![input(-1.0, 2.0), input(-3.0, 1.0)],
            layers: steps,
            output_index: answer,
            ..constant_controller(0.0)
        }
    }

    fn layer(weights: [f64; 4], biases: [f64; 2]) -> NetworkLayer {
        NetworkLayer::Linear(LinearLayer {
            inputs: 2,
            outputs: 2,
            weights: weights.to_vec(),
            biases: biases.to_vec(),
        })
    }

    #[test]
    fn the_largest_output_is_a_sum_of_magnitudes() {
        let plain = layer([1.0, -2.0, 0.5, 4.0], [-0.25, 1.0]);
        for (answer, expected) in [(0, 2.0 + 1.5 + 0.25), (1, 4.0 + 12.0 + 1.0)] {
            assert_eq!(
                two_input_controller(vec![plain.clone()], answer).max_output_magnitude(),
                Ok(expected)
            );
            assert_eq!(
                two_input_controller(
                    vec![plain.clone(), NetworkLayer::Activation(Activation::Tanh)],
                    answer
                )
                .max_output_magnitude(),
                Ok(1.0)
            );
        }
        assert_eq!(
            [0, 1].map(|answer| two_input_controller(vec![], answer).max_output_magnitude()),
            [Ok(2.0), Ok(3.0)]
        );
        assert_eq!(
            two_input_controller(vec![plain], 2).max_output_magnitude(),
            Err(1),
            "there is none"
        );
    }

    #[test]
    fn the_layer_that_may_leave_single_precision_is_named() {
        let half = 0.5 * f64::from(f32::MAX);
        let calm = layer([1.0, 0.0, 0.0, 1.0], [0.0, 0.0]);
        let wild = |number: f64| layer([0.25 * number, 0.0, 0.0, 0.0], [0.5 * number, 0.0]);
        assert_eq!(
            two_input_controller(vec![wild(half)], 0).max_output_magnitude(),
            Ok(half)
        );
        assert_eq!(
            two_input_controller(vec![wild(half.next_up())], 0).max_output_magnitude(),
            Err(0)
        );
        assert_eq!(
            two_input_controller(vec![calm.clone(), wild(half)], 0).max_output_magnitude(),
            Ok(half)
        );
        assert_eq!(
            two_input_controller(vec![calm.clone(), wild(half.next_up())], 0)
                .max_output_magnitude(),
            Err(1)
        );
        assert_eq!(
            two_input_controller(vec![calm.clone(), calm.clone(), wild(half.next_up())], 0)
                .max_output_magnitude(),
            Err(2)
        );
        let multiplied = NetworkLayer::Activation(Activation::Multiply(vec![half, 0.0]));
        assert_eq!(
            two_input_controller(vec![calm.clone(), calm, multiplied], 0).max_output_magnitude(),
            Err(1),
            "behind it"
        );
        let mut far = two_input_controller(vec![], 0);
        far.inputs[1].low = -half;
        assert_eq!(far.max_output_magnitude(), Ok(2.0));
        far.inputs[1].low = -half.next_up();
        assert_eq!(far.max_output_magnitude(), Err(0));
    }

    #[test]
    fn a_tensor_must_have_the_requested_type_and_shape() {
        let tensor = |dtype: &str, shape: &[usize], range: [usize; 2], numbers: [f32; 6]| {
            let data: Vec<u8> = numbers
                .iter()
                .flat_map(|number| number.to_le_bytes())
                .collect();
            let entry = TensorInfo {
                dtype: dtype.to_owned(),
                shape: shape.to_vec(),
                data_offsets: range,
            };
            let mut file = SafetensorsFile {
                tensors: [("w".to_owned(), entry)].into(),
                data: &data,
            };
            let read = file.take_tensor("w", &[2, 3]);
            assert_eq!(
                file.take_tensor("w", &[2, 3]),
                Err("has no tensor w".to_owned()),
                "a second time"
            );
            read
        };
        let (numbers, all) = ([1.0, -2.0, 0.5, 3.0, 0.25, f32::MAX], [0, 24]);
        assert_eq!(
            tensor("F32", &[2, 3], all, numbers),
            Ok(numbers.map(f64::from).to_vec())
        );
        for (dtype, shape, range) in [
            ("I32", &[2, 3][..], all),
            ("f32", &[2, 3], all),
            ("F32", &[3, 2], all),
            ("F32", &[6], all),
            ("F32", &[2, 3], [0, 20]),
            ("F32", &[2, 3], [4, 28]),
            ("F32", &[2, 3], [0, 0]),
        ] {
            let wrong = Err("tensor w has a wrong type or shape".to_owned());
            assert_eq!(
                tensor(dtype, shape, range, numbers),
                wrong,
                "{dtype} {shape:?} {range:?}"
            );
        }
        for number in [f32::NAN, f32::INFINITY] {
            let endless = tensor("F32", &[2, 3], all, [0.0, 0.0, 0.0, 0.0, 0.0, number]);
            assert_eq!(
                endless,
                Err("tensor w contains a number that is not finite".to_owned())
            );
        }
    }

    #[test]
    fn a_file_without_tensors_gets_the_expected_format() {
        let file = [&2_u64.to_le_bytes()[..], b"[]"].concat();
        let error = NeuralController::from_bytes(&file).unwrap_err();
        let expected =
            "header: invalid type: sequence, expected tensors by name, and `__metadata__`";
        assert!(error.starts_with(expected), "{error}");
    }
}
