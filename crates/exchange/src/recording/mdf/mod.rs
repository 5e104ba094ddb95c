//! Signals of ASAM MDF 4 files, and of the raw CAN frames in them.
//!
//! No crate reads MDF 4 within the limits of this one: they map files into memory, panic on damaged blocks, or select
//! another deflate library for the whole program, which changes the bytes of compressed results.

mod blocks;
mod can;
mod channel;
mod conversion;
mod dbc;
mod group;
#[cfg(test)]
pub(super) mod test_file;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod value_tests;

use std::io::{Read, Seek};
use std::path::PathBuf;

use blocks::Blocks;
use can::FrameDecoder;
pub use dbc::DbcFile;
use group::DataGroup;

use super::limits;

/// Maximum number of values in memory: 160 MB.
const MAX_VALUES: usize = 20_000_000;
/// Number of values from which on those that are not needed any more are removed: 32 MB.
const BUFFER_VALUES: usize = 4_000_000;
/// Maximum number of channels of a group.
const MAX_CHANNELS: usize = 100_000;
/// Maximum number of groups of data with signals of the map.
const MAX_DATA_GROUPS: usize = 1000;

/// A file, or its bytes.
pub trait MdfSource: Read + Seek {}

impl<S: Read + Seek> MdfSource for S {}

/// Reason why an MDF file cannot be read.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum MdfError {
    /// The system cannot read the file.
    #[error("{0}")]
    Read(String),
    /// A block that breaks the rules of the format.
    #[error("the MDF file is damaged at byte {offset}: {problem}")]
    Damaged {
        /// Offset of the block.
        offset: u64,
        /// Problem of the block.
        problem: &'static str,
    },
    /// A part of the standard that this release does not read.
    #[error("crumple cannot read {0}")]
    Unsupported(String),
    /// A DBC file that cannot be read.
    #[error("{}{}: {problem}", path.display(), line.map(|line| format!(":{line}")).unwrap_or_default())]
    Dbc {
        /// Path of the DBC file.
        path: PathBuf,
        /// Line, from 1, if known.
        line: Option<usize>,
        /// Problem of the file.
        problem: String,
    },
    /// A signal that no frame of the file contains.
    #[error("the file has no frame with the signal {signal} of the message {message}")]
    NoFrame {
        /// Name of the signal.
        signal: String,
        /// Message, with the choice of the map.
        message: String,
    },
    /// A signal of frames of several bus channels, or of several senders.
    #[error(
        "the signal {signal} is in frames of the {origin} {first} and {second}: choose one with `{key}` in the map"
    )]
    Ambiguous {
        /// Name of the signal.
        signal: String,
        /// Plural of what differs.
        origin: &'static str,
        /// Number of the first frame.
        first: u64,
        /// Other number.
        second: u64,
        /// Key of the map that chooses one.
        key: &'static str,
    },
    /// More than this release holds in memory, or than a file of this size should have.
    #[error("more than {limit} {what}: split the recording")]
    TooLarge {
        /// Limit.
        limit: u64,
        /// Unit of the limit.
        what: &'static str,
    },
}

/// Use of a signal by the map.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum SignalUse {
    Number,
    /// An id of a vehicle, a lane or an event.
    Id,
}

/// Signals with their clocks.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SignalSet {
    /// Signals in the order of the file.
    pub signals: Vec<Signal>,
    /// Times of each clock, in seconds.
    pub clocks_s: Vec<Vec<f64>>,
    /// Number of values and times.
    values: usize,
    /// Number of values and times that were read, and its limit.
    read: u64,
    max_read: u64,
    /// Time from which on all further values must be, in seconds.
    from_s: Option<f64>,
}

/// A signal.
#[derive(Debug, Clone, PartialEq)]
pub struct Signal {
    /// Name of the channel, or of the signal of the DBC file.
    pub name: String,
    /// Unit in the file.
    pub unit: String,
    /// Index of its clock.
    pub clock: usize,
    /// Values in this unit, one for each time of the clock; NaN if invalid.
    pub values: Vec<f64>,
}

/// Signals of a file, read as far as they are needed.
pub(super) struct SignalStream {
    blocks: Blocks,
    decoder: FrameDecoder,
    groups: Vec<DataGroup>,
    /// Time up to which all values are read; `None` at the end of the file.
    read_until_s: Option<f64>,
    /// Values that were read and are still needed.
    pub(super) set: SignalSet,
}

