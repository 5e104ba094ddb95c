//! The whole report: one HTML page, one Markdown text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::{AssessmentReport, ReportPart, ReportSection};
use crate::units::insert_nbsp_before_units;
use crate::{PAGE_STYLE, draw};
use crumple_core::markdown::Markdown;
use crumple_core::quoting::TerminalLines;

const TITLE: &str = "Crash test of longitudinal driving controllers";

pub(super) fn render_html(assessment: &AssessmentReport) -> String {
    let (parts, appendix) = (assessment.parts(), assessment.appendix());
    render_page(&html! {
        header {
            p.kicker { "crumple " (assessment.provenance.crumple) }
            h1 { (TITLE) }
            nav {
                @for ReportSection { anchor, title, .. } in parts.iter().chain(&appendix) {
                    a href={ "#" (anchor) } { (title) } " "
                }
            }
        }
        main {
            (sections(&parts))
            div.appendix { h1 { "Appendix" } (sections(&appendix)) }
        }
    })
}

pub(super) fn render_first_page(assessment: &AssessmentReport) -> String {
    render_page(&html! { main { section { (assessment.first_page.to_html()) } } })
}

fn render_page(body: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content={ "crumple " (env!("CARGO_PKG_VERSION")) };
                title { (TITLE) }
                style { (PreEscaped(PAGE_STYLE)) (PreEscaped(draw::STYLE)) }
            }
            body { (body) }
        }
    };
    // Escape control characters of the page too: text direction marks in names would affect the verdict beside them.
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

fn sections(parts: &[ReportSection<'_>]) -> Markup {
    html! {
        @for ReportSection { anchor, title, part } in parts {
            section id=(anchor) { h2 { (title) } (part.to_html()) }
        }
    }
}

pub(super) fn render_markdown(assessment: &AssessmentReport) -> String {
    let mut text = Markdown::default();
    for (heading, parts) in [
        (TITLE, assessment.parts()),
        ("Appendix", assessment.appendix()),
    ] {
        text.heading(1, heading);
        for ReportSection { title, part, .. } in parts {
            text.heading(2, title);
            text.append(&part.to_markdown());
        }
    }
    text.into_string()
}
