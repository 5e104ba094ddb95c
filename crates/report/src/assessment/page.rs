//! The whole report: one HTML page, one Markdown text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::markdown::Markdown;
use super::{AssessmentReport, ReportPart};
use crate::units::insert_nbsp_before_units;
use crate::{PAGE_STYLE, draw};
use crumple_core::quoting::TerminalLines;

const TITLE: &str = "Crash test of longitudinal driving controllers";

pub(super) fn render_html(assessment: &AssessmentReport) -> String {
    let (parts, appendix) = (assessment.parts(), assessment.appendix());
    let page: Markup = html! {
        (DOCTYPE)
        html lang="en" {
            (html_head(assessment))
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
                    @for part in &parts {
                        section id=(part.anchor_and_title().0) { h2 { (part.anchor_and_title().1) } (part.to_html()) }
                    }
                    div.appendix {
                        h1 { "Appendix" }
                        @for part in &appendix {
                            @let (id, title) = part.anchor_and_title();
                            section id=(id) { h2 { (title) } (part.to_html()) }
                        }
                    }
                }
                script { (PreEscaped(draw::ANIMATION_SCRIPT)) }
            }
        }
    };
    // Escape control characters of the page too: text direction marks in names would affect the verdict beside them.
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

pub(super) fn render_first_page(assessment: &AssessmentReport) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" { (html_head(assessment)) body { main { section { (assessment.first_page.to_html()) } } } }
    };
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

fn html_head(assessment: &AssessmentReport) -> Markup {
    html! {
        head {
            meta charset="utf-8";
            meta name="viewport" content="width=device-width, initial-scale=1";
            meta name="generator" content={ "crumple " (assessment.provenance.crumple) };
            title { (TITLE) }
            style { (PreEscaped(PAGE_STYLE)) (PreEscaped(draw::STYLE)) (PreEscaped(draw::ANIMATION_STYLE)) }
        }
    }
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
