//! Every evaluation as a row of Parquet files: `evaluations/part-00000.parquet` and so on, which pandas and polars read as
//! one table.
//!
//! A part holds 65 536 rows, the last one what is left, in the order of evaluation: the method asked for first, then the
//! reference searches. A part appears whole or not at all. Columns: `method`; `evaluation` (from 1, for each method); one for each
//! coordinate in the unit of its parameter (a class by its name); `ln_likelihood`; `robustness`; and, empty where no
//! vehicles touched, `contact_time_s`, `front_vehicle`, `rear_vehicle`, `impact_speed_mps`, `ego_braking`, `rear_class`.

use std::sync::Arc;

use bytes::Bytes;
use parquet::basic::Compression;
use parquet::column::reader::get_typed_column_reader;
use parquet::data_type::{ByteArray, ByteArrayType, DataType, DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::reader::{FileReader, RowGroupReader, SerializedFileReader};
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;
use parquet::schema::types::{ColumnDescPtr, SchemaDescriptor};

use super::terms::Terms;
use super::{CampaignError, Evaluated};
use crate::falsify::Method;
use crate::work::{Changes, Work};
use crumple_world::measure::{Braking, FirstContact, RunVerdict};
use crumple_world::scenario::VehicleClass;
use crumple_world::scenario::space::{Parameter, Space};

/// Rows of a part.
const ROWS: usize = 65_536;

/// Writes rows to parts.
pub(super) struct Table<'a> {
    space: &'a Space,
    work: &'a Work,
    parts: usize,
    rows: Vec<(Method, Evaluated)>,
}

impl<'a> Table<'a> {
    pub(super) fn new(space: &'a Space, work: &'a Work) -> Self {
        Self { space, work, parts: 0, rows: Vec::new() }
    }

    pub(super) fn add(&mut self, method: Method, evaluated: &Evaluated) -> Result<(), CampaignError> {
        self.rows.push((method, evaluated.clone()));
        if self.rows.len() < ROWS {
            return Ok(());
        }
        // A resumed campaign comes by here again, and finds the part as it left it.
        let (name, part) = self.part()?;
        self.parts += 1;
        self.rows.clear();
        Ok(self.work.write(&name, part)?)
    }

    /// What is left, as one of the results.
    pub(super) fn finish(self, results: &mut Changes<'_>) -> Result<(), CampaignError> {
        if !self.rows.is_empty() {
            let (name, part) = self.part()?;
            results.write(&name, part);
        }
        Ok(())
    }

    fn part(&self) -> Result<(String, Vec<u8>), CampaignError> {
        let name = format!("evaluations/part-{:05}.parquet", self.parts);
        Ok((name, self.encode().map_err(CampaignError::encoding)?))
    }

    fn encode(&self) -> Result<Vec<u8>, ParquetError> {
        let schema = Arc::new(parse_message_type(&schema(self.space))?);
        let properties = Arc::new(WriterProperties::builder().set_compression(Compression::SNAPPY).build());
        let mut writer = SerializedFileWriter::new(Vec::new(), schema, properties)?;
        let mut group = writer.next_row_group()?;
        let rows = &self.rows;
        let parameters: Vec<_> = self.space.coordinate_parameters().collect();
        let struck = |of: fn(&FirstContact) -> f64| -> Vec<Option<f64>> {
            rows.iter().map(|(_, row)| row.verdict.contact.as_ref().map(of)).collect()
        };
        let name = |of: fn(&FirstContact) -> &'static str| -> Vec<Option<&'static str>> {
            rows.iter().map(|(_, row)| row.verdict.contact.as_ref().map(of)).collect()
        };
        let mut index = 0_usize;
        while let Some(mut column) = group.next_column()? {
            let after = index as isize - 2 - parameters.len() as isize;
            match (index, parameters.get(index.wrapping_sub(2))) {
                (0, _) => texts(&mut column, rows.iter().map(|(method, _)| Some(method.name())), false)?,
                (1, _) => {
                    let numbers: Vec<i64> = rows.iter().map(|(_, row)| row.number as i64).collect();
                    column.typed::<Int64Type>().write_batch(&numbers, None, None)?;
                }
                (_, Some(parameter)) => {
                    let values = rows.iter().map(|(_, row)| row.values.get(index - 2).copied().unwrap_or(f64::NAN));
                    if parameter.is_named() {
                        let shown: Vec<String> = values.map(|value| parameter.show(value)).collect();
                        texts(&mut column, shown.iter().map(|text| Some(text.as_str())), false)?;
                    } else {
                        column.typed::<DoubleType>().write_batch(&values.collect::<Vec<_>>(), None, None)?;
                    }
                }
                _ => match after {
                    0 => doubles(&mut column, rows.iter().map(|(_, row)| Some(row.ln_likelihood)).collect(), false)?,
                    1 => {
                        doubles(&mut column, rows.iter().map(|(_, row)| Some(row.verdict.robustness)).collect(), false)?
                    }
                    2 => doubles(&mut column, struck(|struck| struck.time_s), true)?,
                    3 => integers(&mut column, struck(|struck| f64::from(struck.front_vehicle)))?,
                    4 => integers(&mut column, struck(|struck| f64::from(struck.rear_vehicle)))?,
                    5 => doubles(&mut column, struck(|struck| struck.impact_speed_mps), true)?,
                    6 => texts(&mut column, name(|struck| struck.ego_braking.name()).into_iter(), true)?,
                    _ => texts(&mut column, name(|struck| struck.rear_class.name()).into_iter(), true)?,
                },
            }
            column.close()?;
            index += 1;
        }
        group.close()?;
        writer.into_inner()
    }
}

