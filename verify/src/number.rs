//! Numbers in printed text.

use crate::interval::Interval;

/// Formats an interval; one without width as a single number.
pub(crate) fn format_range(of: Interval) -> String {
    if of.low() == of.high() {
        of.low().to_string()
    } else {
        format!("{} to {}", of.low(), of.high())
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
    let kept: Option<i64> = digits.get(..most).and_then(|kept| kept.parse().ok());
    let (Some(kept), Ok(exponent), true) = (kept, exponent.parse::<i32>(), digits.len() > most)
    else {
        return bound;
    };
    // Dropping digits rounds towards zero.
    let is_outward = (bound > 0.0) == (direction > 0);
    let kept = if is_outward { kept + direction } else { kept };
    format!("{kept}e{}", exponent - 3).parse().unwrap_or(bound)
}

/// Formats a number; with an exponent only where it would have many zeros.
pub(crate) fn format_number(number: f64) -> String {
    match number == 0.0 || (1e-4..1e7).contains(&number.abs()) {
        true => number.to_string(),
        false => format!("{number:e}"),
    }
}
