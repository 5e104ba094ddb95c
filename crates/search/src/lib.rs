//! What goes wrong: searches for failures, programs that say whether any driver could have avoided them, and claims
//! with certificates.
//!
//! | module | what it holds |
//! |---|---|
//! | [`worst_case`] | convex programs: could any driver have avoided it, how little braking does it take; certificates |
//! | [`falsify`] | search methods that look for failures, campaigns, counterexamples, and the public benchmark they are measured on |
//! | [`fit`] | search spaces fitted to recorded episodes |
//! | [`evidence`] | claims with certificates: kernels of shields, failure rates; estimates of rare failures |
//! | [`suite`] | tests after regulations: suites as data, verdicts, margins, who could have prevented a failure |

pub mod evidence;
pub mod falsify;
pub mod fit;
pub mod suite;
pub mod worst_case;
