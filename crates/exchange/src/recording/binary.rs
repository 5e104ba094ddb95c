//! Recordings that are no text: Parquet and MDF 4.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::Path;

use super::ReadProgress;
use super::error::{BinaryProblem, RecordingError};
use super::map::RecordingMapSpec;
#[cfg(any(feature = "mdf", feature = "parquet"))]
use super::map::is_same_name;
use super::table::RowReader;
#[cfg(any(feature = "mdf", feature = "parquet"))]
use super::text_rows::Fields;

/// Number of bytes that show the format of a file.
pub(super) const START_BYTES: u64 = 8;

/// Number of names that an error lists.
#[cfg(any(feature = "mdf", feature = "parquet"))]
pub(super) const MAX_LISTED: usize = 30;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BinaryFormat {
    Parquet,
    Mdf,
    /// Another format, with the name and its article.
    Other(&'static str),
}

/// First bytes and names of formats that are often taken for text.
const OTHER_FORMATS: [(&[u8], &str); 5] = [
    (b"PK\x03\x04", "a ZIP archive or an Excel workbook"),
    (b"\x1f\x8b", "a gzip archive"),
    (b"\x89HDF", "an HDF5 file"),
    (b"MATLAB", "a MATLAB file"),
    (b"LOGG", "a BLF file"),
];

/// A file, or its bytes.
pub(super) enum Input {
    File(RecordingFile),
    Bytes(Vec<u8>),
}

/// A file that reports the progress of reading.
pub(super) struct RecordingFile {
    file: File,
    length: u64,
    read: u64,
    progress: Option<ReadProgress>,
}

impl RecordingFile {
    pub(super) fn open(path: &Path, progress: Option<&ReadProgress>) -> io::Result<Self> {
        let file = crumple_core::regular_file::open(path)?;
        let length = file.metadata()?.len();
        Ok(Self {
            file,
            length,
            read: 0,
            progress: progress.cloned(),
        })
    }

    fn report(&self, read: u64) {
        self.progress
            .iter()
            .for_each(|report| report(read.min(self.length), self.length));
    }
}

impl Read for RecordingFile {
    fn read(&mut self, into: &mut [u8]) -> io::Result<usize> {
        let count = self.file.read(into)?;
        self.read += count as u64;
        self.report(self.read);
        Ok(count)
    }
}

impl Seek for RecordingFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

impl BinaryFormat {
    /// Recognises a format by the first bytes of a file; `None` for a text.
    pub(super) fn detect(start: &[u8]) -> Option<Self> {
        if start.starts_with(b"PAR1") {
            Some(Self::Parquet)
        } else if start.starts_with(b"MDF     ") || start.starts_with(b"UnFinMF ") {
            Some(Self::Mdf)
        } else {
            let found = OTHER_FORMATS
                .iter()
                .find(|(first, _)| start.starts_with(first));
            found.map(|(_, name)| Self::Other(name))
        }
    }
}

/// Returns the names of the columns or signals of a file, and whether it can state units. The clocks of an MDF file are
/// `time`.
pub(super) fn column_names(path: &Path) -> Result<(Vec<String>, bool), RecordingError> {
    let error = |source| RecordingError::Read {
        path: path.to_owned(),
        source,
    };
    let open_file = || RecordingFile::open(path, None).map_err(error);
    let mut start = Vec::new();
    open_file()?
        .take(START_BYTES)
        .read_to_end(&mut start)
        .map_err(error)?;
    let mut rows = match BinaryFormat::detect(&start) {
        #[cfg(feature = "mdf")]
        Some(BinaryFormat::Mdf) => {
            let names = std::cell::RefCell::new(vec!["time".to_owned()]);
            let collect = |name: &str| {
                names.borrow_mut().push(name.to_owned());
                false
            };
            let read = super::mdf::SignalSet::read(open_file()?, None, &collect);
            read.map_err(|problem| RecordingError::Binary {
                path: path.to_owned(),
                problem: problem.into(),
            })?;
            return Ok((names.into_inner(), true));
        }
        Some(format) => open(format, Input::File(open_file()?), path, None)?,
        None => RowReader::new(open_file()?, path, None)?,
    };
    let names = rows.next_header()?.ok_or_else(|| RecordingError::Empty {
        path: path.to_owned(),
    })?;
    Ok((names.fields.iter().map(str::to_owned).collect(), false))
}

/// Returns the rows of a file for the columns of a map.
pub(super) fn open<'a>(
    format: BinaryFormat,
    input: Input,
    path: &'a Path,
    map: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, RecordingError> {
    let opened = match format {
        BinaryFormat::Parquet => open_parquet(input, path, map),
        BinaryFormat::Mdf => open_mdf(input, path, map),
        BinaryFormat::Other(format) => Err(BinaryProblem::UnknownFormat { format }),
    };
    opened.map_err(|problem| RecordingError::Binary {
        path: path.to_owned(),
        problem,
    })
}

#[cfg(feature = "parquet")]
fn open_parquet<'a>(
    input: Input,
    path: &'a Path,
    map: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, BinaryProblem> {
    let (rows, names) = match input {
        Input::File(file) => super::parquet::open(file, map)?,
        Input::Bytes(bytes) => super::parquet::open(std::io::Cursor::new(bytes), map)?,
    };
    Ok(RowReader::from_binary(
        Box::new(rows),
        (names, Fields::default()),
        path,
    ))
}

#[cfg(not(feature = "parquet"))]
fn open_parquet<'a>(
    _: Input,
    _: &'a Path,
    _: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, BinaryProblem> {
    Err(BinaryProblem::NeedsFeature {
        format: "a Parquet file",
        feature: "parquet",
    })
}

#[cfg(feature = "mdf")]
fn open_mdf<'a>(
    input: Input,
    path: &'a Path,
    map: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, BinaryProblem> {
    use super::mdf::{DbcFile, SignalStream, SignalUse};
    let map = map.ok_or(BinaryProblem::NeedsMap)?;
    let known = std::cell::RefCell::new(Vec::new());
    let wanted = |name: &str| {
        if known.borrow().len() < MAX_LISTED {
            known.borrow_mut().push(name.to_owned());
        }
        let role = map.column_role(name).filter(|role| !role.is_clock)?;
        Some(if role.is_id {
            SignalUse::Id
        } else {
            SignalUse::Number
        })
    };
    let dbc = map.dbc.as_deref().map(DbcFile::load).transpose()?;
    let dbc = dbc.map(|dbc| dbc.with_frames_of(map)).transpose()?;
    let signals = match input {
        Input::File(file) => SignalStream::open(file, dbc.as_ref(), &wanted),
        Input::Bytes(bytes) => {
            SignalStream::open(std::io::Cursor::new(bytes), dbc.as_ref(), &wanted)
        }
    }?;
    let (rows, names, units) = super::signal_rows::ResampledSignals::new(signals, map);
    check_columns(map, &names, &known.into_inner())?;
    Ok(RowReader::from_binary(Box::new(rows), (names, units), path))
}

/// Checks that a file has the columns of a map, beside numbered ones.
#[cfg(any(feature = "mdf", feature = "parquet"))]
pub(super) fn check_columns(
    map: &RecordingMapSpec,
    names: &Fields,
    known: &[String],
) -> Result<(), BinaryProblem> {
    let is_missing = |column: &str| {
        !column.contains("{}") && !names.iter().any(|name| is_same_name(name, column))
    };
    match map
        .columns()
        .into_iter()
        .find(|(_, column)| is_missing(column))
    {
        Some((_, column)) => {
            let more = if known.len() < MAX_LISTED {
                ""
            } else {
                ", ..."
            };
            let known: Vec<_> = known
                .iter()
                .take(MAX_LISTED)
                .map(|name| super::table::excerpt(name))
                .collect();
            let has_frames =
                map.dbc.is_none() && known.iter().any(|name| name.starts_with("CAN_DataFrame"));
            let hint = if has_frames {
                "; raw CAN frames need `dbc = \"FILE.dbc\"` in the map"
            } else {
                ""
            };
            let known = format!("{}{more}{hint}", known.join(", "));
            Err(BinaryProblem::MissingColumn {
                column: column.to_owned(),
                known,
            })
        }
        None => Ok(()),
    }
}

#[cfg(not(feature = "mdf"))]
fn open_mdf<'a>(
    _: Input,
    _: &'a Path,
    _: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, BinaryProblem> {
    Err(BinaryProblem::NeedsFeature {
        format: "an MDF file",
        feature: "mdf",
    })
}
