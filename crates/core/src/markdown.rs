//! A writer of Markdown: blocks separated by an empty line, with all text escaped.
//!
//! The input is prose: text between backticks is code, and no other character has a special meaning.

use std::fmt::Display;

use crate::quoting::{MarkdownCode, MarkdownText};

/// A text in Markdown.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Markdown {
    text: String,
}

/// Escaped text within a line of Markdown.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Inline {
    text: String,
}

impl Inline {
    /// Creates text, with code between backticks.
    #[must_use]
    pub fn prose(text: &str) -> Self {
        Self::default().and_prose(text)
    }

    /// Creates bold text, with code between backticks.
    #[must_use]
    pub fn strong(text: &str) -> Self {
        Self::default().and_strong(text)
    }

    /// Appends text, with code between backticks.
    #[must_use]
    pub fn and_prose(mut self, text: &str) -> Self {
        for (is_code, piece) in split_prose(text) {
            match is_code && !piece.is_empty() {
                true => self = self.and_code(piece),
                false => self.push_escaped(piece),
            }
        }
        self
    }

    /// Appends bold text, with code between backticks. A space at its end stays, but is not bold.
    #[must_use]
    pub fn and_strong(mut self, text: &str) -> Self {
        self.text += &format!("**{}**", Self::prose(text.trim()).text);
        if text.ends_with(' ') {
            self.text.push(' ');
        }
        self
    }

    /// Appends code.
    #[must_use]
    pub fn and_code(mut self, text: impl Display) -> Self {
        // Two adjacent runs of backticks would be one.
        if self.text.ends_with('`') {
            self.text.push(' ');
        }
        self.text += &MarkdownCode(&text.to_string()).to_string();
        self
    }

    fn push_escaped(&mut self, piece: &str) {
        // Spaces between pieces stay; at the start of a block they would have a meaning.
        let spaces = piece.len() - piece.trim_start().len();
        if spaces > 0 && !self.text.is_empty() {
            self.text.push(' ');
        }
        self.text += &MarkdownText(piece).to_string();
    }

    /// Escapes the text for a table cell, which ends at the next unescaped bar.
    #[must_use]
    pub fn to_table_cell(&self) -> String {
        let mut cell = String::new();
        let mut backslashes = 0;
        for letter in self.text.chars() {
            if letter == '|' && backslashes % 2 == 0 {
                cell.push('\\');
            }
            backslashes = if letter == '\\' { backslashes + 1 } else { 0 };
            cell.push(letter);
        }
        cell
    }
}

/// Splits prose into pieces, each with true for code, which is between backticks. The last of an odd number of
/// backticks is text.
pub fn split_prose(text: &str) -> impl Iterator<Item = (bool, &str)> {
    let paired = text.matches('`').count() / 2 * 2;
    let pieces = text.splitn(paired + 1, '`').enumerate();
    pieces.map(|(index, piece)| (index % 2 == 1, piece))
}

/// Returns a name for prose: without backticks, which would begin and end code there.
#[must_use]
pub fn prose_name(name: &str) -> String {
    name.replace('`', "'")
}

impl From<&str> for Inline {
    fn from(text: &str) -> Self {
        Self::prose(text)
    }
}

impl From<String> for Inline {
    fn from(text: String) -> Self {
        Self::prose(&text)
    }
}

impl Markdown {
    /// Writes a heading of level `depth`, from 1.
    pub fn heading(&mut self, depth: usize, text: &str) {
        let Inline { text } = Inline::prose(text);
        self.push_block(&format!("{} {text}\n", "#".repeat(depth)));
    }

    /// Writes a paragraph, unless the text is empty.
    pub fn paragraph(&mut self, words: impl Into<Inline>) {
        let Inline { text } = words.into();
        if !text.is_empty() {
            self.push_block(&(text + "\n"));
        }
    }

    /// Writes a list, unless it is empty.
    pub fn list<I: Into<Inline>>(&mut self, entries: impl IntoIterator<Item = I>) {
        let lines: String = entries
            .into_iter()
            .map(|entry| format!("- {}\n", entry.into().text))
            .collect();
        if !lines.is_empty() {
            self.push_block(&lines);
        }
    }

    /// Writes a table. `columns` has the Markdown alignment of each column.
    pub fn table<I: Into<Inline>>(
        &mut self,
        header: &[String],
        columns: &[&str],
        rows: impl Iterator<Item = Vec<I>>,
    ) {
        let rows: String = rows.map(table_line).collect();
        self.push_block(&format!(
            "{}| {} |\n{rows}",
            table_line(header.to_vec()),
            columns.join(" | ")
        ));
    }

    /// Writes a table without alignment of its columns.
    pub fn plain_table(&mut self, header: &[&str], rows: impl Iterator<Item = Vec<String>>) {
        let rows: String = rows.map(table_line).collect();
        self.push_block(&format!(
            "{}|{}\n{rows}",
            table_line(header.to_vec()),
            "---|".repeat(header.len())
        ));
    }

