//! Reading of recordings of any format, with their maps.

use std::io::{Cursor, Read};
use std::path::Path;
use std::sync::Arc;

use super::error::{LineProblem, RecordingError};
use super::map::{LayoutSpec, RecordingMap, RecordingMapSpec};
use super::parts::{PART_ROWS, PartSink};
use super::table::{self, CsvRow, RowReader};
use super::{Recording, binary, pairs, platoons, traffic};

/// Receives the number of bytes of a file that were read, and their total.
pub type ReadProgress = Arc<dyn Fn(u64, u64) + Send + Sync>;

/// Reads a recording file with any extension: text, or Parquet or MDF 4 if the build has the features `parquet` and
/// `mdf`. The columns are those of `map`, or of the built-in map that matches the first line.
///
/// # Errors
/// [`RecordingError`] for a file that cannot be read, is of neither built-in format, lacks a column of its map, is
/// truncated, or holds a field that is not a number. Missing and impossible values are no errors: they are in
/// [`Recording::dropped`]. A file of several parts is an error, see [`load_parts`].
pub fn load(path: &Path, map: Option<&RecordingMap>) -> Result<Recording, RecordingError> {
    only_part(path, |sink| load_parts(path, map, None, sink))
}

/// Reads the first part of a recording file, as [`load_parts`].
///
/// # Errors
/// Those of [`load`].
pub fn load_first_part(
    path: &Path,
    map: Option<&RecordingMap>,
) -> Result<Recording, RecordingError> {
    first_part(path, |sink| load_parts(path, map, None, sink))
}

fn first_part(
    path: &Path,
    read: impl FnOnce(&mut PartSink<'_>) -> Result<(), RecordingError>,
) -> Result<Recording, RecordingError> {
    let mut first = None;
    read(&mut |part| {
        first = Some(part);
        Ok(false)
    })?;
    first.ok_or_else(|| RecordingError::Empty {
        path: path.to_owned(),
    })
}

/// Number of rows that show whether a map fits; tests use few.
const SAMPLE_ROWS: usize = PART_ROWS / 5;

/// Reads the first rows of a recording file, in the order of the file: at most `max_rows`, and no more than needed to
/// show whether a map fits.
pub(super) fn load_first_rows(
    path: &Path,
    map: &RecordingMap,
    max_rows: usize,
) -> Result<Recording, RecordingError> {
    let mut table = open(path, Some(map), None)?;
    table.rows_left = SAMPLE_ROWS.min(max_rows);
    first_part(path, |sink| read_rows(table, path, Some(map), sink))
}

/// Reads a recording file in parts, so that memory stays bounded: a part has about 500 000 rows, and overlaps the next
/// by a minute. Braking at each time belongs to one part. Omissions in rows are in the last part, or the first one of
/// traffic; see [`merge_dropped`](super::merge_dropped).
///
/// # Errors
/// Those of [`load`], except for the number of parts, and of `sink`.
pub fn load_parts(
    path: &Path,
    map: Option<&RecordingMap>,
    progress: Option<&ReadProgress>,
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    read_rows(open(path, map, progress)?, path, map, sink)
}

fn open<'p>(
    path: &'p Path,
    map: Option<&RecordingMap>,
    progress: Option<&ReadProgress>,
) -> Result<RowReader<'p>, RecordingError> {
    let mut file = binary::RecordingFile::open(path, progress)
        .map_err(|source| binary::read_error(path, source))?;
    let mut start = Vec::new();
    file.by_ref()
        .take(binary::START_BYTES)
        .read_to_end(&mut start)
        .map_err(|source| binary::read_error(path, source))?;
    let spec = map.map(RecordingMap::spec);
    match binary::BinaryFormat::detect(&start) {
        Some(format) => binary::open(format, binary::Input::File(file), path, spec),
        None => RowReader::new(Cursor::new(start).chain(file), path, spec),
    }
}

/// Returns the only part of a recording.
fn only_part(
    path: &Path,
    read: impl FnOnce(&mut PartSink<'_>) -> Result<(), RecordingError>,
) -> Result<Recording, RecordingError> {
    let mut only = None;
    read(&mut |part| match only.replace(part) {
        None => Ok(true),
        Some(_) => Err(RecordingError::TooLong {
            path: path.to_owned(),
        }),
    })?;
    only.ok_or_else(|| RecordingError::Empty {
        path: path.to_owned(),
    })
}

/// Reads the bytes of a recording file; `path` only names it.
///
/// Fails for lines above a mebibyte, 200 vehicles of a platoon or a million events. Ignores a byte order mark and
/// carriage returns before line feeds.
///
/// # Errors
/// Those of [`load`], except for reading the file.
pub fn read(
    bytes: &[u8],
    path: &Path,
    map: Option<&RecordingMap>,
) -> Result<Recording, RecordingError> {
    let spec = map.map(RecordingMap::spec);
    let table = match binary::BinaryFormat::detect(bytes) {
        Some(format) => binary::open(format, binary::Input::Bytes(bytes.to_vec()), path, spec)?,
        None => RowReader::new(bytes, path, spec)?,
    };
    only_part(path, |sink| read_rows(table, path, map, sink))
}

fn read_rows(
    mut table: RowReader<'_>,
    path: &Path,
    map: Option<&RecordingMap>,
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let Some(first) = table.next_header()? else {
        return Err(RecordingError::Empty {
            path: path.to_owned(),
        });
    };
    let built_in;
    let map = match map {
        Some(map) => map,
        None => {
            let name = match first.text(0) {
                "Date" => "openacc",
                "event" => "car-following",
                name => match RecordingMap::recognise(first.fields.iter()) {
                    Some(map) => return first.reject_line(LineProblem::NeedsMap { map }),
                    None => {
                        return first.reject_line(LineProblem::UnknownFormat {
                            found: table::excerpt(name),
                        });
                    }
                },
            };
            let map = RecordingMap::built_in(name).transpose();
            built_in = map.map_err(|error| RecordingError::Map(Box::new(error)))?;
            match &built_in {
                Some(map) => map,
                None => return first.reject_line(LineProblem::NeedsMap { map: name }),
            }
        }
    };
    read_with_map(&mut table, map.spec(), first, sink)
}

fn read_with_map(
    table: &mut RowReader<'_>,
    map: &RecordingMapSpec,
    first: CsvRow<'_>,
    sink: &mut PartSink<'_>,
) -> Result<(), RecordingError> {
    let mut lines = Vec::new();
    let mut names = first;
    while lines.len() < map.lines_before_names {
        lines.push(names.fields);
        let expected = if lines.len() < map.lines_before_names {
            "the end of its header lines"
        } else {
            "the names of its columns"
        };
        let Some(next) = table.next_header()? else {
            return table.reject_cut_short(expected);
        };
        names = next;
    }
    match &map.layout {
        LayoutSpec::Platoon(platoon) => platoons::read(table, (map, platoon), &lines, &names, sink),
        LayoutSpec::Pairs(pairs) => pairs::read(table, (map, pairs), &names, sink),
        LayoutSpec::Tracks(tracks) => traffic::read(table, (map, tracks), &names, sink),
    }
}
