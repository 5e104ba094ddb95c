//! Any scenario under CRUMPLE_CONTROLLER (`baseline` unless it says otherwise; `any`: the input chooses). Collisions go to
//! the folder CRUMPLE_COLLISIONS, one file for each kind; broken laws are crashes.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU8, Ordering};

use crumple::trial::{Candidate, Collection, Crumple, Trial, Violation, behaviour};
use libfuzzer_sys::fuzz_target;

/// What libFuzzer reads beside the code that was reached; it sets all to zero before each run.
#[unsafe(link_section = "__libfuzzer_extra_counters")]
static BEHAVIOUR: [AtomicU8; behaviour::FEATURES] = [const { AtomicU8::new(0) }; behaviour::FEATURES];

static CONTROLLER: LazyLock<Option<Candidate>> = LazyLock::new(|| {
    let name = std::env::var("CRUMPLE_CONTROLLER").unwrap_or_else(|_| "baseline".to_owned());
    let named = || Candidate::named(&name).unwrap_or_else(|error| panic!("CRUMPLE_CONTROLLER: {error}"));
    (name != "any").then(named)
});

static COLLISIONS: LazyLock<Option<Collection>> = LazyLock::new(|| {
    let folder = std::env::var("CRUMPLE_COLLISIONS").ok()?;
    Some(Collection::in_folder(Path::new(&folder)).unwrap_or_else(|error| panic!("{folder}: {error}")))
});

static WITHOUT_FEEDBACK: LazyLock<bool> = LazyLock::new(|| std::env::var_os("CRUMPLE_NO_FEEDBACK").is_some());

fuzz_target!(|bytes: &[u8]| {
    let mut trial = Trial::of_bytes(bytes);
    if let Some(controller) = CONTROLLER.clone() {
        trial = trial.under_test(controller);
    }
    let result = trial.examine(&Crumple).unwrap_or_else(|violation: Violation| violation.panic());
    if !*WITHOUT_FEEDBACK {
        for feature in behaviour::features(&trial, &result) {
            BEHAVIOUR[feature].store(1, Ordering::Relaxed);
        }
    }
    if let Some(collisions) = &*COLLISIONS {
        collisions.keep(&trial, &result).unwrap_or_else(|error| panic!("CRUMPLE_COLLISIONS: {error}"));
    }
});
