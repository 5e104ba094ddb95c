//! Unchecked content of space files.

use std::fmt;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::copula::Dependence;
use super::observed::{DrivingExposure, ObservedData};
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Driver, ScenarioSpec, VehicleClass};

/// Space file version that this release reads and writes.
pub const SPACE_VERSION: u32 = 1;

/// Content of a space file: a scenario and the parameters that vary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields, expecting = "a space: a table of fields")]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "Space", title = "crumple search space, version 1")
)]
pub struct SpaceSpec {
    /// Version of the file format: 1.
    pub version: u32,
    /// Short name, which begins the names of its scenarios.
    pub name: String,
    /// Coverage and purpose of the space, in a few sentences.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub about: String,
    /// Scenario in which the parameters vary, with the nominal values.
    pub base: Base,
    /// Parameters; 1 to 200, with at most 1000 coordinates.
    #[cfg_attr(feature = "schema", schemars(length(min = 1, max = 200)))]
    pub parameters: Vec<ParameterSpec>,
    /// Dependence of the parameters. Default: independent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dependence: Option<Dependence>,
    /// Driving in which the distribution was observed, for failures per hour and kilometre.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure: Option<DrivingExposure>,
    /// Values to which the distribution was fitted, for refits to resamples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub observed: Option<ObservedData>,
}

/// The base scenario: inline, or the name of a built-in one or of a file.
#[derive(Debug, Clone, PartialEq)]
pub enum Base {
    /// Built-in scenario, or file; a relative path starts at the folder of the space file.
    Named(String),
    /// Inline scenario.
    Inline(Box<ScenarioSpec>),
}

/// A parameter of a space.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ParameterSpec {
    /// Name in logs and summaries: letters, digits and underscores.
    pub name: String,
    /// Field of the scenario, such as `environment.friction` or `vehicles[2].gap_m`.
    pub field: String,
    /// Unit of the field, repeated for readers; `1` for a share, empty for a class or a driver. `m/s2` may stand for
    /// `m/s²`.
    #[serde(default)]
    pub unit: String,
    /// Nominal value. Default: the value in the base scenario.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nominal: Option<ParameterValue>,
    /// Distribution and range.
    pub distribution: DistributionSpec,
}

/// Distribution of a parameter. Each piece of a signal has this distribution independently.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DistributionSpec {
    /// Uniform.
    Uniform(UniformSpec),
    /// Uniform on a logarithmic scale.
    LogUniform(UniformSpec),
    /// Normal, truncated to the range.
    Normal(NormalSpec),
    /// Log-normal, truncated to the range.
    LogNormal(LogNormalSpec),
    /// Gamma, truncated to the range.
    Gamma(ShapeScaleSpec),
    /// Weibull, truncated to the range.
    Weibull(ShapeScaleSpec),
    /// Constant density in each of several bins.
    Histogram(HistogramSpec),
    /// One of a few values.
    Choice(ChoiceSpec),
    /// One value with positive probability, and a density over all others.
    PointMass(PointMassSpec),
}

/// A range, both ends included.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct UniformSpec {
    /// Smallest value; above 0 on a logarithmic scale.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// A truncated normal distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct NormalSpec {
    /// Mean before truncation.
    pub mean: f64,
    /// Standard deviation before truncation; above 0.
    pub deviation: f64,
    /// Smallest value.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// A truncated log-normal distribution.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LogNormalSpec {
    /// Mean of the logarithm before truncation.
    pub ln_mean: f64,
    /// Standard deviation of the logarithm before truncation; above 0.
    pub ln_deviation: f64,
    /// Smallest value, from 0.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// A truncated distribution of positive values with a shape and a scale.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ShapeScaleSpec {
    /// Shape: 1 is exponential; from 0.01 to 1 000 000.
    pub shape: f64,
    /// Scale, in the parameter's unit; above 0.
    pub scale: f64,
    /// Smallest value, from 0.
    pub low: f64,
    /// Largest value.
    pub high: f64,
}

/// Constant densities in adjacent bins.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct HistogramSpec {
    /// Limits of the bins, increasing; one more than bins.
    pub edges: Vec<f64>,
    /// Relative probability of each bin.
    pub weights: Vec<f64>,
}

/// A value with positive probability beside a density, such as the final speed of braking vehicles, some of which stop.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct PointMassSpec {
    /// Value with positive probability: an end of the range of the others, or outside it.
    pub at: f64,
    /// Probability of the value: from 0, below 1.
    pub probability: f64,
    /// Distribution of all other values: neither a choice nor another point mass.
    pub others: Box<DistributionSpec>,
}

