//! The whole report: one HTML page, one Markdown text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::markdown::Markdown;
use super::{AssessmentReport, ReportPart};
use crate::units::insert_nbsp_before_units;
use crate::{draw, html_head};
use crumple_core::quoting::TerminalLines;

const TITLE: &str = "Crash test of longitudinal driving controllers";

pub(super) fn render_html(assessment: &AssessmentReport) -> String {
    let (parts, appendix) = (assessment.parts(), assessment.appendix());
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (html_head(TITLE, draw::ANIMATION_STYLE))
            body {
                header {
                    p.kicker { "crumple " (assessment.provenance.crumple) }
                    h1 { (TITLE) }
                    nav {
                        @for (id, title) in parts.iter().chain(&appendix).map(|part| part.anchor_and_title()) {
                            a href={ "#" (id) } { (title) } " "
                        }
                    }
                }
                main {
                    (sections(&parts))
                    div.appendix { h1 { "Appendix" } (sections(&appendix)) }
                }
                script { (PreEscaped(draw::ANIMATION_SCRIPT)) }
            }
        }
    };
    // Escape control characters of the page too: text direction marks in names would affect the verdict beside them.
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

fn sections(parts: &[&dyn ReportPart]) -> Markup {
    html! {
        @for part in parts {
            @let (id, title) = part.anchor_and_title();
            section id=(id) { h2 { (title) } (part.to_html()) }
        }
    }
}

pub(super) fn render_first_page(assessment: &AssessmentReport) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            (html_head(TITLE, draw::ANIMATION_STYLE))
            body { main { section { (assessment.first_page.to_html()) } } }
        }
    };
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

pub(super) fn render_markdown(assessment: &AssessmentReport) -> String {
    let mut text = Markdown::default();
    for (heading, parts) in [(TITLE, assessment.parts()), ("Appendix", assessment.appendix())] {
        text.heading(1, heading);
        for part in parts {
            text.heading(2, &part.anchor_and_title().1);
            text.append(&part.to_markdown());
        }
    }
    text.into_string()
}
