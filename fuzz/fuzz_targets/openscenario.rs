#![no_main]

use crumple_fuzzing::{Violation, targets};
use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| targets::openscenario(bytes)
    .unwrap_or_else(|violation: Violation| violation.panic()));
