//! Tables that render as HTML and as Markdown.

use std::fmt::Display;

use maud::{Markup, html};

use super::rich_text::RichText;
use crumple_core::markdown::{Inline, Markdown};

/// A table of text. Cells may have a mark, so that failures are visible without colour.
#[derive(Debug, Clone)]
pub(super) struct ReportTable {
    header: Vec<String>,
    rows: Vec<Vec<ReportCell>>,
}

#[derive(Debug, Clone)]
pub(super) struct ReportCell {
    text: RichText,
    mark: CellMark,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum CellMark {
    Neutral,
    Good,
    /// A good result of tests alone.
    Tested,
    Bad,
    /// A right-aligned number.
    Number,
}

impl CellMark {
    fn css_class(self) -> Option<&'static str> {
        match self {
            Self::Neutral => None,
            Self::Good => Some("good compared"),
            Self::Tested => Some("good compared tested"),
            Self::Bad => Some("bad compared"),
            Self::Number => Some("number"),
        }
    }

    fn sign(self) -> &'static str {
        match self {
            Self::Neutral | Self::Number => "",
            Self::Good | Self::Tested => "✓ ",
            Self::Bad => "✗ ",
        }
    }
}

/// A column of a table: its heading, and the cell of an item.
pub(super) type ReportColumn<'a, T> = (&'a str, &'a dyn Fn(&T) -> ReportCell);

impl ReportCell {
    /// Creates the cell of a number, with a dash for `None`.
    pub(super) fn optional(number: Option<impl ToString>) -> Self {
        Self::number(number.map_or_else(|| "–".to_owned(), |number| number.to_string()))
    }

    pub(super) fn digest(sha256: &str) -> Self {
        Self::text(format!("{}…", sha256.get(..16).unwrap_or_default()))
    }

    pub(super) fn text(text: impl ToString) -> Self {
        Self::with_mark(text, CellMark::Neutral)
    }

    /// Creates a cell of code, such as a command.
    pub(super) fn code(text: impl Display) -> Self {
        Self {
            text: RichText::code(text),
            mark: CellMark::Neutral,
        }
    }

    pub(super) fn number(number: impl ToString) -> Self {
        Self::with_mark(number, CellMark::Number)
    }

    pub(super) fn with_mark(text: impl ToString, mark: CellMark) -> Self {
        Self {
            text: text.to_string().into(),
            mark,
        }
    }

    pub(super) fn with_verdict(text: impl ToString, good: bool) -> Self {
        Self::with_mark(text, if good { CellMark::Good } else { CellMark::Bad })
    }

    fn to_html(&self) -> Markup {
        html! { (self.mark.sign()) (self.text.to_html()) }
    }

    fn to_inline(&self) -> Inline {
        self.text.append_to(Inline::prose(self.mark.sign()))
    }
}

impl ReportTable {
    pub(super) fn new(header: &[&str]) -> Self {
        Self {
            header: header.iter().map(|&name| name.to_owned()).collect(),
            rows: Vec::new(),
        }
    }

    /// Builds a table with a row for each item.
    pub(super) fn from_items<T>(
        items: impl IntoIterator<Item = T>,
        columns: &[ReportColumn<'_, T>],
    ) -> Self {
        let mut table = Self::new(&columns.iter().map(|(name, _)| *name).collect::<Vec<_>>());
        items
            .into_iter()
            .for_each(|item| table.push_row(columns.iter().map(|(_, cell)| cell(&item)).collect()));
        table
    }

    pub(super) fn without_column(mut self, column: Option<usize>) -> Self {
        if let Some(column) = column {
            self.header.remove(column);
            self.rows
                .iter_mut()
                .for_each(|row| drop(row.remove(column)));
        }
        self
    }

    pub(super) fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    pub(super) fn push_row(&mut self, cells: Vec<ReportCell>) {
        self.rows.push(cells);
    }

    fn is_number_column(&self, column: usize) -> bool {
        self.rows.iter().all(|row| {
            row.get(column)
                .is_some_and(|cell| cell.mark == CellMark::Number)
        })
    }

    /// Renders the table in a frame that scrolls horizontally on a narrow page. The first column heads its row.
    pub(super) fn to_html(&self) -> Markup {
        html! {
            div.scroll tabindex="0" {
                table {
                    thead { tr {
                        @for (column, name) in self.header.iter().enumerate() {
                            th scope="col" class=[self.is_number_column(column).then_some("number")] { (name) }
                        }
                    } }
                    tbody {
                        @for row in &self.rows { tr {
                            @for (column, cell) in row.iter().enumerate() {
                                @if column == 0 {
                                    th scope="row" { (cell.to_html()) }
                                } @else {
                                    td class=[cell.mark.css_class()] { (cell.to_html()) }
                                }
                            }
                        } }
                    }
                }
            }
        }
    }

    pub(super) fn write_markdown(&self, out: &mut Markdown) {
        let first_row = self.rows.first();
        let alignments: Vec<_> = (0..self.header.len())
            .map(|column| match first_row.and_then(|row| row.get(column)) {
                Some(cell) if cell.mark == CellMark::Number => "---:",
                _ => "---",
            })
            .collect();
        let rows = self.rows.iter();
        let rows = rows.map(|row| row.iter().map(ReportCell::to_inline).collect());
        out.table(&self.header, &alignments, rows);
    }
}