    /// Appends the blocks of another text.
    pub fn append(&mut self, blocks: &Self) {
        if !blocks.text.is_empty() {
            self.push_block(&blocks.text);
        }
    }

    fn push_block(&mut self, text: &str) {
        if !self.text.is_empty() {
            self.text.push('\n');
        }
        self.text += text;
    }

    /// Returns the text.
    #[must_use]
    pub fn into_string(self) -> String {
        self.text
    }
}

fn table_line<I: Into<Inline>>(cells: Vec<I>) -> String {
    let cells = cells.into_iter().map(Into::into);
    let cells: Vec<_> = cells.map(|cell: Inline| cell.to_table_cell()).collect();
    format!("| {} |\n", cells.join(" | "))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use pulldown_cmark::{Event, Options, Parser, Tag};

    use super::*;

    fn hostile() -> impl Strategy<Value = String> {
        let nasty = prop::sample::select(vec![
            "<script>",
            "<img src=x onerror=y>",
            "</td>",
            "<!--",
            "&lt;",
            "<https://x.y>",
            "[a](http://x.y)",
            "![a](b)",
            "[a]: b",
            "|",
            "\\",
            "`",
            "``",
            "*",
            "**",
            "_",
            "~~",
            "$",
            "\n",
            "\n\n",
            "\r\n# ",
            "\t",
            "    ",
            "- ",
            "1. ",
            "> ",
            "---",
            "===",
            "\u{1b}[2J",
            "\u{202e}",
            "\u{0}",
            "a",
            " b ",
            "é",
            "[x]",
            "[^1]",
        ]);
        prop::collection::vec(
            prop_oneof![6 => nasty.prop_map(str::to_owned), 1 => any::<char>().prop_map(String::from)],
            0..12,
        )
        .prop_map(|pieces| pieces.concat())
    }

    fn document(names: &[String]) -> Markdown {
        let mut text = Markdown::default();
        for name in names {
            text.heading(3, &format!("Space {name}"));
            text.paragraph(name.as_str());
            text.paragraph(
                Inline::strong(&format!("x {name} x"))
                    .and_prose(name)
                    .and_code(name),
            );
            text.table(
                names,
                &vec!["---"; names.len()],
                [names.to_vec(), names.to_vec()].into_iter(),
            );
            text.list(names.iter().map(String::as_str));
            text.paragraph("behind");
        }
        text
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// With any names, the document has exactly the blocks that it was written with.
        #[test]
        fn names_never_become_markup(names in prop::collection::vec(hostile(), 1..4)) {
            let text = document(&names).into_string();
            let (mut headings, mut tables, mut rows, mut cells, mut items, mut behind) = (0, 0, 0, 0, 0, 0);
            for event in Parser::new_ext(&text, Options::all()) {
                match event {
                    Event::Html(_) | Event::InlineHtml(_) | Event::Rule | Event::HardBreak | Event::FootnoteReference(_)
                    | Event::InlineMath(_) | Event::DisplayMath(_) | Event::TaskListMarker(_) => {
                        prop_assert!(false, "{event:?} in {text}");
                    }
                    Event::Start(Tag::Link { .. } | Tag::Image { .. } | Tag::HtmlBlock | Tag::CodeBlock(_)
                        | Tag::BlockQuote(_) | Tag::FootnoteDefinition(_) | Tag::Emphasis | Tag::Strikethrough
                        | Tag::MetadataBlock(_)) => {
                        prop_assert!(false, "{event:?} in {text}");
                    }
                    Event::Start(Tag::Heading { .. }) => headings += 1,
                    Event::Start(Tag::Table(_)) => tables += 1,
                    Event::Start(Tag::TableRow) => rows += 1,
                    Event::Start(Tag::TableCell) => cells += 1,
                    Event::Start(Tag::Item) => items += 1,
                    Event::Text(words) if &*words == "behind" => behind += 1,
                    _ => {}
                }
            }
            let many = names.len();
            prop_assert_eq!((headings, tables, rows, items), (many, many, 2 * many, many * many), "{}", text);
            prop_assert_eq!(cells, 3 * many * many, "{}", text);
            prop_assert!(behind >= many);
        }
    }

    #[test]
    fn code_spans_show_their_text() {
        let words = Inline::prose("as in ").and_code("a`|b").and_prose(": `c`");
        assert_eq!(words.to_table_cell(), "as in `` a`\\|b ``: `c`");
        let mut text = Markdown::default();
        text.paragraph(words);
        assert_eq!(text.into_string(), "as in `` a`|b ``: `c`\n");
    }

    #[test]
    fn a_single_backtick_is_text() {
        let Inline { text } = Inline::prose("`a` and b` and c");
        assert_eq!(text, "`a` and b\\` and c");
        let Inline { text } = Inline::prose(&format!("`{}` c", prose_name("a`b")));
        assert_eq!(text, "`a'b` c");
    }
}
