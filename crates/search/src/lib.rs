//! Searches for failures, and convex programs that decide whether any driver could have avoided them.
//!
//! | module | what it holds |
//! |---|---|
//! | [`worst_case`] | convex programs: could any driver have avoided it, how little braking does it take; certificates |
//! | [`falsify`] | search methods that look for failures, campaigns, counterexamples, and the public benchmark they are measured on |

pub mod falsify;
pub mod worst_case;
