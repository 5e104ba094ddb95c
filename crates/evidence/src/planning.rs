//! Number of runs that a rate needs.

use crumple_verify::rate::MAX_RUNS;

use super::record::upper_bound;
use crumple_core::binomial;
use crumple_core::digits::format_plain_within;

/// Reason why no number of runs suffices.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SampleSizeError {
    /// The rate is out of range.
    #[error("rate: must be above 0 and below 1, found {}", format_rate(*found))]
    Rate {
        /// Requested rate.
        found: f64,
    },
    /// The confidence level is out of range.
    #[error("confidence: must be above 0.5 and below 1, found {}", format_rate(*found))]
    Confidence {
        /// Requested confidence level.
        found: f64,
    },
    /// More runs than the maximum are necessary.
    #[error("a rate of {} with {failures} failures would take more than {MAX_RUNS} runs", format_rate(*rate))]
    TooMany {
        /// Requested rate.
        rate: f64,
        /// Allowed number of failures.
        failures: u64,
    },
}

fn format_rate(rate: f64) -> String {
    format_plain_within(rate, 1e-4..1e7)
}

/// Returns the smallest number of runs of which `failures` may fail so that the certificate bounds the rate by `rate`.
///
/// # Errors
/// [`SampleSizeError`] if there is no such number.
pub fn required_runs(rate: f64, confidence: f64, failures: u64) -> Result<u64, SampleSizeError> {
    if !(rate > 0.0 && rate < 1.0) {
        return Err(SampleSizeError::Rate { found: rate });
    }
    if !(confidence > 0.5 && confidence < 1.0) {
        return Err(SampleSizeError::Confidence { found: confidence });
    }
    let suffices =
        |runs: u64| binomial::clopper_pearson_upper(failures, runs, 1.0 - confidence) <= rate;
    let too_many = SampleSizeError::TooMany { rate, failures };
    if failures >= MAX_RUNS || !suffices(MAX_RUNS) {
        return Err(too_many);
    }
    let mut low = failures;
    let mut high = MAX_RUNS;
    while high - low > 1 {
        let middle = low + (high - low) / 2;
        if suffices(middle) {
            high = middle
        } else {
            low = middle
        }
    }
    // The checker rounds outwards, so slightly more runs are necessary.
    let mut step = 1;
    while upper_bound(failures, high, confidence) > rate {
        (high, step) = (high + step, 2 * step);
        if high > MAX_RUNS {
            return Err(too_many);
        }
    }
    Ok(high)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_verify::rate::binomial_tail_upper_bound;

    #[test]
    fn required_runs_suffice_and_slightly_fewer_do_not() {
        for (rate, confidence, failures) in [
            (0.5, 0.51, 0),
            (1e-2, 0.99, 0),
            (1e-3, 0.999, 2),
            (0.3, 0.9, 40),
            (1e-4, 1.0 - 1e-6, 0),
            (0.999, 0.9, 0),
        ] {
            let runs = required_runs(rate, confidence, failures).unwrap();
            assert!(
                binomial_tail_upper_bound(failures, runs, rate) <= 1.0 - confidence,
                "{rate} {failures}: {runs}"
            );
            assert!(upper_bound(failures, runs, confidence) <= rate);
            let fewer = runs - 1 - runs / 100_000_000;
            assert!(
                fewer <= failures
                    || binomial_tail_upper_bound(failures, fewer, rate * (1.0 - 1e-9))
                        > 1.0 - confidence
            );
        }
        assert_eq!(required_runs(1e-4, 1.0 - 1e-6, 0), Ok(138_149));
        // 10⁶ failures plus 3.09 standard deviations.
        let many = required_runs(0.5, 0.999, 1_000_000).unwrap();
        assert!((2_004_300..2_004_500).contains(&many), "{many}");
        let large = required_runs(1e-8, 0.999, 0).unwrap();
        assert!((690_775_520..690_776_600).contains(&large), "{large}");
        assert!(matches!(
            required_runs(1e-9, 0.999, 0),
            Err(SampleSizeError::TooMany { .. })
        ));
        assert!(
            required_runs(0.0, 0.9, 0).is_err()
                && required_runs(f64::NAN, 0.9, 0).is_err()
                && required_runs(0.1, 1.0, 0).is_err()
        );
    }
}
