//! Search spaces: scenarios with parameters that vary, each with a range, a unit and a distribution.
//!
//! [`SpaceSpec`] is the unchecked content of a file. [`ScenarioSpace`] is a spec whose points are all valid scenarios.
//! Field paths are resolved once; a scenario of a point costs a few microseconds.
//!
//! # Points, values, scenarios
//!
//! A *point* lies in the unit cube, with one coordinate for each parameter, or for each piece of a signal. A coordinate
//! is uniform over the *range* of its parameter for any distribution, so that a search reaches unlikely corners as
//! easily as likely ones. [`ScenarioSpace::ln_likelihood`] is the logarithm of the distribution's density with respect
//! to points; it is 0 where the distribution is uniform over the range. [`ScenarioSpace::draw`] samples scenarios from
//! the distribution (failure rates, training, test sets); [`ScenarioSpace::quantile`] maps uniform numbers through the
//! inverse CDF. Expectations under the distribution are thus integrals over uniform numbers u of f(quantile(u)), or
//! over points x of f(x) exp(ln_likelihood(x)).
//!
//! # Fields
//!
//! A parameter names a number of the scenario file by its path (`environment.friction`, `vehicles[2].reaction_delay_s`,
//! `vehicles[0].driver.brake.rate_mps2`), a vehicle's class, a number of all vehicles (`vehicles[*].speed_mps`), a
//! signal (`vehicles[0].driver.pieces.accel_mps2`, with a coordinate for each piece of the base scenario), or a derived
//! field, which rules out invalid combinations:
//!
//! | field | value |
//! |---|---|
//! | `vehicles[i].gap_m` | the bumper gap ahead; vehicles are placed behind the leader without overlap |
//! | `vehicles[i].time_gap_s` | the gap ahead as a time at the vehicle's own speed |
//! | `vehicles[i].closing_time_s` | the gap ahead as a time at the closing speed; at least 2 m |
//! | `vehicles[i].speed_share` | a factor of the vehicle's speed |
//! | `vehicles[i].driver` | a choice of built-in controllers with default settings |
//! | `vehicles[i].size_m` | length, with the class of that length: heavy from 7.5 m on |
//! | `vehicles[i].load` | mass relative to its class's, at equal brake force: deceleration falls as 1 / load above 1 |
//! | `vehicles[i].brake_offset_mps2` | largest deceleration relative to its class's |
//! | `vehicles[i].driver.NAME.rate_share` | rate of a braking script, relative to the vehicle's limit on this road |
//! | `vehicles[i].driver.brake-to-speed.final_share` | final speed of a braking script, relative to its initial speed |
//! | `vehicles[i].driver.pieces.brake_share` | rate of every piece, relative to the vehicle's limit on this road |
//! | `vehicles[i].driver.pieces.onset_s` | start of the first piece; the intervals between pieces stay |
//! | `vehicles[i].driver.pieces.cruise_mps2` | acceleration of every piece, limited to keep 18 to 130 km/h |
//! | `vehicles[i].driver.pieces.stop_and_go_mps2` | acceleration of every piece, limited to keep 0 to 130 km/h |
//! | `vehicles[i].follower` | kind of the last vehicle: a built-in controller, `late`, `weak` or `none` |
//! | `vehicles[i].driver.pieces.scale` | factor of all pieces, applied last: 0 is a constant speed |
//!
//! # Dependence
//!
//! Parameters are independent unless `dependence` states a Gaussian copula: uniform numbers u become normal scores z =
//! Φ⁻¹(u), correlated scores y = L z with L Lᵀ the correlation matrix, and probabilities Φ(y) for the inverse CDF of
//! each parameter (Nelsen, An Introduction to Copulas, 2006, 2.3 and 3.1). Ranges, and thus points, do not change. A
//! value with positive probability has an interval of probabilities. The value's slice of the coordinate maps to that
//! interval, so that densities of points are exact. A point that is made from values lies in the middle of the slice.
//!
//! In a space without positions all vehicles keep their bumper gaps when lengths or classes vary.

