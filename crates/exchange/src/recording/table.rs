//! Rows of numbers from a text file of any size: bounded memory, and errors with file, line and column.

use std::io::{self, Read};
use std::path::Path;

use super::dropped::{DroppedItem, Omission};
use super::error::{BinaryProblem, ColumnProblem, LineProblem, RecordingError};
use super::map::{
    ColumnUnit, DecimalMark, NamedUnit, RecordingMapSpec, is_same_name, list_units, unit_by_name,
    unit_in_name, unknown_unit_in_name,
};
use super::number::parse_number;
use super::text::TextFormat;
use super::text_rows::{Fields, TextRows};

pub(super) struct RowReader<'a> {
    path: &'a Path,
    rows: RowSource<'a>,
    row: CsvRow<'a>,
    decimals: Option<LastDecimals>,
    /// Number of rows until reading ends.
    pub(super) rows_left: usize,
    /// Number of samples that were read.
    pub(super) samples: usize,
}

/// Decimals of the last column in the rows so far.
#[derive(Clone, Copy)]
struct LastDecimals {
    /// Number of decimals in the last row that has some.
    count: usize,
    /// True if all rows have this number.
    is_fixed: bool,
}

enum RowSource<'a> {
    Text(Box<TextRows<'a>>),
    /// Rows, with the names and units of their columns until they are read.
    Binary {
        rows: Box<dyn BinaryRows + 'a>,
        names: Option<(Fields, Fields)>,
    },
}

/// Rows of a file that is no text.
pub(super) trait BinaryRows {
    /// Reads the next row: texts of ids and whole numbers, and numbers, NaN if missing. Returns false at the end.
    fn next_row(
        &mut self,
        texts: &mut Fields,
        numbers: &mut Vec<f64>,
    ) -> Result<bool, BinaryProblem>;
}

impl<'a> RowReader<'a> {
    /// Reads rows whose columns have names and units.
    pub(super) fn from_binary(
        rows: Box<dyn BinaryRows + 'a>,
        names: (Fields, Fields),
        path: &'a Path,
    ) -> Self {
        let rows = RowSource::Binary {
            rows,
            names: Some(names),
        };
        let row = CsvRow::new(path, DecimalMark::Point);
        Self {
            path,
            rows,
            row,
            decimals: None,
            rows_left: usize::MAX,
            samples: 0,
        }
    }

    /// Detects the text format, as far as `map` does not state it.
    pub(super) fn new(
        from: impl Read + 'a,
        path: &'a Path,
        map: Option<&RecordingMapSpec>,
    ) -> Result<Self, RecordingError> {
        if map.is_some_and(|map| map.dbc.is_some()) {
            return Err(RecordingError::Binary {
                path: path.to_owned(),
                problem: BinaryProblem::NeedsMdf,
            });
        }
        let start = CsvRow {
            line: 1,
            ..CsvRow::new(path, DecimalMark::Point)
        };
        let rows = TextRows::new(from, |sample| TextFormat::detect(sample, map));
        let rows = rows.map_err(|error| start.io_error(error))?;
        let decimal = rows.format().decimal;
        Ok(Self {
            path,
            rows: RowSource::Text(Box::new(rows)),
            row: CsvRow::new(path, decimal),
            decimals: None,
            rows_left: usize::MAX,
            samples: 0,
        })
    }

    /// Returns the text format, with the encoding of what was read so far.
    pub(super) fn format(&self) -> TextFormat {
        match &self.rows {
            RowSource::Text(rows) => rows.format(),
            RowSource::Binary { .. } => TextFormat {
                encoding: "UTF-8",
                ..TextFormat::default()
            },
        }
    }

