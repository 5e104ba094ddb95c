//! Figures, tables, and the assessment with its renderings.
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
mod markdown;
pub mod suite;
mod units;

use maud::PreEscaped;

/// Style sheet of pages: text, tables, and the reader's colour scheme. Figures also need [`draw::STYLE`].
pub const PAGE_STYLE: &str = include_str!("page.css");

/// Returns the head of a page with figures; `style` is the rest of its style sheet.
fn html_head(title: &str, style: &str) -> maud::Markup {
    maud::html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="generator" content={ "crumple " (env!("CARGO_PKG_VERSION")) };
            title { (title) }
            style { (PreEscaped(PAGE_STYLE)) (PreEscaped(draw::STYLE)) (PreEscaped(style)) }
        }
    }
}