/// A choice of a few values.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct ChoiceSpec {
    /// Numbers, vehicle classes, built-in controllers, presets, or kinds of followers.
    pub values: Vec<ParameterValue>,
    /// Relative weights of the values. Default: equal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights: Option<Vec<f64>>,
}

/// A value of a parameter.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(
    untagged,
    expecting = "must be a number, a vehicle class, a built-in controller, a preset, `late`, `weak` or `none`"
)]
pub enum ParameterValue {
    /// A number in the field's unit.
    Number(f64),
    /// A vehicle class.
    Class(VehicleClass),
    /// A built-in controller with its default settings, or a preset.
    Driver(DriverName),
    /// A follower that differs from `baseline`, or none.
    Follower(FollowerVariant),
}

/// A kind of follower that no name of a controller states.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum FollowerVariant {
    /// `baseline` that reacts 0.5 s later.
    Late,
    /// `baseline` with 0.7 times its largest deceleration.
    Weak,
    /// No vehicle.
    None,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ValueKind {
    Number,
    Class,
    Driver,
    Follower,
}

impl ValueKind {
    /// Returns the name of a value in points; `None` for a number.
    pub(super) fn value_name(self, value: f64) -> Option<&'static str> {
        match self {
            Self::Number => None,
            Self::Class => VehicleClass::ALL
                .get(value as usize)
                .map(|class| class.name()),
            Self::Driver => DriverName::from_number(value).map(DriverName::name),
            Self::Follower => FollowerVariant::from_number(value)
                .map(FollowerVariant::name)
                .or_else(|| DriverName::from_number(value).map(DriverName::name)),
        }
    }
}

impl ParameterValue {
    pub(super) fn kind(self) -> ValueKind {
        match self {
            Self::Number(_) => ValueKind::Number,
            Self::Class(_) => ValueKind::Class,
            Self::Driver(_) => ValueKind::Driver,
            Self::Follower(_) => ValueKind::Follower,
        }
    }
}

/// The name of a built-in controller, or of a preset.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DriverName(&'static str);

impl DriverName {
    /// Number of the first preset in points. The numbers of built-in controllers are below, those of
    /// [`FollowerVariant`] above.
    const FIRST_PRESET: usize = 500;

    /// Returns the name if it is that of a built-in controller or of a preset.
    #[must_use]
    pub fn find(name: &str) -> Option<Self> {
        let preset = BuiltInController::presets().find(|preset| preset.name == name);
        preset
            .map(|preset| Self(preset.name))
            .or_else(|| BuiltInController::from_name(name).map(|spec| Self(spec.name())))
    }

    /// Returns the name of a driver; `None` for a script and for a controller of a file.
    pub(super) fn of_driver(driver: &Driver) -> Option<Self> {
        match driver {
            Driver::Controller(controller) => {
                Some(Self(controller.preset_name().unwrap_or(controller.name())))
            }
            _ => None,
        }
    }

    /// Returns the name.
    #[must_use]
    pub fn name(self) -> &'static str {
        self.0
    }

    pub(super) fn controller(self) -> Option<BuiltInController> {
        BuiltInController::from_name_or_preset(self.0)
    }

    /// Returns the number that represents the name in points: the index among the built-in controllers, or that among
    /// the presets, plus [`Self::FIRST_PRESET`].
    pub(super) fn number(self) -> f64 {
        let all = BuiltInController::all();
        let mut presets = BuiltInController::presets();
        let preset =
            || Some(presets.position(|preset| preset.name == self.0)? + Self::FIRST_PRESET);
        let built_in = all.iter().position(|spec| spec.name() == self.0);
        let index = built_in.or_else(preset);
        index.map_or(f64::NAN, |index| index as f64)
    }

    pub(super) fn from_number(number: f64) -> Option<Self> {
        let index = number as usize;
        match index.checked_sub(Self::FIRST_PRESET) {
            Some(preset) => BuiltInController::presets()
                .nth(preset)
                .map(|preset| Self(preset.name)),
            None => BuiltInController::all()
                .get(index)
                .map(|spec| Self(spec.name())),
        }
    }
}

impl FollowerVariant {
    /// All variants.
    pub(super) const ALL: [Self; 3] = [Self::Late, Self::Weak, Self::None];
    /// Number of the first variant in points. The numbers of built-in controllers are below.
    const FIRST_NUMBER: f64 = 1000.0;

