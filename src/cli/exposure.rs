//! Option of rates per hour and per 1000 km.

use crumple_evidence::exposure::MIN_RESAMPLES;

/// Parses the option `--resamples`: 0, or enough for an interval.
pub(super) fn parse_resamples(text: &str) -> Result<u32, String> {
    match text.parse() {
        Ok(count @ (0 | MIN_RESAMPLES..=2000)) => Ok(count),
        _ => Err(format!(
            "must be 0 or from {MIN_RESAMPLES} to 2000, found {text}"
        )),
    }
}
