//! Recordings that are no text: Parquet and MDF 4.

use std::fs::File;
use std::io::Read;
use std::path::Path;

use super::error::{BinaryProblem, RecordingError};
use super::map::RecordingMapSpec;
use super::table::RowReader;

/// Number of bytes that show the format of a file.
pub(super) const START_BYTES: u64 = 8;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum BinaryFormat {
    Parquet,
    Mdf,
}

/// A file, or its bytes.
pub(super) enum Input {
    File(File),
    Bytes(Vec<u8>),
}

impl From<File> for Input {
    fn from(file: File) -> Self {
        Self::File(file)
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
            None
        }
    }
}

/// Returns the names of the columns or signals of a file; `time` for the clocks of an MDF file.
pub(super) fn column_names(path: &Path) -> Result<Vec<String>, RecordingError> {
    let error = |source| RecordingError::Read { path: path.to_owned(), source };
    let open_file = || File::open(path).map_err(error);
    let mut start = Vec::new();
    open_file()?.take(START_BYTES).read_to_end(&mut start).map_err(error)?;
    let mut rows = match BinaryFormat::detect(&start) {
        #[cfg(feature = "mdf")]
        Some(BinaryFormat::Mdf) => {
            let names = std::cell::RefCell::new(vec!["time".to_owned()]);
            let collect = |name: &str| {
                names.borrow_mut().push(name.to_owned());
                false
            };
            let read = super::mdf::SignalSet::read(open_file()?, None, &collect);
            read.map_err(|problem| RecordingError::Binary { path: path.to_owned(), problem: problem.into() })?;
            return Ok(names.into_inner());
        }
        Some(format) => open(format, open_file()?, path, None)?,
        None => RowReader::new(open_file()?, path, None)?,
    };
    let names = rows.next_header()?.ok_or_else(|| RecordingError::Empty { path: path.to_owned() })?;
    Ok(names.fields.iter().map(str::to_owned).collect())
}

/// Returns the rows of a file for the columns of a map.
pub(super) fn open<'a>(
    format: BinaryFormat,
    input: impl Into<Input>,
    path: &'a Path,
    map: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, RecordingError> {
    let input = input.into();
    let opened = match format {
        BinaryFormat::Parquet => open_parquet(input, path, map),
        BinaryFormat::Mdf => open_mdf(input, path, map),
    };
    opened.map_err(|problem| RecordingError::Binary { path: path.to_owned(), problem })
}

#[cfg(feature = "parquet")]
fn open_parquet<'a>(
    input: Input,
    path: &'a Path,
    map: Option<&RecordingMapSpec>,
) -> Result<RowReader<'a>, BinaryProblem> {
    let (rows, names) = match input {
        Input::File(file) => super::parquet_rows::open(file, map)?,
        Input::Bytes(bytes) => super::parquet_rows::open(bytes::Bytes::from(bytes), map)?,
    };
    Ok(RowReader::from_binary(Box::new(rows), names, path))
}

#[cfg(not(feature = "parquet"))]
fn open_parquet<'a>(_: Input, _: &'a Path, _: Option<&RecordingMapSpec>) -> Result<RowReader<'a>, BinaryProblem> {
    Err(BinaryProblem::NeedsFeature { format: "a Parquet file", feature: "parquet" })
}

#[cfg(feature = "mdf")]
fn open_mdf<'a>(input: Input, path: &'a Path, map: Option<&RecordingMapSpec>) -> Result<RowReader<'a>, BinaryProblem> {
    use super::mdf::DbcFile;
    let map = map.ok_or(BinaryProblem::NeedsMap)?;
    let (wanted, dbc) = (
        |name: &str| map.column_role(name).is_some_and(|role| !role.is_clock),
        map.dbc.as_deref().map(DbcFile::load).transpose()?,
    );
    let signals = match input {
        Input::File(file) => super::mdf::SignalSet::read(file, dbc.as_ref(), &wanted),
        Input::Bytes(bytes) => super::mdf::SignalSet::read(std::io::Cursor::new(bytes), dbc.as_ref(), &wanted),
    }?;
    let (rows, names) = super::signal_rows::ResampledSignals::new(signals, map);
    Ok(RowReader::from_binary(Box::new(rows), names, path))
}

#[cfg(not(feature = "mdf"))]
fn open_mdf<'a>(_: Input, _: &'a Path, _: Option<&RecordingMapSpec>) -> Result<RowReader<'a>, BinaryProblem> {
    Err(BinaryProblem::NeedsFeature { format: "an MDF file", feature: "mdf" })
}
