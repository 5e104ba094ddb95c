//! Dependence of parameters: a Gaussian copula.

use nalgebra::{DMatrix, DVector};
use serde::{Deserialize, Serialize};
use statrs::distribution::{ContinuousCDF, Normal as Gauss};

use super::SpaceParameter;
use super::invalid::{InvalidSpace, reject};
use super::spec::ValueKind;
use crumple_core::digits::format_compact;

const MAX_CORRELATED: usize = 50;
/// Smallest eigenvalue of a correlation matrix; below it, one sample determines the next to all relevant digits.
const MIN_EIGENVALUE: f64 = 1e-6;
/// Range of probabilities, which keeps normal scores finite: 38 standard deviations below, 8 above.
const PROBABILITY_RANGE: [f64; 2] = [f64::MIN_POSITIVE, 1.0 - f64::EPSILON];

/// Dependence of parameters.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Dependence {
    /// Correlated normal scores.
    GaussianCopula(GaussianCopula),
}

/// A Gaussian copula: parameters with any marginal distributions depend on each other as correlated normal numbers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GaussianCopula {
    /// Names of 2 to 50 parameters with one numeric value each; all others are independent. A value with positive
    /// probability (of a choice or a point mass) occupies an interval of normal scores with that probability; values of
    /// a choice in their listed order.
    #[cfg_attr(feature = "schema", schemars(length(min = 2, max = 50)))]
    pub parameters: Vec<String>,
    /// Correlation matrix of the normal scores, in the order of `parameters`, row by row. Positive definite.
    pub correlation: Vec<Vec<f64>>,
}

#[derive(Debug, Clone)]
pub(super) struct Copula {
    coordinates: Vec<usize>,
    /// L, with L Lᵀ = R.
    cholesky_factor: DMatrix<f64>,
    /// R⁻¹ − 1.
    precision: DMatrix<f64>,
    half_ln_determinant: f64,
}

const CORRELATION: &str = "dependence.gaussian-copula.correlation";

impl Copula {
    pub(super) fn new(
        dependence: &Dependence,
        parameters: &[SpaceParameter],
    ) -> Result<Self, InvalidSpace> {
        let Dependence::GaussianCopula(spec) = dependence;
        let coordinates = spec.coordinates(parameters)?;
        let correlation = spec.correlation_matrix()?;
        let least = correlation.clone().symmetric_eigenvalues().min();
        let Some(cholesky) = correlation
            .clone()
            .cholesky()
            .filter(|_| least >= MIN_EIGENVALUE)
        else {
            let eigenvalue = format_compact(least);
            return reject(
                CORRELATION,
                format!(
                    "must be positive definite, with no eigenvalue below {MIN_EIGENVALUE}, found one of {eigenvalue}"
                ),
            );
        };
        let size = correlation.nrows();
        let half_ln_determinant = cholesky
            .l_dirty()
            .diagonal()
            .iter()
            .map(|entry| entry.ln())
            .sum();
        let precision = cholesky.inverse() - DMatrix::identity(size, size);
        Ok(Self {
            coordinates,
            cholesky_factor: cholesky.l(),
            precision,
            half_ln_determinant,
        })
    }

    /// Makes independent uniform numbers dependent.
    pub(super) fn correlate(&self, uniform: &[f64]) -> Vec<f64> {
        let normal = self.normal_scores(uniform);
        let mut depending = uniform.to_vec();
        for (row, &index) in self.coordinates.iter().enumerate() {
            let sum: f64 = (0..=row)
                .map(|column| self.cholesky_factor[(row, column)] * normal[column])
                .sum();
            if let Some(share) = depending.get_mut(index) {
                *share = Gauss::standard().cdf(sum);
            }
        }
        depending
    }

    /// Returns the coordinates that depend on each other.
    pub(super) fn coordinates(&self) -> impl Iterator<Item = usize> {
        self.coordinates.iter().copied()
    }