impl SignalStream {
    /// Opens a file for the wanted signals.
    pub(super) fn open(
        source: impl MdfSource + 'static,
        dbc: Option<&DbcFile>,
        wanted: &dyn Fn(&str) -> Option<SignalUse>,
    ) -> Result<Self, MdfError> {
        let mut blocks = Blocks::new(Box::new(source))?;
        let mut set = SignalSet {
            max_read: limits::max_values(blocks.file_bytes()),
            ..SignalSet::default()
        };
        let decoder = dbc
            .map(|dbc| dbc.decoder(wanted, &mut set))
            .transpose()?
            .unwrap_or_default();
        let mut groups = Vec::new();
        let mut at = blocks.read(64, b"HD")?.link(0);
        while let Some(block) = blocks.find_once(at, b"DG")? {
            let group = DataGroup::read(&mut blocks, &block, wanted, (&decoder, &mut set))?;
            groups.extend(Some(group).filter(DataGroup::is_needed));
            if groups.len() > MAX_DATA_GROUPS {
                return Err(MdfError::TooLarge {
                    limit: MAX_DATA_GROUPS as u64,
                    what: "groups with signals of the map",
                });
            }
            at = block.link(0);
        }
        let read_until_s = groups.first().map(|_| f64::NEG_INFINITY);
        Ok(Self {
            blocks,
            decoder,
            groups,
            read_until_s,
            set,
        })
    }

    /// Returns the size of the file.
    pub(super) fn file_bytes(&self) -> u64 {
        self.blocks.file_bytes()
    }

    /// Returns the time up to which all values are read; `None` at the end of the file.
    pub(super) fn read_until_s(&self) -> Option<f64> {
        self.read_until_s
    }

    /// Rejects signals of a DBC file that no frame contained, at the end of the file.
    pub(super) fn check_frames(&self) -> Result<(), MdfError> {
        self.decoder.check_frames()
    }

    /// Returns whether the memory for values is used.
    pub(super) fn is_full(&self) -> bool {
        self.set.values >= BUFFER_VALUES
    }

    /// Reads a chunk of the group whose values end first. Returns false at the end of the file.
    pub(super) fn advance(&mut self) -> Result<bool, MdfError> {
        let Self {
            blocks,
            decoder,
            groups,
            set,
            ..
        } = self;
        let lagging = groups
            .iter()
            .enumerate()
            .min_by(|(_, a), (_, b)| a.newest_s.total_cmp(&b.newest_s));
        let Some(index) = lagging.map(|(index, _)| index) else {
            return Ok(false);
        };
        if !groups[index].advance(blocks, decoder, set)? {
            groups.remove(index);
        }
        self.read_until_s = self
            .groups
            .iter()
            .map(|group| group.newest_s)
            .min_by(f64::total_cmp);
        Ok(true)
    }
}

impl SignalSet {
    /// Reads the signals with wanted names.
    ///
    /// # Errors
    /// [`MdfError`] for a damaged file, one with unsupported parts, or one with too many values.
    pub fn read(
        source: impl MdfSource + 'static,
        dbc: Option<&DbcFile>,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Self, MdfError> {
        let mut stream = SignalStream::open(source, dbc, &|name| {
            wanted(name).then_some(SignalUse::Number)
        })?;
        while stream.advance()? {}
        Ok(stream.set)
    }

    /// Removes the first `counts` values of each clock and its signals; later values must be from a time on.
    pub(super) fn forget(&mut self, counts: &[usize], from_s: Option<f64>) {
        let Self {
            signals,
            clocks_s,
            values,
            ..
        } = self;
        let lists = clocks_s.iter_mut().zip(0..).chain(
            signals
                .iter_mut()
                .map(|signal| (&mut signal.values, signal.clock)),
        );
        for (list, clock) in lists {
            let count = counts.get(clock).copied().unwrap_or(0).min(list.len());
            list.drain(..count);
            *values -= count;
        }
        self.from_s = from_s;
    }

    /// Adds a time to a clock. Counts it and `values` values at this time.
    fn add_time(&mut self, clock: usize, time_s: f64, values: usize) -> Result<(), MdfError> {
        if self.from_s.is_some_and(|from_s| time_s < from_s) {
            let problem = "a long recording with samples that are not in order of time in their data group: save it \
                           again in this order";
            return Err(MdfError::Unsupported(problem.to_owned()));
        }
        self.clocks_s[clock].push(time_s);
        self.values += 1 + values;
        self.read += 1 + values as u64;
        if self.values > MAX_VALUES {
            return Err(MdfError::TooLarge {
                limit: MAX_VALUES as u64,
                what: "values of the signals of the map in memory",
            });
        }
        if self.read > self.max_read {
            return Err(MdfError::TooLarge {
                limit: self.max_read,
                what: "values of the signals of the map",
            });
        }
        Ok(())
    }

    fn add_clock(&mut self) -> usize {
        self.clocks_s.push(Vec::new());
        self.clocks_s.len() - 1
    }

    fn add(&mut self, name: String, unit: String, clock: usize) -> usize {
        self.signals.push(Signal {
            name,
            unit,
            clock,
            values: Vec::new(),
        });
        self.signals.len() - 1
    }
}
