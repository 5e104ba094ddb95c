//! The whole report: one HTML page, one Markdown text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::document::ReportDocument;
use super::report_part::{Chapter, ReportPart};
use super::{AssessmentReport, ReportSection};
use crate::units::insert_nbsp_before_units;
use crate::{PAGE_STYLE, draw};
use crumple_core::markdown::Markdown;
use crumple_core::quoting::TerminalLines;

const TITLE: &str = "Crash test of longitudinal driving controllers";

pub(super) fn render_html(assessment: &AssessmentReport) -> String {
    let sections = assessment.sections();
    let [(title, main), (appendix_title, appendix)] = split(&sections);
    render_page(&html! {
        header {
            p.kicker { "crumple " (assessment.provenance.crumple) }
            h1 { (title) }
            nav {
                @for section in &sections {
                    a href={ "#" (section.anchor) } { (section.title) } " "
                }
            }
        }
        main {
            (sections_to_html(main))
            div.appendix { h1 { (appendix_title) } (sections_to_html(appendix)) }
        }
    })
}

pub(super) fn render_first_page(assessment: &AssessmentReport) -> String {
    let mut document = ReportDocument::new();
    assessment.first_page_section().write(&mut document);
    render_page(&html! { main { section { (document.to_html()) } } })
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

/// Returns the sections of the main part and those of the appendix, each under its heading.
fn split(sections: &[ReportSection]) -> [(&'static str, &[ReportSection]); 2] {
    let main = sections.partition_point(|section| section.chapter < Chapter::Appendix);
    let (main, appendix) = sections.split_at(main);
    [(TITLE, main), ("Appendix", appendix)]
}

fn sections_to_html(sections: &[ReportSection]) -> Markup {
    html! {
        @for section in sections {
            section id=(section.anchor) { h2 { (section.title) } (section.document.to_html()) }
        }
    }
}

pub(super) fn render_markdown(assessment: &AssessmentReport) -> String {
    let mut text = Markdown::default();
    for (heading, sections) in split(&assessment.sections()) {
        text.heading(1, heading);
        for section in sections {
            text.heading(2, section.title);
            text.append(&section.document.to_markdown());
        }
    }
    text.into_string()
}
