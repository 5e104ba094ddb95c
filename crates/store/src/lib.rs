//! Studies in run folders: atomic files, a manifest of every file, a lock, and resumption.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`disk`] | atomic files: a reader finds the whole file or none |
//! | [`output_folder`] | folders in which crumple replaces only files that it wrote |
//! | [`program`] | the identity of the running program, which unfinished runs record |
//! | [`run_folder`] | run folders with a manifest: an error names a file that was changed after it was written |
//! | [`study`] | long computations in a run folder: start, steps, resumption, results |

pub mod disk;
pub mod output_folder;
pub mod program;
pub mod run_folder;
pub mod study;
