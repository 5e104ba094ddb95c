//! Whether one controller fails more often than another on the same draws, beyond chance.

use serde::{Deserialize, Serialize};
use statrs::distribution::{Binomial, DiscreteCDF};

/// Draws in which two controllers did not fare alike.
///
/// McNemar's exact test, one-sided: where neither controller is worse, a draw in which exactly one of the two fails is as likely
/// to be the one's as the other's, so the number of new failures is binomial with share 1/2. Source: McNemar 1947, "Note on the
/// sampling error of the difference between correlated proportions or percentages", Psychometrika 12, 153-157.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DiscordantPairs {
    /// Draws that only the second fails.
    #[serde(rename = "new")]
    pub only_second_fails: u64,
    /// Draws that only the first fails.
    #[serde(rename = "fixed")]
    pub only_first_fails: u64,
}

impl DiscordantPairs {
    /// Probability of so many new failures or more, were the second controller no worse than the first.
    #[must_use]
    pub fn p_value(&self) -> f64 {
        let Some(below) = self.only_second_fails.checked_sub(1) else { return 1.0 };
        Binomial::new(0.5, self.only_second_fails.saturating_add(self.only_first_fails))
            .map_or(f64::NAN, |chance| chance.sf(below))
    }

    /// Whether the second controller is worse by a test that finds so with a probability of at most `significance` where it is not.
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
    fn by_hand() {
        let p = |new, fixed| DiscordantPairs { only_second_fails: new, only_first_fails: fixed }.p_value();
        // 1, 4, 6, 4, 1 of 16.
        for (new, of_16) in [(0, 16.0), (1, 15.0), (2, 11.0), (3, 5.0), (4, 1.0)] {
            assert!((p(new, 4 - new) - of_16 / 16.0).abs() < 1e-12, "{new}");
        }
        assert_eq!(p(0, 0), 1.0);
        assert!(
            !DiscordantPairs { only_second_fails: 6, only_first_fails: 0 }.is_worse(0.01)
                && DiscordantPairs { only_second_fails: 7, only_first_fails: 0 }.is_worse(0.01)
        );
    }

    proptest! {
        /// More new failures are never less significant, and more that are fixed never more.
        #[test]
        fn is_monotone(new in 0..4000_u64, fixed in 0..4000_u64) {
            let p = |new, fixed| DiscordantPairs { only_second_fails: new, only_first_fails: fixed }.p_value();
            prop_assert!((0.0..=1.0).contains(&p(new, fixed)));
            prop_assert!(p(new + 1, fixed) <= p(new, fixed) + 1e-9 && p(new, fixed + 1) >= p(new, fixed) - 1e-9);
        }
    }
}
