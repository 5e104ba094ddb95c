//! Construction of a space from fits, and detection of later edits.

use std::path::Path;

use rayon::prelude::*;

use super::FitError;
use super::dependence::{self, CopulaColumn};
use super::marginal::FittedMarginal;
use crumple_spaces::{
    Dependence, DistributionSpec, GaussianCopula, InvalidSpace, ObservedData, ObservedParameter,
    ParameterValue, ScenarioSpace, SpaceSpec,
};
use crumple_world::scenario::NoDriverFiles;

/// Tolerance of a distribution or correlation that is fitted again, relative to the observed values: other machines
/// round differently.
const TOLERANCE: f64 = 1e-4;
const COMPARED_QUANTILES: u32 = 200;

/// Fits the distributions and the dependence of a space to other values of its parameters.
///
/// # Errors
/// [`FitError`] if no family describes the values, or the result is invalid.
pub(crate) fn refit(spec: &SpaceSpec, observed: &ObservedData) -> Result<ScenarioSpace, FitError> {
    build_space(spec, observed, &fit_marginals(spec, observed)?)
}

pub(super) fn fit_marginals(
    spec: &SpaceSpec,
    observed: &ObservedData,
) -> Result<Vec<FittedMarginal>, FitError> {
    let fitted = |parameter: &ObservedParameter| match stated_distribution(spec, &parameter.name) {
        Some(distribution) => FittedMarginal::fit(parameter, distribution),
        None => Err(InvalidSpace::new(
            "observed.parameters",
            format!("there is no `{}`", parameter.name),
        )
        .into()),
    };
    observed.parameters.par_iter().map(fitted).collect()
}

fn stated_distribution<'a>(spec: &'a SpaceSpec, name: &str) -> Option<&'a DistributionSpec> {
    spec.parameters
        .iter()
        .find(|parameter| parameter.name == name)
        .map(|parameter| &parameter.distribution)
}

pub(super) fn build_space(
    spec: &SpaceSpec,
    observed: &ObservedData,
    marginals: &[FittedMarginal],
) -> Result<ScenarioSpace, FitError> {
    let mut spec = spec.clone();
    let distributions: Vec<DistributionSpec> =
        marginals.iter().map(FittedMarginal::distribution).collect();
    for (distribution, values) in distributions.iter().zip(&observed.parameters) {
        if let Some(parameter) = spec
            .parameters
            .iter_mut()
            .find(|parameter| parameter.name == values.name)
        {
            parameter.distribution = distribution.clone();
            parameter.nominal = Some(ParameterValue::Number(median(&values.values)));
        }
    }
    let columns: Vec<CopulaColumn<'_>> = observed
        .parameters
        .iter()
        .zip(&distributions)
        .map(|(parameter, distribution)| CopulaColumn {
            values: &parameter.values,
            distribution,
        })
        .collect();
    let fitted = GaussianCopula {
        parameters: observed
            .parameters
            .iter()
            .map(|parameter| parameter.name.clone())
            .collect(),
        correlation: dependence::estimate_correlation(&columns),
    };
    spec.dependence = merge_copulas(spec.dependence.take(), fitted).map(Dependence::GaussianCopula);
    Ok(ScenarioSpace::new(spec, Path::new(""), &NoDriverFiles)?)
}

/// Merges fitted correlations with stated ones of parameters that were not both observed.
fn merge_copulas(stated: Option<Dependence>, fitted: GaussianCopula) -> Option<GaussianCopula> {
    let Some(Dependence::GaussianCopula(stated)) = stated else {
        return (fitted.parameters.len() > 1).then_some(fitted);
    };
    if fitted.parameters.len() < 2 {
        return Some(stated);
    }
    let mut parameters = stated.parameters.clone();
    parameters.extend(
        fitted
            .parameters
            .iter()
            .filter(|name| !stated.parameters.contains(name))
            .cloned(),
    );
    let entry = |a: &String, b: &String| match copula_entry(&fitted, a, b)
        .or_else(|| copula_entry(&stated, a, b))
    {
        _ if a == b => 1.0,
        found => found.unwrap_or(0.0),
    };
    let rows = parameters
        .iter()
        .map(|a| parameters.iter().map(|b| entry(a, b)).collect())
        .collect();
    let all_fitted = parameters
        .iter()
        .all(|name| fitted.parameters.contains(name));
    let correlation = if all_fitted {
        rows
    } else {
        dependence::shrink_to_positive_definite(rows)
    };
    Some(GaussianCopula {
        parameters,
        correlation,
    })
}

fn copula_entry(copula: &GaussianCopula, a: &str, b: &str) -> Option<f64> {
    let place = |name: &str| copula.parameters.iter().position(|known| known == name);
    copula.correlation.get(place(a)?)?.get(place(b)?).copied()
}

/// Returns the first edit of a space since its fit: the name of a parameter, or `dependence`; `None` without edits.
/// Only for a space without edits do resamples represent what other data would have given.
///
/// # Errors
/// [`FitError`] if no space can be fitted to the values.
pub(crate) fn find_edit(
    space: &ScenarioSpace,
    observed: &ObservedData,
) -> Result<Option<String>, FitError> {
    let again = refit(space.spec(), observed)?;
    for parameter in &observed.parameters {
        let [stated, fitted] =
            [space.spec(), again.spec()].map(|spec| stated_distribution(spec, &parameter.name));
        let (Some(stated), Some(fitted)) = (stated, fitted) else {
            continue;
        };
        let [stated, fitted] = [stated.build()?, fitted.build()?];
        let ends = parameter
            .values
            .iter()
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &value| {
                [low.min(value), high.max(value)]
            });
        let close = TOLERANCE * (ends[1] - ends[0]).abs();
        let share = |index: u32| f64::from(index) / f64::from(COMPARED_QUANTILES);
        if (0..=COMPARED_QUANTILES)
            .any(|at| (stated.quantile(share(at)) - fitted.quantile(share(at))).abs() > close)
        {
            return Ok(Some(parameter.name.clone()));
        }
    }
    let copula = |space: &ScenarioSpace| match &space.spec().dependence {
        Some(Dependence::GaussianCopula(copula)) => copula.clone(),
        None => GaussianCopula {
            parameters: Vec::new(),
            correlation: Vec::new(),
        },
    };
    let (stated, fitted) = (copula(space), copula(&again));
    let differs = |a: &ObservedParameter, b: &ObservedParameter| {
        let of = |copula: &GaussianCopula| copula_entry(copula, &a.name, &b.name).unwrap_or(0.0);
        a.name != b.name && (of(&stated) - of(&fitted)).abs() > TOLERANCE
    };
    let parameters = &observed.parameters;
    let is_other = parameters
        .iter()
        .any(|a| parameters.iter().any(|b| differs(a, b)));
    Ok(is_other.then(|| "dependence".to_owned()))
}

/// Returns the median, the upper one of an even number of values.
pub(super) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
