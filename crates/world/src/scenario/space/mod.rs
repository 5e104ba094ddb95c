//! Search spaces: scenarios with parameters that vary, each with a range, a unit and a distribution.
//!
//! [`SpaceSpec`] is the file: plain data that may hold nonsense. [`ScenarioSpace`] is a spec in which every point was found to be a
//! valid scenario. Field paths are looked up once; making a scenario of a point costs a few microseconds.
//!
//! # Points, values, scenarios
//!
//! A *point* lies in the unit cube, one coordinate a parameter, or one for each piece of a signal. A coordinate runs evenly
//! over the *range* of its parameter, whatever the distribution: a search must reach an unlikely corner as easily as a
//! likely one. How likely a point is says [`ScenarioSpace::ln_likelihood`]: the logarithm of the distribution's density with
//! respect to points, hence 0 where the distribution is even over the range. Whoever wants scenarios *by the
//! distribution* (failure rates, training, held-out sets) draws them with [`ScenarioSpace::draw`], or sends uniform numbers
//! through [`ScenarioSpace::quantile`], the inverse of the distribution's CDF. Expectations under the distribution are thus
//! integrals over uniform numbers u of f(quantile(u)), or over points x of f(x) exp(ln_likelihood(x)).
//!
//! # Fields
//!
//! A parameter names a number of the scenario file by its path (`environment.friction`, `vehicles[2].reaction_delay_s`,
//! `vehicles[0].driver.brake.rate_mps2`), a vehicle's class, a number of all vehicles (`vehicles[*].speed_mps`), a signal
//! (`vehicles[0].driver.pieces.accel_mps2`, as many coordinates as the base scenario has pieces), or one of these,
//! which keep nonsense out by construction:
//!
//! | field | what it sets |
//! |---|---|
//! | `vehicles[i].gap_m` | the bumper gap ahead; vehicles are lined up behind the leader, so that none overlap |
//! | `vehicles[i].time_gap_s` | the same, as the time it takes at the vehicle's own speed |
//! | `vehicles[i].closing_time_s` | the same, as the time it takes at the speed at which the vehicle closes in; 2 m at least |
//! | `vehicles[i].speed_share` | speed as a share of the one that the vehicle has otherwise |
//! | `vehicles[i].driver` | who drives: a choice of built-in controllers with their default settings |
//! | `vehicles[i].size_m` | length, with the class that goes with it: heavy from 7.5 m on |
//! | `vehicles[i].load` | mass relative to its class's, at its class's brake force: deceleration falls as 1 / load above 1 |
//! | `vehicles[i].brake_offset_mps2` | largest deceleration relative to its class's |
//! | `vehicles[i].driver.NAME.rate_share` | rate of a braking script, as a share of what the vehicle can do on this road |
//! | `vehicles[i].driver.brake-to-speed.final_share` | speed down to which a script brakes, as a share of its first |
//! | `vehicles[i].driver.pieces.brake_share` | the same for every piece of a script |
//! | `vehicles[i].driver.pieces.onset_s` | when the first piece starts; the others keep their distance |
//! | `vehicles[i].driver.pieces.cruise_mps2` | acceleration of every piece, cut where the speed would leave 18 to 130 km/h |
//! | `vehicles[i].driver.pieces.scale` | what all pieces are multiplied by, after everything else: 0 is a constant speed |
//!
//! # Dependence
//!
//! Parameters are independent unless `dependence` says otherwise, by a Gaussian copula: uniform numbers u become normal ones,
//! z = Φ⁻¹(u), these become correlated, y = L z with L Lᵀ the correlation matrix, and the shares Φ(y) go through the inverse CDF
//! of each parameter (Nelsen, An Introduction to Copulas, 2006, 2.3 and 3.1). Ranges, and thus points, stay as they are. A value with a
//! probability of its own takes all shares between two ends, and its slice of a coordinate keeps which of these it was: densities of
//! points are exact. Where a point is made of values, it is the middle.
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
mod marginal;
mod numeric_fields;
mod observed;
mod parameter_distribution;
mod spec;
#[cfg(test)]
mod tests;

use std::ops::Range;

use rand::RngExt;

pub use built_in::{BUILT_IN_SPACES, FindSpaceError, built_in_space, find_space};
pub use check::{InvalidSpace, KEY_COLUMNS, RESULT_COLUMNS};
pub use copula::{Dependence, GaussianCopula};
pub use observed::{DrivingExposure, ObservedData, ObservedParameter, SourceExposure};
pub use parameter_distribution::ParameterDistribution;
pub use spec::{
    Base, ChoiceSpec, DistributionSpec, DriverName, LogNormalSpec, NormalSpec, ParameterSpec, ParameterValue,
    PointMassSpec, SPACE_VERSION, ShapeScaleSpec, SpaceSpec, UniformSpec,
};