    /// Returns the next row with trimmed fields, such as column names.
    pub(super) fn next_header(&mut self) -> Result<Option<CsvRow<'a>>, RecordingError> {
        let mut row = self.next_row()?.cloned();
        row.iter_mut().for_each(|row| row.fields.trim());
        Ok(row)
    }

    pub(super) fn path(&self) -> &'a Path {
        self.path
    }

    /// Returns the next row that is not blank; `None` at the end of the file.
    pub(super) fn next_row(&mut self) -> Result<Option<&CsvRow<'a>>, RecordingError> {
        let Some(rows_left) = self.rows_left.checked_sub(1) else {
            return Ok(None);
        };
        self.rows_left = rows_left;
        let Self {
            rows,
            row,
            decimals,
            ..
        } = self;
        let is_row = match rows {
            RowSource::Text(rows) => row.read_text(rows, decimals)?,
            RowSource::Binary { names, .. } if names.is_some() => {
                (row.fields, row.units) = names.take().unwrap_or_default();
                true
            }
            RowSource::Binary { rows, .. } => row.read_binary(&mut **rows)?,
        };
        Ok(is_row.then_some(row))
    }

    /// Returns the next row, which must have a field for each column; `None` at the end of the file.
    pub(super) fn next_sample(
        &mut self,
        names: &Fields,
    ) -> Result<Option<&CsvRow<'a>>, RecordingError> {
        if self.next_row()?.is_none() {
            return Ok(None);
        }
        let expected = names.len();
        let count = self.row.fields.len();
        if count != expected {
            let index = count.min(expected.saturating_sub(1));
            return self.row.reject(
                &excerpt(names.get(index).unwrap_or_default()),
                ColumnProblem::FieldCount {
                    expected,
                    found: count,
                },
            );
        }
        self.samples += 1;
        Ok(Some(&self.row))
    }

    /// Returns the row that was read last.
    pub(super) fn row(&self) -> &CsvRow<'a> {
        &self.row
    }

    /// Rejects a recording without samples, and reports a row that the end of the file cuts off.
    pub(super) fn check_samples(
        &self,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<(), RecordingError> {
        dropped.extend(self.row.is_cut.then(|| {
            self.row.dropped_item(Omission::Note(
                "the file ends within this line, so it was left out".to_owned(),
            ))
        }));
        if self.samples == 0 {
            self.reject_cut_short("its first sample")
        } else {
            Ok(())
        }
    }

    pub(super) fn reject_cut_short<T>(&self, expected: &'static str) -> Result<T, RecordingError> {
        self.row.reject_line(LineProblem::CutShort { expected })
    }
}

#[derive(Clone)]
pub(super) struct CsvRow<'a> {
    path: &'a Path,
    decimal: DecimalMark,
    /// Line of a text; row of any other file.
    pub(super) line: u64,
    pub(super) fields: Fields,
    /// Units of the columns, beside their names, if the file states them.
    units: Fields,
    /// Numbers of a row that is no text.
    numbers: Vec<f64>,
    /// True if the last field may lack its end.
    pub(super) is_cut: bool,
}

impl<'a> CsvRow<'a> {
    fn new(path: &'a Path, decimal: DecimalMark) -> Self {
        Self {
            path,
            decimal,
            line: 0,
            fields: Fields::default(),
            units: Fields::default(),
            numbers: Vec::new(),
            is_cut: false,
        }
    }

    /// Reads the next row of a text. Returns false at its end, and for a last row whose decimals are cut off.
    fn read_text(
        &mut self,
        rows: &mut TextRows<'_>,
        earlier: &mut Option<LastDecimals>,
    ) -> Result<bool, RecordingError> {
        match rows.next_row(&mut self.fields) {
            Ok(Some(line)) => self.line = line,
            Ok(None) => return Ok(false),
            Err((line, error)) => {
                self.line = line;
                return Err(self.io_error(error));
            }
        }
        let last = self.text(self.fields.len() - 1);
        let count = last.rfind(['.', ',']).map_or(0, |mark| last.len() - mark);
        // The end of the file may have cut off decimals, if each row has equally many.
        self.is_cut =
            rows.is_cut && earlier.is_some_and(|earlier| earlier.is_fixed && count < earlier.count);
        if count > 0 {
            let is_fixed = earlier.is_none_or(|earlier| earlier.is_fixed && earlier.count == count);
            *earlier = Some(LastDecimals { count, is_fixed });
        }
        Ok(!self.is_cut)
    }

    /// Reads the next row of a file that is no text. Returns false at the end.
    fn read_binary(&mut self, rows: &mut dyn BinaryRows) -> Result<bool, RecordingError> {
        self.line += 1;
        self.fields.clear();
        self.numbers.clear();
        rows.next_row(&mut self.fields, &mut self.numbers)
            .map_err(|problem| RecordingError::Binary {
                path: self.path.to_owned(),
                problem,
            })
    }

    pub(super) fn text(&self, index: usize) -> &str {
        self.fields.get(index).unwrap_or_default().trim()
    }

    /// Returns the indices of the fields with a property.
    fn indices_of(&self, has_property: impl Fn(&str) -> bool) -> Vec<usize> {
        let fields = self.fields.iter().enumerate();
        fields
            .filter(|(_, field)| has_property(field))
            .map(|(index, _)| index)
            .collect()
    }

