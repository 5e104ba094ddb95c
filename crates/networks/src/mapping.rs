//! Mapping from observations to the inputs of an external controller, and from its answer to a command.

use serde::{Deserialize, Serialize};

use crumple_core::field_error::FieldError;
use crumple_sim::control::ObservedQuantity;
use crumple_sim::observation::Observation;
use crumple_sim::policy::{ActionBounds, ObservationScaling};

/// Default clipping limit of network inputs.
const INPUT_CLIP: f64 = 1e6;

const MAX_INPUTS: usize = 4096;
const MAX_HISTORY: usize = 1000;

/// Largest absolute answer of a process without a controller file, in m/s²; no vehicle of a scenario may exceed it.
const MAX_ANSWER_MPS2: f64 = 30.0;

/// Time between the decisions of crumple's own policies, in seconds.
const NATIVE_INTERVAL_S: f64 = 0.1;

/// One input of a controller: (quantity - offset) / scale, clipped to low and high; or a constant.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct InputMapping {
    /// Observed quantity; either this or a constant.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub quantity: Option<ObservedQuantity>,
    /// Input variable of an FMU; default: the name of the quantity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    /// Constant input, such as a set speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub constant: Option<f64>,
    /// Offset that is subtracted, in the unit of the quantity.
    #[serde(default)]
    pub offset: f64,
    /// Divisor, in the unit of the quantity; not 0.
    #[serde(default = "default_one")]
    pub scale: f64,
    /// Lower clipping limit.
    #[serde(default = "default_low")]
    pub low: f64,
    /// Upper clipping limit.
    #[serde(default = "default_high")]
    pub high: f64,
    /// Unscaled value without such a vehicle. Default: that of a vehicle 80 m away at the own speed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub absent: Option<f64>,
}

fn default_one() -> f64 {
    1.0
}

fn default_low() -> f64 {
    -INPUT_CLIP
}

fn default_high() -> f64 {
    INPUT_CLIP
}

/// Function that is applied to an answer before scaling.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Squash {
    /// Hyperbolic tangent.
    Tanh,
}

/// Command that an answer stands for: offset + scale x answer, clipped to low and high.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct OutputMapping {
    /// Output variable of an FMU; default: the only one, or `acceleration_mps2`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub variable: Option<String>,
    /// Index of the answer, from 0; required if the controller has several.
    #[serde(default)]
    pub answer: Option<usize>,
    /// Function that is applied to the answer before scaling.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub squash: Option<Squash>,
    /// Factor, in m/s².
    #[serde(default = "default_one")]
    pub scale_mps2: f64,
    /// Offset that is added, in m/s².
    #[serde(default)]
    pub offset_mps2: f64,
    /// Minimum acceleration, in m/s².
    pub low_mps2: f64,
    /// Maximum acceleration, in m/s².
    pub high_mps2: f64,
}

/// Inputs that stand for the decisions before the first.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum HistoryPadding {
    /// The inputs of the first decision.
    #[default]
    First,
    /// Zeros.
    Zeros,
}

impl HistoryPadding {
    /// Returns true for the first inputs.
    #[must_use]
    pub fn is_default(&self) -> bool {
        *self == Self::default()
    }
}

/// Mapping of an external controller: its inputs, its decision interval and the meaning of its answer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Mapping {
    /// Time between decisions, in seconds. `None` for a decision at every step, or as the process states.
    pub decision_interval_s: Option<f64>,
    /// Number of decisions whose inputs the controller receives; 1 for the current one only.
    pub history: usize,
    /// Padding before the first decision. Skipped when default, so that hashes of version-1 mappings do not change.
    #[serde(skip_serializing_if = "HistoryPadding::is_default")]
    pub history_padding: HistoryPadding,
    /// True if the current inputs come first; otherwise they come last.
    pub newest_first: bool,
    /// Inputs, in order.
    pub inputs: Vec<InputMapping>,
    /// Meaning of the answer.
    pub output: OutputMapping,
}

/// Error of a mapping.
pub type InvalidMapping = FieldError;

impl Mapping {
    /// Returns the mapping of crumple's own policies: the paper's eight numbers, and an answer from -1 to 1.
    #[must_use]
    pub fn native() -> Self {
        use ObservedQuantity as Q;
        let scaling = ObservationScaling::default();
        let action = ActionBounds::default();
        let order = [
            Q::GapAheadM,
            Q::GapBehindM,
            Q::SpeedAheadMps,
            Q::SpeedMps,
            Q::SpeedBehindMps,
            Q::AccelerationAheadMps2,
            Q::AccelerationMps2,
            Q::AccelerationBehindMps2,
        ];
        let offsets_and_scales = scaling.offset.into_iter().zip(scaling.scale);
        let inputs =
            order
                .into_iter()
                .zip(offsets_and_scales)
                .map(|(quantity, (offset, scale))| InputMapping {
                    offset,
                    scale,
                    low: -scaling.limit,
                    high: scaling.limit,
                    absent: matches!(quantity, Q::GapAheadM | Q::GapBehindM)
                        .then_some(scaling.empty_gap_m),
                    ..InputMapping::unscaled(quantity)
                });
        Self {
            decision_interval_s: Some(NATIVE_INTERVAL_S),
            history: scaling.history,
            history_padding: HistoryPadding::First,
            newest_first: false,
            inputs: inputs.collect(),
            output: OutputMapping::native(&action),
        }
    }

