//! Groups of channels with a common clock, and the records of their data.

use std::ops::Range;

use super::blocks::{Block, Blocks, DataCursor, little_endian};
use super::can::{Frame, FrameDecoder};
use super::channel::Channel;
use super::{MAX_CHANNELS, MdfError, SignalSet, SignalUse};
use can_dbc::MessageId;

const MAX_RECORD_BYTES: usize = 1 << 20;
/// Bit of an identifier of 32 bits that marks an extended one.
const EXTENDED_ID: u64 = 1 << 31;
const FLAG_VARIABLE_LENGTH: u64 = 1;
const FLAG_REMOTE_MASTER: u64 = 1 << 3;
const MASTER: u64 = 2;
const VIRTUAL_MASTER: u64 = 3;
const BYTE_ARRAY: u64 = 10;

/// Groups whose records are in the same data blocks.
pub(super) struct DataGroup {
    id_bytes: usize,
    groups: Vec<Group>,
    /// Id and index of each group, by id.
    index_by_id: Vec<(u64, usize)>,
    /// Bytes of an incomplete record.
    rest: Vec<u8>,
    data: DataCursor,
    /// Offset of the block of the group.
    at: u64,
    /// Last time that was read, in seconds.
    pub(super) newest_s: f64,
}

struct Group {
    id: u64,
    /// Bytes of a record without its id.
    record_bytes: usize,
    /// True if records are single values of variable length, which crumple skips.
    has_variable_length: bool,
    /// Clock in the set of signals, and its channel.
    clock: Option<(usize, Channel)>,
    /// Wanted channels, with their signals.
    channels: Vec<(usize, Channel)>,
    frames: Option<FrameLayout>,
    rows: usize,
}

/// Channels of a group of CAN frames.
struct FrameLayout {
    id: Channel,
    is_extended: Option<Channel>,
    length: Option<Channel>,
    bus_channel: Option<Channel>,
    /// Number of the bus of all frames, if they do not state it.
    bus_of_group: Option<u64>,
    /// First byte and number of bytes of the data.
    data: [usize; 2],
}

impl DataGroup {
    pub(super) fn read(
        blocks: &mut Blocks,
        block: &Block,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
        (decoder, signals): (&FrameDecoder, &mut SignalSet),
    ) -> Result<Self, MdfError> {
        let id_bytes = block.number(0, 1)? as usize;
        if !matches!(id_bytes, 0 | 1 | 2 | 4 | 8) {
            return Err(block.damaged("the length of record ids is wrong"));
        }
        let (mut groups, mut at) = (Vec::new(), block.link(1));
        while let Some(group) = blocks.find_once(at, b"CG")? {
            groups.push(Group::read(blocks, &group, wanted, (decoder, signals))?);
            at = group.link(0);
        }
        if id_bytes == 0 && groups.len() > 1 {
            return Err(block.damaged("several groups have no record ids"));
        }
        let is_needed = groups.iter().any(Group::is_needed);
        let offsets = if is_needed {
            blocks.data_blocks(block.link(2))?
        } else {
            Vec::new()
        };
        let data = DataCursor::new(offsets);
        let mut index_by_id: Vec<(u64, usize)> =
            groups.iter().map(|group| group.id).zip(0..).collect();
        index_by_id.sort_unstable();
        let (rest, newest_s) = (Vec::new(), f64::NEG_INFINITY);
        Ok(Self {
            id_bytes,
            groups,
            index_by_id,
            rest,
            data,
            at: block.at,
            newest_s,
        })
    }

    pub(super) fn is_needed(&self) -> bool {
        self.groups.iter().any(Group::is_needed)
    }

    /// Adds the records of the next chunk of data. Returns false at the end.
    pub(super) fn advance(
        &mut self,
        blocks: &mut Blocks,
        decoder: &mut FrameDecoder,
        signals: &mut SignalSet,
    ) -> Result<bool, MdfError> {
        let Some(chunk) = self.data.next_chunk(blocks)? else {
            let damaged = MdfError::Damaged {
                offset: self.at,
                problem: "the samples end inside a record",
            };
            return if self.rest.is_empty() {
                Ok(false)
            } else {
                Err(damaged)
            };
        };
        // Records are contiguous, except for one at the border of two chunks.
        let is_continued = !self.rest.is_empty();
        let mut bytes = if is_continued {
            let mut joined = std::mem::take(&mut self.rest);
            joined.extend_from_slice(&chunk);
            joined
        } else {
            chunk
        };
        let mut from = 0;
        while let Some((index, content)) = self.next_record(&bytes[from..])? {
            let (start, end) = (from + content.start, from + content.end);
            if let Some(time_s) = self.groups[index].add(&bytes[start..end], decoder, signals)? {
                self.newest_s = time_s;
            }
            from = end;
        }
        bytes.drain(..from);
        self.rest = bytes;
        Ok(true)
    }

