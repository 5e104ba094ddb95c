//! Evaluation log: one row per evaluation, in CSV files `evaluations/part-00000.csv.gz` and so on, as pandas reads
//! them.
//!
//! A part has 65 536 rows, the last part the rest, in the order of evaluation: first the requested method, then the
//! reference searches. Columns, in this order: `method`; `evaluation` (from 1, for each method); one column for each
//! coordinate in the unit of its parameter (a class or driver by its name); `ln_likelihood`; `robustness`; and, empty
//! without a collision, `collision_time_s`, `front_vehicle`, `rear_vehicle`, `impact_speed_mps`, `ego_braking`,
//! `rear_class`. Numbers read back exactly.

use std::io::Read;

use csv::{StringRecord, Writer};
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;

use super::resolved_config::ResolvedConfig;
use super::{CampaignError, EvaluatedPoint};
use crate::falsify::Method;
use crumple_measure::{BrakingLevel, FirstCollision, RunVerdict};
use crumple_sim::scenario::VehicleClass;
use crumple_spaces::{KEY_COLUMNS, RESULT_COLUMNS, ScenarioSpace, SpaceParameter};
use crumple_store::run_folder::{FolderTransaction, RunFolder};

const ROWS_PER_PART: usize = 65_536;

/// Maximum bytes of a field with commas and quotes: longer than any number or name.
const MAX_FIELD_BYTES: usize = 64;

const EXTENSION: &str = ".csv.gz";

#[derive(Default)]
pub(super) struct EvaluationTable {
    part_count: usize,
    rows: Vec<(Method, EvaluatedPoint)>,
}

impl EvaluationTable {
    pub(super) fn add(
        &mut self,
        space: &ScenarioSpace,
        method: &Method,
        evaluated: &EvaluatedPoint,
        folder: &RunFolder,
    ) -> Result<(), CampaignError> {
        self.rows.push((method.clone(), evaluated.clone()));
        if self.rows.len() < ROWS_PER_PART {
            return Ok(());
        }
        // A resumed campaign writes the same part again.
        let part = self.encode_rows(space)?;
        folder.write(&self.part_name(), part)?;
        self.part_count += 1;
        self.rows.clear();
        Ok(())
    }

    pub(super) fn finish(
        &self,
        space: &ScenarioSpace,
        results: &mut FolderTransaction<'_>,
    ) -> Result<(), CampaignError> {
        if !self.rows.is_empty() {
            results.write(&self.part_name(), self.encode_rows(space)?);
        }
        Ok(())
    }

    fn part_name(&self) -> String {
        format!("evaluations/part-{:05}{EXTENSION}", self.part_count)
    }

    fn encode_rows(&self, space: &ScenarioSpace) -> Result<Vec<u8>, CampaignError> {
        self.write_rows(space)
            .map_err(CampaignError::from_encoding_error)
    }

    fn write_rows(&self, space: &ScenarioSpace) -> Result<Vec<u8>, csv::Error> {
        let mut table = Writer::from_writer(GzEncoder::new(Vec::new(), Compression::fast()));
        table.write_record(columns(space))?;
        let parameters: Vec<_> = space.coordinate_parameters().collect();
        for (method, row) in &self.rows {
            table.write_field(method.name())?;
            table.write_field(row.number.to_string())?;
            for (parameter, value) in parameters.iter().zip(&row.values) {
                table.write_field(if parameter.has_named_values() {
                    parameter.format_value(*value)
                } else {
                    format_number(*value)
                })?;
            }
            table.write_field(format_number(row.ln_likelihood))?;
            table.write_field(format_number(row.verdict.robustness))?;
            let collision = row.verdict.collision.as_ref().map(|collision| {
                [
                    format_number(collision.time_s),
                    collision.front_vehicle.to_string(),
                    collision.rear_vehicle.to_string(),
                    format_number(collision.impact_speed_mps),
                    collision.ego_braking.name().to_owned(),
                    collision.rear_class.name().to_owned(),
                ]
            });
            table.write_record(collision.unwrap_or_default())?;
        }
        let compressed = table.into_inner().map_err(|error| error.into_error())?;
        Ok(compressed.finish()?)
    }
}

fn columns(space: &ScenarioSpace) -> Vec<String> {
    let mut columns = Vec::from(KEY_COLUMNS.map(str::to_owned));
    columns.extend(space.coordinate_names());
    columns.extend(RESULT_COLUMNS.map(str::to_owned));
    columns
}

