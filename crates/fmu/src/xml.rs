//! XML reader for selected elements and attributes, in time linear in the length of the text.

use quick_xml::events::{BytesStart, Event};
use quick_xml::{Reader, XmlVersion};

use crate::description::InvalidDescription;
use crate::unit::BASE_UNITS;

/// Maximum depth of a kept element; the root has depth 1. Dropping elements recurses to this depth.
const MAX_DEPTH: usize = 4;
/// Maximum number of kept elements and attributes.
const MAX_ITEMS: usize = 4_000_000;

/// Elements that are read. FMI 2 wraps the type of a variable in `ScalarVariable`, and a declared type in `SimpleType`.
const ELEMENTS: [&str; 16] = [
    "fmiModelDescription",
    "CoSimulation",
    "UnitDefinitions",
    "Unit",
    "BaseUnit",
    "TypeDefinitions",
    "SimpleType",
    "Float64Type",
    "ModelVariables",
    "ScalarVariable",
    "Real",
    "Integer",
    "Boolean",
    "Float64",
    "Int32",
    "Dimension",
];
/// Attributes that are read, besides the exponents of base units.
const ATTRIBUTES: [&str; 17] = [
    "fmiVersion",
    "modelName",
    "guid",
    "instantiationToken",
    "modelIdentifier",
    "needsExecutionTool",
    "canBeInstantiatedOnlyOncePerProcess",
    "name",
    "description",
    "valueReference",
    "causality",
    "start",
    "unit",
    "declaredType",
    "relativeQuantity",
    "factor",
    "offset",
];

#[derive(Debug)]
pub(crate) struct XmlElement {
    /// Name without a namespace prefix.
    pub(crate) name: &'static str,
    pub(crate) line: u32,
    attributes: Vec<(&'static str, String)>,
    /// Children in the order of the text.
    pub(crate) children: Vec<XmlElement>,
}

impl XmlElement {
    pub(crate) fn attribute(&self, name: &str) -> Option<&str> {
        self.attributes
            .iter()
            .find(|(key, _)| *key == name)
            .map(|(_, value)| value.as_str())
    }

    pub(crate) fn child(&self, name: &str) -> Option<&XmlElement> {
        self.children.iter().find(|child| child.name == name)
    }

    /// Reads the root element. Keeps only listed elements and attributes; drops the children of dropped elements.
    ///
    /// # Errors
    /// [`InvalidDescription`] for a text that is not well-formed, has a document type declaration, or has a root of
    /// another name.
    pub(crate) fn parse(text: &str) -> Result<Self, InvalidDescription> {
        let text = text.strip_prefix('\u{feff}').unwrap_or(text);
        let mut lines = LineCounter {
            text: text.as_bytes(),
            offset: 0,
            line: 1,
        };
        let mut reader = Reader::from_str(text);
        let mut tree = XmlTreeBuilder::default();
        loop {
            let start = reader.buffer_position();
            let event = reader.read_event();
            let line = lines.line_at(if event.is_err() {
                reader.error_position()
            } else {
                start
            });
            let added = match event {
                Ok(Event::Eof) => {
                    return tree
                        .finish()
                        .map_err(|problem| InvalidDescription::AtLine { line, problem });
                }
                Ok(event) => tree.add(event, line),
                Err(error) => Err(error.to_string()),
            };
            added.map_err(|problem| InvalidDescription::AtLine { line, problem })?;
        }
    }
}

/// Elements that have been read, and those around the next event.
#[derive(Default)]
struct XmlTreeBuilder {
    root: Option<XmlElement>,
    open: Vec<XmlElement>,
    /// Number of dropped elements around the next event.
    skipped: usize,
    /// Number of kept elements and attributes.
    kept_items: usize,
}

impl XmlTreeBuilder {
    fn is_outside(&self) -> bool {
        self.open.is_empty() && self.skipped == 0
    }