    /// Returns the index of the group of the first record, and the place of its content, which is empty for a value of
    /// variable length; `None` if the record is incomplete.
    fn next_record(&self, bytes: &[u8]) -> Result<Option<(usize, Range<usize>)>, MdfError> {
        let Some(id) = little_endian(bytes, 0, self.id_bytes).filter(|_| !bytes.is_empty()) else {
            return Ok(None);
        };
        let place = if self.id_bytes == 0 {
            0
        } else {
            self.index_by_id.partition_point(|(known, _)| *known < id)
        };
        let found = self
            .index_by_id
            .get(place)
            .filter(|(known, _)| self.id_bytes == 0 || *known == id);
        let unknown = MdfError::Damaged {
            offset: 0,
            problem: "a record has an unknown id",
        };
        let index = found.ok_or(unknown)?.1;
        let group = &self.groups[index];
        if group.has_variable_length {
            let length = little_endian(bytes, self.id_bytes, 4)
                .map(|length| self.id_bytes + 4 + length as usize);
            if length.is_some_and(|length| length > MAX_RECORD_BYTES) {
                return Err(MdfError::Damaged {
                    offset: 0,
                    problem: "the length of a record is wrong",
                });
            }
            return Ok(length
                .filter(|length| *length <= bytes.len())
                .map(|length| (index, length..length)));
        }
        let end = self.id_bytes + group.record_bytes;
        Ok((end <= bytes.len()).then_some((index, self.id_bytes..end)))
    }
}

impl Group {
    fn read(
        blocks: &mut Blocks,
        block: &Block,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
        (decoder, signals): (&FrameDecoder, &mut SignalSet),
    ) -> Result<Self, MdfError> {
        let (id, flags) = (block.number(0, 8)?, block.number(16, 2)?);
        let (data_bytes, invalid_bytes) = (block.number(24, 4)?, block.number(28, 4)?);
        let has_variable_length = flags & FLAG_VARIABLE_LENGTH != 0;
        let record_bytes = (data_bytes + invalid_bytes) as usize;
        let mut group = Self {
            id,
            record_bytes,
            has_variable_length,
            clock: None,
            channels: Vec::new(),
            frames: None,
            rows: 0,
        };
        if has_variable_length {
            return Ok(group);
        }
        if !(1..=MAX_RECORD_BYTES).contains(&record_bytes) {
            return Err(block.damaged("the length of a record is wrong"));
        }
        // The clock is added if the group is needed.
        let clock = signals.clocks_s.len();
        let (mut frame_id, mut is_extended, mut length, mut data) = (None, None, None, None);
        let mut bus_channel = None;
        let mut pending = vec![block.link(1)];
        let mut channels = 0;
        while let Some(at) = pending.pop() {
            let Some(channel) = blocks.find_once(at, b"CN")? else {
                continue;
            };
            channels += 1;
            if channels > MAX_CHANNELS {
                return Err(channel.damaged("the group has too many channels"));
            }
            pending.push(channel.link(0));
            // Members of a structure; arrays are no signals.
            if blocks.is_of_type(channel.link(1), b"CN") {
                pending.push(channel.link(1));
            }
            let name = blocks.text(channel.link(2))?;
            let kind = channel.number(0, 1)?;
            let is_clock = matches!(kind, MASTER | VIRTUAL_MASTER) && channel.number(1, 1)? == 1;
            let part = name
                .strip_prefix("CAN_DataFrame.")
                .filter(|_| !decoder.is_empty());
            if part == Some("DataBytes") {
                let place = [channel.number(4, 4)?, channel.number(8, 4)? / 8]
                    .map(|number| number as usize);
                if kind == 1 || channel.number(2, 1)? != BYTE_ARRAY {
                    return Err(MdfError::Unsupported(
                        "CAN frames whose data is stored elsewhere".to_owned(),
                    ));
                }
                data = Some(place);
            }
            let use_of = wanted(&name);
            if !(is_clock || part.is_some() || use_of.is_some()) {
                continue;
            }
            let use_of = use_of.unwrap_or(SignalUse::Number);
            let Some(read) = Channel::read(blocks, &channel, data_bytes, use_of)? else {
                continue;
            };
            match part {
                _ if is_clock => group.clock = Some((clock, read)),
                Some("ID") => frame_id = Some(read),
                Some("IDE") => is_extended = Some(read),
                Some("DataLength") => length = Some(read),
                Some("BusChannel") => bus_channel = Some(read),
                Some(_) => {}
                None => group.channels.push((
                    signals.add(read.name.clone(), read.unit.clone(), clock),
                    read,
                )),
            }
        }
        if let (Some(id), Some(data)) = (frame_id, data) {
            let bus_of_group = if bus_channel.is_none() {
                bus_of_group(blocks, block)?
            } else {
                None
            };
            group.frames = Some(FrameLayout {
                id,
                is_extended,
                length,
                bus_channel,
                bus_of_group,
                data,
            });
        }
        if group.is_needed() {
            signals.add_clock();
        }
        if group.is_needed() && (group.clock.is_none() || flags & FLAG_REMOTE_MASTER != 0) {
            return Err(MdfError::Unsupported(
                "signals without a clock in their group".to_owned(),
            ));
        }
        Ok(group)
    }

