//! Elements of a file, with their lines. Attributes are read with the values of parameters.

use std::path::Path;
use std::sync::Arc;

use crumple_core::quoting::shorten_message;
use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use super::error::ScenarioImportError;
use super::parameters::Parameters;
use super::vocabulary::Word;
use crumple_core::digits::format_number;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum size of a scenario with its road and its catalogues, in bytes.
pub const MAX_XML_BYTES: u64 = 64 << 20;
/// Maximum number of tags and attributes of these files.
pub const MAX_XML_ITEMS: usize = 1_000_000;
/// Maximum depth of an element.
const MAX_DEPTH: usize = 64;
/// Maximum number of attributes of an element.
const MAX_ATTRIBUTES: usize = 100;
/// Maximum length of a name or an attribute, in bytes.
const MAX_ATTRIBUTE_BYTES: usize = 64 << 10;

/// An element of a file.
#[derive(Debug)]
pub(super) struct SourceElement {
    pub(super) name: String,
    pub(super) line: u32,
    pub(super) path: Arc<Path>,
    attributes: Box<[(String, String)]>,
    children: Vec<SourceElement>,
    has_text: bool,
}

impl SourceElement {
    /// Parses a file of at most `max_items` tags and attributes, and checks the name of its root.
    pub(super) fn parse(bytes: &[u8], path: &Path, root: &str, max_items: usize) -> Result<Self> {
        let path: Arc<Path> = path.into();
        let text = decode_text(bytes, &path)?;
        check_item_count(text, &path, max_items)?;
        let mut reader = Reader::from_str(text);
        let mut tree = SourceTreeBuilder {
            path: &path,
            root: None,
            open: Vec::new(),
        };
        let mut line = 1;
        let mut counted_bytes = 0;
        loop {
            let start = reader.buffer_position();
            let event = reader.read_event();
            let end = if event.is_err() {
                reader.error_position()
            } else {
                start
            };
            let end = usize::try_from(end).unwrap_or(usize::MAX).min(text.len());
            line += count_lines(text.as_bytes().get(counted_bytes..end).unwrap_or_default());
            counted_bytes = counted_bytes.max(end);
            let event = event.map_err(|error| syntax_error(&path, line, &error.to_string()))?;
            if matches!(event, Event::Eof) {
                let element = tree
                    .finish()
                    .map_err(|problem| syntax_error(&path, line, problem))?;
                return element.check_name(root);
            }
            tree.add(event, line)
                .map_err(|problem| syntax_error(&path, line, &problem))?;
        }
    }

    /// Refuses a root of another name.
    fn check_name(self, expected: &str) -> Result<Self> {
        if self.name == expected {
            return Ok(self);
        }
        let problem = format!("the root is `{}`, expected `{expected}`", self.name);
        Err(syntax_error(&self.path, self.line, &problem))
    }

    fn from_tag(
        tag: &BytesStart<'_>,
        line: u32,
        path: &Arc<Path>,
    ) -> std::result::Result<Self, String> {
        check_length(tag.name().as_ref())?;
        let name = String::from_utf8_lossy(tag.local_name().as_ref()).into_owned();
        let mut attributes = Vec::new();
        for (index, attribute) in tag.attributes().enumerate() {
            let attribute = attribute.map_err(|error| error.to_string())?;
            // The parser compares each attribute with all before it.
            if index >= MAX_ATTRIBUTES {
                return Err(format!(
                    "an element has more than {MAX_ATTRIBUTES} attributes"
                ));
            }
            check_length(attribute.key.as_ref())?;
            check_length(&attribute.value)?;
            let key = String::from_utf8_lossy(attribute.key.as_ref()).into_owned();
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            let value = value
                .map_err(|error| format!("attribute `{key}`: {error}"))?
                .into_owned();
            if !key.starts_with("xmlns") && !key.starts_with("xsi:") {
                attributes.push((key, value));
            }
        }
        Ok(Self {
            name,
            line,
            path: path.clone(),
            attributes: attributes.into(),
            children: Vec::new(),
            has_text: false,
        })
    }

