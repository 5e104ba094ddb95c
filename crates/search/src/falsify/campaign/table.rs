//! Every evaluation as a row of Parquet files: `evaluations/part-00000.parquet` and so on, which pandas and polars read as
//! one table.
//!
//! A part holds 65 536 rows, the last one what is left, in the order of evaluation: the method asked for first, then the
//! reference searches. A part appears whole or not at all. Columns: `method`; `evaluation` (from 1, for each method); one for each
//! coordinate in the unit of its parameter (a class by its name); `ln_likelihood`; `robustness`; and, empty where no
//! vehicles touched, `contact_time_s`, `front_vehicle`, `rear_vehicle`, `impact_speed_mps`, `ego_braking`, `rear_class`.

use std::sync::Arc;

use parquet::basic::Compression;
use parquet::data_type::{ByteArray, ByteArrayType, DoubleType, Int32Type, Int64Type};
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use parquet::file::writer::{SerializedColumnWriter, SerializedFileWriter};
use parquet::schema::parser::parse_message_type;

use super::{CampaignError, Evaluated};
use crate::falsify::Method;
use crate::work::{Changes, Work};
use crumple_world::measure::FirstContact;
use crumple_world::scenario::space::Space;

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

    fn schema(&self) -> String {
        let mut columns = "REQUIRED BINARY method (UTF8); REQUIRED INT64 evaluation;".to_owned();
        for (name, parameter) in self.space.coordinate_names().iter().zip(self.space.coordinate_parameters()) {
            let kind = if parameter.is_named() { format!("BINARY {name} (UTF8)") } else { format!("DOUBLE {name}") };
            columns += &format!(" REQUIRED {kind};");
        }
        columns += " REQUIRED DOUBLE ln_likelihood; REQUIRED DOUBLE robustness; OPTIONAL DOUBLE contact_time_s; \
                     OPTIONAL INT32 front_vehicle; OPTIONAL INT32 rear_vehicle; OPTIONAL DOUBLE impact_speed_mps; \
                     OPTIONAL BINARY ego_braking (UTF8); OPTIONAL BINARY rear_class (UTF8);";
        format!("message evaluations {{ {columns} }}")
    }

    fn encode(&self) -> Result<Vec<u8>, ParquetError> {
        let schema = Arc::new(parse_message_type(&self.schema())?);
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