    fn is_needed(&self) -> bool {
        !self.channels.is_empty() || self.frames.is_some()
    }

    /// Adds the values of a record. Returns its time.
    fn add(
        &mut self,
        record: &[u8],
        decoder: &mut FrameDecoder,
        signals: &mut SignalSet,
    ) -> Result<Option<f64>, MdfError> {
        let Some((clock, master)) = self.clock.as_ref().filter(|_| self.is_needed()) else {
            return Ok(None);
        };
        let time_s = master.value(record, self.rows);
        if !self.channels.is_empty() {
            signals.add_time(*clock, time_s, self.channels.len())?;
            for (signal, channel) in &self.channels {
                signals.signals[*signal]
                    .values
                    .push(channel.value(record, self.rows));
            }
        }
        if let Some(layout) = &self.frames {
            layout.decode(record, decoder, &mut |signal, value| {
                signals.add_time(signals.signals[signal].clock, time_s, 1)?;
                signals.signals[signal].values.push(value);
                Ok(())
            })?;
        }
        self.rows += 1;
        Ok(Some(time_s))
    }
}

impl FrameLayout {
    /// Passes on the signals of a frame and their values.
    fn decode(
        &self,
        record: &[u8],
        decoder: &mut FrameDecoder,
        add: &mut dyn FnMut(usize, f64) -> Result<(), MdfError>,
    ) -> Result<(), MdfError> {
        let id = self.id.raw(record);
        let is_extended = match &self.is_extended {
            Some(flag) => flag.raw(record) != 0,
            None => id & EXTENDED_ID != 0 || id > 0x7ff,
        };
        let id = match is_extended {
            true => MessageId::Extended((id & 0x1fff_ffff) as u32),
            false => MessageId::Standard((id & 0x7ff) as u16),
        };
        let bus_channel = self
            .bus_channel
            .as_ref()
            .map(|channel| channel.raw(record))
            .or(self.bus_of_group);
        let [from, count] = self.data;
        let count = self
            .length
            .as_ref()
            .map_or(count, |length| count.min(length.raw(record) as usize));
        let frame = record.get(from..from + count).unwrap_or_default();
        decoder.decode(
            &Frame {
                id,
                bus_channel,
                bytes: frame,
            },
            add,
        )
    }
}

/// Returns the number of the bus in the name or the source of a group, such as `CAN 2`.
fn bus_of_group(blocks: &mut Blocks, group: &Block) -> Result<Option<u64>, MdfError> {
    let mut names = vec![blocks.text(group.link(2))?];
    if let Some(source) = blocks.find(group.link(3), b"SI")? {
        names.extend([blocks.text(source.link(0))?, blocks.text(source.link(1))?]);
    }
    let number = |name: &String| {
        let (bus, number) = name.split_at_checked(3)?;
        number
            .trim_matches([' ', '-', '_'])
            .parse()
            .ok()
            .filter(|_| bus.eq_ignore_ascii_case("can"))
    };
    Ok(names.iter().find_map(number))
}
