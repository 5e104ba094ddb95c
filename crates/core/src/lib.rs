//! Digests, rounded numbers and quoted text, which every other crate of crumple may use.
//!
//! | module | content |
//! |---|---|
//! | [`digest`] | SHA-256, in hexadecimal as files and reports state it |
//! | [`digits`] | numbers with few significant digits, for readers |
//! | [`quoted`] | text from users, quoted for a terminal, for Markdown or for a shell |

pub mod digest;
pub mod digits;
pub mod quoted;