/// The columns, as Parquet writes them down.
fn schema(space: &Space) -> String {
    let mut columns = "REQUIRED BINARY method (UTF8); REQUIRED INT64 evaluation;".to_owned();
    for (name, parameter) in space.coordinate_names().iter().zip(space.coordinate_parameters()) {
        let kind = if parameter.is_named() { format!("BINARY {name} (UTF8)") } else { format!("DOUBLE {name}") };
        columns += &format!(" REQUIRED {kind};");
    }
    columns += " REQUIRED DOUBLE ln_likelihood; REQUIRED DOUBLE robustness; OPTIONAL DOUBLE contact_time_s; \
                     OPTIONAL INT32 front_vehicle; OPTIONAL INT32 rear_vehicle; OPTIONAL DOUBLE impact_speed_mps; \
                     OPTIONAL BINARY ego_braking (UTF8); OPTIONAL BINARY rear_class (UTF8);";
    format!("message evaluations {{ {columns} }}")
}

fn presence<T>(values: &[Option<T>], optional: bool) -> Option<Vec<i16>> {
    optional.then(|| values.iter().map(|value| i16::from(value.is_some())).collect())
}

fn doubles(
    column: &mut SerializedColumnWriter<'_>,
    values: Vec<Option<f64>>,
    optional: bool,
) -> Result<(), ParquetError> {
    let present = presence(&values, optional);
    let values: Vec<f64> = values.into_iter().flatten().collect();
    column.typed::<DoubleType>().write_batch(&values, present.as_deref(), None).map(|_| ())
}

fn integers(column: &mut SerializedColumnWriter<'_>, values: Vec<Option<f64>>) -> Result<(), ParquetError> {
    let present = presence(&values, true);
    let values: Vec<i32> = values.into_iter().flatten().map(|value| value as i32).collect();
    column.typed::<Int32Type>().write_batch(&values, present.as_deref(), None).map(|_| ())
}

fn texts<'t>(
    column: &mut SerializedColumnWriter<'_>,
    values: impl Iterator<Item = Option<&'t str>>,
    optional: bool,
) -> Result<(), ParquetError> {
    let values: Vec<Option<&str>> = values.collect();
    let present = presence(&values, optional);
    let values: Vec<ByteArray> = values.into_iter().flatten().map(ByteArray::from).collect();
    column.typed::<ByteArrayType>().write_batch(&values, present.as_deref(), None).map(|_| ())
}

/// The rows of a part, as far as they are kept: of a run in which a controller failed it is not known when.
pub(super) fn decode(part: Vec<u8>, terms: &Terms) -> Result<Vec<(Method, Evaluated)>, CampaignError> {
    let unreadable = CampaignError::encoding;
    let space = &terms.space;
    let reader = SerializedFileReader::new(Bytes::from(part)).map_err(unreadable)?;
    let expected = SchemaDescriptor::new(Arc::new(parse_message_type(&schema(space)).map_err(unreadable)?));
    let form = |schema: &SchemaDescriptor| {
        let column = |column: &ColumnDescPtr| {
            (column.name().to_owned(), column.physical_type(), column.max_def_level(), column.max_rep_level())
        };
        schema.columns().iter().map(column).collect::<Vec<_>>()
    };
    if form(reader.metadata().file_metadata().schema_descr()) != form(&expected) {
        return Err(CampaignError::Encoding("the columns of a part are not those of its space".to_owned()));
    }
    let parameters: Vec<_> = space.coordinate_parameters().collect();
    let mut rows = Vec::new();
    for index in 0..reader.num_row_groups() {
        let group = reader.get_row_group(index).map_err(unreadable)?;
        let columns = Columns { group: &*group, rows: usize::try_from(group.metadata().num_rows()).unwrap_or(0) };
        rows.extend(columns.decode(&parameters, terms).map_err(unreadable)?.into_iter().flatten());
    }
    Ok(rows)
}

