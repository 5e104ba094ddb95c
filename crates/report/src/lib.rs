//! How it is told: pictures, tables, and the assessment with its renderings.
//!
//! | module | what it holds |
//! |---|---|
//! | [`draw`] | traces and curves as pictures |
//! | [`figures`] | figures of trainings |
//! | [`export`] | traces as tables |
//! | [`suite`] | runs of suites: the matrix, JUnit; crash maps |
//! | [`assessment`] | the safety case and its renderings |

pub mod assessment;
pub mod draw;
pub mod export;
pub mod figures;
mod junit;
mod markdown;
pub mod suite;
mod units;

/// The style sheet of pages: words, tables, and the reader's colour scheme. Figures bring [`draw::STYLE`] besides.
pub const PAGE_STYLE: &str = include_str!("page.css");
