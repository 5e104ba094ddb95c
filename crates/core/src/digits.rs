//! Numbers in messages and reports, for readers: `8.31` and not `8.31e0`.

use std::ops::{Range, RangeInclusive};

const FIXED_NOTATION_EXPONENTS: RangeInclusive<i32> = -4..=6;
/// Significant digits of [`format_number`]; one more would show the rounding of sums and products.
const EXACT_DIGITS: usize = 15;
/// Sizes that [`format_number`] and [`format_fixed`] write without an exponent.
const PLAIN_SIZES: Range<f64> = 1e-9..1e12;

/// Returns a number with `digits` significant digits (at least one), in scientific notation below 1e-4 and from 1e7 on.
///
/// ```
/// use crumple_core::digits::format_rounded;
/// let formatted = [format_rounded(8.3149, 3), format_rounded(9.55691e-4, 5), format_rounded(9.55e-5, 2)];
/// assert_eq!(["8.31", "0.00095569", "9.6e-5"], formatted);
/// ```
#[must_use]
pub fn format_rounded(number: f64, digits: usize) -> String {
    if number == 0.0 || !number.is_finite() {
        // Adding 0 removes the sign of a zero.
        return (number + 0.0).to_string();
    }
    let (rounded, exponent) = format_scientific(number, digits);
    match exponent {
        exponent if FIXED_NOTATION_EXPONENTS.contains(&exponent) => {
            let decimals = usize::try_from(digits as i32 - 1 - exponent).unwrap_or(0);
            format!("{number:.decimals$}")
        }
        _ => rounded,
    }
}

/// Returns an upper bound with `digits` significant digits, rounded up, so that it claims no more than was shown.
#[must_use]
pub fn format_rounded_up(bound: f64, digits: usize) -> String {
    let (rounded, exponent) = format_scientific(bound, digits);
    match rounded.parse::<f64>() {
        Ok(shown) if shown < bound => {
            // Parsed, because powers of ten below 1e-308 are 0 when computed.
            let step = format!("1e{}", exponent + 1 - digits as i32)
                .parse()
                .unwrap_or(f64::MIN_POSITIVE);
            format_rounded(shown + step, digits)
        }
        Ok(shown) => format_rounded(shown, digits),
        Err(_) => rounded,
    }
}

/// Returns a lower bound with `digits` significant digits, rounded down, so that it claims no more than was shown.
///
/// ```
/// use crumple_core::digits::format_rounded_down;
/// assert_eq!(["74.0", "0.259", "9.99"], [74.096, 0.2597, 9.9999].map(|bound| format_rounded_down(bound, 3)));
/// ```
#[must_use]
pub fn format_rounded_down(bound: f64, digits: usize) -> String {
    let nearest = format_rounded(bound, digits);
    let Some(shown) = nearest.parse::<f64>().ok().filter(|shown| *shown > bound) else {
        return nearest;
    };
    let (_, exponent) = format_scientific(bound, digits);
    // Below a power of ten, numbers with as many digits are ten times as dense.
    let lower = [0, 1].into_iter().filter_map(|size| {
        let step: f64 = format!("1e{}", exponent + size - digits as i32)
            .parse()
            .ok()?;
        Some(format_rounded(shown - step, digits))
    });
    lower
        .into_iter()
        .find(|text| text.parse::<f64>().is_ok_and(|shown| shown <= bound))
        .unwrap_or_else(|| "0".to_owned())
}

/// Returns a lower bound with a fixed number of decimals, rounded down.
#[must_use]
pub fn format_fixed_down(bound: f64, decimals: usize) -> String {
    format_fixed_towards(bound, decimals, -1.0)
}

/// Returns an upper bound with a fixed number of decimals, rounded up.
#[must_use]
pub fn format_fixed_up(bound: f64, decimals: usize) -> String {
    format_fixed_towards(bound, decimals, 1.0)
}

/// Returns an interval with a fixed number of decimals, its ends rounded outward.
///
/// ```
/// use crumple_core::digits::format_interval;
/// assert_eq!("0.12 to 0.36", format_interval([0.1249, 0.351], 2));
/// ```
#[must_use]
pub fn format_interval([lower, upper]: [f64; 2], decimals: usize) -> String {
    let lower = format_fixed_down(lower, decimals);
    let upper = format_fixed_up(upper, decimals);
    format!("{lower} to {upper}")
}

/// Returns a number with a fixed number of decimals, or a hyphen for `None`: a cell of a table in a terminal.
#[must_use]
pub fn format_or_hyphen(number: Option<f64>, decimals: usize) -> String {
    number.map_or("-".to_owned(), |number| format_fixed(number, decimals))
}

/// Returns a number with a fixed number of decimals, rounded in the direction of a sign.
fn format_fixed_towards(number: f64, decimals: usize, sign: f64) -> String {
    let nearest = format_fixed(number, decimals);
    match nearest.parse::<f64>() {
        Ok(shown) if sign * shown < sign * number => {
            let step: f64 = format!("1e-{decimals}").parse().unwrap_or(0.0);
            format_fixed(shown + sign * step, decimals)
        }
        _ => nearest,
    }
}

/// Formats a number, with an exponent below 1e-9 and from 1e16 on.
#[must_use]
pub fn format_compact(number: f64) -> String {
    format_plain_within(number, 1e-9..1e16)
}

