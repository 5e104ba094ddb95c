//! Tests of the checker by subject, in one program that is linked once.
#![allow(
    missing_docs,
    unreachable_pub,
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "everything here is a test"
)]

mod avoidable;
mod certificates;
mod exact;
mod form;
mod format;
mod interval;
mod kernel;
mod law_follower;
mod leader;
mod motion;
mod network;
mod network_files;
mod pool;
mod rate;
mod reach;
mod reach_claims;
mod support;
mod two_sided;
mod unavoidable;
mod work;