/// A group of rows whose columns are as they should be.
struct Columns<'a> {
    group: &'a dyn RowGroupReader,
    rows: usize,
}

impl Columns<'_> {
    /// None for a row that crumple did not write.
    fn decode(
        &self,
        parameters: &[&Parameter],
        terms: &Terms,
    ) -> Result<Vec<Option<(Method, Evaluated)>>, ParquetError> {
        let text = |value: ByteArray| String::from_utf8(value.data().to_vec()).unwrap_or_default();
        let methods = self.column::<ByteArrayType>(0)?;
        let numbers = self.column::<Int64Type>(1)?;
        let mut coordinates = Vec::new();
        for (index, parameter) in (2..).zip(parameters) {
            coordinates.push(match parameter.is_named() {
                true => self
                    .column::<ByteArrayType>(index)?
                    .into_iter()
                    .map(|name| named(parameter, &text(name?)))
                    .collect(),
                false => self.column::<DoubleType>(index)?,
            });
        }
        let after = 2 + parameters.len();
        let (likelihoods, robustness) = (self.column::<DoubleType>(after)?, self.column::<DoubleType>(after + 1)?);
        let (times, impacts) = (self.column::<DoubleType>(after + 2)?, self.column::<DoubleType>(after + 5)?);
        let (fronts, rears) = (self.column::<Int32Type>(after + 3)?, self.column::<Int32Type>(after + 4)?);
        let (brakings, classes) = (self.column::<ByteArrayType>(after + 6)?, self.column::<ByteArrayType>(after + 7)?);
        let at = |values: &[Option<f64>], row: usize| values.get(row).copied().flatten();
        let vehicle = |values: &[Option<i32>], row: usize| u32::try_from(values.get(row).copied().flatten()?).ok();
        let name = |values: &[Option<ByteArray>], row: usize| values.get(row).cloned().flatten().map(text);
        let contact = |row: usize| {
            let (braking, class) = (name(&brakings, row)?, name(&classes, row)?);
            Some(FirstContact {
                time_s: at(&times, row)?,
                front_vehicle: vehicle(&fronts, row)?,
                rear_vehicle: vehicle(&rears, row)?,
                impact_speed_mps: at(&impacts, row)?,
                ego_braking: Braking::ALL.into_iter().find(|known| known.name() == braking)?,
                rear_class: VehicleClass::ALL.iter().copied().find(|known| known.name() == class)?,
            })
        };
        let row = |row: usize| {
            let values = coordinates.iter().map(|values| at(values, row)).collect::<Option<Vec<f64>>>()?;
            let point = terms.space.point(&values);
            let evaluated = Evaluated {
                number: u64::try_from(numbers.get(row).copied().flatten()?).ok()?,
                departure: terms.departure(&point),
                point,
                values,
                ln_likelihood: at(&likelihoods, row)?,
                verdict: RunVerdict { contact: contact(row), ..RunVerdict::new(at(&robustness, row)?) },
            };
            Some((name(&methods, row)?.parse().ok()?, evaluated))
        };
        Ok((0..self.rows).map(row).collect())
    }

    /// A column of that type, none for what is empty.
    fn column<T: DataType>(&self, index: usize) -> Result<Vec<Option<T::T>>, ParquetError> {
        let is_optional = self.group.metadata().column(index).column_descr().max_def_level() > 0;
        let mut reader = get_typed_column_reader::<T>(self.group.get_column_reader(index)?);
        let (mut values, mut present) = (Vec::new(), Vec::new());
        let mut read = 0;
        while read < self.rows {
            let (records, ..) =
                reader.read_records(self.rows - read, is_optional.then_some(&mut present), None, &mut values)?;
            if records == 0 {
                break;
            }
            read += records;
        }
        if !is_optional {
            return Ok(values.into_iter().map(Some).collect());
        }
        let mut values = values.into_iter();
        Ok(present.into_iter().map(|level| if level > 0 { values.next() } else { None }).collect())
    }
}

/// The number of a value that has a name.
fn named(parameter: &Parameter, name: &str) -> Option<f64> {
    let [low, high] = parameter.range();
    (low as u64..=high as u64).map(|number| number as f64).find(|&number| parameter.show(number) == name)
}