mod built_in;
mod check;
mod copula;
#[cfg(test)]
mod copula_tests;
mod derived;
mod distribution;
mod field;
pub mod file;
mod invalid;
mod marginal;
mod numeric_fields;
mod observed;
mod parameter_distribution;
mod region;
mod spec;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rand::RngExt;

pub use built_in::{
    BUILT_IN_SPACES, FindSpaceError, VARIANT_SPACES, built_in_space, built_in_space_names,
    built_in_space_summary, find_space,
};
pub use check::{KEY_COLUMNS, RESULT_COLUMNS};
pub use copula::{Dependence, GaussianCopula};
pub use invalid::{InvalidSpace, SpaceProblem};
pub use observed::{DrivingExposure, ObservedData, ObservedParameter, SourceExposure};
pub use parameter_distribution::ParameterDistribution;
pub use spec::{
    Base, ChoiceSpec, DistributionSpec, DriverName, FollowerVariant, HistogramSpec, LogNormalSpec,
    NormalSpec, ParameterSpec, ParameterValue, PointMassSpec, SPACE_VERSION, ShapeScaleSpec,
    SpaceSpec, UniformSpec,
};

use self::copula::Copula;
use self::field::FieldTarget;
use self::marginal::CoordinateMarginal;
use self::region::LikelihoodRegion;
use self::spec::ValueKind;
use crumple_sim::random::{self, Purpose};
use crumple_sim::scenario::{InvalidField, Scenario, ScenarioSpec};

/// A search space in which every point is a valid scenario.
///
/// ```
/// use crumple_spaces::built_in_space;
///
/// let space = built_in_space("high-risk").unwrap();
/// // The seed and the index determine the sample.
/// assert_eq!(space.draw(7, 3).unwrap(), space.draw(7, 3).unwrap());
/// ```
#[derive(Debug, Clone)]
pub struct ScenarioSpace {
    spec: SpaceSpec,
    /// Base scenario. If `uses_gaps` is set, `position_m` of all vehicles but the first holds the gap ahead.
    template: ScenarioSpec,
    uses_gaps: bool,
    parameters: Vec<SpaceParameter>,
    /// Indices of parameters in the order in which they are set.
    order: Vec<usize>,
    /// Dependence of coordinates.
    copula: Option<Copula>,
    /// Region of searches in a fitted space.
    region: Option<LikelihoodRegion>,
}

/// A parameter of a space.
#[derive(Debug, Clone)]
pub struct SpaceParameter {
    name: String,
    unit: &'static str,
    target: FieldTarget,
    marginal: CoordinateMarginal,
    coordinates: Range<usize>,
    nominal: Vec<f64>,
}

impl SpaceParameter {
    /// Returns the name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Returns the unit: `1` for a share, empty for a class or a driver.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        self.unit
    }

    /// Returns the coordinates in a point; more than one for a signal.
    #[must_use]
    pub fn coordinates(&self) -> Range<usize> {
        self.coordinates.clone()
    }

    /// Returns the nominal values, one for each coordinate.
    #[must_use]
    pub fn nominal(&self) -> &[f64] {
        &self.nominal
    }

    /// Smallest and largest value; of a class or a driver, their numbers.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        [self.marginal.low(), self.marginal.high()]
    }

    /// Returns true for a choice of a few values.
    #[must_use]
    pub fn is_choice(&self) -> bool {
        matches!(self.marginal, CoordinateMarginal::Choice { .. })
    }

    /// Returns true if values are names of classes or drivers.
    #[must_use]
    pub fn has_named_values(&self) -> bool {
        self.target.kind() != ValueKind::Number
    }

    /// Returns the value at a coordinate in [0, 1], linear over the range or over its logarithm.
    #[must_use]
    pub fn value(&self, coordinate: f64) -> f64 {
        self.marginal.value(coordinate)
    }

    /// Returns true if the parameter is part of the script of vehicle 0.
    #[must_use]
    pub fn is_leader_script(&self) -> bool {
        self.target.driver_vehicle() == Some(0)
    }

    pub(crate) fn coordinate(&self, value: f64) -> f64 {
        self.marginal.coordinate(value)
    }

    /// Formats a value as a number or a name.
    #[must_use]
    pub fn format_value(&self, value: f64) -> String {
        let name = self.target.kind().value_name(value);
        name.map_or_else(|| value.to_string(), str::to_owned)
    }
}

