//! Run folders: files that are written atomically, a manifest of every file, a lock, and shards of divided work.
//!
//! | module | content |
//! |---|---|
//! | [`difference`] | the field in which the configuration of an earlier run differs from the expected one |
//! | [`disk`] | atomic files: a reader finds the whole file or none |
//! | [`program`] | the identity of the running program, by which unfinished work is recognised |
//! | [`work`] | run folders with a manifest: an error names a file that was changed after it was written |
//! | [`shard`] | one of N parts of work that several machines share |
//! | [`jobs`] | job files for engines that place shards on machines: HyperQueue, Ray, Slurm |

pub mod difference;
pub mod disk;
pub mod jobs;
pub mod program;
pub mod run_folder;
pub mod shard;
