//! Matrices of three rows and columns. Each sum of products is formed from left to right, so that results do not depend
//! on the compiler.

use std::ops::{Add, Mul};

pub(super) type Vector3 = [f64; 3];

/// A matrix, given by its rows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Matrix3(pub(super) [Vector3; 3]);

impl Matrix3 {
    pub(super) const IDENTITY: Self = Self([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);

    fn from_fn(element: impl Fn(usize, usize) -> f64) -> Self {
        Self([0, 1, 2].map(|row| [0, 1, 2].map(|column| element(row, column))))
    }

    /// Returns the product of a column and a row.
    pub(super) fn outer_product(column: &Vector3, row: &Vector3) -> Self {
        Self(column.map(|left| row.map(|right| left * right)))
    }

    pub(super) fn first_column(&self) -> Vector3 {
        self.0.map(|[first, ..]| first)
    }

    pub(super) fn transpose(&self) -> Self {
        Self::from_fn(|row, column| self.0[column][row])
    }

    /// Returns the inverse by the formula of cofactors; `None` if the determinant is 0.
    pub(super) fn inverse(&self) -> Option<Self> {
        let [[a, b, c], [d, e, f], [g, h, i]] = self.0;
        let minor_a = e * i - h * f;
        let minor_b = d * i - g * f;
        let minor_c = d * h - g * e;
        let determinant = a * minor_a - b * minor_b + c * minor_c;
        #[rustfmt::skip]
        let adjugate = Self([
            [minor_a, c * h - i * b, b * f - e * c],
            [-minor_b, a * i - g * c, c * d - f * a],
            [minor_c, b * g - h * a, a * e - d * b],
        ]);
        (determinant != 0.0).then(|| Self(adjugate.0.map(|row| row.map(|x| x / determinant))))
    }

    /// Returns the lower triangular factor L of a symmetric matrix L Lᵀ; `None` if it is not positive definite. Reads
    /// only the lower triangle.
    pub(super) fn cholesky(&self) -> Option<Self> {
        let [[a, ..], [b, d, _], [c, e, f]] = self.0;
        let l00 = positive_root(a)?;
        let l10 = b / l00;
        let l20 = c / l00;
        let l11 = positive_root(d - l10 * l10)?;
        let l21 = (e - l10 * l20) / l11;
        let l22 = positive_root(f - l20 * l20 - l21 * l21)?;
        Some(Self([[l00, 0.0, 0.0], [l10, l11, 0.0], [l20, l21, l22]]))
    }
}

fn positive_root(value: f64) -> Option<f64> {
    (value > 0.0).then(|| value.sqrt())
}

impl Add for Matrix3 {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self::from_fn(|row, column| self.0[row][column] + other.0[row][column])
    }
}

impl Mul for Matrix3 {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let columns = other.transpose().0.map(|column| self * column);
        Self(columns).transpose()
    }
}

impl Mul<Vector3> for Matrix3 {
    type Output = Vector3;

    fn mul(self, [x, y, z]: Vector3) -> Vector3 {
        self.0.map(|[a, b, c]| a * x + b * y + c * z)
    }
}

impl Mul<f64> for Matrix3 {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self(self.0.map(|row| row.map(|value| value * factor)))
    }
}

#[cfg(test)]
mod tests;
