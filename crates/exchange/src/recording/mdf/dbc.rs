//! DBC files: the messages of a CAN bus and their signals.

use std::collections::{HashMap, HashSet};
use std::io::Read;
use std::path::{Path, PathBuf};

use can_dbc::{
    AttributeDefinition, AttributeValue, AttributeValueType, ByteOrder, Dbc, ExtendedMultiplex,
};
use can_dbc::{
    Message, MessageId, MultiplexIndicator, Signal as DbcSignal, SignalExtendedValueType, ValueType,
};

use super::can::{BitPlace, FrameDecoder, FrameMessage, FrameSignal, Selector, parameter_group};
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
        let error = |problem: String| MdfError::Dbc {
            path: path.to_owned(),
            line: None,
            problem,
        };
        let mut bytes = Vec::new();
        let file =
            crumple_core::regular_file::open(path).map_err(|source| error(source.to_string()))?;
        file.take(MAX_DBC_BYTES + 1)
            .read_to_end(&mut bytes)
            .map_err(|source| error(source.to_string()))?;
        Self::parse(&bytes, path)
    }

    /// Parses the bytes of a DBC file in UTF-8 or Windows-1252; `path` only names it.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] if the text is no DBC file, or exceeds a limit.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, MdfError> {
        let error = |line, problem| MdfError::Dbc {
            path: path.to_owned(),
            line,
            problem,
        };
        if bytes.len() as u64 > MAX_DBC_BYTES {
            return Err(error(None, format!("has more than {MAX_DBC_BYTES} bytes")));
        }
        let (text, _, _) = encoding_rs::WINDOWS_1252.decode(bytes);
        let text = std::str::from_utf8(bytes).unwrap_or(&text);
        let words = count_words(text);
        if words > MAX_DBC_WORDS {
            return Err(error(
                None,
                format!("has {words} words, numbers and separators, more than {MAX_DBC_WORDS}"),
            ));
        }
        let dbc = Dbc::try_from(text).map_err(|problem| {
            // A syntax error contains ` --> line:column` and the names of grammar rules.
            let problem = problem.to_string();
            let line = problem
                .split_once("--> ")
                .and_then(|(_, rest)| rest.split(':').next()?.trim().parse().ok());
            match line {
                Some(line) => error(Some(line), "this is no valid line of a DBC file".to_owned()),
                None => error(
                    None,
                    problem.split_whitespace().collect::<Vec<_>>().join(" "),
                ),
            }
        })?;
        Ok(Self {
            dbc,
            path: path.to_owned(),
            text: text.to_owned(),
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
            let is_known =
                |name: &str| self.dbc.messages.iter().any(|message| message.name == name);
            if let Some(name) = numbers.keys().find(|name| !is_known(name)) {
                let problem = format!(
                    "has no message {}, which `{key}` of the map names",
                    excerpt(name)
                );
                return Err(MdfError::Dbc {
                    path: self.path,
                    line: None,
                    problem,
                });
            }
        }
        (self.bus_channel, self.source_address) =
            (map.bus_channel.clone(), map.source_address.clone());
        Ok(self)
    }

    /// Returns an error at the last definition of a message, or at a signal of it.
    fn error(&self, message: &Message, signal: Option<&str>, problem: String) -> MdfError {
        let starts = |line: &str, words: [&str; 2]| {
            let mut found = line.split(|letter: char| letter.is_whitespace() || letter == ':');
            let mut found = found.by_ref().filter(|word| !word.is_empty());
            words.into_iter().all(|word| found.next() == Some(word))
        };
        let id = message.id.raw().to_string();
        let begin = self
            .text
            .lines()
            .enumerate()
            .filter(|(_, line)| starts(line, ["BO_", &id]))
            .last();
        let line = begin.and_then(|(from, _)| match signal {
            None => Some(from),
            Some(signal) => (from..)
                .zip(self.text.lines().skip(from))
                .find(|(_, line)| starts(line, ["SG_", signal]))
                .map(|(at, _)| at),
        });
        MdfError::Dbc {
            path: self.path.clone(),
            line: line.map(|line| line + 1),
            problem,
        }
    }

    /// Adds the wanted signals and returns their decoder. The error is a message that is defined twice, or a signal
    /// beyond the end of its message. A name may begin with that of the message and a point.
    pub(super) fn decoder(
        &self,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
        signals: &mut SignalSet,
    ) -> Result<FrameDecoder, MdfError> {
        let mut decoder = FrameDecoder::default();
        let mut multiplexers = Multiplexers::new();
        for one in &self.dbc.extended_multiplex {
            multiplexers
                .entry((one.message_id, one.signal_name.as_str()))
                .or_insert(one);
        }
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
            let choice = |choice: &Option<FrameChoice>| {
                choice
                    .as_ref()
                    .and_then(|one| one.of_message(&message.name))
            };
            let (bus_channel, source_address) =
                (choice(&self.bus_channel), choice(&self.source_address));
            let is_j1939 = self.is_j1939(message);
            let label = label(message, is_j1939);
            let mut found = FrameMessage {
                label,
                signals: Vec::new(),
                bus_channel,
                source_address,
            };
            for (signal, name) in wanted {
                self.check_signal(message, signal)?;
                // Frames without the signal, by a multiplexer, have no place in its clock.
                let clock = signals.add_clock();
                let index = signals.add(name, signal.unit.clone(), clock);
                found.signals.push(self.frame_signal(
                    message,
                    signal,
                    &multiplexers,
                    (index, is_j1939),
                )?);
            }
            match message.id {
                MessageId::Extended(id) if is_j1939 && id & 0xff == ANY_SOURCE => {
                    if !decoder.insert_group(id, found) {
                        let problem =
                            "two messages from any sender have this parameter group number"
                                .to_owned();
                        return Err(self.error(message, None, problem));
                    }
                }
                id => decoder.insert(id, found),
            }
        }
        let is_any = |message: &Message| matches!(message.id, MessageId::Extended(id) if id & 0xff == ANY_SOURCE);
        let of_one_sender = self.dbc.messages.iter().filter(|message| !is_any(message));
        of_one_sender.for_each(|message| decoder.reserve(message.id));
        Ok(decoder)
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
        let name = |signal: &DbcSignal| {
            let qualified = format!("{}.{}", message.name, signal.name);
            [qualified, signal.name.clone()]
                .into_iter()
                .find(|name| wanted(name).is_some())
        };
        Ok(message
            .signals
            .iter()
            .filter_map(|signal| Some((signal, name(signal)?)))
            .collect())
    }

    fn check_signal(&self, message: &Message, signal: &DbcSignal) -> Result<(), MdfError> {
        let start = match signal.byte_order {
            // Bits count from the least significant one of each byte.
            ByteOrder::BigEndian => signal.start_bit ^ 7,
            ByteOrder::LittleEndian => signal.start_bit,
        };
        let (name, size) = (excerpt(&signal.name), signal.size);
        let kind = self.place(message, signal).kind;
        let float_bits = match kind {
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
        let is_protocol = |name: &str, value: &AttributeValue| {
            name == "ProtocolType"
                && matches!(value, AttributeValue::String(text) if text.contains("J1939"))
        };
        self.dbc
            .attribute_values_database
            .iter()
            .any(|one| is_protocol(&one.name, &one.value))
            || id & 0xff == ANY_SOURCE
    }

    /// Returns the text of an attribute of messages, which may be an index of its texts.
    fn attribute_text<'d>(&'d self, name: &str, value: &'d AttributeValue) -> Option<&'d str> {
        let index = match value {
            AttributeValue::String(text) => return Some(text),
            AttributeValue::Uint(index) => usize::try_from(*index).ok()?,
            AttributeValue::Int(index) => usize::try_from(*index).ok()?,
            AttributeValue::Double(_) => return None,
        };
        let texts = |definition: &'d AttributeDefinition| match definition {
            AttributeDefinition::Message(known, AttributeValueType::Enum(texts))
                if known == name =>
            {
                Some(texts)
            }
            _ => None,
        };
        let texts = self.dbc.attribute_definitions.iter().find_map(texts)?;
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
            selectors.push(Selector::new(self.place(message, by), values));
            current = by;
        }
        let place = self.place(message, signal);
        Ok(FrameSignal {
            index,
            name: signal.name.clone(),
            place,
            selectors,
            factor: signal.factor,
            offset: signal.offset,
            reserved_from: place.reserved_from().filter(|_| is_j1939),
            origin: None,
        })
    }

    fn place(&self, message: &Message, signal: &DbcSignal) -> BitPlace {
        let kind = self
            .dbc
            .extended_value_type_for_signal(message.id, &signal.name)
            .copied();
        BitPlace {
            start: signal.start_bit,
            size: u32::try_from(signal.size).unwrap_or(0),
            is_big_endian: signal.byte_order == ByteOrder::BigEndian,
            kind: kind.unwrap_or(SignalExtendedValueType::SignedOrUnsignedInteger),
            is_signed: signal.value_type == ValueType::Signed,
        }
    }
}

