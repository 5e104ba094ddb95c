//! Digests, rounded numbers, errors of fields, intervals of rates, quoted text, Markdown, progress, opening of files,
//! text files with errors that name a line, and the number of threads, for every other crate of crumple.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`binomial`] | ends of exact Clopper-Pearson intervals |
//! | [`digest`] | SHA-256 in the hexadecimal form of files and reports |
//! | [`digits`] | numbers in messages and reports, for readers |
//! | [`field_error`] | an invalid field, with its path and its problem |
//! | [`format_version`] | the version of a file format, and the error of another one |
//! | [`interval`] | exact confidence intervals of a rate |
//! | [`non_finite`] | numbers that may be infinite, in JSON |
//! | [`observer`] | progress of long work, and the decision to stop it |
//! | [`quoting`] | text from users, quoted for a terminal, for Markdown or for a shell |
//! | [`markdown`] | a writer of Markdown, with all text escaped |
//! | [`regular_file`] | opening of files that users name: regular files only |
//! | [`old_names`] | names that files had in earlier releases |
//! | [`requirement`] | names of requirements that gates and tests verify |
//! | [`text_file`] | text files in TOML or JSON, with errors that name line and field |
//! | [`threads`] | the number of threads of long work |

pub mod binomial;
pub mod digest;
pub mod digits;
pub mod field_error;
pub mod format_version;
pub mod interval;
pub mod markdown;
pub mod non_finite;
pub mod observer;
pub mod old_names;
pub mod quoting;
pub mod regular_file;
pub mod requirement;
pub mod text_file;
pub mod threads;
