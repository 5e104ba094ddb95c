//! Imported networks: the JSON text in the file that describes the network.
//!
//! The file must agree with its source file (`source`) and controller file. That is an assumption, unless the source is
//! read again. The text omits nothing and has no other fields:
//!
//! - `version`: 1;
//! - `source`: `format` and `sha256` of the source file;
//! - `inputs`: in order, `quantity` or `constant`, then `offset`, `scale`, `low`, `high`, and optionally `absent`;
//! - `steps`: in order, `{"linear": outputs}`, `"relu"`, `{"leaky-relu": slope}`, `{"elu": alpha}`, `"tanh"`,
//!   `"sigmoid"`, `"add"`, `"multiply"`, `"divide"`, `"clip"`;
//! - `output`: `answer`, `scale_mps2`, `offset_mps2`, `low_mps2`, `high_mps2`;
//! - `empty_gap_m`: gap to the substitute of an absent vehicle, which has the ego's speed;
//! - `decision_interval_s`: time between decisions.
//!
//! Single-precision tensors: `steps.I.weight` (one row per input) and `steps.I.bias` of products, `steps.I.operand` of
//! sums, products and quotients with constants, `steps.I.low` and `steps.I.high` of clips.

use serde::Deserialize;

use super::activation::Activation;
use super::controller::{
    ControllerInput, LinearLayer, NetworkFileSource, NetworkLayer, NeuralController,
    OBSERVATION_SIZE,
};
use super::safetensors::{MAX_LAYER_WIDTH, MAX_NUMBERS, SafetensorsFile};
use crate::canonical::is_sha256;

const VERSION: u32 = 1;
const METADATA_KEY: &str = "crumple_network";
const MAX_STEPS: usize = 256;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkFileHeader {
    version: u32,
    source: NetworkFileSource,
    inputs: Vec<NetworkFileInput>,
    steps: Vec<NetworkFileStep>,
    output: NetworkFileOutput,
    empty_gap_m: f64,
    decision_interval_s: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkFileInput {
    quantity: Option<NetworkFileQuantity>,
    constant: Option<f64>,
    offset: f64,
    scale: f64,
    low: f64,
    high: f64,
    absent: Option<f64>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "snake_case")]
