//! Tests of crumple by subject, in one program, so that it is linked once.
//!
//! Each property test states its number of cases for `PROPERTY_CASES=256` (`crates/cases`). proptest stores failures in
//! `proptest-regressions/`.
#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "everything here is a test"
)]

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
mod harm;
mod hostile_names;
mod invariant;
mod lanes;
mod measures;
mod networks;
mod obligations;
mod onnx_bytes;
mod openscenario;
mod openscenario_import;
mod order;
mod paper;
mod physics;
mod plants;
mod policy_files;
mod printed;
#[cfg(unix)]
mod processes;
mod reach;
mod readme;
mod rear_end_study;
mod reference_drivers;
mod report;
mod retrained;
mod road;
mod scenario_files;
mod schema;
mod search;
mod seeds;
mod shield;
mod short_line;
#[cfg(unix)]
mod spaces;
mod special_files;
mod suite_pages;
mod suites;
mod test_cases;
mod tiny;
mod training_schema;
mod versions;
mod worst_case;