    /// Returns an error of reading the line, or of its text.
    fn io_error(&self, source: io::Error) -> RecordingError {
        let path = self.path.to_owned();
        if source.kind() != io::ErrorKind::InvalidData {
            return RecordingError::Read { path, source };
        }
        RecordingError::Line {
            path,
            line: self.line,
            problem: LineProblem::Malformed(source.to_string()),
        }
    }

    /// Returns the number of a field; `None` for an empty field or NaN, which many tools write for missing values.
    pub(super) fn number(&self, column: &CsvColumn) -> Result<Option<f64>, RecordingError> {
        let text = self.text(column.index);
        let number = self
            .numbers
            .get(column.index)
            .map(|number| number * column.factor);
        if let Some(number) = number.filter(|number| number.is_finite()) {
            return Ok(Some(number));
        }
        if text.is_empty() && number.is_none_or(f64::is_nan) {
            return Ok(None);
        }
        match parse_number(text, self.decimal) {
            Some(number) if (number * column.factor).is_finite() => {
                Ok(Some(number * column.factor))
            }
            Some(number) if number.is_nan() => Ok(None),
            _ => {
                let hint = match self.decimal {
                    _ if !text.contains(['.', ',']) => "",
                    DecimalMark::Point if parse_number(text, DecimalMark::Comma).is_some() => {
                        "; set decimal = \"comma\" in the map for decimal commas"
                    }
                    DecimalMark::Comma if parse_number(text, DecimalMark::Point).is_some() => {
                        "; set decimal = \"point\" in the map for decimal points"
                    }
                    _ => "",
                };
                self.reject(
                    &column.name,
                    ColumnProblem::NotANumber {
                        found: excerpt(text),
                        hint,
                    },
                )
            }
        }
    }

    /// Returns the column at a place of a row of names. If the map states no unit, it has that of the file, or that in
    /// its name.
    pub(super) fn column(
        &self,
        index: usize,
        unit: ColumnUnit,
    ) -> Result<CsvColumn, RecordingError> {
        let full_name = self.fields.get(index).unwrap_or_default();
        let in_file = self.units.get(index).filter(|unit| !is_missing(unit));
        let unit = match unit {
            ColumnUnit::None => DetectedUnit::stated(1.0),
            ColumnUnit::Frames(interval_s) => DetectedUnit::stated(interval_s),
            ColumnUnit::Quantity { units, stated } => match in_file {
                Some(in_file) => self.unit_of_file(full_name, in_file, units, stated)?,
                None => self.unit_of_name(full_name, units, stated)?,
            },
        };
        Ok(CsvColumn {
            name: excerpt(full_name),
            index,
            factor: unit.factor,
            unit_in_name: unit.in_name,
        })
    }

    /// Returns the unit of a column for which the file states one. That of the map takes precedence.
    fn unit_of_file(
        &self,
        full_name: &str,
        in_file: &str,
        units: &[NamedUnit],
        stated: Option<NamedUnit>,
    ) -> Result<DetectedUnit, RecordingError> {
        match stated.or_else(|| unit_by_name(units, in_file)) {
            Some((_, factor)) => Ok(DetectedUnit::stated(factor)),
            None => self.reject(
                &excerpt(full_name),
                ColumnProblem::UnknownUnit {
                    unit: excerpt(in_file),
                    advice: unit_advice(units, STATE_UNIT),
                },
            ),
        }
    }

    /// Returns the unit of a column for which only its name or the map can state one.
    fn unit_of_name(
        &self,
        full_name: &str,
        units: &[NamedUnit],
        stated: Option<NamedUnit>,
    ) -> Result<DetectedUnit, RecordingError> {
        let named = unit_in_name(units, full_name);
        let unknown = unknown_unit_in_name(units, full_name);
        let problem = match (stated, named, unknown) {
            (Some((in_map, factor)), Some((in_name, name_factor)), _) if name_factor != factor => {
                ColumnProblem::OtherUnit {
                    in_name: in_name.into(),
                    in_map,
                    remedy: "correct the map".into(),
                }
            }
            (Some((in_map, _)), None, Some(unknown)) if unknown.is_certain => {
                ColumnProblem::OtherUnit {
                    in_name: excerpt(&unknown.text).into(),
                    in_map,
                    remedy: format!("crumple knows {}; {CONVERT}", list_units(units)).into(),
                }
            }
            (None, None, Some(unknown)) => ColumnProblem::UnknownUnit {
                unit: excerpt(&unknown.text),
                advice: match unknown.is_certain {
                    true => unit_advice(units, CONVERT),
                    false => unit_advice(units, STATE_UNIT),
                },
            },
            (Some((_, factor)), ..) => return Ok(DetectedUnit::stated(factor)),
            (None, Some((unit, factor)), _) => {
                return Ok(DetectedUnit {
                    factor,
                    in_name: Some(unit),
                });
            }
            (None, None, None) => return Ok(DetectedUnit::stated(1.0)),
        };
        self.reject(&excerpt(full_name), problem)
    }