    /// Replaces scores of dependent coordinates by independent ones, for CDF values `below`.
    pub(super) fn decorrelate(&self, below: &[f64], scores: &mut [f64]) {
        let depending = DVector::from_vec(self.normal_scores(below));
        let Some(independent) = self.cholesky_factor.solve_lower_triangular(&depending) else {
            return;
        };
        for (&index, &independent_score) in self.coordinates.iter().zip(independent.iter()) {
            if let Some(score) = scores.get_mut(index) {
                *score = independent_score;
            }
        }
    }

    /// Returns the logarithm of the copula density at CDF values `below`: ln c(u) = −½ ln det R − ½ zᵀ (R⁻¹ − 1) z.
    pub(super) fn ln_density(&self, below: &[f64]) -> f64 {
        let z = self.normal_scores(below);
        let mut form = 0.0;
        for (row, left) in z.iter().enumerate() {
            for (column, right) in z.iter().enumerate() {
                form += left * self.precision[(row, column)] * right;
            }
        }
        -self.half_ln_determinant - 0.5 * form
    }

    /// Returns the normal scores of the dependent coordinates; 0 for missing ones.
    fn normal_scores(&self, shares: &[f64]) -> Vec<f64> {
        let scores = self.coordinates.iter().map(|&index| {
            let share = shares.get(index).copied().unwrap_or(0.5);
            let [lowest, highest] = PROBABILITY_RANGE;
            Gauss::standard().inverse_cdf(share.clamp(lowest, highest))
        });
        scores.collect()
    }
}

impl GaussianCopula {
    fn coordinates(&self, parameters: &[SpaceParameter]) -> Result<Vec<usize>, InvalidSpace> {
        let count = self.parameters.len();
        if !(2..=MAX_CORRELATED).contains(&count) {
            let field = "dependence.gaussian-copula.parameters";
            return reject(
                field,
                format!("must be 2 to {MAX_CORRELATED}, found {count}"),
            );
        }
        let mut coordinates = Vec::with_capacity(count);
        for (index, name) in self.parameters.iter().enumerate() {
            let field = format!("dependence.gaussian-copula.parameters[{index}]");
            let Some(parameter) = parameters.iter().find(|parameter| parameter.name() == name)
            else {
                return reject(field, format!("there is no parameter `{name}`"));
            };
            if parameter.target.kind() != ValueKind::Number {
                return reject(
                    field,
                    format!("`{name}` is a class or a driver, and only numbers can be correlated"),
                );
            }
            if parameter.coordinates().len() != 1 {
                return reject(
                    field,
                    format!(
                        "`{name}` is a signal, and only parameters with one value can be correlated"
                    ),
                );
            }
            if coordinates.contains(&parameter.coordinates().start) {
                return reject(field, format!("`{name}` is named twice"));
            }
            coordinates.push(parameter.coordinates().start);
        }
        Ok(coordinates)
    }

    fn correlation_matrix(&self) -> Result<DMatrix<f64>, InvalidSpace> {
        let size = self.parameters.len();
        if self.correlation.len() != size {
            return reject(
                CORRELATION,
                format!("must have {size} rows, found {}", self.correlation.len()),
            );
        }
        for (row, entries) in self.correlation.iter().enumerate() {
            let field = format!("{CORRELATION}[{row}]");
            if entries.len() != size {
                return reject(
                    field,
                    format!("must have {size} entries, found {}", entries.len()),
                );
            }
            for (column, &entry) in entries.iter().enumerate() {
                if let Some(problem) = self.entry_problem(row, column, entry) {
                    return reject(field, problem);
                }
            }
        }
        Ok(DMatrix::from_fn(size, size, |row, column| {
            self.correlation[row][column]
        }))
    }

    fn entry_problem(&self, row: usize, column: usize, entry: f64) -> Option<String> {
        let entry_text = format_compact(entry);
        if !(-1.0..=1.0).contains(&entry) {
            return Some(format!("must be from -1 to 1, found {entry_text}"));
        }
        if row == column && entry != 1.0 {
            return Some(format!("must have 1 on the diagonal, found {entry_text}"));
        }
        let mirrored = *self.correlation.get(column)?.get(row)?;
        (mirrored != entry).then(|| {
            format!(
                "must be symmetric, found {entry_text} and {}",
                format_compact(mirrored)
            )
        })
    }
}
