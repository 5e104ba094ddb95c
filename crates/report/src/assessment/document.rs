//! The text of a part, written as HTML and as Markdown at once.

use maud::{Markup, PreEscaped, Render, html};

use super::prose::prose_to_html;
use super::table::ReportTable;
use crumple_core::markdown::Markdown;

/// A text with two forms: HTML with figures, and Markdown without.
#[derive(Debug, Default)]
pub struct ReportDocument {
    html: String,
    markdown: Markdown,
}

impl ReportDocument {
    /// Writes a paragraph; text between backticks is code.
    pub(super) fn paragraph(&mut self, text: &str) {
        self.push_html(html! { p { (prose_to_html(text)) } });
        self.markdown.paragraph(text);
    }

    /// Writes a heading below that of the part.
    pub(super) fn heading(&mut self, text: &str) {
        self.push_html(html! { h3 { (text) } });
        self.markdown.heading(3, text);
    }

    pub(super) fn table(&mut self, table: &ReportTable) {
        self.push_html(table.to_html());
        table.write_markdown(&mut self.markdown);
    }

    pub(super) fn list(&mut self, lines: &[String]) {
        self.push_html(html! { ul { @for line in lines { li { (prose_to_html(line)) } } } });
        self.markdown.list(lines.iter().map(String::as_str));
    }

    /// Writes content that only HTML shows, such as a figure.
    pub(super) fn push_html(&mut self, markup: impl Render) {
        markup.render_to(&mut self.html);
    }

    pub(super) fn figure(&mut self, figure: impl Render) {
        self.push_html(html! { figure { (figure) } });
    }

    pub(super) fn markdown_mut(&mut self) -> &mut Markdown {
        &mut self.markdown
    }

    /// Writes blocks that HTML shows on demand, below a summary.
    pub(super) fn collapsible(&mut self, summary: &str, write: impl FnOnce(&mut Self)) {
        self.html += "<details>";
        self.push_html(html! { summary { (summary) } });
        write(self);
        self.html += "</details>";
    }

    pub(super) fn into_html(self) -> Markup {
        PreEscaped(self.html)
    }

    pub(super) fn into_markdown(self) -> Markdown {
        self.markdown
    }
}
