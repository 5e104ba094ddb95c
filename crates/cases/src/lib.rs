//! Number of cases of every property test in the workspace.
//!
//! `PROPTEST_CASES` scales all tests together. `.cargo/config.toml` sets 64, `.ci/nightly` 2560.

use proptest::test_runner::Config;

const DEFAULT_CASES: u64 = 256;

/// Returns a configuration for `normal` cases at `PROPTEST_CASES=256`, scaled for other values, with at least one case.
#[must_use]
pub fn with_cases(normal: u32) -> Config {
    let config = Config::default();
    let scaled = (u64::from(normal) * u64::from(config.cases)).div_ceil(DEFAULT_CASES);
    Config { cases: u32::try_from(scaled).unwrap_or(u32::MAX), max_shrink_iters: 2000, ..config }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_in_proportion_to_the_variable() {
        let variable = Config::default().cases;
        assert_eq!(with_cases(256).cases, variable);
        assert!(with_cases(5).cases >= 1 && with_cases(2560).cases == 10 * variable);
    }
}
