//! The footer of a Parquet file: its columns and where their pages are.

use super::codec::Codec;
use super::column::{ColumnMeaning, FlatColumn, PhysicalType};
use super::thrift::{ThriftReader, ValueType};
use super::{FileBytes, ParquetError};

const MAGIC: &[u8] = b"PAR1";
const ENCRYPTED_MAGIC: &[u8] = b"PARE";
/// Maximum size of the footer; a terabyte in row groups of 100 MB with 20 columns has 20 MB.
const MAX_FOOTER_BYTES: u64 = 64 << 20;
/// Maximum number of columns, with those that contain others.
const MAX_COLUMNS: usize = 100_000;
/// Maximum depth of nested columns.
const MAX_DEPTH: usize = 64;
const MAX_FIXED_BYTES: i64 = 1 << 10;

pub(super) struct Footer {
    /// Wanted columns that are not nested.
    pub(super) columns: Vec<FlatColumn>,
    pub(super) groups: Vec<RowGroup>,
    /// Names of all columns that are not nested.
    pub(super) all_names: Vec<String>,
}

/// Rows that are stored together.
pub(super) struct RowGroup {
    pub(super) rows: u64,
    /// Places of the wanted columns.
    pub(super) chunks: Vec<ColumnChunk>,
}

/// Place of the pages of a column.
#[derive(Debug, Clone, Copy)]
pub(super) struct ColumnChunk {
    pub(super) codec: Codec,
    pub(super) at: u64,
    pub(super) end: u64,
}

/// Columns that contain the next element of the schema.
#[derive(Default)]
struct SchemaNesting {
    /// Number of columns that are still to come within each of them.
    open: Vec<i64>,
}

impl SchemaNesting {
    fn is_complete(&self) -> bool {
        self.open.is_empty()
    }

    /// Adds an element, which contains other columns unless it has values.
    fn add(&mut self, children: i64, has_values: bool) -> Result<(), ParquetError> {
        if self.open.len() > MAX_DEPTH {
            return Err(ParquetError::TooLarge {
                limit: MAX_DEPTH as u64,
                what: "levels of nested columns",
            });
        }
        if let Some(to_come) = self.open.last_mut() {
            *to_come -= 1;
        }
        if !has_values {
            self.open.push(children);
        }
        while self.open.last() == Some(&0) {
            self.open.pop();
        }
        Ok(())
    }
}

/// An element of the schema, which lists columns before those that they contain.
#[derive(Default)]
struct SchemaElement {
    name: String,
    physical: Option<i64>,
    length: i64,
    repetition: i64,
    children: i64,
    converted: Option<i64>,
    scale: i64,
    /// Ids of the logical type and of its unit.
    logical: Option<[i64; 2]>,
}

