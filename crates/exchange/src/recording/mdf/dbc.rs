//! DBC files: the messages of a CAN bus and their signals.

use std::collections::{HashMap, HashSet};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

use can_dbc::{
    AttributeDefinition, AttributeValue, AttributeValueType, ByteOrder, Dbc, ExtendedMultiplex,
};
use can_dbc::{
    Message, MessageId, MultiplexIndicator, Signal as DbcSignal, SignalExtendedValueType, ValueType,
};

use super::can::{FrameBits, FrameDecoder, FrameMessage, FrameSignal, Selector, parameter_group};
use super::{MdfError, SignalSet, SignalUse};
use crate::recording::map::{FrameChoice, RecordingMapSpec};
use crate::recording::table::excerpt;

const MAX_DBC_BYTES: u64 = 16 << 20;
/// Maximum number of words, numbers, separators and lines of a DBC file, which take about 100 bytes each while it is
/// parsed. A signal has about 17.
const MAX_DBC_WORDS: usize = 3_000_000;
/// Longest name of a message or signal, in bytes.
const MAX_NAME_BYTES: usize = 256;
/// Maximum number of bits of a signal.
const MAX_SIGNAL_BITS: u64 = 64;
/// Maximum number of multiplexers that select each other.
const MAX_SELECTORS: usize = 16;
/// Source address of a message of J1939 that any sender may send.
const ANY_SOURCE: u32 = 0xfe;

/// A DBC file: the messages of a CAN bus.
#[derive(Debug, Clone)]
pub struct DbcFile {
    dbc: Dbc,
    path: PathBuf,
    text: String,
    bus_channel: Option<FrameChoice>,
    source_address: Option<FrameChoice>,
}

/// Multiplexers by the id of the message and the name of the signal.
type Multiplexers<'d> = HashMap<(MessageId, &'d str), &'d ExtendedMultiplex>;

impl DbcFile {
    /// Reads a DBC file.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] for a file that cannot be read, is too long, or is no DBC file.
    pub fn load(path: &Path) -> Result<Self, MdfError> {
        let bytes = read_start(path)
            .map_err(|source| dbc_error(path.to_owned(), None, source.to_string()))?;
        Self::parse(&bytes, path)
    }