    pub(super) fn location(&self) -> ElementLocation {
        ElementLocation {
            path: self.path.clone(),
            line: self.line,
            name: shorten_message(&self.name).into_owned(),
        }
    }

    pub(super) fn refuse(&self, reason: impl Into<String>) -> ScenarioImportError {
        self.location().refuse(&reason.into())
    }

    /// Returns the size of this element with its children.
    pub(super) fn size(&self) -> ElementSize {
        let texts = self.attributes.iter();
        let mut size = ElementSize {
            items: 1 + self.attributes.len(),
            bytes: texts.map(|(name, value)| name.len() + value.len()).sum(),
        };
        for child in self.children.iter().map(Self::size) {
            size.items += child.items;
            size.bytes += child.bytes;
        }
        size
    }

    pub(super) fn children(&self) -> &[Self] {
        &self.children
    }
}

/// Refuses a name or an attribute that is longer than the limit.
fn check_length(text: &[u8]) -> std::result::Result<(), String> {
    if text.len() > MAX_ATTRIBUTE_BYTES {
        return Err(format!(
            "a name or an attribute has more than {MAX_ATTRIBUTE_BYTES} bytes"
        ));
    }
    Ok(())
}

/// Elements that have been read, and those around the next event.
struct SourceTreeBuilder<'a> {
    path: &'a Arc<Path>,
    root: Option<SourceElement>,
    open: Vec<SourceElement>,
}

impl SourceTreeBuilder<'_> {
    /// Adds what an event says, apart from the end of the text.
    fn add(&mut self, event: Event<'_>, line: u32) -> std::result::Result<(), String> {
        let closed = match event {
            Event::Start(_) | Event::Empty(_) if self.open.is_empty() && self.root.is_some() => {
                return Err("there is a second root element".to_owned());
            }
            Event::Start(tag) => {
                if self.open.len() >= MAX_DEPTH {
                    return Err(format!("elements are nested deeper than {MAX_DEPTH}"));
                }
                let element = SourceElement::from_tag(&tag, line, self.path)?;
                self.open.push(element);
                None
            }
            Event::Empty(tag) => Some(SourceElement::from_tag(&tag, line, self.path)?),
            Event::End(_) => self.open.pop(),
            Event::DocType(_) => return Err("there is a document type declaration".to_owned()),
            Event::Text(text) if text.iter().all(u8::is_ascii_whitespace) => None,
            Event::Text(_) | Event::CData(_) | Event::GeneralRef(_) => {
                let around = self.open.last_mut();
                around
                    .ok_or("there is text outside of the root element")?
                    .has_text = true;
                None
            }
            Event::Eof | Event::Decl(_) | Event::Comment(_) | Event::PI(_) => None,
        };
        match (closed, self.open.last_mut()) {
            (Some(element), Some(parent)) => parent.children.push(element),
            (Some(element), None) => self.root = Some(element),
            (None, _) => {}
        }
        Ok(())
    }

    /// Returns the root at the end of the text.
    fn finish(self) -> std::result::Result<SourceElement, &'static str> {
        if !self.open.is_empty() {
            return Err("the text ends within an element");
        }
        self.root.ok_or("there is no element")
    }
}

fn syntax_error(path: &Path, line: u32, problem: &str) -> ScenarioImportError {
    ScenarioImportError::Syntax {
        path: path.to_path_buf(),
        line,
        problem: shorten_message(problem).into_owned(),
    }
}

/// Returns the text of a file without a byte order mark.
fn decode_text<'a>(bytes: &'a [u8], path: &Path) -> Result<&'a str> {
    let text = std::str::from_utf8(bytes).map_err(|error| {
        let before = bytes.get(..error.valid_up_to()).unwrap_or_default();
        syntax_error(path, 1 + count_lines(before), "the text is not UTF-8")
    })?;
    Ok(text.strip_prefix('\u{feff}').unwrap_or(text))
}

