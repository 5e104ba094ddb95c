//! Linear scales, and round numbers for the labels of an axis.

use crumple_core::digits::format_fixed;

/// Maximum absolute value of an axis, which keeps every difference finite.
const MAX_VALUE: f64 = 1e12;

/// Maximum pixel coordinate, far outside any figure.
const MAX_PX: f64 = 1e5;

#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct LinearScale {
    domain: (f64, f64),
    range: (f64, f64),
}

impl LinearScale {
    /// Maps `domain.0` to `range.0` and `domain.1` to `range.1`; see [`drawable_interval`] for invalid domains.
    #[must_use]
    pub(crate) fn new(domain: (f64, f64), range: (f64, f64)) -> Self {
        Self {
            domain: drawable_interval(domain),
            range,
        }
    }

    /// Returns the pixel coordinate of `value`; NaN is at the start.
    #[must_use]
    pub(crate) fn to_px(self, value: f64) -> f64 {
        let value = if value.is_nan() { self.domain.0 } else { value };
        let share = (value - self.domain.0) / (self.domain.1 - self.domain.0);
        let px = self.range.0 + share * (self.range.1 - self.range.0);
        px.clamp(-MAX_PX, MAX_PX)
    }
}

/// Returns the nearest number that can be drawn; 0 for NaN.
fn clamp_finite(value: f64) -> f64 {
    if value.is_nan() {
        0.0
    } else {
        value.clamp(-MAX_VALUE, MAX_VALUE)
    }
}

/// Returns the nearest interval that can be drawn: finite, increasing, and wide enough that its ticks differ.
#[must_use]
pub(crate) fn drawable_interval(domain: (f64, f64)) -> (f64, f64) {
    let from = clamp_finite(domain.0);
    let to = clamp_finite(domain.1);
    let low = from.min(to);
    let high = from.max(to);
    let min_width = (low.abs().max(high.abs()) * 1e-6).max(1e-9);
    if high - low >= min_width {
        return (low, high);
    }
    let half = (low.abs().max(high.abs()) * 0.05).max(0.5);
    (low - half, high + half)
}

/// Returns the smallest interval that holds every finite value; `(0, 1)` if there is none.
#[must_use]
pub fn extent(values: impl IntoIterator<Item = f64>) -> (f64, f64) {
    let finite = values.into_iter().filter(|value| value.is_finite());
    let (low, high) = finite.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| {
        (low.min(v), high.max(v))
    });
    if low <= high { (low, high) } else { (0.0, 1.0) }
}

/// Adds `share` of its width to each end of an interval.
#[must_use]
pub fn pad_interval(domain: (f64, f64), share: f64) -> (f64, f64) {
    let (low, high) = drawable_interval(domain);
    let pad = share * (high - low);
    (low - pad, high + pad)
}

/// Round numbers inside an interval, evenly spaced by 1, 2 or 5 times a power of ten.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ticks {
    /// Numbers in increasing order.
    pub values: Vec<f64>,
    /// Number of decimals that distinguishes them.
    pub decimals: usize,
}

impl Ticks {
    /// Returns the closest-spaced round numbers in `domain`: at least 2, and at most `max_count` (clamped to 5 to 10).
    #[must_use]
    pub(crate) fn new(domain: (f64, f64), max_count: usize) -> Self {
        let (low, high) = drawable_interval(domain);
        let max_count = max_count.clamp(5, 10);
        // Neighbouring steps differ by a factor of at most 2.5: the first that fits leaves two or more.
        let start = ((high - low) / max_count as f64).log10().floor() as i32 - 1;
        for exponent in start..start + 5 {
            for factor in [1.0, 2.0, 5.0] {
                let step = factor * 10f64.powi(exponent);
                // Count multiples in whole numbers, so that no rounding error accumulates.
                let slack = 1e-9;
                let first = (low / step - slack).ceil();
                let last = (high / step + slack).floor();
                let count = (last - first) as usize + 1;
                if last >= first && count <= max_count {
                    let values = (0..count).map(|index| {
                        let multiple = first + index as f64;
                        let value = if exponent < 0 {
                            multiple * factor / 10f64.powi(-exponent)
                        } else {
                            multiple * step
                        };
                        value.clamp(low, high) + 0.0
                    });
                    let decimals = usize::try_from(-exponent).unwrap_or(0);
                    return Self {
                        values: values.collect(),
                        decimals,
                    };
                }
            }
        }
        Self {
            values: vec![low, high],
            decimals: 0,
        }
    }

    pub(crate) fn labels(&self) -> impl Iterator<Item = (f64, String)> + '_ {
        self.values
            .iter()
            .map(|&value| (value, format_number(value, self.decimals)))
    }
}

/// Formats a number with a true minus sign, and none on zero.
#[must_use]
pub fn format_number(value: f64, decimals: usize) -> String {
    let text = format_fixed(value, decimals);
    match text.strip_prefix('-') {
        Some(digits) => format!("\u{2212}{digits}"),
        None => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::num::f64::ANY as ANY_NUMBER;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn ticks_are_few_round_and_inside(low in -1e6..1e6f64, exponent in -3.0..6.0f64, most in 0usize..20) {
            let domain = (low, low + 10f64.powf(exponent));
            let Ticks { values, decimals } = Ticks::new(domain, most);
            let (low, high) = drawable_interval(domain);
            prop_assert!((2..=10).contains(&values.len()), "{values:?}");
            prop_assert!(values.iter().all(|v| (low..=high).contains(v)), "{values:?}");
            let steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
            let step = steps[0];
            prop_assert!(steps.iter().all(|other| (other / step - 1.0).abs() < 1e-3), "{values:?}");
            let mantissa = step / 10f64.powf((step * 1.000_1).log10().floor());
            prop_assert!([1.0, 2.0, 5.0].iter().any(|nice| (mantissa / nice - 1.0).abs() < 1e-3), "{values:?}");
            let mut labels: Vec<String> = values.iter().map(|v| format_number(*v, decimals)).collect();
            labels.dedup();
            prop_assert_eq!(labels.len(), values.len());
        }

        #[test]
        fn any_interval_can_be_drawn(low in ANY_NUMBER, high in ANY_NUMBER, value in ANY_NUMBER) {
            let scale = LinearScale::new((low, high), (10.0, 110.0));
            prop_assert!(scale.to_px(value).is_finite());
            prop_assert!((scale.to_px(scale.domain.0) - 10.0).abs() < 1e-9);
            prop_assert!((scale.to_px(scale.domain.1) - 110.0).abs() < 1e-9);
            prop_assert!((2..=10).contains(&Ticks::new((low, high), 6).values.len()));
        }
    }

    #[test]
    fn typical_axes_have_round_ticks() {
        assert_eq!(Ticks::new((0.0, 15.0), 6).values, [0.0, 5.0, 10.0, 15.0]);
        assert_eq!(
            Ticks::new((0.0, 26.5), 6).values,
            [0.0, 5.0, 10.0, 15.0, 20.0, 25.0]
        );
        assert_eq!(
            Ticks::new((-0.2, 0.31), 6).values,
            [-0.2, -0.1, 0.0, 0.1, 0.2, 0.3]
        );
        assert_eq!(format_number(-0.04, 1), "0.0");
        assert_eq!(format_number(-2.5, 1), "\u{2212}2.5");
    }
}
