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
use group::DataGroup;

use super::table::MAX_VALUES;

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
    #[error("{}: {problem}", path.display())]
    Dbc {
        /// Path of the DBC file.
        path: PathBuf,
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
    values: usize,
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
        let mut blocks = Blocks::new(Box::new(source))?;
        let mut signals = Self::default();
        let decoder = dbc.map(|dbc| dbc.decoder(wanted, &mut signals)).unwrap_or_default();
        let mut at = blocks.read(64, b"HD")?.link(0);
        while let Some(block) = blocks.find_once(at, b"DG")? {
            let mut group = DataGroup::read(&mut blocks, &block, wanted, (&decoder, &mut signals))?;
            if group.is_needed() {
                for offset in blocks.data_blocks(block.link(2))? {
                    blocks.read_data(offset, &mut |bytes| group.add(bytes, &decoder, &mut signals))?;
                }
                group.finish(&block)?;
            }
            at = block.link(0);
        }
        Ok(signals)
    }

    fn add_clock(&mut self) -> usize {
        self.clocks_s.push(Vec::new());
        self.clocks_s.len() - 1
    }

    fn add(&mut self, name: String, unit: String, clock: usize) -> usize {
        self.signals.push(Signal { name, unit, clock, values: Vec::new() });
        self.signals.len() - 1
    }

    fn count(&mut self, values: usize) -> Result<(), MdfError> {
        self.values += values;
        if self.values > MAX_VALUES { Err(MdfError::TooLarge) } else { Ok(()) }
    }
}
