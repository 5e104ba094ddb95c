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
        let mut groups = Vec::new();
        let mut at = block.link(1);
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
        Ok(Self {
            id_bytes,
            groups,
            index_by_id,
            rest: Vec::new(),
            data,
            at: block.at,
            newest_s: f64::NEG_INFINITY,
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
            let end = from + content.end;
            let record = &bytes[from + content.start..end];
            if let Some(time_s) = self.groups[index].add(record, decoder, signals)? {
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
        let unknown = MdfError::Damaged {
            offset: 0,
            problem: "a record has an unknown id",
        };
        let index = self.index_of_group(id).ok_or(unknown)?;
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

    /// Returns the index of the group whose records have an id; the only group has records without id.
    fn index_of_group(&self, id: u64) -> Option<usize> {
        if self.id_bytes == 0 {
            return self.index_by_id.first().map(|(_, index)| *index);
        }
        let position = self
            .index_by_id
            .partition_point(|(group_id, _)| *group_id < id);
        self.index_by_id
            .get(position)
            .filter(|(group_id, _)| *group_id == id)
            .map(|(_, index)| *index)
    }
}

impl Group {
    fn read(
        blocks: &mut Blocks,
        block: &Block,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
        (decoder, signals): (&FrameDecoder, &mut SignalSet),
    ) -> Result<Self, MdfError> {
        let flags = block.number(16, 2)?;
        let data_bytes = block.number(24, 4)?;
        let record_bytes = (data_bytes + block.number(28, 4)?) as usize;
        let mut group = Self {
            id: block.number(0, 8)?,
            record_bytes,
            has_variable_length: flags & FLAG_VARIABLE_LENGTH != 0,
            clock: None,
            channels: Vec::new(),
            frames: None,
            rows: 0,
        };
        if group.has_variable_length {
            return Ok(group);
        }
        if !(1..=MAX_RECORD_BYTES).contains(&record_bytes) {
            return Err(block.damaged("the length of a record is wrong"));
        }
        let mut reader = ChannelReader {
            wanted,
            reads_frames: !decoder.is_empty(),
            data_bytes,
            // The clock is added if the group is needed.
            clock: signals.clocks_s.len(),
            group: &mut group,
            frames: FrameChannels::default(),
        };
        reader.read_all(blocks, block, signals)?;
        let frames = reader.frames;
        group.frames = frames.into_layout(blocks, block)?;
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

/// Reader of the channels of a group.
struct ChannelReader<'r> {
    wanted: &'r dyn Fn(&str) -> Option<SignalUse>,
    reads_frames: bool,
    /// Bytes of a record before the bits that mark invalid values.
    data_bytes: u64,
    /// Index of the clock of the group.
    clock: usize,
    group: &'r mut Group,
    frames: FrameChannels,
}

impl ChannelReader<'_> {
    /// Reads the channels of a group, and the members of those that are structures.
    fn read_all(
        &mut self,
        blocks: &mut Blocks,
        group: &Block,
        signals: &mut SignalSet,
    ) -> Result<(), MdfError> {
        let mut pending = vec![group.link(1)];
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
            self.read(blocks, &channel, signals)?;
        }
        Ok(())
    }

    /// Adds a channel to the group if it is a clock, a wanted signal or part of CAN frames.
    fn read(
        &mut self,
        blocks: &mut Blocks,
        block: &Block,
        signals: &mut SignalSet,
    ) -> Result<(), MdfError> {
        let name = blocks.text(block.link(2))?;
        let kind = block.number(0, 1)?;
        let is_clock = matches!(kind, MASTER | VIRTUAL_MASTER) && block.number(1, 1)? == 1;
        let frame_part = name
            .strip_prefix("CAN_DataFrame.")
            .filter(|_| self.reads_frames);
        if frame_part == Some("DataBytes") {
            self.frames.data = Some(frame_bytes(block)?);
        }
        let signal_use = (self.wanted)(&name);
        if !(is_clock || frame_part.is_some() || signal_use.is_some()) {
            return Ok(());
        }
        let signal_use = signal_use.unwrap_or(SignalUse::Number);
        let Some(channel) = Channel::read(blocks, block, self.data_bytes, signal_use)? else {
            return Ok(());
        };
        let is_read = matches!(frame_part, Some("ID" | "IDE" | "DataLength" | "BusChannel"));
        if is_read && !is_clock && channel.is_virtual() {
            return Err(MdfError::Unsupported(format!(
                "`{name}` as a virtual channel: frames need its bits in each record"
            )));
        }
        match frame_part {
            _ if is_clock => self.group.clock = Some((self.clock, channel)),
            Some("ID") => self.frames.id = Some(channel),
            Some("IDE") => self.frames.is_extended = Some(channel),
            Some("DataLength") => self.frames.length = Some(channel),
            Some("BusChannel") => self.frames.bus_channel = Some(channel),
            Some(_) => {}
            None => {
                let signal = signals.add(channel.name.clone(), channel.unit.clone(), self.clock);
                self.group.channels.push((signal, channel));
            }
        }
        Ok(())
    }
}

/// Returns the first byte and the number of bytes of the data of CAN frames.
fn frame_bytes(channel: &Block) -> Result<[usize; 2], MdfError> {
    const VARIABLE_LENGTH: u64 = 1;
    let first = channel.number(4, 4)? as usize;
    let count = (channel.number(8, 4)? / 8) as usize;
    if channel.number(0, 1)? == VARIABLE_LENGTH || channel.number(2, 1)? != BYTE_ARRAY {
        return Err(MdfError::Unsupported(
            "CAN frames whose data is stored elsewhere".to_owned(),
        ));
    }
    Ok([first, count])
}

/// Channels of CAN frames that a group has.
#[derive(Default)]
struct FrameChannels {
    id: Option<Channel>,
    is_extended: Option<Channel>,
    length: Option<Channel>,
    bus_channel: Option<Channel>,
    /// First byte and number of bytes of the data.
    data: Option<[usize; 2]>,
}

impl FrameChannels {
    /// Returns the layout of the frames; `None` if the group has no frames with id and data.
    fn into_layout(
        self,
        blocks: &mut Blocks,
        group: &Block,
    ) -> Result<Option<FrameLayout>, MdfError> {
        let Some((id, data)) = self.id.zip(self.data) else {
            return Ok(None);
        };
        let bus_of_group = match self.bus_channel {
            Some(_) => None,
            None => bus_of_group(blocks, group)?,
        };
        Ok(Some(FrameLayout {
            id,
            is_extended: self.is_extended,
            length: self.length,
            bus_channel: self.bus_channel,
            bus_of_group,
            data,
        }))
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
    Ok(names.iter().find_map(|name| bus_number(name)))
}

/// Returns the number in the name of a bus, such as `CAN 2`.
fn bus_number(name: &str) -> Option<u64> {
    let (bus, number) = name.split_at_checked(3)?;
    number
        .trim_matches([' ', '-', '_'])
        .parse()
        .ok()
        .filter(|_| bus.eq_ignore_ascii_case("can"))
}
