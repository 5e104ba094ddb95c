//! Searches with coverage feedback: `cargo fuzz run controller`. Failures are scenario files in `crumple-corpus`.
#![no_main]

use std::sync::LazyLock;

use crumple_testing::{ControllerCheck, Property, check, stateless};
use libfuzzer_sys::fuzz_target;

static CHECK: LazyLock<ControllerCheck> = LazyLock::new(|| {
    let check = check(stateless(my_controller::decide)).on("alone");
    check
        .property(Property::no_avoidable_collision())
        .corpus("crumple-corpus")
});

fuzz_target!(|bytes: &[u8]| CHECK.assert_input(bytes));
