//! Matrices of three rows and columns. Each sum of products is formed from left to right, so that results do not depend
//! on the compiler.

use std::ops::{Add, Mul};

pub(super) type Vector3 = [f64; 3];

/// A matrix, given by its rows.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Matrix3(pub(super) [Vector3; 3]);

impl Matrix3 {
    pub(super) const IDENTITY: Self = Self([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);

    /// Computes each element. With loops, since nested `map` of arrays is a call for each element where it is not
    /// inlined, and took a quarter of the time of short runs.
    #[inline]
    fn from_fn(element: impl Fn(usize, usize) -> f64) -> Self {
        let mut rows = [[0.0; 3]; 3];
        for (row, values) in rows.iter_mut().enumerate() {
            for (column, value) in values.iter_mut().enumerate() {
                *value = element(row, column);
            }
        }
        Self(rows)
    }

    /// Returns the product of a column and a row.
    pub(super) fn outer_product(column: &Vector3, row: &Vector3) -> Self {
        Self::from_fn(|left, right| column[left] * row[right])
    }

    pub(super) fn first_column(&self) -> Vector3 {
        let [[x, ..], [y, ..], [z, ..]] = self.0;
        [x, y, z]
    }

    #[inline]
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
        (determinant != 0.0)
            .then(|| Self::from_fn(|row, column| adjugate.0[row][column] / determinant))
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
        Self::from_fn(|row, column| {
            let [a, b, c] = self.0[row];
            a * other.0[0][column] + b * other.0[1][column] + c * other.0[2][column]
        })
    }
}

impl Mul<Vector3> for Matrix3 {
    type Output = Vector3;

    #[inline]
    fn mul(self, [x, y, z]: Vector3) -> Vector3 {
        let [first, second, third] = self.0;
        let product = |[a, b, c]: Vector3| a * x + b * y + c * z;
        [product(first), product(second), product(third)]
    }
}

impl Mul<f64> for Matrix3 {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self::from_fn(|row, column| self.0[row][column] * factor)
    }
}

#[cfg(test)]
mod tests;
