//! Certificates state what the shield computes, and the checker accepts them.
#![allow(clippy::unwrap_used, clippy::panic)]

use std::ops::{Add, Div, Mul, Neg, Sub};

use super::*;
use crumple_sim::control::Real;
use crumple_verify::{ProvedClaim, check};
use proptest::prelude::*;

/// Exact arithmetic for the shield's functions. Overflow panics; the numbers of the tests are short.
impl Real for Rational {
    type Truth = bool;

    fn from_f64(value: f64) -> Self {
        let scaled = value * 4.0;
        assert!(scaled.fract() == 0.0, "no constant from_f64 the kernel");
        Self::new(scaled as i128, 4).unwrap()
    }

    fn greater_than(self, other: Self) -> bool {
        self.checked_sub(other).unwrap().numerator > 0
    }

    fn at_least(self, other: Self) -> bool {
        self.checked_sub(other).unwrap().numerator >= 0
    }

    fn select(truth: bool, then: impl FnOnce() -> Self, otherwise: impl FnOnce() -> Self) -> Self {
        if truth { then() } else { otherwise() }
    }
}

impl Add for Rational {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        self.checked_sub(-other).unwrap()
    }
}

impl Sub for Rational {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        self.checked_sub(other).unwrap()
    }
}

impl Mul for Rational {
    type Output = Self;
    fn mul(self, other: Self) -> Self {
        Self::new(
            self.numerator.checked_mul(other.numerator).unwrap(),
            self.denominator.checked_mul(other.denominator).unwrap(),
        )
        .unwrap()
    }
}

impl Div for Rational {
    type Output = Self;
    fn div(self, other: Self) -> Self {
        let sign = other.numerator.signum();
        self * Self::new(sign * other.denominator, sign * other.numerator).unwrap()
    }
}

impl Neg for Rational {
    type Output = Self;
    fn neg(self) -> Self {
        Self {
            numerator: -self.numerator,
            denominator: self.denominator,
        }
    }
}

fn rational(value: f64) -> Rational {
    Real::from_f64(value)
}

fn parse_rational(text: &str) -> Rational {
    let (over, under) = text.split_once('/').unwrap_or((text, "1"));
    Rational::new(over.parse().unwrap(), under.parse().unwrap()).unwrap()
}

/// D(v, w) as `crumple_verify::kernel` proves it.
fn stated_gap_m(stated: &crumple_verify::KernelClaim, v: Rational, w: Rational) -> Rational {
    let [b, c, p, q] = [
        &stated.ego_brake_mps2,
        &stated.leader_brake_mps2,
        &stated.stopping_own_squared,
        &stated.stopping_ahead_squared,
    ]
    .map(|text| parse_rational(text));
    let zero = rational(0.0);
    match &stated.catching_up_squared {
        Some(r) if Real::greater_than(w / c, v / b) => {
            parse_rational(r) * (v - w).larger(zero) * (v - w).larger(zero)
        }
        _ => (p * v * v + q * w * w).larger(zero),
    }
}

/// Compares with the shield's function in exact arithmetic, so that any wrong coefficient is detected.
#[test]
fn certificate_and_shield_compute_the_same() {
    let quarter = |over: i128| Rational::new(over, 4).unwrap();
    let speeds = || (0..=60).chain([75, 100, 140]).map(quarter);
    for (b, c) in [
        (7.5, 7.5),
        (7.5, 6.0),
        (6.0, 7.5),
        (6.0, 6.0),
        (8.0, 5.0),
        (0.25, 30.0),
        (30.0, 0.5),
    ] {
        let limits = ViabilityKernel {
            own_brake_mps2: b,
            ahead_brake_mps2: c,
        };
        let certificate = kernel_certificate(&limits, 0.01, 1e-6).unwrap();
        assert_eq!(check(&certificate), Ok(ProvedClaim::Kernel));
        let Statement::Kernel(stated) = certificate.statement else {
            panic!("a kernel")
        };
        let shield = ViabilityKernel {
            own_brake_mps2: rational(b),
            ahead_brake_mps2: rational(c),
        };
        for v in speeds() {
            for w in speeds() {
                assert_eq!(
                    shield.demanded_gap_m(v, w),
                    stated_gap_m(&stated, v, w),
                    "{v} m/s behind {w} m/s, {b} {c}"
                );
            }
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn certificates_of_any_pair_are_accepted(
        b in 0.001..30.0_f64, c in 0.001..30.0_f64, v in 0.0..100.0_f64, part in 0.0..2.0_f64,
    ) {
        let kernel = ViabilityKernel { own_brake_mps2: b, ahead_brake_mps2: c };
        let certificate = kernel_certificate(&kernel, 0.01, 1e-6).unwrap();
        prop_assert_eq!(check(&certificate), Ok(ProvedClaim::Kernel));
        let Statement::Kernel(stated) = certificate.statement else { panic!("a kernel") };
        let number = |text: &str| {
            let (over, under) = text.split_once('/').unwrap_or((text, "1"));
            over.parse::<f64>().unwrap() / under.parse::<f64>().unwrap()
        };
        let (p, q) = (number(&stated.stopping_own_squared), number(&stated.stopping_ahead_squared));
        // A leader that stops at `part` of the follower's time to standstill.
        let w = part * c * v / b;
        let demanded_m = match &stated.catching_up_squared {
            Some(r) if part > 1.0 => number(r) * (v - w).max(0.0).powi(2),
            _ => (p * v * v + q * w * w).max(0.0),
        };
        prop_assert!((kernel.demanded_gap_m(v, w) - demanded_m).abs() <= 1e-9 * (p * v * v - q * w * w));
    }
}
