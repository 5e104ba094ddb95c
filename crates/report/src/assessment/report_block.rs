//! The blocks of a report, from which HTML and Markdown follow. Markdown has no figures, no commands beside them, and
//! no titles and summaries of blocks that have nothing else.

use maud::{Markup, html};

use super::rich_text::RichText;
use super::table::ReportTable;
use crumple_core::markdown::{Inline, Markdown};

#[derive(Debug, Clone)]
pub(super) enum ReportBlock {
    Paragraph(RichText, ParagraphStyle),
    /// A heading below that of the part.
    Heading(String),
    /// A paragraph with a title: a heading in HTML, bold text at the start of the paragraph in Markdown.
    Entry(String, RichText),
    Table(ReportTable),
    List(Vec<RichText>, ListStyle),
    /// Lists beside each other in HTML, one after the other in Markdown.
    Columns(Vec<TitledList>),
    /// Names and their values.
    Definitions(Vec<(String, String)>),
    /// Commands in one paragraph, only in HTML.
    Commands(Vec<String>),
    /// A figure and the text below it, only in HTML.
    Figure(Markup, Option<RichText>),
    /// A drawing without the frame of a figure, only in HTML.
    Drawing(Markup),
    /// Figures beside each other, only in HTML.
    Gallery(Vec<CaptionedDrawing>),
    /// Blocks that HTML shows on demand below a summary, and Markdown after it.
    Collapsible(String, Vec<Self>),
    /// Blocks below a heading.
    Titled(String, Vec<Self>),
}

/// The appearance of a paragraph in HTML.
#[derive(Debug, Clone, Copy)]
pub(super) enum ParagraphStyle {
    Plain,
    /// A paragraph with a class of the style sheet.
    Class(&'static str),
    /// A paragraph with an identifier.
    Id(&'static str),
}

/// The appearance of a list in HTML.
#[derive(Debug, Clone, Copy)]
pub(super) enum ListStyle {
    Plain,
    /// Entries of a few words.
    Short,
}

/// A list under a title. Without lines it states that there are none.
#[derive(Debug, Clone)]
pub(super) struct TitledList {
    pub(super) title: String,
    pub(super) lines: Vec<String>,
}

/// A drawing with its caption, and the command that makes its content.
#[derive(Debug, Clone)]
pub(super) struct CaptionedDrawing {
    pub(super) drawing: Markup,
    pub(super) caption: String,
    pub(super) command: Option<String>,
}

impl ReportBlock {
    pub(super) fn to_html(&self) -> Markup {
        match self {
            Self::Paragraph(text, style) => style.to_html(text),
            Self::Heading(text) => html! { h3 { (text) } },
            Self::Entry(title, text) => html! { h3 { (title) } p { (text.to_html()) } },
            Self::Table(table) => table.to_html(),
            Self::List(lines, style) => list_to_html(lines, *style),
            Self::Columns(columns) => {
                html! { div.sides { @for column in columns { (column.to_html()) } } }
            }
            Self::Definitions(rows) => {
                html! { dl { @for (name, value) in rows { dt { (name) } dd { (value) } } } }
            }
            Self::Commands(commands) => {
                html! { p.replay { @for command in commands { (command_to_html(command)) br; } } }
            }
            Self::Figure(drawing, text) => html! {
                figure {
                    (drawing)
                    @if let Some(text) = text { figcaption { (text.to_html()) } }
                }
            },
            Self::Drawing(drawing) => drawing.clone(),
            Self::Gallery(figures) => {
                html! { div.worst { @for figure in figures { (figure.to_html()) } } }
            }
            Self::Collapsible(summary, content) => {
                html! { details { summary { (summary) } (blocks_to_html(content)) } }
            }
            Self::Titled(title, content) => html! { h3 { (title) } (blocks_to_html(content)) },
        }
    }

    pub(super) fn write_markdown(&self, out: &mut Markdown) {
        match self {
            _ if !self.is_in_markdown() => {}
            Self::Paragraph(text, _) => out.paragraph(text.to_inline()),
            Self::Heading(text) => out.heading(3, text),
            Self::Entry(title, text) => out.paragraph(entry_to_inline(title, text)),
            Self::Table(table) => table.write_markdown(out),
            Self::List(lines, _) => out.list(lines.iter().map(RichText::to_inline)),
            Self::Columns(columns) => columns.iter().for_each(|list| list.write_markdown(out)),
            Self::Definitions(rows) => out.list(rows.iter().map(definition_to_inline)),
            Self::Collapsible(summary, content) => {
                out.paragraph(RichText::strong(format!("{summary}:")).to_inline());
                write_blocks_as_markdown(content, out);
            }
            Self::Titled(title, content) => {
                out.heading(3, title);
                write_blocks_as_markdown(content, out);
            }
            Self::Commands(_) | Self::Figure(..) | Self::Drawing(_) | Self::Gallery(_) => {}
        }
    }

    /// False if the block has nothing that Markdown shows.
    fn is_in_markdown(&self) -> bool {
        match self {
            Self::Commands(_) | Self::Figure(..) | Self::Drawing(_) | Self::Gallery(_) => false,
            Self::Collapsible(_, content) | Self::Titled(_, content) => {
                content.iter().any(Self::is_in_markdown)
            }
            _ => true,
        }
    }
}

pub(super) fn blocks_to_html(blocks: &[ReportBlock]) -> Markup {
    html! { @for block in blocks { (block.to_html()) } }
}

pub(super) fn write_blocks_as_markdown(blocks: &[ReportBlock], out: &mut Markdown) {
    blocks.iter().for_each(|block| block.write_markdown(out));
}

impl ParagraphStyle {
    fn to_html(self, text: &RichText) -> Markup {
        match self {
            Self::Plain => html! { p { (text.to_html()) } },
            Self::Class(class) => html! { p class=(class) { (text.to_html()) } },
            Self::Id(id) => html! { p id=(id) { (text.to_html()) } },
        }
    }
}

fn list_to_html(lines: &[RichText], style: ListStyle) -> Markup {
    let entries = html! { @for line in lines { li { (line.to_html()) } } };
    match style {
        ListStyle::Plain => html! { ul { (entries) } },
        ListStyle::Short => html! { ul.short { (entries) } },
    }
}

fn command_to_html(command: &str) -> Markup {
    html! { code { (command) } " " }
}

fn entry_to_inline(title: &str, text: &RichText) -> Inline {
    let title = RichText::strong(format!("{title}. "));
    text.append_to(title.to_inline())
}

fn definition_to_inline((name, value): &(String, String)) -> Inline {
    Inline::prose(&format!("{name}: ")).and_code(value)
}

impl TitledList {
    fn entries(&self) -> Vec<RichText> {
        match self.lines.as_slice() {
            [] => vec!["none".into()],
            lines => lines.iter().map(RichText::from).collect(),
        }
    }

    fn to_html(&self) -> Markup {
        let entries = list_to_html(&self.entries(), ListStyle::Plain);
        html! { div { h3 { (RichText::from(&self.title).to_html()) } (entries) } }
    }

    fn write_markdown(&self, out: &mut Markdown) {
        out.heading(3, &self.title);
        out.list(self.entries().iter().map(RichText::to_inline));
    }
}

impl CaptionedDrawing {
    fn to_html(&self) -> Markup {
        html! {
            figure {
                (self.drawing)
                figcaption {
                    (self.caption)
                    @if let Some(command) = &self.command { " · " (command_to_html(command)) }
                }
            }
        }
    }
}
