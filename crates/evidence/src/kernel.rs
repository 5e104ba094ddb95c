//! Certificates of safety kernels: the closed form with exact coefficients.

use crumple_verify::{Certificate, Statement};

use super::certificate_without_scenario;
use crumple_sim::control::{MIN_MARGIN_M, ViabilityKernel};
use crumple_sim::scenario::{PAPER_STEP_S, VehicleClass};

/// Returns the certificates of all pairs of vehicle classes on a dry road, by names such as `light-behind-heavy`.
#[must_use]
pub fn shipped_kernels() -> Vec<(String, Certificate)> {
    let pairs = VehicleClass::ALL
        .iter()
        .flat_map(|&own| VehicleClass::ALL.iter().map(move |&ahead| (own, ahead)));
    let certificates = pairs.filter_map(|(own, ahead)| {
        let kernel = ViabilityKernel {
            own_brake_mps2: own.max_brake_mps2(),
            ahead_brake_mps2: ahead.max_brake_mps2(),
        };
        let name = format!("{}-behind-{}", own.name(), ahead.name());
        let certificate = kernel_certificate(&kernel, PAPER_STEP_S, MIN_MARGIN_M)?;
        Some((name, certificate))
    });
    certificates.collect()
}

/// Returns the certificate of a kernel; `None` if a limit is not positive, or has too many digits. Numbers are taken as
/// they are printed: 7.5 is 15/2, and 0.01 is 1/100.
#[must_use]
pub fn kernel_certificate(
    kernel: &ViabilityKernel,
    step_s: f64,
    margin_m: f64,
) -> Option<Certificate> {
    let [b, c, h, m] = [
        kernel.own_brake_mps2,
        kernel.ahead_brake_mps2,
        step_s,
        margin_m,
    ]
    .map(Rational::from_f64);
    let b = b?;
    let c = c?;
    let harder = b.checked_sub(c)?;
    Some(certificate_without_scenario(Statement::Kernel(
        crumple_verify::KernelClaim {
            ego_brake_mps2: b.to_string(),
            leader_brake_mps2: c.to_string(),
            step_s: h?.to_string(),
            margin_m: m?.to_string(),
            stopping_own_squared: b.half_reciprocal()?.to_string(),
            stopping_ahead_squared: format!("-{}", c.half_reciprocal()?),
            catching_up_squared: if harder.numerator > 0 {
                Some(harder.half_reciprocal()?.to_string())
            } else {
                None
            },
        },
    )))
}

/// A rational number in lowest terms.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Rational {
    numerator: i128,
    denominator: i128,
}

impl Rational {
    fn new(numerator: i128, denominator: i128) -> Option<Self> {
        let mut divisor = numerator.checked_abs()?;
        let mut remainder = denominator;
        while remainder != 0 {
            (divisor, remainder) = (remainder, divisor % remainder);
        }
        (denominator > 0).then(|| Self {
            numerator: numerator / divisor,
            denominator: denominator / divisor,
        })
    }

    /// Converts a positive number as it is printed.
    fn from_f64(value: f64) -> Option<Self> {
        let text = (value > 0.0 && value.is_finite()).then(|| value.to_string())?;
        let (whole, decimals) = text.split_once('.').unwrap_or((&text, ""));
        let denominator = 10_i128.checked_pow(u32::try_from(decimals.len()).ok()?)?;
        Self::new(format!("{whole}{decimals}").parse().ok()?, denominator)
    }

    fn checked_sub(self, subtrahend: Self) -> Option<Self> {
        let minuend_numerator = self.numerator.checked_mul(subtrahend.denominator)?;
        let subtrahend_numerator = subtrahend.numerator.checked_mul(self.denominator)?;
        Self::new(
            minuend_numerator.checked_sub(subtrahend_numerator)?,
            self.denominator.checked_mul(subtrahend.denominator)?,
        )
    }

    fn half_reciprocal(self) -> Option<Self> {
        Self::new(self.denominator, self.numerator.checked_mul(2)?)
    }
}

impl std::fmt::Display for Rational {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self {
            numerator,
            denominator,
        } = self;
        if *denominator == 1 {
            write!(out, "{numerator}")
        } else {
            write!(out, "{numerator}/{denominator}")
        }
    }
}

#[cfg(test)]
mod tests;
