//! A Rust controller: copy this target, and replace the function. Failures are scenario files in `crumple-corpus`.
#![no_main]

use std::sync::LazyLock;

use crumple_testing::{ControllerCheck, Property, check, stateless};
use libfuzzer_sys::fuzz_target;

static CHECK: LazyLock<ControllerCheck> = LazyLock::new(|| {
    let soft = stateless(|seen| {
        seen.ahead
            .map_or(0.0, |ahead| 0.1 * (ahead.gap_m - 1.2 * seen.speed_mps))
            .max(-4.0)
    });
    check(soft)
        .on("high-risk")
        .property(Property::no_avoidable_collision())
        .corpus("crumple-corpus")
});

fuzz_target!(|bytes: &[u8]| CHECK.assert_input(bytes));