    /// Returns the mapping of processes without a controller file. Inputs are all quantities in their own units; the
    /// answer is an acceleration, which may exceed the limits of any vehicle.
    #[must_use]
    pub fn unscaled() -> Self {
        use ObservedQuantity as Q;
        let order = [
            Q::GapAheadM,
            Q::RelativeSpeedAheadMps,
            Q::AccelerationAheadMps2,
            Q::SpeedMps,
            Q::AccelerationMps2,
            Q::GapBehindM,
            Q::RelativeSpeedBehindMps,
            Q::AccelerationBehindMps2,
            Q::IsAhead,
            Q::IsBehind,
        ];
        Self {
            decision_interval_s: None,
            history: 1,
            history_padding: HistoryPadding::First,
            newest_first: false,
            inputs: order.map(InputMapping::unscaled).into(),
            output: OutputMapping {
                variable: None,
                answer: None,
                squash: None,
                scale_mps2: 1.0,
                offset_mps2: 0.0,
                low_mps2: -MAX_ANSWER_MPS2,
                high_mps2: MAX_ANSWER_MPS2,
            },
        }
    }

    /// Returns the number of inputs of the controller, with those of earlier decisions.
    #[must_use]
    pub fn width(&self) -> usize {
        self.inputs.len() * self.history
    }

    /// Checks the mapping.
    ///
    /// # Errors
    /// [`InvalidMapping`] names the first field that is wrong.
    pub fn check(&self) -> Result<(), InvalidMapping> {
        if let Some(interval_s) = self
            .decision_interval_s
            .filter(|interval_s| !(interval_s.is_finite() && *interval_s > 0.0))
        {
            let problem = format!("must be positive, found {interval_s}");
            return Err(InvalidMapping::new("decision_interval_s", problem));
        }
        if !(1..=MAX_HISTORY).contains(&self.history) {
            let problem = format!("must be from 1 to {MAX_HISTORY}, found {}", self.history);
            return Err(InvalidMapping::new("history", problem));
        }
        if !(1..=MAX_INPUTS).contains(&self.inputs.len()) {
            let problem = format!("must be 1 to {MAX_INPUTS}, found {}", self.inputs.len());
            return Err(InvalidMapping::new("inputs", problem));
        }
        for (index, input) in self.inputs.iter().enumerate() {
            input
                .check()
                .map_err(|invalid| invalid.within(&format!("inputs[{index}]")))?;
        }
        self.output
            .check()
            .map_err(|invalid| invalid.within("output."))
    }

    /// Returns the inputs that follow from an observation.
    #[inline]
    pub fn input_values(
        &self,
        observation: &Observation,
        last_answer_mps2: f64,
    ) -> impl Iterator<Item = f64> {
        self.inputs
            .iter()
            .map(move |input| input.value(observation, last_answer_mps2))
    }

    pub(super) fn limits(&self) -> Vec<[f64; 2]> {
        let has_zeros = self.history > 1 && self.history_padding == HistoryPadding::Zeros;
        let limits = self.inputs.iter().map(|input| {
            let [low, high] = input.limits();
            if has_zeros {
                [low.min(0.0), high.max(0.0)]
            } else {
                [low, high]
            }
        });
        limits.collect::<Vec<_>>().repeat(self.history)
    }

    /// Returns the acceleration of a network's answer, in m/s², clipped to its range; the minimum for NaN.
    #[must_use]
    #[inline]
    pub fn acceleration_mps2(&self, answer: f32) -> f64 {
        let answer = match self.output.squash {
            Some(Squash::Tanh) => libm::tanhf(answer),
            None => answer,
        };
        let OutputMapping {
            scale_mps2,
            offset_mps2,
            low_mps2,
            high_mps2,
            ..
        } = self.output;
        let wanted_mps2 = offset_mps2 + scale_mps2 * f64::from(answer);
        if wanted_mps2 > high_mps2 {
            high_mps2
        } else if wanted_mps2 >= low_mps2 {
            wanted_mps2
        } else {
            low_mps2
        }
    }

