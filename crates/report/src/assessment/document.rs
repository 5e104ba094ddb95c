//! The text of a part as blocks, from which HTML and Markdown follow.

use maud::{Markup, Render, html};

use super::report_block::{
    ListStyle, ParagraphStyle, ReportBlock, blocks_to_html, write_blocks_as_markdown,
};
use super::rich_text::RichText;
use super::table::ReportTable;
use crumple_core::markdown::Markdown;

/// A text of blocks. Text between backticks is code.
#[derive(Debug, Clone)]
pub(super) struct ReportDocument {
    blocks: Vec<ReportBlock>,
}

impl ReportDocument {
    pub(super) fn new() -> Self {
        Self { blocks: Vec::new() }
    }

    pub(super) fn push(&mut self, block: ReportBlock) {
        self.blocks.push(block);
    }

    pub(super) fn paragraph(&mut self, text: impl Into<RichText>) {
        self.push(ReportBlock::Paragraph(text.into(), ParagraphStyle::Plain));
    }

    /// Writes a heading below that of the part.
    pub(super) fn heading(&mut self, text: impl Into<String>) {
        self.push(ReportBlock::Heading(text.into()));
    }

    pub(super) fn table(&mut self, table: ReportTable) {
        self.push(ReportBlock::Table(table));
    }

    pub(super) fn list(&mut self, lines: impl IntoIterator<Item = impl Into<RichText>>) {
        let lines = lines.into_iter().map(Into::into).collect();
        self.push(ReportBlock::List(lines, ListStyle::Plain));
    }

    pub(super) fn figure(&mut self, figure: impl Render) {
        self.push(ReportBlock::Figure(html! { (figure) }, None));
    }

    /// Writes blocks that HTML shows on demand, below a summary.
    pub(super) fn collapsible(&mut self, summary: impl Into<String>, content: impl Into<Self>) {
        let content = content.into().blocks;
        self.push(ReportBlock::Collapsible(summary.into(), content));
    }

    /// Writes blocks below a heading.
    pub(super) fn titled(&mut self, title: impl Into<String>, content: impl Into<Self>) {
        self.push(ReportBlock::Titled(title.into(), content.into().blocks));
    }

    pub(super) fn to_html(&self) -> Markup {
        blocks_to_html(&self.blocks)
    }

    pub(super) fn to_markdown(&self) -> Markdown {
        let mut text = Markdown::default();
        write_blocks_as_markdown(&self.blocks, &mut text);
        text
    }
}

impl From<ReportBlock> for ReportDocument {
    fn from(block: ReportBlock) -> Self {
        Self {
            blocks: vec![block],
        }
    }
}

impl From<ReportTable> for ReportDocument {
    fn from(table: ReportTable) -> Self {
        ReportBlock::Table(table).into()
    }
}