use self::copula::Copula;
use self::field::FieldTarget;
use self::marginal::CoordinateMarginal;
use self::spec::ValueKind;
use super::{InvalidField, Scenario, ScenarioSpec, VehicleClass};
use crate::random::{self, Purpose};

/// A search space in which every point is a valid scenario.
///
/// ```
/// use crumple_world::scenario::space::built_in_space;
///
/// let space = built_in_space("high-risk").unwrap();
/// // One seed decides every draw, in any order.
/// assert_eq!(space.draw(7, 3).unwrap(), space.draw(7, 3).unwrap());
/// ```
#[derive(Debug, Clone)]
pub struct ScenarioSpace {
    spec: SpaceSpec,
    /// The base scenario; where it lines up, with gaps in place of all positions but the leader's.
    template: ScenarioSpec,
    uses_gaps: bool,
    parameters: Vec<SpaceParameter>,
    /// Parameters in the order in which they are set.
    order: Vec<usize>,
    /// How coordinates depend on each other.
    copula: Option<Copula>,
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
    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Its unit: `1` for a share, empty for a class or a driver.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        self.unit
    }

    /// Its coordinates in a point; more than one for a signal.
    #[must_use]
    pub fn coordinates(&self) -> Range<usize> {
        self.coordinates.clone()
    }

    /// Nominal values, one a coordinate.
    #[must_use]
    pub fn nominal(&self) -> &[f64] {
        &self.nominal
    }

    /// Smallest and largest value; of a class or a driver, their numbers.
    #[must_use]
    pub fn range(&self) -> [f64; 2] {
        [self.marginal.low(), self.marginal.high()]
    }

    /// Whether it is one of a few values.
    #[must_use]
    pub fn is_choice(&self) -> bool {
        matches!(self.marginal, CoordinateMarginal::Choice { .. })
    }

    /// Whether its values have names instead of being numbers: a vehicle's class, or its driver.
    #[must_use]
    pub fn has_named_values(&self) -> bool {
        self.target.kind() != ValueKind::Number
    }

    /// The value at a coordinate from 0 to 1, on the parameter's own scale: even over the range, or over its logarithm.
    #[must_use]
    pub fn value(&self, coordinate: f64) -> f64 {
        self.marginal.value(coordinate)
    }

    /// Whether it is part of the script that vehicle 0 follows.
    #[must_use]
    pub fn is_leader_script(&self) -> bool {
        self.target.driver_vehicle() == Some(0)
    }

    /// Where in [0, 1] a value lies.
    #[must_use]
    pub(crate) fn coordinate(&self, value: f64) -> f64 {
        self.marginal.coordinate(value)
    }

    /// The value as a reader knows it: a number, or a name.
    #[must_use]
    pub fn format_value(&self, value: f64) -> String {
        let name = match self.target.kind() {
            ValueKind::Number => None,
            ValueKind::Class => VehicleClass::ALL.get(value as usize).map(|class| class.name()),
            ValueKind::Driver => DriverName::from_number(value).map(DriverName::name),
        };
        name.map_or_else(|| value.to_string(), str::to_owned)
    }
}

impl ScenarioSpace {
    /// The data of the space, with the base scenario spelled out.
    #[must_use]
    pub fn spec(&self) -> &SpaceSpec {
        &self.spec
    }