    /// Adds the element of an event, apart from the end of the text.
    fn add(&mut self, event: Event<'_>, line: u32) -> Result<(), String> {
        let is_outside = self.is_outside();
        let closed = match event {
            Event::Start(_) | Event::Empty(_) if is_outside && self.root.is_some() => {
                return Err("there is a second root element".to_owned());
            }
            Event::Start(tag) => {
                match self.read_kept(&tag, line)? {
                    Some(element) => self.open.push(element),
                    None => self.skipped += 1,
                }
                None
            }
            Event::Empty(tag) => self.read_kept(&tag, line)?,
            Event::End(_) if self.skipped > 0 => {
                self.skipped -= 1;
                None
            }
            Event::End(_) => self.open.pop(),
            Event::DocType(_) => return Err("has a document type declaration".to_owned()),
            Event::Text(text) if text.iter().all(u8::is_ascii_whitespace) => None,
            Event::Text(_) | Event::CData(_) | Event::GeneralRef(_) if is_outside => {
                return Err("there is text outside of the root element".to_owned());
            }
            _ => None,
        };
        if let Some(element) = closed {
            match self.open.last_mut() {
                Some(parent) => parent.children.push(element),
                None => self.root = Some(element),
            }
        }
        Ok(())
    }

    /// Reads a start tag; none for an element that is dropped.
    fn read_kept(&mut self, tag: &BytesStart<'_>, line: u32) -> Result<Option<XmlElement>, String> {
        let element = read_start_tag(tag, line, &mut self.kept_items)?;
        Ok(element.filter(|_| self.skipped == 0 && self.open.len() < MAX_DEPTH))
    }

    /// Returns the root at the end of the text.
    fn finish(self) -> Result<XmlElement, String> {
        if !self.is_outside() {
            return Err("the text ends within an element".to_owned());
        }
        self.root
            .ok_or_else(|| "there is no root element of a known name".to_owned())
    }
}

/// Reads a start tag; none for an element that is not kept. Checks attributes in any case.
fn read_start_tag(
    tag: &BytesStart<'_>,
    line: u32,
    kept_items: &mut usize,
) -> Result<Option<XmlElement>, String> {
    let mut attributes = Vec::new();
    for attribute in tag.attributes() {
        let attribute = attribute.map_err(|error| error.to_string())?;
        let key = attribute.key.as_ref();
        if let Some(name) = listed_name(&ATTRIBUTES, key).or_else(|| listed_name(&BASE_UNITS, key))
        {
            let value = attribute.normalized_value(XmlVersion::Implicit1_0);
            let value = value.map_err(|error| format!("attribute `{name}`: {error}"))?;
            attributes.push((name, value.into_owned()));
        }
    }
    let Some(name) = listed_name(&ELEMENTS, tag.local_name().as_ref()) else {
        return Ok(None);
    };
    *kept_items += 1 + attributes.len();
    if *kept_items > MAX_ITEMS {
        return Err(format!(
            "there are more than {MAX_ITEMS} elements and attributes"
        ));
    }
    Ok(Some(XmlElement {
        name,
        line,
        attributes,
        children: Vec::new(),
    }))
}

/// Returns the listed name that is equal to a name in the text.
fn listed_name(names: &[&'static str], text: &[u8]) -> Option<&'static str> {
    names.iter().copied().find(|name| name.as_bytes() == text)
}

struct LineCounter<'a> {
    text: &'a [u8],
    offset: usize,
    line: u32,
}

impl LineCounter<'_> {
    /// Returns the line at a byte offset, which must not decrease between calls.
    fn line_at(&mut self, offset: u64) -> u32 {
        let offset = usize::try_from(offset)
            .unwrap_or(usize::MAX)
            .min(self.text.len());
        let passed = self.text.get(self.offset..offset).unwrap_or_default();
        self.line += passed.iter().filter(|&&byte| byte == b'\n').count() as u32;
        self.offset = self.offset.max(offset);
        self.line
    }
}
