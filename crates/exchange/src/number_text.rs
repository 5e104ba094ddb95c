//! Numbers in messages, as a person reads them.

/// Number of significant digits; one more would show the rounding of sums and products.
const DIGITS: usize = 15;
/// Sizes outside this range have an exponent.
const PLAIN_RANGE: std::ops::Range<f64> = 1e-9..1e12;

/// Returns a number without rounding errors and without a negative zero, with an exponent if it is very large or small.
pub(crate) fn format_number(number: f64) -> String {
    let scientific = format!("{number:.*e}", DIGITS - 1);
    let rounded = scientific.parse().unwrap_or(number);
    if rounded == 0.0 {
        "0".to_owned()
    } else if f64::is_finite(rounded) && !PLAIN_RANGE.contains(&rounded.abs()) {
        format!("{rounded:e}")
    } else {
        rounded.to_string()
    }
}

/// Returns a number with a fixed number of decimals, unless it is very large.
pub(crate) fn format_fixed(number: f64, decimals: usize) -> String {
    if number.abs() >= PLAIN_RANGE.end {
        return format_number(number);
    }
    let text = format!("{number:.decimals$}");
    match text.strip_prefix('-') {
        Some(zero) if zero.bytes().all(|byte| matches!(byte, b'0' | b'.')) => zero.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
