//! Raw CAN frames, and the values of signals in them.

use std::collections::HashMap;

use can_dbc::{MessageId, SignalExtendedValueType};

use super::MdfError;
use super::channel::sign_extend;

/// A frame of a bus.
pub(super) struct Frame<'b> {
    pub(super) id: MessageId,
    /// Number of its bus, if known.
    pub(super) bus_channel: Option<u64>,
    pub(super) bytes: &'b [u8],
}

/// Wanted signals by their messages.
#[derive(Default)]
pub(super) struct FrameDecoder {
    /// Messages with one id. Those without wanted signals are listed, too, where another message has any sender.
    by_id: HashMap<MessageId, FrameMessage>,
    /// Messages of J1939 from any sender, by the number of their group of parameters.
    by_parameter_group: HashMap<u32, FrameMessage>,
}

/// A message with wanted signals.
#[derive(Default)]
pub(super) struct FrameMessage {
    /// Name and id, for errors.
    pub(super) label: String,
    pub(super) signals: Vec<FrameSignal>,
    /// Bus channel and source address that the map chooses.
    pub(super) bus_channel: Option<u64>,
    pub(super) source_address: Option<u64>,
}

/// A signal of a message that is decoded.
pub(super) struct FrameSignal {
    /// Index in the set of signals.
    pub(super) index: usize,
    pub(super) name: String,
    pub(super) bits: FrameBits,
    /// Multiplexers with the values that select the signal.
    pub(super) selectors: Vec<Selector>,
    pub(super) factor: f64,
    pub(super) offset: f64,
    /// First raw value that J1939 reserves for errors and missing values.
    pub(super) reserved_from: Option<u64>,
    /// Bus channel and sender of the first value.
    pub(super) origin: Option<[Option<u64>; 2]>,
}

/// A multiplexer of a signal.
pub(super) struct Selector {
    bits: FrameBits,
    /// Ranges of its values, in order and apart.
    ranges: Vec<[u64; 2]>,
}

/// Bits of a frame, from the most significant one.
#[derive(Debug, Clone, Copy)]
pub(super) struct FrameBits {
    pub(super) start: u64,
    pub(super) size: u32,
    pub(super) is_big_endian: bool,
    pub(super) kind: SignalExtendedValueType,
    pub(super) is_signed: bool,
}

/// Returns the number of the group of parameters of an extended id of J1939. The priority and the source address, and
/// the destination of messages that have one, are no part of it.
pub(super) fn parameter_group(id: u32) -> u32 {
    const BROADCAST_FORMAT: u32 = 240;
    let group = id >> 8 & 0x3_ffff;
    if group >> 8 & 0xff < BROADCAST_FORMAT {
        group & 0x3_ff00
    } else {
        group
    }
}

impl FrameDecoder {
    pub(super) fn is_empty(&self) -> bool {
        self.by_id.is_empty() && self.by_parameter_group.is_empty()
    }

    pub(super) fn insert(&mut self, id: MessageId, message: FrameMessage) {
        self.by_id.insert(id, message);
    }

    /// Adds a message of J1939 from any sender. Returns false if there is one of its group.
    pub(super) fn insert_group(&mut self, id: u32, message: FrameMessage) -> bool {
        self.by_parameter_group
            .insert(parameter_group(id), message)
            .is_none()
    }

    /// Reserves an id for a message without wanted signals, if another message would otherwise decode its frames.
    pub(super) fn reserve(&mut self, id: MessageId) {
        if let MessageId::Extended(number) = id
            && self
                .by_parameter_group
                .contains_key(&parameter_group(number))
        {
            self.by_id.entry(id).or_default();
        }
    }

    /// Rejects a signal that no frame contained.
    pub(super) fn check_frames(&self) -> Result<(), MdfError> {
        let messages = self.by_id.values().chain(self.by_parameter_group.values());
        let absent = messages
            .flat_map(|message| message.signals.iter().map(move |signal| (message, signal)));
        let absent = absent.filter(|(_, signal)| signal.origin.is_none());
        let Some((message, signal)) = absent.min_by_key(|(_, signal)| signal.index) else {
            return Ok(());
        };
        let chosen = [
            ("on the bus channel", message.bus_channel),
            ("from the source address", message.source_address),
        ];
        let chosen = chosen
            .into_iter()
            .filter_map(|(what, number)| Some(format!(" {what} {}", number?)));
        let message = format!("{}{}", message.label, chosen.collect::<String>());
        Err(MdfError::NoFrame {
            signal: signal.name.clone(),
            message,
        })
    }

    /// Passes on the index and the value of each signal of a frame.
    ///
    /// # Errors
    /// [`MdfError::Ambiguous`] if earlier values came from another bus channel or sender; errors of `add`.
    pub(super) fn decode(
        &mut self,
        frame: &Frame<'_>,
        add: &mut dyn FnMut(usize, f64) -> Result<(), MdfError>,
    ) -> Result<(), MdfError> {
        if let Some(message) = self.by_id.get_mut(&frame.id) {
            return message.decode(frame, None, add);
        }
        let MessageId::Extended(id) = frame.id else {
            return Ok(());
        };
        match self.by_parameter_group.get_mut(&parameter_group(id)) {
            Some(message) => message.decode(frame, Some(u64::from(id & 0xff)), add),
            None => Ok(()),
        }
    }
}

