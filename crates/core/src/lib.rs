//! Digests, rounded numbers, quoted text and progress, which every other crate of crumple may use.
//!
//! | module | content |
//! |---|---|
//! | [`digest`] | SHA-256, in hexadecimal as files and reports state it |
//! | [`digits`] | numbers with few significant digits, for readers |
//! | [`observer`] | progress of long work, and the decision to stop it |
//! | [`quoted`] | text from users, quoted for a terminal, for Markdown or for a shell |

pub mod digest;
pub mod digits;
pub mod observer;
pub mod quoting;
