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
            OTHER_FORMATS
                .iter()
                .find(|(first, _)| start.starts_with(first))
                .map(|(_, name)| Self::Other(name))
        }
    }
}

/// Columns or signals of a file.
pub(super) struct FileColumns {
    /// Names; the clocks of an MDF file are `time`.
    pub(super) names: Vec<String>,
    /// True if the file can state units.
    pub(super) states_units: bool,
}

/// Reads the names of the columns or signals of a file.
pub(super) fn read_columns(path: &Path) -> Result<FileColumns, RecordingError> {
    let mut start = Vec::new();
    open_file(path)?
        .take(START_BYTES)
        .read_to_end(&mut start)
        .map_err(|source| read_error(path, source))?;
    let mut rows = match BinaryFormat::detect(&start) {
        #[cfg(feature = "mdf")]
        Some(BinaryFormat::Mdf) => return read_signals(path),
        Some(format) => open(format, Input::File(open_file(path)?), path, None)?,
        None => RowReader::new(open_file(path)?, path, None)?,
    };
    let names = rows.next_header()?.ok_or_else(|| RecordingError::Empty {
        path: path.to_owned(),
    })?;
    Ok(FileColumns {
        names: names.fields.iter().map(str::to_owned).collect(),
        states_units: false,
    })
}

fn open_file(path: &Path) -> Result<RecordingFile, RecordingError> {
    RecordingFile::open(path, None).map_err(|source| read_error(path, source))
}

/// Returns the error for a file that the system cannot read.
pub(super) fn read_error(path: &Path, source: io::Error) -> RecordingError {
    RecordingError::Read {
        path: path.to_owned(),
        source,
    }
}

/// Reads the names of the signals of an MDF file.
#[cfg(feature = "mdf")]
fn read_signals(path: &Path) -> Result<FileColumns, RecordingError> {
    let names = std::cell::RefCell::new(vec!["time".to_owned()]);
    super::mdf::SignalSet::read(open_file(path)?, None, &|name| {
        names.borrow_mut().push(name.to_owned());
        false
    })
    .map_err(|problem| RecordingError::Binary {
        path: path.to_owned(),
        problem: problem.into(),
    })?;
    Ok(FileColumns {
        names: names.into_inner(),
        states_units: true,
    })
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
    let rows = match input {
        Input::File(file) => super::parquet::open(file, map)?,
        Input::Bytes(bytes) => super::parquet::open(std::io::Cursor::new(bytes), map)?,
    };
    let names = rows.names();
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
    let listed = std::cell::RefCell::new(Vec::new());
    let wanted = |name: &str| {
        if listed.borrow().len() < MAX_LISTED {
            listed.borrow_mut().push(name.to_owned());
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
    let rows = super::signal_rows::ResampledSignals::new(signals, map);
    let names = rows.names(map);
    check_columns(map, &names, &listed.into_inner())?;
    let units = rows.units();
    Ok(RowReader::from_binary(Box::new(rows), (names, units), path))
}

/// Checks that a file has the columns of a map, beside numbered ones.
#[cfg(any(feature = "mdf", feature = "parquet"))]
pub(super) fn check_columns(
    map: &RecordingMapSpec,
    names: &Fields,
    names_in_file: &[String],
) -> Result<(), BinaryProblem> {
    let columns = map.columns();
    let missing = columns.iter().find(|(_, column)| {
        !column.contains("{}") && !names.iter().any(|name| is_same_name(name, column))
    });
    let Some((_, column)) = missing else {
        return Ok(());
    };
    let more = if names_in_file.len() < MAX_LISTED {
        ""
    } else {
        ", ..."
    };
    let excerpts: Vec<_> = names_in_file
        .iter()
        .take(MAX_LISTED)
        .map(|name| super::table::excerpt(name))
        .collect();
    let has_frames = excerpts
        .iter()
        .any(|name| name.starts_with("CAN_DataFrame"));
    let hint = if has_frames && map.dbc.is_none() {
        "; raw CAN frames need `dbc = \"FILE.dbc\"` in the map"
    } else {
        ""
    };
    Err(BinaryProblem::MissingColumn {
        column: (*column).to_owned(),
        known: format!("{}{more}{hint}", excerpts.join(", ")),
    })
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