    pub(super) fn reject<T>(
        &self,
        column: &str,
        problem: ColumnProblem,
    ) -> Result<T, RecordingError> {
        self.reject_line(LineProblem::Column {
            column: column.to_owned(),
            problem,
        })
    }

    pub(super) fn reject_too_large<T>(
        &self,
        limit: usize,
        what: &'static str,
    ) -> Result<T, RecordingError> {
        self.reject_line(LineProblem::TooLarge { limit, what })
    }

    pub(super) fn reject_line<T>(&self, problem: LineProblem) -> Result<T, RecordingError> {
        Err(RecordingError::Line {
            path: self.path.to_owned(),
            line: self.line,
            problem,
        })
    }

    /// Counts an omission whose first occurrence, with count 0, is `first`.
    pub(super) fn count(
        &self,
        counted: &mut Option<DroppedItem>,
        first: impl FnOnce() -> Omission,
    ) {
        let item = counted.get_or_insert_with(|| self.dropped_item(first()));
        item.omission.add(1);
    }

    pub(super) fn dropped_item(&self, omission: Omission) -> DroppedItem {
        DroppedItem {
            path: self.path.to_owned(),
            line: self.line,
            omission,
        }
    }
}

/// Unit of a column.
struct DetectedUnit {
    /// Size of the unit in seconds, metres or metres per second.
    factor: f64,
    /// The unit, if only the name of the column states it.
    in_name: Option<&'static str>,
}

impl DetectedUnit {
    /// Returns a unit that the map or the file states.
    fn stated(factor: f64) -> Self {
        Self {
            factor,
            in_name: None,
        }
    }
}

/// Changes that end an error about a unit.
const CONVERT: &str = "convert the column, and rename it";
const STATE_UNIT: &str = "state the unit in the map";

/// Returns the known units of a quantity, with a change that ends the error.
fn unit_advice(units: &[NamedUnit], change: &str) -> Box<str> {
    format!("not one of {}: {change}", list_units(units)).into()
}

/// Returns whether a text stands for a missing value.
pub(super) fn is_missing(text: &str) -> bool {
    const MARKS: [&str; 7] = ["", "-", "nan", "na", "n/a", "none", "null"];
    text.len() <= 4 && MARKS.iter().any(|mark| text.eq_ignore_ascii_case(mark))
}

/// Returns the beginning of a text, on one line.
pub(super) fn excerpt(text: &str) -> String {
    const MAX_LENGTH: usize = 40;
    let letters = text.chars().take(MAX_LENGTH);
    let mut excerpt: String = letters
        .map(|letter| {
            if letter.is_control() {
                char::REPLACEMENT_CHARACTER
            } else {
                letter
            }
        })
        .collect();
    if text.chars().nth(MAX_LENGTH).is_some() {
        excerpt += "...";
    }
    excerpt
}

#[derive(Debug, Clone)]
pub(super) struct CsvColumn {
    pub(super) name: String,
    pub(super) index: usize,
    /// Size of its unit in seconds, metres or metres per second.
    pub(super) factor: f64,
    /// Unit that its name states, if the map states none.
    pub(super) unit_in_name: Option<&'static str>,
}

impl CsvColumn {
    /// Finds a column by its name. Capital letters matter only if two names differ by nothing else.
    pub(super) fn find(
        names: &CsvRow<'_>,
        name: &str,
        unit: ColumnUnit,
    ) -> Result<Self, RecordingError> {
        let mut indices = names.indices_of(|column| column == name);
        if indices.is_empty() {
            indices = names.indices_of(|column| is_same_name(column, name));
        }
        match indices[..] {
            [index] => names.column(index, unit),
            [] => {
                let list = excerpt(&names.fields.iter().collect::<Vec<_>>().join(", "));
                names.reject(&excerpt(name), ColumnProblem::Missing { known: list })
            }
            _ => names.reject(&excerpt(name), ColumnProblem::Repeated),
        }
    }
}

#[cfg(test)]
mod tests;
