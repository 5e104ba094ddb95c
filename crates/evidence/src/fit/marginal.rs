//! Marginal distributions of features.

use super::FitError;
use super::family::{DistributionFamily, FamilyFit, FamilyFitError};
use crate::RateInterval;
use crumple_spaces::{
    ChoiceSpec, DistributionSpec, ObservedParameter, ParameterValue, PointMassSpec,
};
use serde::Serialize;

/// Fit of a value with a point mass.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct PointFit {
    /// Value with the point mass.
    pub at: f64,
    /// Number of episodes with the value.
    pub count: u64,
    /// Share of these episodes.
    pub probability: f64,
    /// Clopper-Pearson interval of the probability at 95 %.
    pub interval_95: [f64; 2],
}

impl PointFit {
    fn new(at: f64, values: &[f64]) -> Self {
        let count = values.iter().filter(|value| **value == at).count() as u64;
        let all = values.len() as u64;
        let RateInterval { lower, upper } = RateInterval::clopper_pearson(count, all, 0.95);
        Self {
            at,
            count,
            probability: count as f64 / all.max(1) as f64,
            interval_95: [lower, upper],
        }
    }
}

#[derive(Clone)]
pub(super) enum FittedMarginal {
    Continuous(Box<ContinuousMarginal>),
    Discrete(Vec<PointFit>),
}

#[derive(Clone)]
pub(super) struct ContinuousMarginal {
    pub(super) families: FamilyRanking,
    pub(super) point: Option<PointFit>,
}

impl ContinuousMarginal {
    pub(super) fn distribution(&self) -> DistributionSpec {
        let others = self.families.chosen.distribution.clone();
        match self.point {
            None => others,
            Some(PointFit {
                at, probability, ..
            }) => DistributionSpec::PointMass(PointMassSpec {
                at,
                probability,
                others: Box::new(others),
            }),
        }
    }
}

impl FittedMarginal {
    /// Fits a feature. A feature that is discrete in the space, by `stated`, stays discrete.
    pub(super) fn fit(
        parameter: &ObservedParameter,
        stated: &DistributionSpec,
    ) -> Result<Self, FitError> {
        let values = &parameter.values;
        if let DistributionSpec::Choice(choice) = stated {
            let numbers = choice.values.iter().filter_map(|value| match value {
                ParameterValue::Number(number) => Some(*number),
                _ => None,
            });
            let points = numbers.map(|number| PointFit::new(number, values));
            return Ok(Self::Discrete(points.collect()));
        }
        let point = parameter
            .point_mass
            .map(|at| PointFit::new(at, values))
            .filter(|point| point.count > 0);
        let others = match point {
            Some(point) => &values
                .iter()
                .copied()
                .filter(|value| *value != point.at)
                .collect::<Vec<f64>>(),
            None => values,
        };
        let families =
            FamilyRanking::fit(others, [parameter.low, parameter.high]).map_err(|why| {
                let name = parameter.name.clone();
                match point {
                    None => FitError::NoFamily { name, why },
                    Some(PointFit { at, count, .. }) => FitError::NoFamilyBesidePoint {
                        name,
                        at,
                        count,
                        all: values.len(),
                        why,
                    },
                }
            })?;
        Ok(Self::Continuous(Box::new(ContinuousMarginal {
            families,
            point,
        })))
    }

    pub(super) fn distribution(&self) -> DistributionSpec {
        match self {
            Self::Continuous(dense) => dense.distribution(),
            Self::Discrete(points) => DistributionSpec::Choice(ChoiceSpec {
                values: points
                    .iter()
                    .map(|point| ParameterValue::Number(point.at))
                    .collect(),
                weights: Some(points.iter().map(|point| point.count as f64).collect()),
            }),
        }
    }
}

#[derive(Clone)]
pub(super) struct FamilyRanking {
    pub(super) chosen: FamilyFit,
    pub(super) others: Vec<FamilyFit>,
    pub(super) impossible: Vec<(DistributionFamily, FamilyFitError)>,
}

impl FamilyRanking {
    pub(super) fn fit(values: &[f64], range: [f64; 2]) -> Result<Self, FamilyFitError> {
        let mut fits = Vec::new();
        let mut impossible = Vec::new();
        for family in DistributionFamily::ALL {
            match family.fit(values, range) {
                Ok(fit) => fits.push(fit),
                Err(why) => impossible.push((family, why)),
            }
        }
        fits.sort_by(|a: &FamilyFit, b| b.ln_likelihood.total_cmp(&a.ln_likelihood));
        let mut fits = fits.into_iter();
        let why = impossible
            .first()
            .map_or(FamilyFitError::NoMaximum, |(_, why)| *why);
        let chosen = fits.next().ok_or(why)?;
        Ok(Self {
            chosen,
            others: fits.collect(),
            impossible,
        })
    }
}
