//! Any scenario under CRUMPLE_CONTROLLER: whatever `--controller` takes, `baseline` by default; `any` if the input
//! chooses. Collisions go to the folder CRUMPLE_COLLISIONS, one file for each kind; violated invariants are crashes.
#![no_main]

use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU8, Ordering};

use crumple_fuzzing::{CollisionSearch, TEST_CASE_BYTES, behaviour};
use libfuzzer_sys::{Corpus, fuzz_target};

/// Counters that libFuzzer reads in addition to the code coverage. It zeroes them before each run, a word at a time. No
/// Rust code reads them, hence `#[used]`.
#[repr(align(8))]
struct Counters([AtomicU8; behaviour::FEATURE_COUNT.next_multiple_of(8)]);
#[used]
#[unsafe(link_section = "__libfuzzer_extra_counters")]
static BEHAVIOUR: Counters =
    Counters([const { AtomicU8::new(0) }; behaviour::FEATURE_COUNT.next_multiple_of(8)]);

/// The search; a failure ends the program with exit code 2. Created before the first input, since libFuzzer reports a
/// later exit as a crash of that input.
static SEARCH: LazyLock<CollisionSearch> = LazyLock::new(|| {
    let named = |name: &str| std::env::var(name).ok();
    let (controller, folder) = (named("CRUMPLE_CONTROLLER"), named("CRUMPLE_COLLISIONS"));
    let search = CollisionSearch::new(
        controller.as_deref().unwrap_or("baseline"),
        folder.as_deref().map(Path::new),
    );
    search.unwrap_or_else(|error| {
        eprintln!("error: {error}");
        std::process::exit(2)
    })
});

static FEEDBACK: LazyLock<bool> =
    LazyLock::new(|| std::env::var_os("CRUMPLE_NO_FEEDBACK").is_none());

fuzz_target!(init: LazyLock::force(&SEARCH), |bytes: &[u8]| -> Corpus {
    if bytes.len() > TEST_CASE_BYTES {
        return Corpus::Reject;
    }
    let features = SEARCH.run_input(bytes).unwrap_or_else(|error| panic!("{error}"));
    for feature in features.into_iter().filter(|_| *FEEDBACK) {
        BEHAVIOUR.0[feature].store(1, Ordering::Relaxed);
    }
    Corpus::Keep
});
