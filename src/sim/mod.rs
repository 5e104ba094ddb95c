//! How it happens: exact motion, contact by root finding, and the engines.

mod outcome;
mod trace;

pub use outcome::{AfterContact, Contact, Impact, Outcome, Simulated, VehicleSummary};
pub use trace::{Pair, Trace, Track};