/// Formats a number, with an exponent if its size is outside `plain_sizes`.
#[must_use]
pub fn format_plain_within(number: f64, plain_sizes: Range<f64>) -> String {
    let size = number.abs();
    if size != 0.0 && size.is_finite() && !plain_sizes.contains(&size) {
        format!("{number:e}")
    } else {
        number.to_string()
    }
}

/// Returns a number without rounding errors and without a negative zero, with an exponent below 1e-9 and from 1e12 on.
///
/// ```
/// use crumple_core::digits::format_number;
/// assert_eq!(["0.3", "0"], [0.1 + 0.2, -0.0].map(format_number));
/// ```
#[must_use]
pub fn format_number(number: f64) -> String {
    let (scientific, _) = format_scientific(number, EXACT_DIGITS);
    let rounded = scientific.parse().unwrap_or(number);
    // Adding 0 removes the sign of a zero.
    format_plain_within(rounded + 0.0, PLAIN_SIZES)
}

/// Returns a number with a fixed number of decimals and without a negative zero; from 1e12 on, as [`format_number`].
#[must_use]
pub fn format_fixed(number: f64, decimals: usize) -> String {
    if number.abs() >= PLAIN_SIZES.end {
        return format_number(number);
    }
    let text = format!("{number:.decimals$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|byte| matches!(byte, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

/// Returns a number in scientific notation, and its exponent.
fn format_scientific(number: f64, digits: usize) -> (String, i32) {
    let rounded = format!("{number:.*e}", digits.saturating_sub(1));
    let exponent = rounded
        .rsplit_once('e')
        .and_then(|(_, exponent)| exponent.parse().ok())
        .unwrap_or(0);
    (rounded, exponent)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn only_very_small_and_large_numbers_have_an_exponent() {
        for (number, digits, shown) in [
            (8.31, 3, "8.31"),
            (0.0, 3, "0"),
            (-0.0, 3, "0"),
            (9.999, 3, "10.0"),
            (0.000_123_4, 2, "0.00012"),
            (0.000_012_34, 2, "1.2e-5"),
            (123_456.0, 3, "123456"),
            (12_345_678.0, 3, "1.23e7"),
            (-2.5, 2, "-2.5"),
            (f64::INFINITY, 3, "inf"),
        ] {
            assert_eq!(format_rounded(number, digits), shown);
        }
    }

    #[test]
    fn bounds_are_rounded_to_the_safe_side() {
        for (bound, shown) in [
            (0.260_149, "0.2602"),
            (0.469_700_7, "0.4698"),
            (0.25, "0.2500"),
            (9.9999e-7, "1.000e-6"),
            (9.9999, "10.00"),
            (123_456.0, "123500"),
            (0.0, "0"),
        ] {
            assert_eq!(format_rounded_up(bound, 4), shown);
        }
    }

    #[test]
    fn numbers_are_short_and_zero_has_no_sign() {
        for (number, expected) in [
            (-0.0, "0"),
            (0.1 + 0.2, "0.3"),
            (1e308, "1e308"),
            (-1.5e300, "-1.5e300"),
            (1e-300, "1e-300"),
            (1_700_000_000.123, "1700000000.123"),
            (-8.0, "-8"),
            (f64::INFINITY, "inf"),
        ] {
            assert_eq!(format_number(number), expected);
        }
        for (number, expected) in [
            (-0.04, "0.0"),
            (-0.06, "-0.1"),
            (1e308, "1e308"),
            (f64::NAN, "NaN"),
        ] {
            assert_eq!(format_fixed(number, 1), expected);
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn no_bound_is_below_its_number(
            bound in proptest::num::f64::POSITIVE | proptest::num::f64::NORMAL,
            digits in 1..8_usize,
        ) {
            let shown: f64 = format_rounded_up(bound, digits).parse().unwrap();
            prop_assert!(shown >= bound, "{shown} is shown for {bound}");
        }

        #[test]
        fn rounded_bounds_are_outside_and_less_than_one_step_away(
            bound in 1e-12..1e12_f64,
            digits in 1..8_usize,
            decimals in 0..4_usize,
        ) {
            let parse = |text: String| text.parse::<f64>().unwrap();
            let down = parse(format_rounded_down(bound, digits));
            let step = 10f64.powi(1 - digits as i32);
            prop_assert!(down <= bound && down >= bound * (1.0 - 1.000_001 * step), "{down} is shown for {bound}");
            let step = 1.000_001 * 10f64.powi(-(decimals as i32)) + 1e-15 * bound;
            let ends = [format_fixed_down, format_fixed_up].map(|format| parse(format(bound, decimals)));
            prop_assert!(ends[0] <= bound && bound <= ends[1], "{ends:?} is shown for {bound}");
            prop_assert!(bound - ends[0] < step && ends[1] - bound < step, "{ends:?} is shown for {bound}");
        }

        #[test]
        fn numbers_are_shown_to_their_digits(number in 1e-12..1e12_f64, digits in 1..8_usize) {
            let shown: f64 = format_rounded(number, digits).parse().unwrap();
            prop_assert!((shown / number - 1.0).abs() <= 0.5 * 10f64.powi(1 - digits as i32) + 1e-12);
        }
    }
}