/// Returns the present name of a column, for logs of releases up to 0.3.0.
fn present_name(column: &str) -> &str {
    match column {
        "contact_time_s" => "collision_time_s",
        present => present,
    }
}

/// Formats a number so that it reads back exactly, with an exponent if decimals would be long.
fn format_number(value: f64) -> String {
    format!("{value:?}")
}

/// Reads the rows of a part. A log does not record the failure of a controller, so its verdicts omit it.
///
/// # Errors
/// [`CampaignError::Encoding`] if it is not a part of a campaign in the space of `config`.
pub(super) fn decode_part(
    name: &str,
    part: &[u8],
    config: &ResolvedConfig,
) -> Result<Vec<(Method, EvaluatedPoint)>, CampaignError> {
    let damaged = |problem: &str| CampaignError::Encoding(format!("{name}: {problem}"));
    if !name.ends_with(EXTENSION) {
        return Err(damaged(
            "an earlier release wrote this log, in a format that this release does not read",
        ));
    }
    let columns = columns(&config.space);
    let header: usize = columns.iter().map(|column| column.len() + 3).sum();
    // A few compressed bytes can stand for gigabytes.
    let most = header + ROWS_PER_PART * columns.len() * MAX_FIELD_BYTES;
    let mut table = csv::Reader::from_reader(GzDecoder::new(part).take(most as u64));
    let headers = table
        .headers()
        .map_err(|error| damaged(&error.to_string()))?;
    let has_columns = headers.iter().map(present_name).eq(&columns);
    if !has_columns {
        return Err(damaged(
            "the columns differ from the parameters of the campaign's space",
        ));
    }
    let parameters: Vec<_> = config.space.coordinate_parameters().collect();
    let mut record = StringRecord::new();
    let mut rows = Vec::new();
    while table
        .read_record(&mut record)
        .map_err(|error| damaged(&error.to_string()))?
    {
        rows.push(parse_row(&record, &parameters, config).ok_or_else(|| {
            let line = record.position().map_or(0, csv::Position::line);
            damaged(&format!("line {line} is not an evaluation"))
        })?);
    }
    Ok(rows)
}

/// Parses a row; `None` if crumple did not write it.
fn parse_row(
    record: &StringRecord,
    parameters: &[&SpaceParameter],
    config: &ResolvedConfig,
) -> Option<(Method, EvaluatedPoint)> {
    let mut fields = record.iter();
    let method = fields.next()?.parse().ok()?;
    let number = fields.next()?.parse().ok()?;
    let values = parameters
        .iter()
        .map(|parameter| parse_value(parameter, fields.next()?))
        .collect::<Option<Vec<f64>>>()?;
    let ln_likelihood = fields.next()?.parse().ok()?;
    let robustness = fields.next()?.parse().ok()?;
    let collision = match <[&str; 6]>::try_from(fields.collect::<Vec<_>>()).ok()? {
        ["", "", "", "", "", ""] => None,
        fields => Some(parse_collision(fields)?),
    };
    let point = config.space.point(&values);
    let evaluated = EvaluatedPoint {
        number,
        distance_from_nominal: config.distance_from_nominal(&point),
        point,
        values,
        ln_likelihood,
        harm: 0.0,
        verdict: RunVerdict {
            collision,
            ..RunVerdict::new(robustness)
        },
    };
    Some((method, evaluated))
}

/// Parses time, vehicles, impact speed, braking of the ego vehicle and class of the rear vehicle.
fn parse_collision(
    [time, front, rear, impact, braking, class]: [&str; 6],
) -> Option<FirstCollision> {
    Some(FirstCollision {
        time_s: time.parse().ok()?,
        front_vehicle: front.parse().ok()?,
        rear_vehicle: rear.parse().ok()?,
        impact_speed_mps: impact.parse().ok()?,
        ego_braking: BrakingLevel::ALL
            .into_iter()
            .find(|level| level.name() == braking)?,
        rear_class: VehicleClass::ALL
            .iter()
            .copied()
            .find(|candidate| candidate.name() == class)?,
    })
}

fn parse_value(parameter: &SpaceParameter, field: &str) -> Option<f64> {
    if parameter.has_named_values() {
        parse_named_value(parameter, field)
    } else {
        field.parse().ok()
    }
}

fn parse_named_value(parameter: &SpaceParameter, name: &str) -> Option<f64> {
    let [low, high] = parameter.range();
    (low as u64..=high as u64)
        .map(|number| number as f64)
        .find(|&number| parameter.format_value(number) == name)
}
