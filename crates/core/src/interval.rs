//! Exact confidence intervals of a failure rate.

use serde::{Deserialize, Serialize};

use super::binomial;
use super::digits::format_interval;

/// A two-sided confidence interval of a rate.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct RateInterval {
    /// Lower end.
    pub lower: f64,
    /// Upper end.
    pub upper: f64,
}

impl RateInterval {
    /// Computes the Clopper-Pearson interval (Biometrika 26, 1934) of `failures` in `runs` independent runs. It
    /// contains the true rate with probability at least `confidence`. Up to 10⁹ runs, its ends are never inside the
    /// exact ones and outside by at most a part in 10¹¹.
    #[must_use]
    pub fn clopper_pearson(failures: u64, runs: u64, confidence: f64) -> Self {
        let tail = 0.5 * (1.0 - confidence);
        Self {
            lower: binomial::clopper_pearson_lower(failures, runs, tail),
            upper: binomial::clopper_pearson_upper(failures, runs, tail),
        }
    }

    /// Returns both ends in percent, rounded outward: `0.2 to 7.1`.
    #[must_use]
    pub fn to_percent_text(&self, decimals: usize) -> String {
        format_interval([self.lower, self.upper].map(|end| 100.0 * end), decimals)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use statrs::distribution::{Binomial, DiscreteCDF};

    #[test]
    fn ends_in_percent_are_rounded_outward() {
        let interval = RateInterval {
            lower: 0.012_49,
            upper: 0.074_024,
        };
        assert_eq!(interval.to_percent_text(1), "1.2 to 7.5");
        let all = RateInterval {
            lower: 0.0,
            upper: 1.0,
        };
        assert_eq!(all.to_percent_text(2), "0.00 to 100.00");
    }

    #[test]
    fn each_end_leaves_its_share_of_the_binomial_tail() {
        for (failures, runs) in [(1, 10), (5, 100), (37, 1000), (999, 1000)] {
            let RateInterval { lower, upper } = RateInterval::clopper_pearson(failures, runs, 0.95);
            let at_most = Binomial::new(upper, runs).unwrap().cdf(failures);
            let at_least = Binomial::new(lower, runs).unwrap().sf(failures - 1);
            assert!(
                (at_most - 0.025).abs() < 1e-6 && (at_least - 0.025).abs() < 1e-6,
                "{at_most} {at_least}"
            );
        }
    }
}