    /// Parses the bytes of a DBC file in UTF-8 or Windows-1252; `path` only names it.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] if the text is no DBC file, or exceeds a limit.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, MdfError> {
        let path = path.to_owned();
        if bytes.len() as u64 > MAX_DBC_BYTES {
            let problem = format!("has more than {MAX_DBC_BYTES} bytes");
            return Err(dbc_error(path, None, problem));
        }
        let text = match std::str::from_utf8(bytes) {
            Ok(text) => text.to_owned(),
            Err(_) => encoding_rs::WINDOWS_1252.decode(bytes).0.into_owned(),
        };
        let words = count_words(&text);
        if words > MAX_DBC_WORDS {
            let problem =
                format!("has {words} words, numbers and separators, more than {MAX_DBC_WORDS}");
            return Err(dbc_error(path, None, problem));
        }
        let dbc = match Dbc::try_from(text.as_str()) {
            Ok(dbc) => dbc,
            Err(problem) => return Err(syntax_error(path, &problem.to_string())),
        };
        Ok(Self {
            dbc,
            path,
            text,
            bus_channel: None,
            source_address: None,
        })
    }

    /// Restricts messages to the bus channels and source addresses that a map chooses.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] if the map names a message that the file lacks.
    pub(in crate::recording) fn with_frames_of(
        mut self,
        map: &RecordingMapSpec,
    ) -> Result<Self, MdfError> {
        for (key, choice) in [
            ("bus_channel", &map.bus_channel),
            ("source_address", &map.source_address),
        ] {
            let Some(FrameChoice::ByMessage(numbers)) = choice else {
                continue;
            };
            let messages = &self.dbc.messages;
            let unknown = numbers
                .keys()
                .find(|name| !messages.iter().any(|message| message.name == **name));
            if let Some(name) = unknown {
                let problem = format!(
                    "has no message {}, which `{key}` of the map names",
                    excerpt(name)
                );
                return Err(dbc_error(self.path, None, problem));
            }
        }
        self.bus_channel = map.bus_channel.clone();
        self.source_address = map.source_address.clone();
        Ok(self)
    }

    /// Returns an error at the last definition of a message, or at a signal of it.
    fn error(&self, message: &Message, signal: Option<&str>, problem: String) -> MdfError {
        let id = message.id.raw().to_string();
        let begin = self
            .text
            .lines()
            .enumerate()
            .filter(|(_, line)| starts_with_words(line, ["BO_", &id]))
            .last();
        let line = begin.and_then(|(from, _)| match signal {
            None => Some(from),
            Some(signal) => (from..)
                .zip(self.text.lines().skip(from))
                .find(|(_, line)| starts_with_words(line, ["SG_", signal]))
                .map(|(at, _)| at),
        });
        dbc_error(self.path.clone(), line.map(|line| line + 1), problem)
    }

    /// Adds the wanted signals and returns their decoder. The error is a message that is defined twice, or a signal
    /// beyond the end of its message. A name may begin with that of the message and a point.
    pub(super) fn decoder(
        &self,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
        signals: &mut SignalSet,
    ) -> Result<FrameDecoder, MdfError> {
        let mut decoder = FrameDecoder::default();
        let multiplexers = self.multiplexers();
        let mut defined = HashSet::new();
        for message in &self.dbc.messages {
            let wanted = self.wanted_signals(message, wanted)?;
            if wanted.is_empty() {
                continue;
            }
            let id = message.id.raw();
            if !defined.insert(id) {
                return Err(self.error(message, None, format!("message {id} is defined twice")));
            }
            let is_j1939 = self.is_j1939(message);
            let mut decoded = FrameMessage {
                label: label(message, is_j1939),
                signals: Vec::new(),
                bus_channel: chosen_number(self.bus_channel.as_ref(), message),
                source_address: chosen_number(self.source_address.as_ref(), message),
            };
            for (signal, name) in wanted {
                self.check_signal(message, signal)?;
                // Frames without the signal, by a multiplexer, have no place in its clock.
                let clock = signals.add_clock();
                let index = signals.add(name, signal.unit.clone(), clock);
                let decoded_signal =
                    self.frame_signal(message, signal, &multiplexers, (index, is_j1939))?;
                decoded.signals.push(decoded_signal);
            }
            match message.id {
                MessageId::Extended(id) if is_j1939 && has_any_sender(message) => {
                    if !decoder.insert_group(id, decoded) {
                        let problem =
                            "two messages from any sender have this parameter group number";
                        return Err(self.error(message, None, problem.to_owned()));
                    }
                }
                id => decoder.insert(id, decoded),
            }
        }
        let messages = self.dbc.messages.iter();
        let of_one_sender = messages.filter(|message| !has_any_sender(message));
        of_one_sender.for_each(|message| decoder.reserve(message.id));
        Ok(decoder)
    }

    /// Returns the multiplexers by message and signal, the first one of each.
    fn multiplexers(&self) -> Multiplexers<'_> {
        let mut multiplexers = Multiplexers::new();
        for multiplex in &self.dbc.extended_multiplex {
            multiplexers
                .entry((multiplex.message_id, multiplex.signal_name.as_str()))
                .or_insert(multiplex);
        }
        multiplexers
    }

    /// Returns the wanted signals of a message with their names.
    fn wanted_signals<'m>(
        &self,
        message: &'m Message,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
    ) -> Result<Vec<(&'m DbcSignal, String)>, MdfError> {
        let lengths = message.signals.iter().map(|signal| signal.name.len());
        if message.name.len() > MAX_NAME_BYTES
            || lengths.max().is_some_and(|length| length > MAX_NAME_BYTES)
        {
            let problem = format!("a name of this message has more than {MAX_NAME_BYTES} bytes");
            return Err(self.error(message, None, problem));
        }
        let signals = message.signals.iter().filter_map(|signal| {
            let qualified = format!("{}.{}", message.name, signal.name);
            let name = [qualified, signal.name.clone()]
                .into_iter()
                .find(|name| wanted(name).is_some())?;
            Some((signal, name))
        });
        Ok(signals.collect())
    }

    fn check_signal(&self, message: &Message, signal: &DbcSignal) -> Result<(), MdfError> {
        let start = match signal.byte_order {
            // Bits count from the least significant one of each byte.
            ByteOrder::BigEndian => signal.start_bit ^ 7,
            ByteOrder::LittleEndian => signal.start_bit,
        };
        let name = excerpt(&signal.name);
        let size = signal.size;
        let float_bits = match self.bits(message, signal).kind {
            SignalExtendedValueType::IEEEfloat32Bit => Some(32),
            SignalExtendedValueType::IEEEdouble64bit => Some(64),
            SignalExtendedValueType::SignedOrUnsignedInteger => None,
        };
        let problem = if !(1..=MAX_SIGNAL_BITS).contains(&size) {
            format!("signal {name} has {size} bits, and crumple reads 1 to {MAX_SIGNAL_BITS}")
        } else if let Some(bits) = float_bits.filter(|bits| *bits != size) {
            format!("signal {name} has {size} bits, but its floating-point numbers have {bits}")
        } else if start.saturating_add(size) > message.size.saturating_mul(8) {
            format!(
                "signal {name} goes beyond the {} bytes of its message",
                message.size
            )
        } else if signal.factor == 0.0 {
            format!("signal {name} has the factor 0")
        } else {
            return Ok(());
        };
        Err(self.error(message, Some(&signal.name), problem))
    }

    /// Returns whether a message is one of J1939: by the attribute of the message or of the file, or because any sender
    /// may send it.
    fn is_j1939(&self, message: &Message) -> bool {
        const FORMAT: &str = "VFrameFormat";
        let MessageId::Extended(id) = message.id else {
            return false;
        };
        if let Some(format) = self.dbc.message_attribute(message.id, FORMAT) {
            return self
                .attribute_text(FORMAT, format)
                .is_some_and(|format| format.contains("J1939"));
        }
        let is_j1939_file = self.dbc.attribute_values_database.iter().any(|attribute| {
            attribute.name == "ProtocolType"
                && matches!(&attribute.value, AttributeValue::String(text) if text.contains("J1939"))
        });
        is_j1939_file || id & 0xff == ANY_SOURCE
    }

    /// Returns the text of an attribute of messages, which may be an index of its texts.
    fn attribute_text<'d>(&'d self, name: &str, value: &'d AttributeValue) -> Option<&'d str> {
        let index = match value {
            AttributeValue::String(text) => return Some(text),
            AttributeValue::Uint(index) => usize::try_from(*index).ok()?,
            AttributeValue::Int(index) => usize::try_from(*index).ok()?,
            AttributeValue::Double(_) => return None,
        };
        let mut definitions = self.dbc.attribute_definitions.iter();
        let texts = definitions.find_map(|definition| match definition {
            AttributeDefinition::Message(attribute, AttributeValueType::Enum(texts))
                if attribute == name =>
            {
                Some(texts)
            }
            _ => None,
        })?;
        texts.get(index).map(String::as_str)
    }

    fn frame_signal(
        &self,
        message: &Message,
        signal: &DbcSignal,
        multiplexers: &Multiplexers<'_>,
        (index, is_j1939): (usize, bool),
    ) -> Result<FrameSignal, MdfError> {
        let mut selectors = Vec::new();
        let mut current = signal;
        // Multiplexers may be multiplexed themselves.
        while let Some((by, values)) = multiplexer(message, current, multiplexers) {
            if selectors.len() >= MAX_SELECTORS {
                let problem = format!(
                    "more than {MAX_SELECTORS} multiplexers select signal {}, or each other",
                    signal.name
                );
                return Err(self.error(message, Some(&signal.name), problem));
            }
            self.check_signal(message, by)?;
            selectors.push(Selector::new(self.bits(message, by), values));
            current = by;
        }
        let bits = self.bits(message, signal);
        Ok(FrameSignal {
            index,
            name: signal.name.clone(),
            bits,
            selectors,
            factor: signal.factor,
            offset: signal.offset,
            reserved_from: bits.reserved_from().filter(|_| is_j1939),
            origin: None,
        })
    }

    /// Returns the bits of a signal in its frames.
    fn bits(&self, message: &Message, signal: &DbcSignal) -> FrameBits {
        let kind = self
            .dbc
            .extended_value_type_for_signal(message.id, &signal.name)
            .copied();
        FrameBits {
            start: signal.start_bit,
            size: u32::try_from(signal.size).unwrap_or(0),
            is_big_endian: signal.byte_order == ByteOrder::BigEndian,
            kind: kind.unwrap_or(SignalExtendedValueType::SignedOrUnsignedInteger),
            is_signed: signal.value_type == ValueType::Signed,
        }
    }
}