    /// Its name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.spec.name
    }

    /// What varies.
    #[must_use]
    pub fn parameters(&self) -> &[SpaceParameter] {
        &self.parameters
    }

    /// The number of coordinates of a point, at least one.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.parameters.last().map_or(0, |parameter| parameter.coordinates.end)
    }

    /// A name for each coordinate: the parameter's, with the number of the piece for a signal.
    #[must_use]
    pub fn coordinate_names(&self) -> Vec<String> {
        let name = |parameter: &SpaceParameter| -> Vec<String> {
            match parameter.coordinates.len() {
                1 => vec![parameter.name.clone()],
                pieces => (0..pieces).map(|piece| format!("{}_{piece}", parameter.name)).collect(),
            }
        };
        self.parameters.iter().flat_map(name).collect()
    }

    /// The parameter that each coordinate belongs to.
    pub fn coordinate_parameters(&self) -> impl Iterator<Item = &SpaceParameter> {
        self.parameters.iter().flat_map(|parameter| std::iter::repeat_n(parameter, parameter.coordinates.len()))
    }

    /// The same space with another seed for all noise of its scenarios.
    #[must_use]
    pub fn with_noise_seed(mut self, seed: u64) -> Self {
        // A TOML file cannot hold more.
        self.template.seed = seed & i64::MAX as u64;
        self
    }

    /// The nominal values, one a coordinate.
    #[must_use]
    pub fn nominal(&self) -> Vec<f64> {
        self.parameters.iter().flat_map(|parameter| parameter.nominal.iter().copied()).collect()
    }

    /// The values at a point. Coordinates that are missing are taken as nominal, and those outside [0, 1] as the nearest end.
    #[must_use]
    pub fn values(&self, point: &[f64]) -> Vec<f64> {
        let mut values = self.nominal();
        let with_marginal = values.iter_mut().zip(self.coordinate_parameters());
        for ((value, parameter), &coordinate) in with_marginal.zip(point) {
            *value = parameter.marginal.value(coordinate);
        }
        values
    }

    /// The point at which values are taken.
    #[must_use]
    pub fn point(&self, values: &[f64]) -> Vec<f64> {
        let pairs = self.coordinate_parameters().zip(values);
        pairs.map(|(parameter, &value)| parameter.marginal.coordinate(value)).collect()
    }

    /// Whether values, one a coordinate, are in the space: each within its range, and of a choice one of its values.
    #[must_use]
    pub fn contains(&self, values: &[f64]) -> bool {
        let is_of = |(parameter, &value): (&SpaceParameter, &f64)| {
            let [low, high] = parameter.range();
            let is_chosen = || parameter.value(parameter.coordinate(value)) == value;
            (low..=high).contains(&value) && (!parameter.is_choice() || is_chosen())
        };
        values.len() == self.dimension() && self.coordinate_parameters().zip(values).all(is_of)
    }

    /// The scenario of values, one a coordinate.
    ///
    /// # Errors
    /// [`InvalidField`] for values outside the ranges; never for what [`ScenarioSpace::values`] returns.
    pub fn scenario(&self, values: &[f64]) -> Result<Scenario, InvalidField> {
        Scenario::new(self.fill_template(values))
    }

    /// The scenario at a point, coordinates running over the ranges.
    ///
    /// # Errors
    /// None: [`ScenarioSpace::new`] has checked all points. The error is passed on rather than hidden.
    pub fn scenario_at(&self, point: &[f64]) -> Result<Scenario, InvalidField> {
        self.scenario(&self.values(point))
    }

    /// The scenario at a point, with noise of its own.
    ///
    /// # Errors
    /// None, as for [`ScenarioSpace::at`].
    pub fn scenario_at_with_seed(&self, point: &[f64], seed: u64) -> Result<Scenario, InvalidField> {
        let mut spec = self.fill_template(&self.values(point));
        // A TOML file cannot hold more.
        spec.seed = seed & i64::MAX as u64;
        Scenario::new(spec)
    }

    /// The point that independent uniform numbers, one a coordinate, come to: below it lie shares `uniform` of the distribution,
    /// coordinate by coordinate; where coordinates depend on each other, shares that the copula makes of them.
    #[must_use]
    pub fn quantile(&self, uniform: &[f64]) -> Vec<f64> {
        let depending = self.copula.as_ref().map(|copula| copula.correlate(uniform));
        let shares = depending.as_deref().unwrap_or(uniform);
        self.coordinate_parameters().zip(shares).map(|(parameter, &u)| parameter.marginal.quantile(u)).collect()
    }

    /// Logarithm of the distribution's density at a point, relative to a distribution that is even over all ranges.
    #[must_use]
    pub fn ln_likelihood(&self, point: &[f64]) -> f64 {
        let apart: f64 =
            self.coordinate_parameters().zip(point).map(|(parameter, &x)| parameter.marginal.ln_density(x)).sum();
        let Some(copula) = &self.copula else { return apart };
        let below = self.coordinate_parameters().zip(point).map(|(parameter, &x)| parameter.marginal.cdf(x));
        apart + copula.ln_density(&below.collect::<Vec<_>>())
    }

    /// The `index`-th draw by the distribution, with noise of its own. The same seed and index give the same scenario, in
    /// any order.
    ///
    /// # Errors
    /// None, as for [`ScenarioSpace::at`].
    pub fn draw(&self, seed: u64, index: u64) -> Result<Scenario, InvalidField> {
        let mut spec = self.fill_template(&self.values(&self.draw_point(seed, index)));
        spec.seed = random::derived_seed(seed, index);
        spec.name = format!("{}-draw-{seed}-{index}", self.spec.name);
        spec.about = format!("A draw from the space `{}`.", self.spec.name);
        Scenario::new(spec)
    }

    /// The point of the `index`-th draw.
    #[must_use]
    pub fn draw_point(&self, seed: u64, index: u64) -> Vec<f64> {
        let mut stream = random::stream(seed, Purpose::ScenarioSampling, index);
        let uniform: Vec<f64> = (0..self.dimension()).map(|_| stream.random()).collect();
        self.quantile(&uniform)
    }

    fn fill_template(&self, values: &[f64]) -> ScenarioSpec {
        let mut spec = self.template.clone();
        for parameter in self.order.iter().filter_map(|&index| self.parameters.get(index)) {
            parameter.target.set(&mut spec, values.get(parameter.coordinates.clone()).unwrap_or_default());
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

/// The JSON Schema of space files.
#[cfg(feature = "schema")]
#[must_use]
pub fn json_schema() -> serde_json::Value {
    schemars::schema_for!(SpaceSpec).to_value()
}
