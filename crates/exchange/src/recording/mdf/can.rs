//! Raw CAN frames, and the signals that a DBC file describes in them.

use std::collections::HashMap;
use std::io::Read;
use std::path::{Path, PathBuf};

use can_dbc::{ByteOrder, Dbc, ExtendedMultiplex, Message, MessageId, MultiplexIndicator, ValueType};
use can_dbc::{Signal as DbcSignal, SignalExtendedValueType};

use super::channel::sign_extend;
use super::{MdfError, SignalSet};

const MAX_DBC_BYTES: u64 = 16 << 20;

/// A DBC file: the messages of a CAN bus.
#[derive(Debug, Clone)]
pub struct DbcFile {
    dbc: Dbc,
    path: PathBuf,
    text: String,
}

/// A signal of a message that is decoded.
pub(super) struct FrameSignal {
    /// Index in the set of signals.
    index: usize,
    place: Place,
    /// Multiplexers with the values that select the signal.
    selectors: Vec<(Place, Vec<[u64; 2]>)>,
    factor: f64,
    offset: f64,
}

/// Bits of a frame, from the most significant one.
#[derive(Debug, Clone, Copy)]
struct Place {
    start: u64,
    size: u32,
    is_big_endian: bool,
    kind: SignalExtendedValueType,
    is_signed: bool,
}

/// Wanted signals by the id of their message.
pub(super) type FrameDecoder = HashMap<MessageId, Vec<FrameSignal>>;

impl DbcFile {
    /// Reads a DBC file.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] for a file that cannot be read, is too long, or is no DBC file.
    pub fn load(path: &Path) -> Result<Self, MdfError> {
        let error = |problem: String| MdfError::Dbc { path: path.to_owned(), line: None, problem };
        let mut bytes = Vec::new();
        let file = crumple_core::regular_file::open(path).map_err(|source| error(source.to_string()))?;
        file.take(MAX_DBC_BYTES + 1).read_to_end(&mut bytes).map_err(|source| error(source.to_string()))?;
        Self::parse(&bytes, path)
    }

    /// Parses the bytes of a DBC file in UTF-8 or Windows-1252; `path` only names it.
    ///
    /// # Errors
    /// [`MdfError::Dbc`] if the text is no DBC file, or exceeds a limit.
    pub fn parse(bytes: &[u8], path: &Path) -> Result<Self, MdfError> {
        let error = |line, problem| MdfError::Dbc { path: path.to_owned(), line, problem };
        if bytes.len() as u64 > MAX_DBC_BYTES {
            return Err(error(None, format!("has more than {MAX_DBC_BYTES} bytes")));
        }
        let (text, _, _) = encoding_rs::WINDOWS_1252.decode(bytes);
        let text = std::str::from_utf8(bytes).unwrap_or(&text);
        let dbc = Dbc::try_from(text).map_err(|problem| {
            // A syntax error contains ` --> line:column` and the names of grammar rules.
            let problem = problem.to_string();
            let line = problem.split_once("--> ").and_then(|(_, rest)| rest.split(':').next()?.trim().parse().ok());
            match line {
                Some(line) => error(Some(line), "this is no valid line of a DBC file".to_owned()),
                None => error(None, problem.split_whitespace().collect::<Vec<_>>().join(" ")),
            }
        })?;
        Ok(Self { dbc, path: path.to_owned(), text: text.to_owned() })
    }

    /// Returns an error at the last definition of a message, or at a signal of it.
    fn error(&self, message: &Message, signal: Option<&str>, problem: String) -> MdfError {
        let starts = |line: &str, words: [&str; 2]| {
            let mut found = line.split(|letter: char| letter.is_whitespace() || letter == ':');
            let mut found = found.by_ref().filter(|word| !word.is_empty());
            words.into_iter().all(|word| found.next() == Some(word))
        };
        let id = message.id.raw().to_string();
        let begin = self.text.lines().enumerate().filter(|(_, line)| starts(line, ["BO_", &id])).last();
        let line = begin.and_then(|(from, _)| match signal {
            None => Some(from),
            Some(signal) => (from..)
                .zip(self.text.lines().skip(from))
                .find(|(_, line)| starts(line, ["SG_", signal]))
                .map(|(at, _)| at),
        });
        MdfError::Dbc { path: self.path.clone(), line: line.map(|line| line + 1), problem }
    }