/// Returns the name of a message with its id, and with the number of its parameter group if any sender may send it.
fn label(message: &Message, is_j1939: bool) -> String {
    let name = excerpt(&message.name);
    match message.id {
        MessageId::Extended(id) if is_j1939 && id & 0xff == ANY_SOURCE => {
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
    let is_blank = |byte: &u8| b" \t\r:@()[]".contains(byte);
    let is_mark = |byte: &u8| b"\";|,\n".contains(byte);
    let kind = |byte: &u8| (is_blank(byte), is_mark(byte));
    let marks = text.as_bytes().iter().filter(|byte| is_mark(byte)).count();
    let runs = text.as_bytes().chunk_by(|a, b| kind(a) == kind(b));
    marks
        + runs
            .filter(|run| {
                run.first()
                    .is_some_and(|first| kind(first) == (false, false))
            })
            .count()
}

/// Returns the multiplexer of a signal, and the ranges of its values that select the signal.
fn multiplexer<'m>(
    message: &'m Message,
    signal: &DbcSignal,
    multiplexers: &Multiplexers<'_>,
) -> Option<(&'m DbcSignal, Vec<[u64; 2]>)> {
    if let Some(found) = multiplexers.get(&(message.id, signal.name.as_str())) {
        let by = message
            .signals
            .iter()
            .find(|one| one.name == found.multiplexor_signal_name)?;
        return Some((
            by,
            found
                .mappings
                .iter()
                .map(|range| [range.min_value, range.max_value])
                .collect(),
        ));
    }
    let value = match signal.multiplexer_indicator {
        MultiplexIndicator::MultiplexedSignal(value)
        | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value) => value,
        _ => return None,
    };
    let by = message
        .signals
        .iter()
        .find(|one| one.multiplexer_indicator == MultiplexIndicator::Multiplexor)?;
    Some((by, vec![[value, value]]))
}
