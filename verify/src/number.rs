//! Numbers in printed text.

use crate::interval::Interval;

/// Formats an interval; one without width as a single number.
pub(crate) fn format_range(range: Interval) -> String {
    // Adding 0 removes the sign of a zero.
    let [low, high] = [range.low() + 0.0, range.high() + 0.0];
    if low == high {
        low.to_string()
    } else {
        format!("{low} to {high}")
    }
}

/// Rounds a lower bound down to four significant digits.
pub(crate) fn round_down(bound: f64) -> f64 {
    round_towards(bound, -1)
}

/// Rounds an upper bound up to four significant digits.
pub(crate) fn round_up(bound: f64) -> f64 {
    round_towards(bound, 1)
}

/// Rounds to four significant digits, up for a `direction` of 1 and down for -1. Returns a shorter number unchanged.
fn round_towards(bound: f64, direction: i64) -> f64 {
    let shortest = format!("{bound:e}");
    let Some((mantissa, exponent)) = shortest.split_once('e') else {
        return bound;
    };
    let digits = mantissa.replace('.', "");
    let most = 4 + usize::from(bound < 0.0);
    let kept_digits: Option<i64> = digits
        .get(..most)
        .and_then(|kept_digits| kept_digits.parse().ok());
    let (Some(kept_digits), Ok(exponent), true) =
        (kept_digits, exponent.parse::<i32>(), digits.len() > most)
    else {
        return bound;
    };
    // Dropping digits rounds towards zero.
    let is_outward = (bound > 0.0) == (direction > 0);
    let kept_digits = if is_outward {
        kept_digits + direction
    } else {
        kept_digits
    };
    format!("{kept_digits}e{}", exponent - 3)
        .parse()
        .unwrap_or(bound)
}

/// Formats a number without rounding errors; with an exponent only where it would have many zeros.
pub(crate) fn format_number(number: f64) -> String {
    /// Significant digits; one more would show the rounding of sums and differences.
    const EXACT_DIGITS: usize = 15;
    let number = format!("{number:.*e}", EXACT_DIGITS - 1)
        .parse()
        .unwrap_or(number);
    match number == 0.0 || (1e-4..1e7).contains(&number.abs()) {
        true => number.to_string(),
        false => format!("{number:e}"),
    }
}
