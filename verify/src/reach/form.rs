//! Affine forms: numbers that keep their correlations.
//!
//! A form is the set of numbers c + Σ aᵢ εᵢ + ρ with εᵢ and ρ/rest in [-1, 1]. Forms share the symbols εᵢ, so common
//! parts of two forms cancel in their difference; `rest` is not shared.
//!
//! # Rounding
//! An operation that changes terms computes each of them with at most three roundings. Each rounding of a result r errs
//! by at most u |r| with u = 2⁻⁵³, or by less than 10⁻³⁰⁰ if it underflows. The sum of the |r| times at least 2u goes
//! into `rest`, at least twice the required amount, which also covers rounding that sum. Sums of n ≤ 8500 numbers that
//! are not negative err by less than 10⁻¹² of themselves. A number that is not finite makes the form the whole line.

use crate::interval::Interval;

/// Upper bound of the relative error of a sum of 8500 products, (8500 + 2) 2⁻⁵³.
pub(super) const SUM_REL_ERROR: f64 = 1e-12;

/// Bounds a number that is not negative and was computed with at most five roundings.
pub(super) fn round_up(computed: f64) -> f64 {
    computed * (1.0 + 1e-15) + 1e-300
}

/// Largest rest that gets no symbol.
const NEGLIGIBLE_REST: f64 = 1e-9;

/// An affine form c + Σ aᵢ εᵢ + ρ.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct AffineForm {
    centre: f64,
    terms: Vec<f64>,
    rest: f64,
}

impl AffineForm {
    /// Returns the whole line.
    #[must_use]
    pub fn entire() -> Self {
        Self {
            centre: 0.0,
            terms: Vec::new(),
            rest: f64::INFINITY,
        }
    }

    /// Creates an uncorrelated form of an interval.
    #[must_use]
    pub fn constant(value: Interval) -> Self {
        let mut form = Self::default();
        form.shift(value);
        form
    }

    /// Creates a form in which `symbol` selects the member of an interval.
    #[must_use]
    pub fn symbol(symbol: usize, value: Interval) -> Self {
        Self::constant(value).with_rest_as_symbol(symbol)
    }

    /// Turns `rest` into a term, unless it is negligible; no other form may use `symbol`.
    #[must_use]
    pub fn with_rest_as_symbol(mut self, symbol: usize) -> Self {
        if self.rest > NEGLIGIBLE_REST {
            self.terms.resize(self.terms.len().max(symbol + 1), 0.0);
            self.terms[symbol] = self.rest;
            self.rest = 0.0;
        }
        self
    }

    /// Returns c.
    #[must_use]
    pub fn centre(&self) -> f64 {
        self.centre
    }

    /// Returns the stored aᵢ; the others are 0.
    #[must_use]
    pub fn terms(&self) -> &[f64] {
        &self.terms
    }

    /// Returns the radius of ρ, which belongs to no symbol.
    #[must_use]
    pub fn rest(&self) -> f64 {
        self.rest
    }

    /// Returns the largest distance from c.
    #[must_use]
    pub fn radius(&self) -> f64 {
        round_up(
            (self.terms.iter().map(|term| term.abs()).sum::<f64>() + self.rest)
                * (1.0 + SUM_REL_ERROR),
        )
    }

    /// Returns the interval of all members.
    #[must_use]
    pub fn range(&self) -> Interval {
        if *self == Self::default() {
            return Interval::ZERO;
        }
        Interval::point(self.centre) + Interval::around_zero(self.radius())
    }

    /// True if the form is exactly zero.
    #[must_use]
    pub fn is_zero(&self) -> bool {
        self.centre == 0.0 && self.rest == 0.0 && self.terms.iter().all(|&term| term == 0.0)
    }

    /// Adds any number from -`by` to `by`.
    pub fn widen(&mut self, by: f64) {
        self.rest = round_up(self.rest + by);
    }

    /// Adds an interval.
    pub fn shift(&mut self, by: Interval) {
        let (middle, radius) = by.middle_and_radius();
        let centre = self.centre + middle;
        let rounding = if self.centre == 0.0 || middle == 0.0 {
            0.0
        } else {
            centre.abs() * f64::EPSILON
        };
        if radius > 0.0 || rounding > 0.0 {
            self.widen(radius + rounding);
        }
        self.centre = centre;
    }

    /// Adds a multiple of another form.
    pub fn add_scaled(&mut self, other: &Self, factor: Interval) {
        if other.is_zero() {
            return;
        }
        let (factor, uncertain) = factor.middle_and_radius();
        self.terms
            .resize(self.terms.len().max(other.terms.len()), 0.0);
        let mut rounded = 0.0;
        let mut add = |to: &mut f64, from: f64| {
            let product = factor * from;
            *to += product;
            rounded += product.abs() + to.abs();
        };
        add(&mut self.centre, other.centre);
        for (to, &from) in self.terms.iter_mut().zip(&other.terms) {
            add(to, from);
        }
        let mut more = factor.abs() * other.rest + rounded * (2.0 * f64::EPSILON);
        if uncertain > 0.0 {
            more += uncertain * (other.centre.abs() + other.radius());
        }
        self.widen(more);
    }

    /// Returns a multiple of the form.
    #[must_use]
    pub fn scaled(&self, factor: Interval) -> Self {
        let mut scaled = Self::default();
        scaled.add_scaled(self, factor);
        scaled
    }

    /// Returns the sum.
    #[must_use]
    pub fn plus(mut self, other: &Self) -> Self {
        self.add_scaled(other, Interval::point(1.0));
        self
    }

    /// Returns the difference.
    #[must_use]
    pub fn minus(mut self, other: &Self) -> Self {
        self.add_scaled(other, Interval::point(-1.0));
        self
    }

    /// Returns a form that encloses both for common symbol values. Each term keeps its common part, so the range does
    /// not exceed the hull of both ranges.
    #[must_use]
    pub fn join(&self, other: &Self) -> Self {
        if self == other {
            return self.clone();
        }
        let terms = self.terms.iter().zip(&other.terms).map(|(&a, &b)| {
            if a * b > 0.0 {
                a.abs().min(b.abs()).copysign(a)
            } else {
                0.0
            }
        });
        let mut joined = Self {
            centre: 0.5 * self.centre + 0.5 * other.centre,
            terms: terms.collect(),
            rest: 0.0,
        };
        let [excess, other_excess] = [self, other].map(|form| form.clone().minus(&joined).range());
        joined.shift(excess.hull(other_excess));
        joined
    }

    /// Replaces the terms from a symbol on, and adds any number from -`by` to `by`.
    pub(super) fn replace_terms(&mut self, from: usize, terms: impl Iterator<Item = f64>, by: f64) {
        self.terms.resize(from, 0.0);
        self.terms.extend(terms);
        if by != 0.0 {
            self.widen(by);
        }
    }

    /// Returns the product: (c + α)(d + β) = c (d + β) + d α + α β, where |α β| is at most the product of the radii.
    #[must_use]
    pub fn times(&self, other: &Self) -> Self {
        let mut product = other.scaled(Interval::point(self.centre));
        let deviation = Self {
            centre: 0.0,
            ..self.clone()
        };
        product.add_scaled(&deviation, Interval::point(other.centre));
        let beyond = self.radius() * other.radius();
        if !self.is_zero() && !other.is_zero() {
            product.widen(round_up(beyond));
        }
        product
    }
}