impl Footer {
    pub(super) fn read(
        file: &mut FileBytes,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<Self, ParquetError> {
        let tail_at = file
            .length
            .checked_sub(8)
            .ok_or(ParquetError::Damaged("it is too short"))?;
        let tail = file.read(tail_at, 8)?;
        match &tail[4..] {
            MAGIC => {}
            ENCRYPTED_MAGIC => return Err(ParquetError::Unsupported("encrypted files".to_owned())),
            _ => return Err(ParquetError::Damaged("the end of the file is missing")),
        }
        let length = tail[..4]
            .iter()
            .rev()
            .fold(0, |all, byte| all << 8 | u64::from(*byte));
        if length > MAX_FOOTER_BYTES {
            return Err(ParquetError::TooLarge {
                limit: MAX_FOOTER_BYTES,
                what: "bytes of metadata",
            });
        }
        let at = tail_at
            .checked_sub(length)
            .ok_or(ParquetError::Damaged("the length of its metadata is wrong"))?;
        Self::parse(&file.read(at, length)?, wanted)
    }

    fn parse(bytes: &[u8], wanted: &dyn Fn(&str) -> bool) -> Result<Self, ParquetError> {
        let mut footer = Self {
            columns: Vec::new(),
            groups: Vec::new(),
            all_names: Vec::new(),
        };
        let mut leaves = None;
        ThriftReader::new(bytes).read_struct(|reader, id, kind| {
            match id {
                2 => leaves = Some(footer.read_schema(reader, kind, wanted)?),
                4 => {
                    let leaves =
                        leaves.ok_or(ParquetError::Damaged("its metadata lacks a schema"))?;
                    for _ in 0..reader.structs(kind)? {
                        let group = footer.read_group(reader, leaves)?;
                        footer.groups.push(group);
                    }
                }
                _ => reader.skip(kind)?,
            }
            Ok::<_, ParquetError>(())
        })?;
        Ok(footer)
    }

    /// Reads the columns. Returns the number of columns with values.
    fn read_schema(
        &mut self,
        reader: &mut ThriftReader<'_>,
        kind: ValueType,
        wanted: &dyn Fn(&str) -> bool,
    ) -> Result<usize, ParquetError> {
        let count = reader.structs(kind)?;
        if count > MAX_COLUMNS {
            return Err(ParquetError::TooLarge {
                limit: MAX_COLUMNS as u64,
                what: "columns",
            });
        }
        let mut nesting = SchemaNesting::default();
        let mut leaves = 0;
        for index in 0..count {
            let element = SchemaElement::read(reader)?;
            let left = (count - index - 1) as i64;
            if !(0..=left).contains(&element.children) || index > 0 && nesting.is_complete() {
                return Err(ParquetError::Damaged("a number of columns is wrong"));
            }
            let is_top_level = nesting.open.len() == 1;
            let has_values = element.children == 0 && index > 0;
            nesting.add(element.children, has_values)?;
            if is_top_level {
                self.all_names.push(element.name.clone());
            }
            if has_values {
                if is_top_level && element.repetition != 2 && wanted(&element.name) {
                    self.columns.push(element.flat_column(leaves)?);
                }
                leaves += 1;
            }
        }
        if nesting.is_complete() {
            Ok(leaves)
        } else {
            Err(ParquetError::Damaged("a number of columns is wrong"))
        }
    }

    fn read_group(
        &self,
        reader: &mut ThriftReader<'_>,
        leaves: usize,
    ) -> Result<RowGroup, ParquetError> {
        let mut group = RowGroup {
            rows: 0,
            chunks: Vec::new(),
        };
        reader.read_struct(|reader, id, kind| {
            match id {
                1 => {
                    if reader.structs(kind)? != leaves {
                        return Err(ParquetError::Damaged("a group of rows lacks a column"));
                    }
                    let mut columns = self.columns.iter().peekable();
                    for leaf in 0..leaves {
                        match columns.next_if(|column| column.leaf == leaf) {
                            Some(column) => group.chunks.push(read_chunk(reader, column)?),
                            None => reader.read_struct(|reader, _, kind| reader.skip(kind))?,
                        }
                    }
                }
                3 => group.rows = positive(reader.number(kind)?)?,
                _ => reader.skip(kind)?,
            }
            Ok(())
        })?;
        Ok(group)
    }
}

fn positive(number: i64) -> Result<u64, ParquetError> {
    u64::try_from(number).map_err(|_| ParquetError::Damaged("a size is negative"))
}

fn read_chunk(
    reader: &mut ThriftReader<'_>,
    column: &FlatColumn,
) -> Result<ColumnChunk, ParquetError> {
    let mut metadata = ChunkMetadata::default();
    let mut is_elsewhere = false;
    reader.read_struct(|reader, id, kind| {
        match id {
            1 => {
                is_elsewhere = true;
                reader.skip(kind)?;
            }
            3 => metadata.read(reader)?,
            _ => reader.skip(kind)?,
        }
        Ok::<_, ParquetError>(())
    })?;
    let Some(data_at) = metadata.data_at.filter(|_| !is_elsewhere) else {
        return Err(ParquetError::Unsupported(format!(
            "the column {}, which is in another file",
            column.shown_name()
        )));
    };
    let at = metadata
        .dictionary_at
        .map_or(data_at, |dictionary_at| dictionary_at.min(data_at));
    let end = at
        .checked_add(metadata.bytes)
        .ok_or(ParquetError::Damaged("a column is too long"))?;
    Ok(ColumnChunk {
        codec: Codec::from_id(metadata.codec)?,
        at,
        end,
    })
}

/// Metadata of the pages of a column in a group of rows.
#[derive(Default)]
struct ChunkMetadata {
    codec: i64,
    /// Size of all pages.
    bytes: u64,
    /// Offsets of the first page with values, and of the dictionary, if there is one.
    data_at: Option<u64>,
    dictionary_at: Option<u64>,
}

impl ChunkMetadata {
    /// Reads the structure in the metadata of a column.
    fn read(&mut self, reader: &mut ThriftReader<'_>) -> Result<(), ParquetError> {
        reader.read_struct(|reader, id, kind| {
            match id {
                4 => self.codec = reader.number(kind)?,
                7 => self.bytes = positive(reader.number(kind)?)?,
                9 => self.data_at = Some(positive(reader.number(kind)?)?),
                11 => {
                    let dictionary_at = positive(reader.number(kind)?)?;
                    self.dictionary_at = Some(dictionary_at).filter(|at| *at > 0);
                }
                _ => reader.skip(kind)?,
            }
            Ok(())
        })
    }
}

impl SchemaElement {
    fn read(reader: &mut ThriftReader<'_>) -> Result<Self, ParquetError> {
        let mut element = Self::default();
        reader.read_struct(|reader, id, kind| {
            match id {
                1 => element.physical = Some(reader.number(kind)?),
                2 => element.length = reader.number(kind)?,
                3 => element.repetition = reader.number(kind)?,
                4 => element.name = String::from_utf8_lossy(reader.binary(kind)?).into_owned(),
                5 => element.children = reader.number(kind)?,
                6 => element.converted = Some(reader.number(kind)?),
                7 => element.scale = reader.number(kind)?,
                10 => element.logical = Some(read_logical_type(reader)?),
                _ => reader.skip(kind)?,
            }
            Ok::<_, ParquetError>(())
        })?;
        Ok(element)
    }

