//! Falsification, and convex programs that decide if any driver could have avoided a failure.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`StudySubject`] | record of what a study is about |
//! | [`confirmation`] | replays of counterexamples and escapes with the multi-body plant |
//! | [`worst_case`] | convex programs: avoidability, least necessary braking, worst-case profiles; certificates |
//! | [`falsify`] | search methods, campaigns, counterexamples, and a public benchmark of search methods |
#![cfg_attr(doctest, doc = include_str!("../../../docs/optimisers.md"))]

mod study_subject;

pub mod confirmation;
pub mod falsify;
pub mod worst_case;

pub use study_subject::StudySubject;
