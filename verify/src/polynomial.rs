//! Polynomials in three variables with exact rational coefficients. One without a negative coefficient is nonnegative
//! if no variable is negative.

use std::collections::BTreeMap;
use std::ops::{Add, Mul, Neg, Sub};

use num_rational::BigRational;
use num_traits::{Signed, Zero};

/// A polynomial in x, y and z: the coefficient of xⁱ yʲ zᵏ under `[i, j, k]`, zeros left out.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Polynomial(BTreeMap<[u8; 3], BigRational>);

impl Polynomial {
    #[must_use]
    pub(crate) fn constant(value: &BigRational) -> Self {
        Self::term([0; 3], value.clone())
    }

    /// Returns the three variables.
    #[must_use]
    pub fn variables() -> [Self; 3] {
        let unit = BigRational::from_integer(1.into());
        [[1, 0, 0], [0, 1, 0], [0, 0, 1]].map(|powers| Self::term(powers, unit.clone()))
    }

    fn term(powers: [u8; 3], coefficient: BigRational) -> Self {
        let terms = [(powers, coefficient)]
            .into_iter()
            .filter(|(_, coefficient)| !coefficient.is_zero());
        Self(terms.collect())
    }

    /// Returns the product with itself.
    #[must_use]
    pub fn squared(&self) -> Self {
        self * self
    }

    #[cfg(test)]
    pub(crate) fn evaluate(&self, point: [&BigRational; 3]) -> BigRational {
        let terms = self.0.iter().map(|(powers, coefficient)| {
            powers
                .iter()
                .zip(point)
                .flat_map(|(&power, value)| std::iter::repeat_n(value, power.into()))
                .fold(coefficient.clone(), |product, factor| product * factor)
        });
        terms.sum()
    }

    /// True for the polynomial 0.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.0.is_empty()
    }

    /// True if no coefficient is negative, so that no value is, for x, y, z >= 0.
    #[must_use]
    pub fn has_no_negative_coefficient(&self) -> bool {
        self.0
            .values()
            .all(|coefficient| !coefficient.is_negative())
    }
}

impl Add for &Polynomial {
    type Output = Polynomial;

    fn add(self, other: &Polynomial) -> Polynomial {
        let mut sum = self.0.clone();
        for (powers, coefficient) in &other.0 {
            *sum.entry(*powers).or_insert_with(BigRational::zero) += coefficient;
        }
        sum.retain(|_, coefficient| !coefficient.is_zero());
        Polynomial(sum)
    }
}

impl Neg for &Polynomial {
    type Output = Polynomial;

    fn neg(self) -> Polynomial {
        Polynomial(
            self.0
                .iter()
                .map(|(powers, coefficient)| (*powers, -coefficient))
                .collect(),
        )
    }
}

impl Sub for &Polynomial {
    type Output = Polynomial;

    fn sub(self, other: &Polynomial) -> Polynomial {
        self + &-other
    }
}

impl Mul for &Polynomial {
    type Output = Polynomial;

    fn mul(self, other: &Polynomial) -> Polynomial {
        let mut product = Polynomial(BTreeMap::new());
        for ([i, j, k], a) in &self.0 {
            for ([l, m, n], b) in &other.0 {
                product = &product + &Polynomial::term([i + l, j + m, k + n], a * b);
            }
        }
        product
    }
}

impl Mul<&Polynomial> for &BigRational {
    type Output = Polynomial;

    fn mul(self, other: &Polynomial) -> Polynomial {
        &Polynomial::constant(self) * other
    }
}