impl FrameMessage {
    fn decode(
        &mut self,
        frame: &Frame<'_>,
        source_address: Option<u64>,
        add: &mut dyn FnMut(usize, f64) -> Result<(), MdfError>,
    ) -> Result<(), MdfError> {
        if differ(frame.bus_channel, self.bus_channel)
            || differ(source_address, self.source_address)
        {
            return Ok(());
        }
        for signal in &mut self.signals {
            if let Some(value) = signal.decode(frame.bytes) {
                signal.check_origin([frame.bus_channel, source_address])?;
                add(signal.index, value)?;
            }
        }
        Ok(())
    }
}

/// Returns whether two numbers are known and different.
fn differ(a: Option<u64>, b: Option<u64>) -> bool {
    a.zip(b).is_some_and(|(a, b)| a != b)
}

impl FrameSignal {
    /// Returns the value of the signal, NaN if missing; `None` if the frame does not contain it.
    fn decode(&self, frame: &[u8]) -> Option<f64> {
        if !self
            .selectors
            .iter()
            .all(|selector| selector.selects(frame))
        {
            return None;
        }
        let raw = self.bits.raw(frame)?;
        if self.reserved_from.is_some_and(|reserved| raw >= reserved) {
            return Some(f64::NAN);
        }
        Some(self.bits.number(raw) * self.factor + self.offset)
    }

    /// Rejects values from a second bus channel or sender, which are of another sensor.
    fn check_origin(&mut self, origin: [Option<u64>; 2]) -> Result<(), MdfError> {
        let first_origin = *self.origin.get_or_insert(origin);
        if first_origin == origin {
            return Ok(());
        }
        let kinds = [
            ("bus channels", "bus_channel"),
            ("source addresses", "source_address"),
        ];
        for ((first, second), (kind, key)) in first_origin.into_iter().zip(origin).zip(kinds) {
            if let Some((first, second)) = first.zip(second).filter(|(a, b)| a != b) {
                return Err(MdfError::Ambiguous {
                    signal: self.name.clone(),
                    origin: kind,
                    first,
                    second,
                    key,
                });
            }
        }
        Ok(())
    }
}

impl Selector {
    pub(super) fn new(bits: FrameBits, mut ranges: Vec<[u64; 2]>) -> Self {
        ranges.retain(|[low, high]| low <= high);
        ranges.sort_unstable();
        ranges.dedup_by(|next, before| {
            let touches = next[0] <= before[1];
            if touches {
                before[1] = before[1].max(next[1]);
            }
            touches
        });
        Self { bits, ranges }
    }

    fn selects(&self, frame: &[u8]) -> bool {
        let Some(raw) = self.bits.raw(frame) else {
            return false;
        };
        let index = self.ranges.partition_point(|[_, high]| *high < raw);
        self.ranges.get(index).is_some_and(|[low, _]| *low <= raw)
    }
}

fn bit(frame: &[u8], at: u64) -> Option<u64> {
    let byte = frame.get(usize::try_from(at / 8).ok()?)?;
    Some(u64::from(byte >> (at % 8) & 1))
}

impl FrameBits {
    /// Returns the bits; `None` if the frame is too short.
    fn raw(&self, frame: &[u8]) -> Option<u64> {
        if !(1..=64).contains(&self.size) {
            return None;
        }
        let mut at = self.start;
        let mut raw = 0;
        for index in 0..u64::from(self.size) {
            if self.is_big_endian {
                raw = raw << 1 | bit(frame, at)?;
                // Bits count from the least significant one of each byte.
                at = if at.is_multiple_of(8) {
                    at.checked_add(15)?
                } else {
                    at - 1
                };
            } else {
                raw |= bit(frame, self.start.checked_add(index)?)? << index;
            }
        }
        Some(raw)
    }

    fn number(&self, raw: u64) -> f64 {
        match self.kind {
            SignalExtendedValueType::IEEEfloat32Bit => f64::from(f32::from_bits(raw as u32)),
            SignalExtendedValueType::IEEEdouble64bit => f64::from_bits(raw),
            _ if self.is_signed => sign_extend(raw, self.size) as f64,
            _ => raw as f64,
        }
    }

    /// Returns the first raw value that J1939 reserves, for whole numbers without sign (SAE J1939-71: from 0xFB in the
    /// first byte on; the last two values of fewer bits).
    pub(super) fn reserved_from(&self) -> Option<u64> {
        let is_integer = matches!(self.kind, SignalExtendedValueType::SignedOrUnsignedInteger)
            && !self.is_signed;
        match self.size {
            2..=64 if !is_integer => None,
            size @ (8 | 16 | 24 | 32 | 40 | 48 | 56 | 64) => Some(0xfb << (size - 8)),
            size @ 2..=63 => Some((1 << size) - 2),
            _ => None,
        }
    }
}