/// Returns the bytes of a file, at most one more than the limit.
fn read_start(path: &Path) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    crumple_core::regular_file::open(path)?
        .take(MAX_DBC_BYTES + 1)
        .read_to_end(&mut bytes)?;
    Ok(bytes)
}

fn dbc_error(path: PathBuf, line: Option<usize>, problem: String) -> MdfError {
    MdfError::Dbc {
        path,
        line,
        problem,
    }
}

/// Returns the error for a message of the parser, which contains ` --> line:column` and the names of grammar rules.
fn syntax_error(path: PathBuf, message: &str) -> MdfError {
    let line = message
        .split_once("--> ")
        .and_then(|(_, rest)| rest.split(':').next()?.trim().parse().ok());
    let problem = match line {
        Some(_) => "this is no valid line of a DBC file".to_owned(),
        None => message.split_whitespace().collect::<Vec<_>>().join(" "),
    };
    dbc_error(path, line, problem)
}

/// Returns whether a line starts with two words, separated by blanks or a colon.
fn starts_with_words(line: &str, words: [&str; 2]) -> bool {
    let mut line_words = line
        .split(|letter: char| letter.is_whitespace() || letter == ':')
        .filter(|word| !word.is_empty());
    words
        .into_iter()
        .all(|word| line_words.next() == Some(word))
}