/// Returns the unit of a field that may vary, `path`, for the given base scenario; `None` if it may not vary.
#[must_use]
pub fn field_unit(path: &str, base: &ScenarioSpec) -> Option<&'static str> {
    field::ParameterField::resolve(path, base)
        .ok()
        .map(|field| field.unit)
}

impl ScenarioSpace {
    /// Returns the data of the space, with the base scenario inline.
    #[must_use]
    pub fn spec(&self) -> &SpaceSpec {
        &self.spec
    }

    /// Returns the name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.spec.name
    }

    /// Returns the parameters.
    #[must_use]
    pub fn parameters(&self) -> &[SpaceParameter] {
        &self.parameters
    }

    /// Returns the number of coordinates of a point, at least one.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.parameters
            .last()
            .map_or(0, |parameter| parameter.coordinates.end)
    }

    /// Returns a name for each coordinate: the parameter's, with the number of the piece for a signal.
    #[must_use]
    pub fn coordinate_names(&self) -> Vec<String> {
        let name = |parameter: &SpaceParameter| -> Vec<String> {
            match parameter.coordinates.len() {
                1 => vec![parameter.name.clone()],
                pieces => (0..pieces)
                    .map(|piece| format!("{}_{piece}", parameter.name))
                    .collect(),
            }
        };
        self.parameters.iter().flat_map(name).collect()
    }

    /// Returns the parameter of each coordinate.
    pub fn coordinate_parameters(&self) -> impl Iterator<Item = &SpaceParameter> {
        self.parameters
            .iter()
            .flat_map(|parameter| std::iter::repeat_n(parameter, parameter.coordinates.len()))
    }

    /// Returns the space with another noise seed for its scenarios.
    #[must_use]
    pub fn with_noise_seed(mut self, seed: u64) -> Self {
        // TOML integers are signed.
        self.template.seed = seed & i64::MAX as u64;
        self
    }

    /// Returns the nominal values, one for each coordinate.
    #[must_use]
    pub fn nominal(&self) -> Vec<f64> {
        self.parameters
            .iter()
            .flat_map(|parameter| parameter.nominal.iter().copied())
            .collect()
    }

    /// Returns the values at a point. Missing coordinates are nominal; coordinates outside [0, 1] are clipped.
    #[must_use]
    pub fn values(&self, point: &[f64]) -> Vec<f64> {
        let mut values = self.nominal();
        let with_marginal = values.iter_mut().zip(self.coordinate_parameters());
        for ((value, parameter), &coordinate) in with_marginal.zip(point) {
            *value = parameter.marginal.value(coordinate);
        }
        values
    }

    /// Returns the point of values.
    #[must_use]
    pub fn point(&self, values: &[f64]) -> Vec<f64> {
        let pairs = self.coordinate_parameters().zip(values);
        pairs
            .map(|(parameter, &value)| parameter.marginal.coordinate(value))
            .collect()
    }

    /// Returns true if all values, one for each coordinate, are in the space: within the range, or among those of a
    /// choice.
    #[must_use]
    pub fn contains(&self, values: &[f64]) -> bool {
        let is_of = |(parameter, &value): (&SpaceParameter, &f64)| {
            let [low, high] = parameter.range();
            let is_chosen = || parameter.value(parameter.coordinate(value)) == value;
            (low..=high).contains(&value) && (!parameter.is_choice() || is_chosen())
        };
        values.len() == self.dimension() && self.coordinate_parameters().zip(values).all(is_of)
    }

    /// Creates the scenario of values, one for each coordinate.
    ///
    /// # Errors
    /// [`InvalidField`] for values outside the ranges; never for results of [`ScenarioSpace::values`].
    pub fn scenario(&self, values: &[f64]) -> Result<Scenario, InvalidField> {
        Scenario::new(self.fill_template(values))
    }

    /// Creates the scenario at a point.
    ///
    /// # Errors
    /// None: [`ScenarioSpace::new`] has checked all points. Passes on the error.
    pub fn scenario_at(&self, point: &[f64]) -> Result<Scenario, InvalidField> {
        self.scenario(&self.values(point))
    }

    /// Creates the scenario at a point with a noise seed.
    ///
    /// # Errors
    /// None, as for [`ScenarioSpace::scenario_at`].
    pub fn scenario_at_with_seed(
        &self,
        point: &[f64],
        seed: u64,
    ) -> Result<Scenario, InvalidField> {
        let mut spec = self.fill_template(&self.values(point));
        // TOML integers are signed.
        spec.seed = seed & i64::MAX as u64;
        Scenario::new(spec)
    }

    /// Maps independent uniform numbers, one for each coordinate, through the copula and the inverse CDFs to a point.
    #[must_use]
    pub fn quantile(&self, uniform: &[f64]) -> Vec<f64> {
        let depending = self.copula.as_ref().map(|copula| copula.correlate(uniform));
        let shares = depending.as_deref().unwrap_or(uniform);
        self.coordinate_parameters()
            .zip(shares)
            .map(|(parameter, &u)| parameter.marginal.quantile(u))
            .collect()
    }

    /// Returns the logarithm of the density at a point, relative to the uniform distribution over all ranges.
    #[must_use]
    pub fn ln_likelihood(&self, point: &[f64]) -> f64 {
        let apart: f64 = self
            .coordinate_parameters()
            .zip(point)
            .map(|(parameter, &x)| parameter.marginal.ln_density(x))
            .sum();
        let Some(copula) = &self.copula else {
            return apart;
        };
        let below = self
            .coordinate_parameters()
            .zip(point)
            .map(|(parameter, &x)| parameter.marginal.cdf(x));
        apart + copula.ln_density(&below.collect::<Vec<_>>())
    }

    /// Draws sample `index` from the distribution, with its own noise. Equal seed and index give an equal scenario, in
    /// any order.
    ///
    /// # Errors
    /// None, as for [`ScenarioSpace::scenario_at`].
    pub fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        let mut spec = self.fill_template(&self.values(&self.draw_point(seed, index)));
        spec.seed = random::derived_seed(seed, index);
        spec.name = format!("{}-draw-{seed}-{index}", self.spec.name);
        spec.about = format!("A draw from the space `{}`.", self.spec.name);
        Scenario::new(spec)
    }

    /// Draws the point of sample `index`.
    #[must_use]
    pub fn draw_point(&self, seed: u64, index: u64) -> Vec<f64> {
        let mut stream = random::stream(seed, Purpose::ScenarioSampling, index);
        let uniform: Vec<f64> = (0..self.dimension()).map(|_| stream.random()).collect();
        self.quantile(&uniform)
    }

    fn fill_template(&self, values: &[f64]) -> ScenarioSpec {
        let mut spec = self.template.clone();
        for parameter in self
            .order
            .iter()
            .filter_map(|&index| self.parameters.get(index))
        {
            parameter.target.set(
                &mut spec,
                values
                    .get(parameter.coordinates.clone())
                    .unwrap_or_default(),
            );
        }
        if self.uses_gaps {
            let mut rear_bumper_m = 0.0;
            for (index, vehicle) in spec.vehicles.iter_mut().enumerate() {
                if index > 0 {
                    vehicle.position_m = rear_bumper_m - vehicle.position_m;
                }
                rear_bumper_m = vehicle.position_m - vehicle.length_m();
            }
        }
        spec
    }
}

/// Returns the JSON Schema of space files.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(SpaceSpec).to_value()
}
