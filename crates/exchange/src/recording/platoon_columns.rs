//! Header lines and columns of a platoon.

use std::collections::BTreeMap;

use super::dropped::{DroppedItem, Omission};
use super::error::{ColumnProblem, RecordingError};
use super::map::{LengthUnit, PlatoonSpec, RecordingMapSpec, SpeedUnit};
use super::series::Clock;
use super::table::{CsvColumn, CsvRow, excerpt};
use super::text_rows::Fields;

/// Maximum number of vehicles of a platoon: ten times that of any published recording.
const MAX_VEHICLES: usize = 200;

#[derive(Default)]
pub(super) struct PlatoonHeader {
    order: Vec<String>,
    number_of_vehicles: usize,
}

impl PlatoonHeader {
    pub(super) fn read_line(&mut self, platoon: &PlatoonSpec, fields: &Fields) {
        let values = fields.iter().skip(1).filter(|value| !value.is_empty());
        let first = fields.get(0);
        if first.is_some() && first == platoon.names_line.as_deref() {
            self.order = values.map(excerpt).collect();
        } else if first.is_some() && first == platoon.count_line.as_deref() {
            self.number_of_vehicles = values.flat_map(str::parse).next().unwrap_or_default();
        }
    }

    /// Returns the name of a vehicle. Names count from vehicle 1 if there are enough, or from the first recorded
    /// vehicle if each has one; otherwise they are ambiguous.
    pub(super) fn name_of<T>(
        &self,
        number: usize,
        recorded: &BTreeMap<usize, T>,
    ) -> Option<String> {
        let last = *recorded.keys().next_back()?;
        let index = if self.order.len() >= last {
            number.checked_sub(1)?
        } else if self.order.len() == recorded.len() {
            recorded.keys().position(|&vehicle| vehicle == number)?
        } else {
            return None;
        };
        self.order.get(index).cloned()
    }
}

pub(super) struct PlatoonColumns {
    pub(super) time: Clock,
    /// Speed columns by number of the vehicle.
    pub(super) speeds: BTreeMap<usize, CsvColumn>,
    /// Spacing columns by number of the vehicle ahead.
    pub(super) gaps: BTreeMap<usize, CsvColumn>,
    /// Name of the columns of spacings.
    spacing: String,
}

impl PlatoonColumns {
    pub(super) fn from_names(
        (map, platoon): (&RecordingMapSpec, &PlatoonSpec),
        names: &CsvRow<'_>,
    ) -> Result<Self, RecordingError> {
        let time = Clock::find(names, &map.time)?;
        let mut speeds = BTreeMap::new();
        let mut gaps = BTreeMap::new();
        for (index, name) in names
            .fields
            .iter()
            .enumerate()
            .filter(|(index, _)| *index != time.column.index)
        {
            let earlier = if let Some(number) = column_number(name, &platoon.speed.column) {
                let unit = SpeedUnit::column_unit(platoon.speed.unit);
                speeds.insert(number, names.column(index, unit)?)
            } else if let Some(number) = column_number(name, &platoon.spacing.column) {
                let unit = LengthUnit::column_unit(platoon.spacing.unit);
                gaps.insert(number, names.column(index, unit)?)
            } else {
                None
            };
            if earlier.is_some() {
                return names.reject(&excerpt(name), ColumnProblem::Repeated);
            }
        }
        if speeds.len().max(gaps.len()) > MAX_VEHICLES {
            return names.reject_too_large(MAX_VEHICLES, "vehicles");
        }
        Ok(Self {
            time,
            speeds,
            gaps,
            spacing: platoon.spacing.column.clone(),
        })
    }

    /// Splits the platoon into lines of two or more vehicles without holes; returns their numbers.
    pub(super) fn split(
        &self,
        names: &CsvRow<'_>,
        header: &PlatoonHeader,
        dropped: &mut Vec<DroppedItem>,
    ) -> Result<Vec<Vec<usize>>, RecordingError> {
        let mut notes = Vec::new();
        let mut lines = self.split_at_unknown_spacings(&mut notes);
        // A count far beyond the columns is a typing error.
        let last = self.speeds.keys().next_back().copied().unwrap_or(0);
        let count = header.number_of_vehicles;
        if count > last && count <= MAX_VEHICLES {
            notes.push(missing_vehicles(last + 1, count, "the platoon ends before"));
        }
        for (number, column) in &self.gaps {
            if !(self.speeds.contains_key(number) && self.speeds.contains_key(&(number + 1))) {
                notes.push(format!(
                    "{}: ignored, because one of its two vehicles has no speed column",
                    column.name
                ));
            }
        }
        for line in &lines {
            if let [number] = **line {
                let reason = "no spacing to a vehicle ahead of it or behind it is recorded";
                notes.push(format!("vehicle {number}: left out, because {reason}"));
            }
        }
        let omissions = notes.into_iter().map(Omission::Note);
        dropped.extend(omissions.map(|omission| names.dropped_item(omission)));
        lines.retain(|line| line.len() > 1);
        if lines.is_empty() {
            return names.reject(
                &excerpt(&self.spacing.replace("{}", "1")),
                ColumnProblem::NoFollower,
            );
        }
        Ok(lines)
    }

    /// Returns the vehicles in lines whose spacings are all known, and adds the reasons of splits to `notes`.
    fn split_at_unknown_spacings(&self, notes: &mut Vec<String>) -> Vec<Vec<usize>> {
        let mut lines: Vec<Vec<usize>> = Vec::new();
        let mut ahead = 0;
        for &number in self.speeds.keys() {
            if number > ahead + 1 {
                let consequence = match ahead {
                    0 => "the platoon starts behind",
                    _ => "the platoon is split there, because the spacing is unknown",
                };
                notes.push(missing_vehicles(ahead + 1, number - 1, consequence));
            }
            match lines.last_mut() {
                Some(line) if number == ahead + 1 && self.gaps.contains_key(&ahead) => {
                    line.push(number)
                }
                _ => {
                    if number == ahead + 1 && ahead > 0 {
                        let column = self.spacing.replace("{}", &ahead.to_string());
                        notes.push(format!(
                            "{column}: no such column, so the platoon is split between vehicles {ahead} and {number}"
                        ));
                    }
                    lines.push(vec![number]);
                }
            }
            ahead = number;
        }
        lines
    }
}

/// Describes vehicles without speed columns.
fn missing_vehicles(first: usize, last: usize, consequence: &str) -> String {
    if first == last {
        format!("vehicle {first} has no speed column: {consequence}")
    } else {
        format!("vehicles {first} to {last} have no speed column: {consequence}")
    }
}

/// Returns the number, from 1, of a column such as `Speed2`, for the pattern `Speed{}`.
pub(super) fn column_number(name: &str, called: &str) -> Option<usize> {
    let (before, after) = called.split_once("{}")?;
    let number = name
        .strip_prefix(before)?
        .strip_suffix(after)?
        .parse::<u16>()
        .ok()?;
    (number > 0).then_some(usize::from(number))
}