enum NetworkFileQuantity {
    SpeedMps,
    AccelerationMps2,
    GapAheadM,
    SpeedAheadMps,
    RelativeSpeedAheadMps,
    AccelerationAheadMps2,
    IsAhead,
    GapBehindM,
    SpeedBehindMps,
    RelativeSpeedBehindMps,
    AccelerationBehindMps2,
    IsBehind,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum NetworkFileStep {
    Linear(usize),
    Relu,
    LeakyRelu(f64),
    Elu(f64),
    Tanh,
    Sigmoid,
    Add,
    Multiply,
    Divide,
    Clip,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NetworkFileOutput {
    answer: usize,
    scale_mps2: f64,
    offset_mps2: f64,
    low_mps2: f64,
    high_mps2: f64,
}

impl NetworkFileQuantity {
    fn coefficients(self) -> [f64; OBSERVATION_SIZE] {
        // Gaps ahead and behind; speeds ahead, own, behind; accelerations ahead, own, behind.
        match self {
            Self::GapAheadM => [1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            Self::GapBehindM => [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            Self::SpeedAheadMps => [0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            Self::SpeedMps => [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            Self::SpeedBehindMps => [0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            Self::AccelerationAheadMps2 => [0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
            Self::AccelerationMps2 => [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0],
            Self::AccelerationBehindMps2 => [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            Self::RelativeSpeedAheadMps => [0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, 0.0],
            Self::RelativeSpeedBehindMps => [0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0, 0.0],
            Self::IsAhead | Self::IsBehind => [0.0; OBSERVATION_SIZE],
        }
    }

    fn is_about_follower(self) -> bool {
        matches!(
            self,
            Self::GapBehindM
                | Self::SpeedBehindMps
                | Self::RelativeSpeedBehindMps
                | Self::AccelerationBehindMps2
        )
    }

    fn is_about_leader(self) -> bool {
        matches!(
            self,
            Self::GapAheadM
                | Self::SpeedAheadMps
                | Self::RelativeSpeedAheadMps
                | Self::AccelerationAheadMps2
        )
    }
}

impl NetworkFileInput {
    fn to_controller_input(&self) -> Result<ControllerInput, &'static str> {
        let given = [
            Some(self.offset),
            Some(self.scale),
            Some(self.low),
            Some(self.high),
            self.constant,
            self.absent,
        ];
        if !given.into_iter().flatten().all(f64::is_finite)
            || self.scale == 0.0
            || self.low > self.high
        {
            return Err("contains numbers outside their ranges");
        }
        Ok(ControllerInput {
            coefficients: self
                .quantity
                .map_or([0.0; OBSERVATION_SIZE], NetworkFileQuantity::coefficients),
            constant: match self.quantity {
                Some(NetworkFileQuantity::IsAhead | NetworkFileQuantity::IsBehind) => 1.0,
                _ => self.constant.unwrap_or(0.0),
            },
            absent_value: self.absent_value()?,
            offset: self.offset,
            scale: self.scale,
            low: self.low,
            high: self.high,
        })
    }

    /// Returns the value for an absent vehicle, which only a follower can be: a vehicle ahead is always present.
    fn absent_value(&self) -> Result<Option<f64>, &'static str> {
        match (self.quantity, self.constant) {
            (None, Some(_)) | (Some(NetworkFileQuantity::IsAhead), None)
                if self.absent.is_none() =>
            {
                Ok(None)
            }
            (Some(NetworkFileQuantity::IsBehind), None) if self.absent.is_none() => Ok(Some(0.0)),
            (Some(quantity), None) if quantity.is_about_follower() => Ok(self.absent),
            (Some(quantity), None) if quantity.is_about_leader() || self.absent.is_none() => {
                Ok(None)
            }
            _ => Err(
                "must be a quantity or a constant; `absent` is only for quantities of another vehicle",
            ),
        }
    }
}

impl NetworkFileHeader {
    fn check(&self) -> Result<(), String> {
        let Self {
            version,
            source,
            inputs,
            steps,
            output,
            empty_gap_m,
            decision_interval_s,
        } = self;
        if *version != VERSION {
            return Err(format!(
                "{METADATA_KEY}: version {version} is not supported: this release reads {VERSION}"
            ));
        }
        if !is_sha256(&source.sha256) {
            return Err(format!("{METADATA_KEY}: source: `sha256` is not a SHA-256"));
        }
        if !(1..=MAX_LAYER_WIDTH).contains(&inputs.len()) || steps.len() > MAX_STEPS {
            return Err("describes too large a network".to_owned());
        }
        let are_positive = [empty_gap_m, decision_interval_s]
            .into_iter()
            .all(|value| *value > 0.0 && value.is_finite());
        if !are_positive {
            return Err(format!(
                "{METADATA_KEY}: `empty_gap_m` and `decision_interval_s` must be positive"
            ));
        }
        output.check()
    }
}

impl NetworkFileOutput {
    fn check(&self) -> Result<(), String> {
        let Self {
            scale_mps2,
            offset_mps2,
            low_mps2,
            high_mps2,
            ..
        } = self;
        let is_finite = [scale_mps2, offset_mps2, low_mps2, high_mps2]
            .into_iter()
            .all(|value| value.is_finite());
        if is_finite && low_mps2 < high_mps2 {
            Ok(())
        } else {
            Err(format!(
                "{METADATA_KEY}: output: numbers that are not finite and in order"
            ))
        }
    }
}

pub(super) fn read(text: &str, file: &mut SafetensorsFile<'_>) -> Result<NeuralController, String> {
    let header: NetworkFileHeader =
        serde_json::from_str(text).map_err(|error| format!("{METADATA_KEY}: {error}"))?;
    header.check()?;
    let inputs = header
        .inputs
        .iter()
        .enumerate()
        .map(|(index, input)| {
            input
                .to_controller_input()
                .map_err(|problem| format!("{METADATA_KEY}: inputs[{index}]: {problem}"))
        })
        .collect::<Result<Vec<_>, _>>()?;
    let layers = read_layers(&header, file)?;
    let NetworkFileOutput {
        answer,
        scale_mps2,
        offset_mps2,
        low_mps2,
        high_mps2,
    } = header.output;
    let mut controller = NeuralController {
        inputs,
        layers,
        output_index: answer,
        scale_mps2,
        offset_mps2,
        action_bounds_mps2: [low_mps2, high_mps2],
        is_clipped: true,
        empty_gap_m: header.empty_gap_m,
        decision_interval_s: header.decision_interval_s,
        source: Some(header.source),
    };
    controller.is_clipped = !controller.stays_within_action_bounds();
    Ok(controller)
}

/// Reads the layers and checks that the last one has the answer.
fn read_layers(
    header: &NetworkFileHeader,
    file: &mut SafetensorsFile<'_>,
) -> Result<Vec<NetworkLayer>, String> {
    let mut layers = Vec::new();
    let mut width = header.inputs.len();
    let mut numbers = width;
    for (index, step) in header.steps.iter().enumerate() {
        let layer = step.read_layer(index, width, file)?;
        match &layer {
            NetworkLayer::Linear(layer) => width = layer.outputs,
            // It adds at most one symbol per number.
            NetworkLayer::Activation(_) => numbers += width,
        }
        if numbers > MAX_NUMBERS {
            return Err("describes too large a network".to_owned());
        }
        layers.push(layer);
    }
    let answer = header.output.answer;
    if answer >= width {
        return Err(format!(
            "{METADATA_KEY}: output: there is no output {answer}"
        ));
    }
    Ok(layers)
}

impl NeuralController {
    /// True if the last activation bounds the output so that no command exceeds the action bounds.
    fn stays_within_action_bounds(&self) -> bool {
        let is_bounded = matches!(
            self.layers.last(),
            Some(NetworkLayer::Activation(
                Activation::Tanh | Activation::Sigmoid | Activation::Clip { .. }
            ))
        );
        let [low_mps2, high_mps2] = self.action_bounds_mps2;
        // Double-precision arithmetic is monotone, so the largest output decides for all. A sum may round up.
        is_bounded
            && self.max_output_magnitude().is_ok_and(|largest| {
                let farthest = (self.scale_mps2 * largest).abs();
                self.offset_mps2 + farthest <= high_mps2 && self.offset_mps2 - farthest >= low_mps2
            })
    }
}

impl NetworkFileStep {
    fn read_layer(
        &self,
        index: usize,
        width: usize,
        file: &mut SafetensorsFile<'_>,
    ) -> Result<NetworkLayer, String> {
        let mut tensor =
            |name: &str, shape: &[usize]| file.take_tensor(&format!("steps.{index}.{name}"), shape);
        Ok(NetworkLayer::Activation(match *self {
            Self::Linear(outputs) => {
                if !(1..=MAX_LAYER_WIDTH).contains(&outputs) || width > MAX_LAYER_WIDTH {
                    return Err(step_error(index, "is too wide"));
                }
                return Ok(NetworkLayer::Linear(LinearLayer {
                    inputs: width,
                    outputs,
                    weights: tensor("weight", &[width, outputs])?,
                    biases: tensor("bias", &[outputs])?,
                }));
            }
            Self::Relu => Activation::Relu,
            Self::LeakyRelu(number) | Self::Elu(number) if !is_single_precision(number) => {
                return Err(step_error(index, "is not a number in single precision"));
            }
            Self::LeakyRelu(slope) => Activation::LeakyRelu(slope),
            Self::Elu(alpha) => Activation::Elu(alpha),
            Self::Tanh => Activation::Tanh,
            Self::Sigmoid => Activation::Sigmoid,
            Self::Add => Activation::Add(tensor("operand", &[width])?),
            Self::Multiply => Activation::Multiply(tensor("operand", &[width])?),
            Self::Divide => {
                let operands = tensor("operand", &[width])?;
                if operands.contains(&0.0) {
                    return Err(step_error(index, "divides by 0"));
                }
                Activation::Divide(operands)
            }
            Self::Clip => {
                let low = tensor("low", &[width])?;
                let high = tensor("high", &[width])?;
                if !low.iter().zip(&high).all(|(low, high)| low <= high) {
                    return Err(step_error(index, "has a lower limit above the upper one"));
                }
                Activation::Clip { low, high }
            }
        }))
    }
}

fn step_error(index: usize, problem: &str) -> String {
    format!("{METADATA_KEY}: steps[{index}]: {problem}")
}

/// True if a number is in single precision, like those of the network.
fn is_single_precision(number: f64) -> bool {
    number.is_finite() && f64::from(number as f32) == number
}
