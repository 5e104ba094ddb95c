//! Fit of a space to a sample of episodes, with its goodness of fit.

use serde::Serialize;

use super::FitError;
use super::base::{base_scenario, describe_space};
use super::episodes::{EpisodeFeature, EpisodeSample};
use super::family::{DistributionFamily, FamilyFit};
use super::goodness::{GoodnessOfFit, MIN_P_VALUE, Tails, format_p_value};
use super::marginal::{ContinuousMarginal, FittedMarginal, PointFit};
use super::space::{build_space, fit_marginals, median};
use crumple_sim::control::BuiltInController;
use crumple_spaces::{
    Base, ChoiceSpec, Dependence, DistributionSpec, ParameterSpec, ParameterValue, SPACE_VERSION,
    ScenarioSpace, SpaceSpec, UniformSpec,
};

/// Fit of a continuous feature.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedFeature {
    /// Name of the feature.
    pub name: String,
    /// Unit of the values.
    pub unit: &'static str,
    /// Point mass, if any; all other fields except the last two describe the remaining values.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub point_mass: Option<PointFit>,
    /// Family of the fit.
    pub chosen: FamilyFit,
    /// Other families, in order of likelihood.
    pub others: Vec<FamilyFit>,
    /// Families that cannot describe the values, each with the reason.
    pub impossible: Vec<(DistributionFamily, String)>,
    /// Goodness of fit of the chosen family.
    pub goodness: GoodnessOfFit,
    /// Extrapolation beyond the observed values.
    pub tails: Tails,
    /// All values, sorted.
    #[serde(skip)]
    pub sorted: Vec<f64>,
    /// Distribution of all values.
    #[serde(skip)]
    pub distribution: DistributionSpec,
}

/// Fit of a discrete feature: the size of a vehicle.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FittedSize {
    /// Name of the feature.
    pub name: String,
    /// Unit of the values.
    pub unit: &'static str,
    /// Values with their probabilities.
    pub values: Vec<PointFit>,
}

/// A space fitted to episodes.
#[derive(Debug, Clone)]
pub struct FittedSpace {
    /// Fitted space.
    pub space: ScenarioSpace,
    /// Fits of the continuous features.
    pub features: Vec<FittedFeature>,
    /// Fits of the discrete features.
    pub sizes: Vec<FittedSize>,
    /// Names of the parameters of the copula.
    pub copula_parameters: Vec<String>,
    /// Correlations of the copula.
    pub correlation: Vec<Vec<f64>>,
}

/// Settings of a fit.
#[derive(Debug, Clone, PartialEq)]
pub struct FitOptions {
    /// Name of the space.
    pub name: String,
    /// Driver of the last of three or more vehicles.
    pub follower: BuiltInController,
    /// Number of bootstrap samples of the goodness of fit of each feature.
    pub samples: u32,
    /// Seed of these samples.
    pub seed: u64,
}

/// Fits a space to a sample.
///
/// # Errors
/// [`FitError`] if no family describes a feature.
pub fn fit(sample: &EpisodeSample, options: &FitOptions) -> Result<FittedSpace, FitError> {
    let mut spec = unfitted_spec(sample, options);
    let marginals = fit_marginals(&spec, &sample.observed)?;
    let mut features = Vec::new();
    let mut sizes = Vec::new();
    for (index, (feature, marginal)) in sample.features.iter().zip(&marginals).enumerate() {
        match marginal.clone() {
            FittedMarginal::Discrete(values) => {
                sizes.push(FittedSize {
                    name: feature.name.clone(),
                    unit: feature.unit,
                    values,
                });
            }
            FittedMarginal::Continuous(dense) => {
                let effort = (options.samples, options.seed, index as u64);
                let values = sample.observed_values(index);
                features.push(assess_fit(feature, values, *dense, effort)?);
            }
        }
    }
    if let Some(rejected) = describe_rejected(&features) {
        // Part of hashes, therefore not the sentence of the report.
        spec.about += &format!(" {rejected} Rates that follow from this space depend on it.");
    }
    let space = build_space(&spec, &sample.observed, &marginals)?;
    let dependence = space.spec().dependence.as_ref();
    let copula = dependence.map(|Dependence::GaussianCopula(copula)| copula);
    Ok(FittedSpace {
        features,
        sizes,
        copula_parameters: copula.map_or_else(Vec::new, |copula| copula.parameters.clone()),
        correlation: copula.map_or_else(Vec::new, |copula| copula.correlation.clone()),
        space,
    })
}

/// States the parameters whose family does not fit; `None` if all fit.
pub(super) fn describe_rejected(features: &[FittedFeature]) -> Option<String> {
    let rejected: Vec<String> = features
        .iter()
        .filter(|feature| feature.goodness.is_rejected())
        .map(|feature| {
            let p = format_p_value(feature.goodness.smallest_p());
            format!("{} ({}, p {p})", feature.name, feature.chosen.family.name())
        })
        .collect();
    (!rejected.is_empty()).then(|| {
        format!(
            "The most likely family does not fit, with p below {MIN_P_VALUE}, for: {}.",
            rejected.join(", ")
        )
    })
}

/// Returns the space with placeholders for the distributions of its parameters.
fn unfitted_spec(sample: &EpisodeSample, options: &FitOptions) -> SpaceSpec {
    let features = sample.features.iter().zip(&sample.observed.parameters);
    SpaceSpec {
        version: SPACE_VERSION,
        name: options.name.clone(),
        about: describe_space(sample, &options.follower),
        base: Base::Inline(Box::new(base_scenario(sample, options))),
        parameters: features
            .map(|(feature, observed)| ParameterSpec {
                name: feature.name.clone(),
                field: feature.field.clone(),
                unit: feature.unit.to_owned(),
                nominal: Some(ParameterValue::Number(median(&observed.values))),
                distribution: placeholder_distribution(feature),
            })
            .collect(),
        dependence: None,
        exposure: Some(sample.exposure.clone()),
        observed: Some(sample.observed.clone()),
    }
}

fn placeholder_distribution(feature: &EpisodeFeature) -> DistributionSpec {
    let [low, high] = feature.range;
    match feature.choices {
        Some(values) => DistributionSpec::Choice(ChoiceSpec {
            values: values.map(ParameterValue::Number).to_vec(),
            weights: None,
        }),
        None => DistributionSpec::Uniform(UniformSpec { low, high }),
    }
}

fn assess_fit(
    feature: &EpisodeFeature,
    values: &[f64],
    dense: ContinuousMarginal,
    effort: (u32, u64, u64),
) -> Result<FittedFeature, FitError> {
    let distribution = dense.distribution();
    let ContinuousMarginal { families, point } = dense;
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let others: Vec<f64> = sorted
        .iter()
        .copied()
        .filter(|value| point.is_none_or(|point| *value != point.at))
        .collect();
    let ready = families.chosen.distribution.build()?;
    Ok(FittedFeature {
        name: feature.name.clone(),
        unit: feature.unit,
        point_mass: point,
        goodness: GoodnessOfFit::bootstrap(
            &others,
            feature.range,
            &families.chosen,
            &ready,
            effort,
        ),
        tails: Tails::new(&others, &ready),
        chosen: families.chosen,
        others: families.others,
        impossible: families
            .impossible
            .into_iter()
            .map(|(family, why)| (family, why.to_string()))
            .collect(),
        sorted,
        distribution,
    })
}
