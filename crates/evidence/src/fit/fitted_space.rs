//! A space fitted to a sample, with what was chosen and how well it fits.

use serde::Serialize;

use super::FitError;
use super::base::{about, base};
use super::episodes::{Number, Sample};
use super::family::{Family, FamilyFit};
use super::goodness::{GoodnessOfFit, Tails};
use super::marginal::{Dense, Marginal, PointFit};
use super::space::{marginals, median, space_of};
use crumple_world::scenario::space::{
    Base, Choice, Dependence, Distribution, ObservedParameter, ParameterSpec, SPACE_VERSION, Space, SpaceSpec, Uniform,
    Value,
};

/// A number as it was fitted.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedFeature {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// A value with a probability of its own. All that follows is of the other values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<PointFit>,
    /// The family that was chosen.
    pub chosen: FamilyFit,
    /// The other families, the likeliest first, ...
    pub others: Vec<FamilyFit>,
    /// ... and those that cannot describe the values, with why.
    pub impossible: Vec<(Family, String)>,
    /// How well the chosen one fits.
    pub goodness: GoodnessOfFit,
    /// What it says beyond what was seen.
    pub tails: Tails,
    /// All values, sorted.
    #[serde(skip)]
    pub sorted: Vec<f64>,
    /// How all of them are distributed.
    #[serde(skip)]
    pub distribution: Distribution,
}

/// A number that has one of a few values: the size of a vehicle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedSize {
    /// Its name.
    pub name: String,
    /// Its unit.
    pub unit: &'static str,
    /// The values.
    pub values: Vec<PointFit>,
}

/// A space fitted to episodes.
#[derive(Debug, Clone)]
pub struct FittedSpace {
    /// The space.
    pub space: Space,
    /// Its numbers that have a density.
    pub features: Vec<FittedFeature>,
    /// Its numbers that have one of a few values.
    pub sizes: Vec<FittedSize>,
    /// Names of the parameters of the copula.
    pub copula_parameters: Vec<String>,
    /// Correlations of the copula.
    pub correlation: Vec<Vec<f64>>,
}

/// Fits a space to a sample. `samples` are drawn for each number to judge how well it fits.
///
/// # Errors
/// [`FitError`] for numbers that no family describes.
pub fn fit(sample: &Sample, name: &str, samples: u32, seed: u64) -> Result<FittedSpace, FitError> {
    let parameter = |(number, observed): (&Number, &ObservedParameter)| ParameterSpec {
        name: number.name.clone(),
        field: number.field.clone(),
        unit: number.unit.to_owned(),
        nominal: Some(Value::Number(median(&observed.values))),
        distribution: unfitted(number),
    };
    let spec = SpaceSpec {
        version: SPACE_VERSION,
        name: name.to_owned(),
        about: about(sample),
        base: Base::Inline(Box::new(base(sample, name))),
        parameters: sample.numbers.iter().zip(&sample.observed.parameters).map(parameter).collect(),
        dependence: None,
        exposure: Some(sample.exposure.clone()),
        observed: Some(sample.observed.clone()),
    };
    let marginals = marginals(&spec, &sample.observed)?;
    let space = space_of(&spec, &sample.observed, &marginals)?;
    let (mut numbers, mut sizes) = (Vec::new(), Vec::new());
    for (place, (number, marginal)) in sample.numbers.iter().zip(marginals).enumerate() {
        let values = sample.observed.parameters.get(place).map_or(&[][..], |observed| observed.values.as_slice());
        match marginal {
            Marginal::Few(values) => {
                sizes.push(FittedSize { name: number.name.clone(), unit: number.unit, values });
            }
            Marginal::Dense(dense) => numbers.push(judged(number, values, *dense, (samples, seed, place as u64))?),
        }
    }
    let (depending, correlation) = match &space.spec().dependence {
        Some(Dependence::GaussianCopula(copula)) => (copula.parameters.clone(), copula.correlation.clone()),
        None => (Vec::new(), Vec::new()),
    };
    Ok(FittedSpace { space, numbers, sizes, depending, correlation })
}

/// A distribution of the kind that a number will have.
fn placeholder_distribution(number: &Number) -> Distribution {
    let [low, high] = number.range;
    match number.few {
        Some(values) => Distribution::Choice(Choice { values: values.map(Value::Number).to_vec(), weights: None }),
        None => Distribution::Uniform(Uniform { low, high }),
    }
}

/// How well a number with a density is fitted.
fn assess_fit(number: &Number, values: &[f64], dense: Dense, effort: (u32, u64, u64)) -> Result<FittedFeature, FitError> {
    let distribution = dense.distribution();
    let Dense { families, point } = dense;
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let others: Vec<f64> =
        sorted.iter().copied().filter(|value| point.is_none_or(|point| *value != point.at)).collect();
    let ready = families.chosen.distribution.ready()?;
    Ok(FittedFeature {
        name: number.name.clone(),
        unit: number.unit,
        point_mass: point,
        goodness: GoodnessOfFit::of(&others, number.range, &families.chosen, &ready, effort),
        tails: Tails::of(&others, &ready),
        chosen: families.chosen,
        others: families.others,
        impossible: families.impossible.into_iter().map(|(family, why)| (family, why.to_string())).collect(),
        sorted,
        distribution,
    })
}