/// Returns the number that a map chooses for the frames of a message.
fn chosen_number(choice: Option<&FrameChoice>, message: &Message) -> Option<u64> {
    choice?.for_message(&message.name)
}

/// Returns whether the source address in the id of a message stands for any sender.
fn has_any_sender(message: &Message) -> bool {
    matches!(message.id, MessageId::Extended(id) if id & 0xff == ANY_SOURCE)
}

/// Returns the name of a message with its id, and with the number of its parameter group if any sender may send it.
fn label(message: &Message, is_j1939: bool) -> String {
    let name = excerpt(&message.name);
    match message.id {
        MessageId::Extended(id) if is_j1939 && has_any_sender(message) => {
            format!(
                "{name} (id {id:#x}, parameter group {})",
                parameter_group(id)
            )
        }
        MessageId::Extended(id) => format!("{name} (id {id:#x}, extended)"),
        MessageId::Standard(id) => format!("{name} (id {id:#x})"),
    }
}

/// Returns the number of words and numbers, and of the separators that the parser keeps.
fn count_words(text: &str) -> usize {
    let bytes = text.as_bytes();
    let marks = bytes
        .iter()
        .filter(|byte| DbcByte::new(**byte) == DbcByte::Mark)
        .count();
    let runs = bytes.chunk_by(|a, b| DbcByte::new(*a) == DbcByte::new(*b));
    let words = runs
        .filter(|run| {
            run.first()
                .is_some_and(|first| DbcByte::new(*first) == DbcByte::Word)
        })
        .count();
    marks + words
}

/// Kind of a byte of a DBC file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum DbcByte {
    /// Part of a word or of a number.
    Word,
    /// A separator that the parser keeps.
    Mark,
    Blank,
}

impl DbcByte {
    fn new(byte: u8) -> Self {
        match byte {
            b' ' | b'\t' | b'\r' | b':' | b'@' | b'(' | b')' | b'[' | b']' => Self::Blank,
            b'"' | b';' | b'|' | b',' | b'\n' => Self::Mark,
            _ => Self::Word,
        }
    }
}

/// Returns the multiplexer of a signal, and the ranges of its values that select the signal.
fn multiplexer<'m>(
    message: &'m Message,
    signal: &DbcSignal,
    multiplexers: &Multiplexers<'_>,
) -> Option<(&'m DbcSignal, Vec<[u64; 2]>)> {
    let mut signals = message.signals.iter();
    if let Some(multiplex) = multiplexers.get(&(message.id, signal.name.as_str())) {
        let selector =
            signals.find(|selector| selector.name == multiplex.multiplexor_signal_name)?;
        let ranges = multiplex.mappings.iter();
        let ranges = ranges.map(|range| [range.min_value, range.max_value]);
        return Some((selector, ranges.collect()));
    }
    let value = match signal.multiplexer_indicator {
        MultiplexIndicator::MultiplexedSignal(value)
        | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value) => value,
        _ => return None,
    };
    let selector = signals
        .find(|selector| selector.multiplexer_indicator == MultiplexIndicator::Multiplexor)?;
    Some((selector, vec![[value, value]]))
}
