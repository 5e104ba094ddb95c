//! Digests, rounded numbers, intervals of rates, quoted text, progress and opening of files, for every other crate of
//! crumple.
//!
//! | module | content |
//! |---|---|
//! | [`binomial`] | ends of exact Clopper-Pearson intervals |
//! | [`digest`] | SHA-256 in the hexadecimal form of files and reports |
//! | [`digits`] | numbers with few significant digits, for readers |
//! | [`interval`] | exact confidence intervals of a rate |
//! | [`observer`] | progress of long work, and the decision to stop it |
//! | [`quoting`] | text from users, quoted for a terminal, for Markdown or for a shell |
//! | [`regular_file`] | opening of files that users name: regular files only |

pub mod binomial;
pub mod digest;
pub mod digits;
pub mod interval;
pub mod observer;
pub mod quoting;
pub mod regular_file;
