//! Signals of ASAM MDF 4 files, and of the raw CAN frames in them.
//!
//! No crate reads MDF 4 within the limits of this one: they map files into memory, panic on damaged blocks, or select
//! another deflate library for the whole program, which changes the bytes of compressed results.

mod blocks;
mod can;
mod channel;
mod group;
#[cfg(test)]
mod tests;

use std::io::{Read, Seek};
use std::path::PathBuf;

use blocks::Blocks;
pub use can::DbcFile;
use can::FrameDecoder;
use group::DataGroup;

/// Maximum number of values in memory: 160 MB.
const MAX_VALUES: usize = 20_000_000;
/// Number of values from which on those that are not needed any more are removed: 32 MB.
const BUFFER_VALUES: usize = 4_000_000;
/// Maximum number of channels of a file.
const MAX_CHANNELS: usize = 100_000;

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
    /// More values than this release holds in memory.
    #[error("more than {MAX_VALUES} values of the signals of the map: split the recording")]
    TooLarge,
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
    /// Values that were read and are still needed.
    pub(super) set: SignalSet,
}

impl SignalStream {
    /// Opens a file for the signals with wanted names.
    pub(super) fn open(
        source: impl MdfSource + 'static,
        dbc: Option<&DbcFile>,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Self, MdfError> {
        let mut blocks = Blocks::new(Box::new(source))?;
        let mut set = SignalSet::default();
        let decoder = dbc.map(|dbc| dbc.decoder(wanted, &mut set)).transpose()?.unwrap_or_default();
        let mut groups = Vec::new();
        let mut at = blocks.read(64, b"HD")?.link(0);
        while let Some(block) = blocks.find_once(at, b"DG")? {
            let group = DataGroup::read(&mut blocks, &block, wanted, (&decoder, &mut set))?;
            groups.extend(Some(group).filter(DataGroup::is_needed));
            at = block.link(0);
        }
        Ok(Self { blocks, decoder, groups, set })
    }

    /// Returns the time up to which all values are read; `None` at the end of the file.
    pub(super) fn read_until_s(&self) -> Option<f64> {
        self.groups.iter().map(|group| group.newest_s).min_by(f64::total_cmp)
    }

    /// Returns whether the memory for values is used.
    pub(super) fn is_full(&self) -> bool {
        self.set.values >= BUFFER_VALUES
    }

    /// Reads a chunk of the group whose values end first. Returns false at the end of the file.
    pub(super) fn advance(&mut self) -> Result<bool, MdfError> {
        let Self { blocks, decoder, groups, set } = self;
        let lagging = groups.iter().enumerate().min_by(|(_, a), (_, b)| a.newest_s.total_cmp(&b.newest_s));
        let Some(index) = lagging.map(|(index, _)| index) else { return Ok(false) };
        if !groups[index].advance(blocks, decoder, set)? {
            groups.remove(index);
        }
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
        let mut stream = SignalStream::open(source, dbc, wanted)?;
        while stream.advance()? {}
        Ok(stream.set)
    }

    /// Removes the first `counts` values of each clock and its signals; later values must be from a time on.
    pub(super) fn forget(&mut self, counts: &[usize], from_s: Option<f64>) {
        let Self { signals, clocks_s, values, .. } = self;
        let lists = clocks_s.iter_mut().zip(0..).chain(signals.iter_mut().map(|one| (&mut one.values, one.clock)));
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
            let problem = "a long recording whose groups are not in order of time: save it again in this order";
            return Err(MdfError::Unsupported(problem.to_owned()));
        }
        self.clocks_s[clock].push(time_s);
        self.values += 1 + values;
        if self.values > MAX_VALUES { Err(MdfError::TooLarge) } else { Ok(()) }
    }

    fn add_clock(&mut self) -> usize {
        self.clocks_s.push(Vec::new());
        self.clocks_s.len() - 1
    }

    fn add(&mut self, name: String, unit: String, clock: usize) -> usize {
        self.signals.push(Signal { name, unit, clock, values: Vec::new() });
        self.signals.len() - 1
    }
}
