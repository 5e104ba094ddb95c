//! Paired comparison of the failures of two controllers on the same random scenarios.

use serde::{Deserialize, Serialize};
use statrs::distribution::{Binomial, DiscreteCDF};

/// Numbers of random scenarios that exactly one of two controllers fails. McNemar's exact test, one-sided: if neither
/// controller is worse, each of them is equally likely to be the one that fails, so the number of new failures is
/// binomial with share 1/2. Source: McNemar 1947, "Note on the sampling error of the difference between correlated
/// proportions or percentages", Psychometrika 12, 153-157.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscordantPairs {
    /// Scenarios that only the second controller fails.
    #[serde(alias = "new")]
    pub only_second_fails: u64,
    /// Scenarios that only the first controller fails.
    #[serde(alias = "fixed")]
    pub only_first_fails: u64,
}

impl DiscordantPairs {
    /// Returns the probability of at least so many new failures if the second controller is no worse.
    #[must_use]
    pub fn p_value(&self) -> f64 {
        let Some(below) = self.only_second_fails.checked_sub(1) else {
            return 1.0;
        };
        Binomial::new(
            0.5,
            self.only_second_fails.saturating_add(self.only_first_fails),
        )
        .map_or(f64::NAN, |chance| chance.sf(below))
    }

    /// True if the second controller is worse at this significance level.
    #[must_use]
    pub fn is_worse(&self, significance: f64) -> bool {
        self.p_value() < significance
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn p_values_match_those_by_hand() {
        let p = |new, fixed| {
            DiscordantPairs {
                only_second_fails: new,
                only_first_fails: fixed,
            }
            .p_value()
        };
        for (new, of_16) in [(0, 16.0), (1, 15.0), (2, 11.0), (3, 5.0), (4, 1.0)] {
            assert!((p(new, 4 - new) - of_16 / 16.0).abs() < 1e-12, "{new}");
        }
        assert_eq!(p(0, 0), 1.0);
        assert!(
            !DiscordantPairs {
                only_second_fails: 6,
                only_first_fails: 0
            }
            .is_worse(0.01)
                && DiscordantPairs {
                    only_second_fails: 7,
                    only_first_fails: 0
                }
                .is_worse(0.01)
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn p_value_is_monotone(new in 0..4000_u64, fixed in 0..4000_u64) {
            let p = |new, fixed| DiscordantPairs { only_second_fails: new, only_first_fails: fixed }.p_value();
            prop_assert!((0.0..=1.0).contains(&p(new, fixed)));
            prop_assert!(p(new + 1, fixed) <= p(new, fixed) + 1e-9 && p(new, fixed + 1) >= p(new, fixed) - 1e-9);
        }
    }
}