/// Refuses too many tags and attributes, before elements are built, which take more memory than their text.
fn check_item_count(text: &str, path: &Path, max_items: usize) -> Result<()> {
    let mut items = text.bytes().enumerate().filter(|(_, byte)| is_item(*byte));
    let Some((excess_at, _)) = items.nth(max_items) else {
        return Ok(());
    };
    let before = text.as_bytes().get(..excess_at).unwrap_or_default();
    let problem = format!(
        "there are more than {MAX_XML_ITEMS} tags and attributes, with the other files of the scenario"
    );
    Err(syntax_error(path, 1 + count_lines(before), &problem))
}

/// Size of an element in its file.
pub(super) struct ElementSize {
    /// Number of elements and attributes.
    pub(super) items: usize,
    /// Bytes of the attributes.
    pub(super) bytes: usize,
}

/// File, line and name of an element, for errors after its parameters are forgotten.
#[derive(Debug, Clone)]
pub(super) struct ElementLocation {
    pub(super) path: Arc<Path>,
    pub(super) line: u32,
    pub(super) name: String,
}

/// Returns true for a byte of which a text has at least as many as tags and attributes.
fn is_item(byte: u8) -> bool {
    matches!(byte, b'<' | b'=')
}

/// Returns the number of tags and attributes of a text, or more.
pub(super) fn count_items(bytes: &[u8]) -> usize {
    bytes.iter().filter(|byte| is_item(**byte)).count()
}

fn count_lines(bytes: &[u8]) -> u32 {
    u32::try_from(bytes.iter().filter(|&&byte| byte == b'\n').count()).unwrap_or(u32::MAX)
}

/// An element with the values of the parameters that its attributes name.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node<'a> {
    pub(super) element: &'a SourceElement,
    pub(super) parameters: &'a Parameters,
}

impl ElementLocation {
    pub(super) fn refuse(&self, reason: &str) -> ScenarioImportError {
        ScenarioImportError::Refused {
            path: self.path.to_path_buf(),
            line: self.line,
            element: self.name.clone(),
            reason: shorten_message(reason).into_owned(),
        }
    }
}