    /// Adds the wanted signals and returns their decoder. The error is a message that is defined twice, or a signal
    /// beyond the end of its message. A name may begin with that of the message and a point.
    pub(super) fn decoder(
        &self,
        wanted: &dyn Fn(&str) -> bool,
        signals: &mut SignalSet,
    ) -> Result<FrameDecoder, MdfError> {
        let mut decoder = FrameDecoder::new();
        for message in &self.dbc.messages {
            let name = |signal: &DbcSignal| {
                let qualified = format!("{}.{}", message.name, signal.name);
                [qualified, signal.name.clone()].into_iter().find(|name| wanted(name))
            };
            let wanted: Vec<_> = message.signals.iter().filter_map(|signal| Some((signal, name(signal)?))).collect();
            if !wanted.is_empty() && decoder.contains_key(&message.id) {
                return Err(self.error(message, None, format!("message {} is defined twice", message.id.raw())));
            }
            for (signal, name) in wanted {
                let start = match signal.byte_order {
                    // Bits count from the least significant one of each byte.
                    ByteOrder::BigEndian => signal.start_bit ^ 7,
                    ByteOrder::LittleEndian => signal.start_bit,
                };
                if start.saturating_add(signal.size) > message.size.saturating_mul(8) {
                    let problem =
                        format!("signal {} goes beyond the {} bytes of its message", signal.name, message.size);
                    return Err(self.error(message, Some(&signal.name), problem));
                }
                if signal.factor == 0.0 {
                    let problem = format!("signal {} has the factor 0", signal.name);
                    return Err(self.error(message, Some(&signal.name), problem));
                }
                // Frames without the signal, by a multiplexer, have no place in its clock.
                let clock = signals.add_clock();
                let index = signals.add(name, signal.unit.clone(), clock);
                let found = self.frame_signal(message, signal, index);
                decoder.entry(message.id).or_default().push(found);
            }
        }
        Ok(decoder)
    }

    fn frame_signal(&self, message: &Message, signal: &DbcSignal, index: usize) -> FrameSignal {
        let place = |signal: &DbcSignal| Place {
            start: signal.start_bit,
            size: u32::try_from(signal.size).unwrap_or(0),
            is_big_endian: signal.byte_order == ByteOrder::BigEndian,
            kind: self
                .dbc
                .extended_value_type_for_signal(message.id, &signal.name)
                .copied()
                .unwrap_or(SignalExtendedValueType::SignedOrUnsignedInteger),
            is_signed: signal.value_type == ValueType::Signed,
        };
        let mut selectors = Vec::new();
        let mut current = signal;
        // Multiplexers may be multiplexed themselves; a DBC file in which they form a circle selects nothing.
        while selectors.len() < message.signals.len()
            && let Some((by, values)) = self.multiplexer(message, current)
        {
            selectors.push((place(by), values));
            current = by;
        }
        FrameSignal { index, place: place(signal), selectors, factor: signal.factor, offset: signal.offset }
    }

    /// Returns the multiplexer of a signal, and the ranges of its values that select the signal.
    fn multiplexer<'m>(&self, message: &'m Message, signal: &DbcSignal) -> Option<(&'m DbcSignal, Vec<[u64; 2]>)> {
        let extended = |one: &&ExtendedMultiplex| one.message_id == message.id && one.signal_name == signal.name;
        if let Some(found) = self.dbc.extended_multiplex.iter().find(extended) {
            let by = message.signals.iter().find(|one| one.name == found.multiplexor_signal_name)?;
            return Some((by, found.mappings.iter().map(|range| [range.min_value, range.max_value]).collect()));
        }
        let value = match signal.multiplexer_indicator {
            MultiplexIndicator::MultiplexedSignal(value)
            | MultiplexIndicator::MultiplexorAndMultiplexedSignal(value) => value,
            _ => return None,
        };
        let by = message.signals.iter().find(|one| one.multiplexer_indicator == MultiplexIndicator::Multiplexor)?;
        Some((by, vec![[value, value]]))
    }
}

impl FrameSignal {
    /// Returns index and value of the signal; `None` if the frame does not contain it.
    pub(super) fn decode(&self, frame: &[u8]) -> Option<(usize, f64)> {
        let is_selected = |(by, ranges): &(Place, Vec<[u64; 2]>)| {
            by.raw(frame).is_some_and(|raw| ranges.iter().any(|[low, high]| (*low..=*high).contains(&raw)))
        };
        let value = self.selectors.iter().all(is_selected).then(|| self.place.value(frame)).flatten()?;
        Some((self.index, value * self.factor + self.offset))
    }
}

impl Place {
    /// Returns the bits; `None` if the frame is too short.
    fn raw(&self, frame: &[u8]) -> Option<u64> {
        if !(1..=64).contains(&self.size) {
            return None;
        }
        let bit = |at: u64| Some(u64::from(frame.get(usize::try_from(at / 8).ok()?)? >> (at % 8) & 1));
        let (mut at, mut raw) = (self.start, 0);
        for index in 0..u64::from(self.size) {
            if self.is_big_endian {
                raw = raw << 1 | bit(at)?;
                // Bits count from the least significant one of each byte.
                at = if at % 8 == 0 { at.checked_add(15)? } else { at - 1 };
            } else {
                raw |= bit(self.start.checked_add(index)?)? << index;
            }
        }
        Some(raw)
    }

    fn value(&self, frame: &[u8]) -> Option<f64> {
        let raw = self.raw(frame)?;
        match self.kind {
            SignalExtendedValueType::IEEEfloat32Bit => Some(f64::from(f32::from_bits(raw as u32))),
            SignalExtendedValueType::IEEEdouble64bit => Some(f64::from_bits(raw)),
            _ if self.is_signed => Some(sign_extend(raw, self.size) as f64),
            _ => Some(raw as f64),
        }
    }
}