    /// Returns the name in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Late => "late",
            Self::Weak => "weak",
            Self::None => "none",
        }
    }

    pub(super) fn number(self) -> f64 {
        Self::FIRST_NUMBER + f64::from(self as u8)
    }

    pub(super) fn from_number(number: f64) -> Option<Self> {
        Self::ALL
            .into_iter()
            .find(|variant| variant.number() == number)
    }
}

impl Serialize for DriverName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.0)
    }
}

impl<'de> Deserialize<'de> for DriverName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        let name = String::deserialize(deserializer)?;
        Self::find(&name)
            .ok_or_else(|| de::Error::custom(format!("there is no controller `{name}`")))
    }
}

/// Writes distribution and range for readers, without the unit.
impl fmt::Display for DistributionSpec {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Uniform(UniformSpec { low, high }) => write!(out, "{low} to {high}, evenly"),
            Self::LogUniform(UniformSpec { low, high }) => {
                write!(out, "{low} to {high}, evenly on a logarithmic scale")
            }
            Self::Normal(normal) => write!(
                out,
                "{} to {}, normal: {} ± {}",
                normal.low, normal.high, normal.mean, normal.deviation
            ),
            Self::LogNormal(normal) => write!(
                out,
                "{} to {}, log-normal: logarithm {} ± {}",
                normal.low, normal.high, normal.ln_mean, normal.ln_deviation
            ),
            Self::Gamma(gamma) => write_shape_and_scale(out, "gamma", gamma),
            Self::Weibull(weibull) => write_shape_and_scale(out, "Weibull", weibull),
            Self::Histogram(HistogramSpec { edges, weights }) => write!(
                out,
                "histogram with edges {} and weights {}",
                join_numbers(edges, ", "),
                join_numbers(weights, ", ")
            ),
            Self::Choice(ChoiceSpec { values, weights }) => {
                let values: Vec<String> = values.iter().map(ParameterValue::to_string).collect();
                write!(out, "{}", values.join(" or "))?;
                match weights.as_deref() {
                    None | Some([]) => Ok(()),
                    Some(weights) => write!(out, ", {}", join_numbers(weights, " to ")),
                }
            }
            Self::PointMass(PointMassSpec {
                at,
                probability,
                others,
            }) => write!(
                out,
                "{at} with probability {probability}, otherwise {others}"
            ),
        }
    }
}

fn write_shape_and_scale(
    out: &mut fmt::Formatter<'_>,
    family: &str,
    spec: &ShapeScaleSpec,
) -> fmt::Result {
    let ShapeScaleSpec {
        shape,
        scale,
        low,
        high,
    } = spec;
    write!(
        out,
        "{low} to {high}, {family}: shape {shape}, scale {scale}"
    )
}

fn join_numbers(numbers: &[f64], separator: &str) -> String {
    let texts: Vec<String> = numbers.iter().map(f64::to_string).collect();
    texts.join(separator)
}

impl fmt::Display for ParameterValue {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(number) => number.fmt(out),
            Self::Class(class) => out.write_str(class.name()),
            Self::Driver(driver) => out.write_str(driver.name()),
            Self::Follower(variant) => out.write_str(variant.name()),
        }
    }
}

impl Serialize for Base {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Named(name) => serializer.serialize_str(name),
            Self::Inline(spec) => spec.serialize(serializer),
        }
    }
}

impl<'de> Deserialize<'de> for Base {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        /// An untagged enum would lose line and field of an error inside the scenario.
        struct BaseVisitor;
        impl<'de> de::Visitor<'de> for BaseVisitor {
            type Value = Base;

            fn expecting(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
                out.write_str("a scenario's name, or a scenario")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<Base, E> {
                Ok(Base::Named(name.to_owned()))
            }

            fn visit_map<A: de::MapAccess<'de>>(self, map: A) -> Result<Base, A::Error> {
                let spec = ScenarioSpec::deserialize(de::value::MapAccessDeserializer::new(map))?;
                Ok(Base::Inline(Box::new(spec)))
            }
        }
        deserializer.deserialize_any(BaseVisitor)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for DriverName {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "DriverName".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let all = BuiltInController::all();
        let mut names: Vec<_> = all.iter().map(BuiltInController::name).collect();
        names.extend(BuiltInController::presets().map(|preset| preset.name));
        schemars::json_schema!({
            "description": "The name of a built-in controller, or of a preset.",
            "enum": names
        })
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Base {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Base".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let inline = generator.subschema_for::<ScenarioSpec>();
        schemars::json_schema!({
            "description": "The base scenario: the name of a built-in one or of a file, or spelled out.",
            "anyOf": [{ "type": "string" }, inline],
        })
    }
}
