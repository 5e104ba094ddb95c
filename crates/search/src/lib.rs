//! What goes wrong: searches for failures, programs that say whether any driver could have avoided them, and claims
//! with certificates.
//!
//! | module | what it holds |
//! |---|---|
//! | [`difference`] | in what the file of earlier work differs from the one expected |
//! | [`disk`] | files that appear whole or not at all |
//! | [`program`] | the identity of the running program, by which half-done work is known |
//! | [`work`] | work that is kept in a folder: what lies there is what was written, or an error names it |
//! | [`shard`] | a part of work that is divided over machines: I of N |
//! | [`jobs`] | files for engines that place shards on machines: HyperQueue, Ray, Slurm |
//! | [`worst_case`] | convex programs: could any driver have avoided it, how little braking does it take; certificates |
//! | [`falsify`] | search methods that look for failures, campaigns, counterexamples, and the public benchmark they are measured on |
//! | [`fit`] | search spaces fitted to recorded episodes |
//! | [`evidence`] | claims with certificates: kernels of shields, failure rates; estimates of rare failures |
//! | [`suite`] | tests after regulations: suites as data, verdicts, margins, who could have prevented a failure |

pub mod difference;
pub mod disk;
pub mod evidence;
pub mod falsify;
pub mod fit;
pub mod jobs;
pub mod program;
pub mod shard;
pub mod suite;
pub mod work;
pub mod worst_case;
