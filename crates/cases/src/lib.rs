//! Number of cases of every property test in the workspace, and generators that unit tests of several crates share.
//!
//! `PROPERTY_CASES` scales all tests together; the default is 64, and `.ci/nightly` sets 640. It is not proptest's own
//! variable, `PROPTEST_CASES`, which replaces the number of each test, so that a test that needs minutes for 64 cases
//! runs 64, and one that needs a second for 1500, too.

use std::fmt::Debug;

use proptest::prelude::*;
use proptest::test_runner::Config;

const VARIABLE: &str = "PROPERTY_CASES";
const DEFAULT_CASES: u64 = 64;
/// Value of the variable at which a test has its normal number of cases.
const NORMAL_CASES: u64 = 256;

/// Returns a configuration for `normal` cases at `PROPERTY_CASES=256`, scaled for other values, with at least one case.
///
/// # Panics
/// If the variable is not a number.
#[must_use]
#[expect(clippy::panic, reason = "only tests call it")]
pub fn with_cases(normal: u32) -> Config {
    let wanted = std::env::var(VARIABLE).map_or(DEFAULT_CASES, |text| match text.parse() {
        Ok(wanted) => wanted,
        Err(_) => panic!("{VARIABLE} must be a number, found {text:?}"),
    });
    let scaled = u64::from(normal)
        .saturating_mul(wanted)
        .div_ceil(NORMAL_CASES)
        .max(1);
    Config {
        cases: u32::try_from(scaled).unwrap_or(u32::MAX),
        max_shrink_iters: 2000,
        ..Config::default()
    }
}

/// Generates a lane change by each trigger: a time (s), a gap (m), a time to collision (s). The type of lane changes is
/// that of the caller, because the simulator's own tests use this function.
pub fn any_lane_change<T: Debug>(
    at_s: fn(f64) -> T,
    gap_m: fn(f64) -> T,
    ttc_s: fn(f64) -> T,
) -> impl Strategy<Value = T> {
    prop_oneof![
        (0.0..7.0_f64).prop_map(at_s),
        (0.5..40.0_f64).prop_map(gap_m),
        (0.5..5.0_f64).prop_map(ttc_s),
    ]
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    /// proptest applies its own variables after this configuration.
    #[test]
    fn a_test_runs_its_share_of_cases() {
        let count = Cell::new(0);
        proptest!(with_cases(2 * NORMAL_CASES as u32), |(_ in 0..9_u8)| count.set(count.get() + 1));
        let wanted = with_cases(NORMAL_CASES as u32).cases;
        assert_eq!(count.get(), 2 * wanted);
        assert!(with_cases(5).cases >= 1 && with_cases(2560).cases == 10 * wanted);
    }
}