impl<'a> Node<'a> {
    pub(super) fn name(self) -> &'a str {
        &self.element.name
    }

    pub(super) fn location(self) -> ElementLocation {
        self.element.location()
    }

    pub(super) fn refuse(self, reason: impl Into<String>) -> ScenarioImportError {
        self.element.refuse(reason)
    }

    /// Returns a note with the file, line and name of the element.
    pub(super) fn note(self, text: impl Into<String>) -> String {
        self.refuse(text).to_string()
    }

    pub(super) fn children(self) -> impl Iterator<Item = Node<'a>> {
        self.element
            .children
            .iter()
            .map(move |element| Node { element, ..self })
    }

    pub(super) fn named(self, name: &str) -> impl Iterator<Item = Node<'a>> {
        self.children().filter(move |child| child.name() == name)
    }

    /// Refuses the first child or attribute that is not listed, and text.
    pub(super) fn only(self, children: &[&str], attributes: &[&str]) -> Result<()> {
        if let Some(child) = self
            .children()
            .find(|child| !children.contains(&child.name()))
        {
            return Err(child.refuse(format!("is not supported in `{}`", self.name())));
        }
        if let Some((name, _)) = self
            .element
            .attributes
            .iter()
            .find(|(name, _)| !attributes.contains(&name.as_str()))
        {
            return Err(self.refuse(format!("the attribute `{name}` is not supported")));
        }
        if self.element.has_text {
            Err(self.refuse("text is not supported"))
        } else {
            Ok(())
        }
    }

    pub(super) fn optional(self, name: &'a str) -> Option<Node<'a>> {
        self.named(name).next()
    }

    pub(super) fn child(self, name: &'a str) -> Result<Node<'a>> {
        self.optional(name)
            .ok_or_else(|| self.refuse(format!("has no `{name}`")))
    }

    /// Returns the only child.
    pub(super) fn single(self) -> Result<Node<'a>> {
        let mut children = self.children();
        match (children.next(), children.next()) {
            (Some(child), None) => Ok(child),
            (None, _) => Err(self.refuse("is empty")),
            (_, Some(second)) => {
                Err(second.refuse(format!("is a second element in `{}`", self.name())))
            }
        }
    }

    /// Returns an attribute as written.
    pub(super) fn raw(self, name: &str) -> Option<&'a str> {
        self.element
            .attributes
            .iter()
            .find(|(key, _)| key == name)
            .map(|(_, value)| value.as_str())
    }

    pub(super) fn optional_text(self, name: &str) -> Result<Option<String>> {
        let Some(raw) = self.raw(name) else {
            return Ok(None);
        };
        let text = self.parameters.resolve(raw);
        text.map(Some)
            .map_err(|reason| self.refuse(format!("attribute `{name}`: {reason}")))
    }

    pub(super) fn text(self, name: &str) -> Result<String> {
        self.optional_text(name)?
            .ok_or_else(|| self.refuse(format!("has no attribute `{name}`")))
    }

    pub(super) fn optional_number(self, name: &str) -> Result<Option<f64>> {
        let Some(text) = self.optional_text(name)? else {
            return Ok(None);
        };
        let number = text.trim().parse::<f64>().ok();
        match number.filter(|number| number.is_finite()) {
            Some(number) => Ok(Some(number)),
            None => Err(self.refuse(format!(
                "attribute `{name}`: `{text}` is not a finite number"
            ))),
        }
    }

    pub(super) fn number(self, name: &str) -> Result<f64> {
        self.optional_number(name)?
            .ok_or_else(|| self.refuse(format!("has no attribute `{name}`")))
    }

    pub(super) fn non_negative(self, name: &str) -> Result<f64> {
        match self.number(name)? {
            value if value >= 0.0 => Ok(value),
            value => Err(self.refuse_negative(name, value)),
        }
    }

    pub(super) fn optional_non_negative(self, name: &str) -> Result<Option<f64>> {
        match self.optional_number(name)? {
            Some(value) if value < 0.0 => Err(self.refuse_negative(name, value)),
            value => Ok(value),
        }
    }

    fn refuse_negative(self, name: &str, value: f64) -> ScenarioImportError {
        self.refuse(format!(
            "attribute `{name}`: must not be negative, found {}",
            format_number(value)
        ))
    }

    pub(super) fn flag(self, name: &str, default: bool) -> Result<bool> {
        match self.optional_text(name)?.as_deref() {
            None => Ok(default),
            Some("true" | "1") => Ok(true),
            Some("false" | "0") => Ok(false),
            Some(other) => Err(self.refuse(format!(
                "attribute `{name}`: `{other}` is not true or false"
            ))),
        }
    }

    /// Returns the value of an attribute that is a word of the vocabulary.
    pub(super) fn word<T: Word>(self, name: &str) -> Result<T> {
        let text = self.text(name)?;
        T::parse(&text).ok_or_else(|| self.refuse_word(name, &text, T::NAMES))
    }

    /// Returns the value of an attribute that is a word of the vocabulary, or `None` without the attribute.
    pub(super) fn optional_word<T: Word>(self, name: &str) -> Result<Option<T>> {
        match self.raw(name) {
            Some(_) => self.word(name).map(Some),
            None => Ok(None),
        }
    }

    fn refuse_word(self, name: &str, text: &str, expected: &[&str]) -> ScenarioImportError {
        self.refuse(format!(
            "`{name}` = `{text}` is not supported, only {}",
            expected.join(", ")
        ))
    }

    /// Refuses any value of an attribute but the expected ones; a missing attribute is accepted.
    pub(super) fn expect(self, name: &str, expected: &[&str]) -> Result<()> {
        match self.optional_text(name)? {
            Some(text) if !expected.contains(&text.as_str()) => {
                Err(self.refuse_word(name, &text, expected))
            }
            _ => Ok(()),
        }
    }
}
