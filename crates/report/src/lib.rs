//! Figures, tables, and the assessment with its renderings.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`draw`] | figures of traces and curves |
//! | [`figures`] | figures of trainings |
//! | [`export`] | traces as tables |
//! | [`suite`] | runs of suites: the matrix, JUnit |
//! | [`assessment`] | the safety case and its renderings |

pub mod assessment;
pub mod draw;
pub mod export;
pub mod figures;
mod junit;
pub mod suite;
mod units;

/// Style sheet of pages: text, tables, and the reader's colour scheme. Figures also need [`draw::STYLE`].
pub const PAGE_STYLE: &str = concat!(include_str!("page.css"), include_str!("print.css"));