    /// Returns the unclipped acceleration of an answer, and its allowed range, in m/s².
    pub fn acceleration_and_range_mps2(&self, answer: f64) -> (f64, [f64; 2]) {
        let OutputMapping {
            squash,
            scale_mps2,
            offset_mps2,
            low_mps2,
            high_mps2,
            ..
        } = self.output;
        let answer = match squash {
            Some(Squash::Tanh) => libm::tanh(answer),
            None => answer,
        };
        (offset_mps2 + scale_mps2 * answer, [low_mps2, high_mps2])
    }
}

impl InputMapping {
    /// Returns the mapping of a quantity in its own unit.
    #[must_use]
    pub fn unscaled(quantity: ObservedQuantity) -> Self {
        Self {
            quantity: Some(quantity),
            variable: None,
            constant: None,
            offset: 0.0,
            scale: 1.0,
            low: default_low(),
            high: default_high(),
            absent: None,
        }
    }

    /// Returns the name of the quantity, or `constant`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.quantity.map_or("constant", ObservedQuantity::name)
    }

    fn check(&self) -> Result<(), InvalidMapping> {
        let finite = [
            (".offset", self.offset),
            (".scale", self.scale),
            (".low", self.low),
            (".high", self.high),
        ];
        let given = [(".constant", self.constant), (".absent", self.absent)];
        let given = given
            .into_iter()
            .filter_map(|(field, value)| Some((field, value?)));
        if let Some((field, value)) = finite
            .into_iter()
            .chain(given)
            .find(|(_, value)| !value.is_finite())
        {
            let problem = format!("must be a finite number, found {value}");
            return Err(InvalidMapping::new(field, problem));
        }
        self.check_source()?;
        if self.scale == 0.0 {
            return Err(InvalidMapping::new(".scale", "must not be 0"));
        }
        if self.low > self.high {
            let problem = format!("must not be above high, {}", self.high);
            return Err(InvalidMapping::new(".low", problem));
        }
        Ok(())
    }

    /// Checks that the input is a quantity or a constant, and that only a neighbour may be absent.
    fn check_source(&self) -> Result<(), InvalidMapping> {
        match (self.quantity, self.constant) {
            (None, None) => Err(InvalidMapping::new("", "needs a quantity or a constant")),
            (Some(_), Some(_)) => Err(InvalidMapping::new(
                ".constant",
                "an input is a quantity or a constant, not both",
            )),
            (Some(quantity), None) if self.absent.is_some() && !quantity.is_of_neighbour() => {
                Err(InvalidMapping::new(
                    ".absent",
                    "is allowed only for quantities of another vehicle",
                ))
            }
            (None, Some(_)) if self.absent.is_some() => {
                Err(InvalidMapping::new(".absent", "a constant is always there"))
            }
            _ => Ok(()),
        }
    }

    /// Returns the smallest and the largest input.
    #[must_use]
    pub fn limits(&self) -> [f64; 2] {
        match self.constant {
            Some(constant) => [self.scaled(constant); 2],
            None => [self.low, self.high],
        }
    }

    #[inline]
    pub(super) fn scaled(&self, value: f64) -> f64 {
        let scaled = (value - self.offset) / self.scale;
        let scaled = if scaled.is_nan() { 0.0 } else { scaled };
        let scaled = if scaled < self.low { self.low } else { scaled };
        if scaled > self.high {
            self.high
        } else {
            scaled
        }
    }

    #[inline]
    fn value(&self, observation: &Observation, last_answer_mps2: f64) -> f64 {
        let value = match (self.constant, self.quantity) {
            (Some(constant), _) => constant,
            (None, Some(quantity)) => quantity.value(observation, last_answer_mps2, self.absent),
            (None, None) => 0.0,
        };
        self.scaled(value)
    }
}

impl OutputMapping {
    /// Returns the mapping of an answer from -1 to 1 to the accelerations of a policy.
    fn native(action: &ActionBounds) -> Self {
        Self {
            variable: None,
            answer: None,
            squash: None,
            scale_mps2: 0.5 * (action.high_mps2 - action.low_mps2),
            offset_mps2: 0.5 * (action.low_mps2 + action.high_mps2),
            low_mps2: action.low_mps2,
            high_mps2: action.high_mps2,
        }
    }

    fn check(&self) -> Result<(), InvalidMapping> {
        let numbers = [
            ("scale_mps2", self.scale_mps2),
            ("offset_mps2", self.offset_mps2),
            ("low_mps2", self.low_mps2),
            ("high_mps2", self.high_mps2),
        ];
        if let Some((field, value)) = numbers.into_iter().find(|(_, value)| !value.is_finite()) {
            let problem = format!("must be a finite number, found {value}");
            return Err(InvalidMapping::new(field, problem));
        }
        if self.low_mps2 >= self.high_mps2 {
            let problem = format!("must be below high_mps2, {}", self.high_mps2);
            return Err(InvalidMapping::new("low_mps2", problem));
        }
        Ok(())
    }
}
