//! Running text of a report: prose, bold text and code.

use std::fmt::Display;

use maud::{Markup, html};

use super::prose::prose_to_html;
use crumple_core::markdown::Inline;

/// A line of running text. In prose and bold text, text between backticks is code.
#[derive(Debug, Clone)]
pub(super) struct RichText {
    spans: Vec<TextSpan>,
}

#[derive(Debug, Clone)]
enum TextSpan {
    Prose(String),
    Strong(String),
    Code(String),
}

impl RichText {
    pub(super) fn strong(text: impl Into<String>) -> Self {
        Self::new(TextSpan::Strong(text.into()))
    }

    pub(super) fn code(text: impl Display) -> Self {
        Self::new(TextSpan::Code(text.to_string()))
    }

    pub(super) fn and_prose(self, text: impl Into<String>) -> Self {
        self.and(TextSpan::Prose(text.into()))
    }

    pub(super) fn and_code(self, text: impl Display) -> Self {
        self.and(TextSpan::Code(text.to_string()))
    }

    fn new(span: TextSpan) -> Self {
        Self { spans: vec![span] }
    }

    fn and(mut self, span: TextSpan) -> Self {
        self.spans.push(span);
        self
    }

    pub(super) fn to_html(&self) -> Markup {
        html! { @for span in &self.spans { (span.to_html()) } }
    }

    pub(super) fn to_inline(&self) -> Inline {
        self.append_to(Inline::default())
    }

    pub(super) fn append_to(&self, line: Inline) -> Inline {
        self.spans
            .iter()
            .fold(line, |line, span| span.append_to(line))
    }
}

impl TextSpan {
    fn to_html(&self) -> Markup {
        match self {
            Self::Prose(text) => prose_to_html(text),
            Self::Strong(text) => html! { b { (prose_to_html(text)) } },
            Self::Code(text) => html! { code { (text) } },
        }
    }

    fn append_to(&self, line: Inline) -> Inline {
        match self {
            Self::Prose(text) => line.and_prose(text),
            Self::Strong(text) => line.and_strong(text),
            Self::Code(text) => line.and_code(text),
        }
    }
}

impl From<String> for RichText {
    fn from(text: String) -> Self {
        Self::new(TextSpan::Prose(text))
    }
}

impl From<&str> for RichText {
    fn from(text: &str) -> Self {
        text.to_owned().into()
    }
}

impl From<&String> for RichText {
    fn from(text: &String) -> Self {
        text.clone().into()
    }
}
