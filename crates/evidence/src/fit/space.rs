//! Construction of a space from fits, and detection of later edits.

use std::path::Path;

use rayon::prelude::*;

use super::FitError;
use super::dependence::{self, CopulaColumn};
use super::marginal::FittedMarginal;
use crumple_sim::scenario::NoDriverFiles;
use crumple_spaces::{
    Dependence, DistributionSpec, GaussianCopula, InvalidSpace, ObservedData, ObservedParameter,
    ParameterValue, ScenarioSpace, SpaceSpec,
};

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
    let marginals = observed.parameters.par_iter().map(|parameter| {
        match stated_distribution(spec, &parameter.name) {
            Some(distribution) => FittedMarginal::fit(parameter, distribution),
            None => Err(InvalidSpace::new(
                "observed.parameters",
                format!("there is no `{}`", parameter.name),
            )
            .into()),
        }
    });
    marginals.collect()
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
    let rows = parameters.iter().map(|a| {
        let entries = parameters.iter().map(|b| match a == b {
            true => 1.0,
            false => copula_entry(&fitted, a, b)
                .or_else(|| copula_entry(&stated, a, b))
                .unwrap_or(0.0),
        });
        entries.collect()
    });
    let rows = rows.collect();
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
    let [row, column] = [a, b].map(|name| {
        let mut parameters = copula.parameters.iter();
        parameters.position(|parameter| parameter == name)
    });
    copula.correlation.get(row?)?.get(column?).copied()
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
    let refitted = refit(space.spec(), observed)?;
    for parameter in &observed.parameters {
        if is_distribution_edited(space.spec(), refitted.spec(), parameter)? {
            return Ok(Some(parameter.name.clone()));
        }
    }
    let parameters = &observed.parameters;
    let is_dependence_edited = parameters.iter().any(|a| {
        parameters.iter().any(|b| {
            let [stated, fitted] =
                [space, &refitted].map(|space| dependence_of(space, &a.name, &b.name));
            a.name != b.name && (stated - fitted).abs() > TOLERANCE
        })
    });
    Ok(is_dependence_edited.then(|| "dependence".to_owned()))
}

/// True if quantiles of the stated and of the fitted distribution of a parameter differ.
fn is_distribution_edited(
    stated: &SpaceSpec,
    fitted: &SpaceSpec,
    parameter: &ObservedParameter,
) -> Result<bool, FitError> {
    let [stated, fitted] = [stated, fitted].map(|spec| stated_distribution(spec, &parameter.name));
    let (Some(stated), Some(fitted)) = (stated, fitted) else {
        return Ok(false);
    };
    let [stated, fitted] = [stated.build()?, fitted.build()?];
    let [smallest, largest] = parameter
        .values
        .iter()
        .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], &value| {
            [low.min(value), high.max(value)]
        });
    let tolerance = TOLERANCE * (largest - smallest).abs();
    Ok((0..=COMPARED_QUANTILES).any(|index| {
        let share = f64::from(index) / f64::from(COMPARED_QUANTILES);
        (stated.quantile(share) - fitted.quantile(share)).abs() > tolerance
    }))
}

/// Returns the correlation of two parameters of a space; 0 if its copula does not have both.
fn dependence_of(space: &ScenarioSpace, a: &str, b: &str) -> f64 {
    match &space.spec().dependence {
        Some(Dependence::GaussianCopula(copula)) => copula_entry(copula, a, b).unwrap_or(0.0),
        None => 0.0,
    }
}

/// Returns the median, the upper one of an even number of values.
pub(super) fn median(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(f64::NAN)
}