    fn flat_column(&self, leaf: usize) -> Result<FlatColumn, ParquetError> {
        let physical = match self.physical {
            Some(0) => PhysicalType::Boolean,
            Some(1) => PhysicalType::Int32,
            Some(2) => PhysicalType::Int64,
            Some(3) => PhysicalType::Int96,
            Some(4) => PhysicalType::Float,
            Some(5) => PhysicalType::Double,
            Some(6) => PhysicalType::Bytes,
            Some(7) if (1..=MAX_FIXED_BYTES).contains(&self.length) => {
                PhysicalType::FixedBytes(self.length as usize)
            }
            _ => return Err(ParquetError::Damaged("a column has an unknown type")),
        };
        let is_optional = self.repetition == 1;
        Ok(FlatColumn {
            name: self.name.clone(),
            leaf,
            physical,
            meaning: self.meaning(),
            is_optional,
        })
    }

    /// Returns the meaning by the logical type, or by the converted type of older files.
    fn meaning(&self) -> ColumnMeaning {
        let scale = u32::try_from(self.scale).unwrap_or(0).min(100);
        match (self.logical, self.converted) {
            (Some([5, _]), _) | (_, Some(5)) => ColumnMeaning::Decimal { scale },
            (Some([7, 1]), _) | (_, Some(7)) => ColumnMeaning::TimeOfDay { per_second: 1000 },
            (Some([7, 2]), _) | (_, Some(8)) => ColumnMeaning::TimeOfDay {
                per_second: 1_000_000,
            },
            (Some([7, _]), _) => ColumnMeaning::TimeOfDay {
                per_second: 1_000_000_000,
            },
            (Some([10, 0]), _) | (_, Some(11..=14)) => ColumnMeaning::Unsigned,
            (Some([15, _]), _) => ColumnMeaning::Float16,
            _ => ColumnMeaning::Plain,
        }
    }
}

/// Reads a logical type: its id, and the unit of a time or 1 for whole numbers with a sign.
fn read_logical_type(reader: &mut ThriftReader<'_>) -> Result<[i64; 2], ParquetError> {
    let mut logical_type = [0; 2];
    reader.read_struct(|reader, id, _| {
        logical_type[0] = id;
        reader.read_struct(|reader, inner, kind| {
            match (id, inner) {
                // The unit of a time is a union, whose member's id states it.
                (7, 2) => reader.read_struct(|reader, unit, kind| {
                    logical_type[1] = unit;
                    reader.skip(kind).map_err(ParquetError::from)
                })?,
                (10, 2) => {
                    logical_type[1] = i64::from(ThriftReader::boolean(kind));
                    reader.skip(kind)?;
                }
                _ => reader.skip(kind)?,
            }
            Ok::<_, ParquetError>(())
        })?;
        Ok::<_, ParquetError>(())
    })?;
    Ok(logical_type)
}
