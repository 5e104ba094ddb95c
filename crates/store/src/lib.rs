//! Run folders: atomic files, a manifest of every file, and a lock.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`disk`] | atomic files: a reader finds the whole file or none |
//! | [`program`] | the identity of the running program, which unfinished runs record |
//! | [`run_folder`] | run folders with a manifest: an error names a file that was changed after it was written |

pub mod disk;
pub mod program;
pub mod run_folder;
