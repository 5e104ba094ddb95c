//! The whole report: one HTML page, one Markdown text.

use maud::{DOCTYPE, Markup, PreEscaped, html};

use super::document::ReportDocument;
use super::prose::prose_to_html;
use super::report_part::{Chapter, ReportPart};
use super::{AssessmentReport, ReportSection};
use crate::units::insert_nbsp_before_units;
use crate::{PAGE_STYLE, draw};
use crumple_core::markdown::Markdown;
use crumple_core::quoting::TerminalLines;

const KICKER: &str = "crumple: crash test of longitudinal driving controllers";

const APPENDIX: &str = "Appendix";

pub(super) fn render_html(assessment: &AssessmentReport) -> String {
    let sections = assessment.sections();
    let [main, appendix] = split(&sections);
    let title = assessment.identity.title();
    render_page(
        assessment,
        &html! {
            header {
                p.kicker { (KICKER) }
                h1 { (prose_to_html(&title)) }
                nav {
                    @for section in &sections {
                        a href={ "#" (section.anchor) } { (section.title) } " "
                    }
                }
            }
            main {
                (sections_to_html(main))
                div.appendix { h1 { (APPENDIX) } (sections_to_html(appendix)) }
            }
        },
    )
}

pub(super) fn render_first_page(assessment: &AssessmentReport) -> String {
    let mut document = ReportDocument::new();
    assessment.first_page_section().write(&mut document);
    render_page(
        assessment,
        &html! { main { section id="answer" { (document.to_html()) } } },
    )
}

fn render_page(assessment: &AssessmentReport, body: &Markup) -> String {
    let title = assessment.identity.one_line();
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content={ "crumple " (env!("CARGO_PKG_VERSION")) };
                title { (title) }
                style { (PreEscaped(PAGE_STYLE)) (PreEscaped(draw::STYLE)) (PreEscaped(page_foot(&title))) }
            }
            body { (body) }
        }
    };
    // Escape control characters of the page too: text direction marks in names would affect the verdict beside them.
    insert_nbsp_before_units(&TerminalLines(&page.into_string()).to_string())
}

/// Returns the style of the foot of each printed page: the identity, and the number of the page.
fn page_foot(identity: &str) -> String {
    let quoted: String = identity.chars().map(css_escape).collect();
    format!(
        "@page{{@bottom-left{{font:8pt sans-serif;content:\"{quoted}\"}}@bottom-right{{font:8pt \
         sans-serif;content:counter(page) \" / \" counter(pages)}}}}"
    )
}

/// Escapes a character of a CSS string, also inside HTML: only letters, digits and harmless punctuation stay.
fn css_escape(letter: char) -> String {
    match letter {
        ' ' | ',' | '.' | ':' | '-' | '_' => letter.to_string(),
        _ if letter.is_ascii_alphanumeric() => letter.to_string(),
        _ => format!("\\{:x} ", u32::from(letter)),
    }
}

/// Returns the sections of the main part and those of the appendix.
fn split(sections: &[ReportSection]) -> [&[ReportSection]; 2] {
    let main = sections.partition_point(|section| section.chapter < Chapter::Appendix);
    let (main, appendix) = sections.split_at(main);
    [main, appendix]
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
    let title = assessment.identity.title();
    let headings = [title.as_str(), APPENDIX];
    for (heading, sections) in headings.into_iter().zip(split(&assessment.sections())) {
        text.heading(1, heading);
        for section in sections {
            text.heading(2, section.title);
            text.append(&section.document.to_markdown());
        }
    }
    text.into_string()
}
