//! What crumple promises, by subject: one program, so that it is linked once.
//!
//! Property tests run the number of cases each states. `PROPTEST_CASES` scales them all together: 256 is the normal
//! run, 25600 runs each a hundred times longer. Failures are kept beside the suite in `proptest-regressions/`.
#![allow(clippy::unwrap_used, clippy::expect_used, clippy::panic, reason = "everything here is a test")]

mod assessments;
mod claims;
mod command_line;
mod controller_failures;
mod controllers;
mod corpora;
mod damage;
mod documentation;
mod engines;
mod estimation;
mod explore;
#[cfg(unix)]
mod external;
#[cfg(target_os = "linux")]
mod faults;
mod findings;
#[cfg(unix)]
mod fmus;
mod forgery;
mod formulas;
mod generate;
mod hostile_names;
mod lanes;
mod measures;
mod networks;
mod obligations;
mod onnx_bytes;
mod openscenario;
mod paper;
mod physics;
mod policy_files;
mod printed;
#[cfg(unix)]
mod processes;
mod reach;
mod readme;
mod reference_drivers;
mod report;
mod retrained;
mod road;
mod scenario_files;
mod schema;
mod search;
mod seeds;
mod shield;
mod spaces;
mod suite_pages;
mod suites;
mod test_cases;
mod tiny;
mod training_schema;
mod worst_case;
