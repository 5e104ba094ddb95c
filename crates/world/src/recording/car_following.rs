//! Car-following events: one leader and one follower, cut out of a traffic recording.
//!
//! One header line, `event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps`, then one row for each
//! instant. Rows of one event stand together; each event becomes a platoon of two. The relative speed is leader's minus
//! follower's: it supplies whichever of the two is missing, and contradicts them or not.

use std::io::Read;
use std::mem;

use super::dropped::{Dropped, Omission};
use super::error::{ColumnProblem, RecordingError, ValueProblem};
use super::series::{Clock, Quantity, Series};
use super::table::{Column, Extent, Row, Table, excerpt};
use super::{Format, Platoon, Recording, Vehicle};

const RELATIVE_SPEED: &str = "relative_speed_mps";
const COLUMNS: [&str; 6] = ["event", "time_s", "gap_m", "follower_speed_mps", RELATIVE_SPEED, "leader_speed_mps"];

/// Largest difference between the three speeds that is put down to rounding and filtering, in m/s.
const SPEED_AGREEMENT_MPS: f64 = 0.1;
/// Most events of one file. Each takes about a kilobyte beside its samples, however few those are.
const MOST_EVENTS: usize = 100_000;

/// Reads what follows the column names.
pub(super) fn read<R: Read>(table: &mut Table<'_, R>, names: &Row<'_>) -> Result<Recording, RecordingError> {
    for (index, name) in COLUMNS.into_iter().enumerate() {
        if names.text(index) != name {
            return names.misnamed(name, ColumnProblem::Expected { found: excerpt(names.text(index)) });
        }
    }
    if let Some(extra) = names.fields.get(COLUMNS.len()) {
        return names
            .misnamed("leader_speed_mps", ColumnProblem::Expected { found: format!("{} after it", excerpt(extra)) });
    }
    let mut extent = Extent::new(&names.fields, 3);
    let mut events = Events::new();
    while let Some(row) = table.next_row()? {
        extent.admit(row)?;
        events.take(row)?;
    }
    if extent.rows == 0 {
        return Err(table.cut_short("its first sample"));
    }
    let (path, format) = (table.path().to_owned(), Format::CarFollowing);
    events.finish_event();
    let mut dropped = Vec::new();
    for series in [&events.gap, &events.follower, &events.relative, &events.leader] {
        series.report(&path, extent.rows, &mut dropped);
    }
    events.clock.report(&mut dropped);
    if let Some((mut first, rows)) = events.contradictions {
        if let Omission::SpeedsContradict { count, .. } = &mut first.what {
            *count = rows;
        }
        dropped.push(first);
    }
    Ok(Recording { path, format, platoons: events.platoons, dropped })
}

/// The events read so far, and the one being read.
struct Events {
    platoons: Vec<Platoon>,
    /// The full text: events may differ in their last letter only.
    event: Option<String>,
    clock: Clock,
    time_s: Vec<f64>,
    line: Vec<u64>,
    gap: Series,
    follower: Series,
    relative: Series,
    leader: Series,
    contradictions: Option<(Dropped, usize)>,
}

impl Events {
    fn new() -> Self {
        let column = |index: usize| Column { name: COLUMNS.get(index).copied().unwrap_or_default().to_owned(), index };
        Self {
            platoons: Vec::new(),
            event: None,
            clock: Clock::new(column(1)),
            time_s: Vec::new(),
            line: Vec::new(),
            gap: Series::new(column(2), Quantity::Gap),
            follower: Series::new(column(3), Quantity::Speed),
            relative: Series::new(column(4), Quantity::RelativeSpeed),
            leader: Series::new(column(5), Quantity::Speed),
            contradictions: None,
        }
    }

    fn take(&mut self, row: &Row<'_>) -> Result<(), RecordingError> {
        let event = row.text(0);
        if event.is_empty() {
            return row.wrong("event", ValueProblem::Missing);
        }
        if self.event.as_deref() != Some(event) {
            self.finish_event();
            if self.platoons.len() >= MOST_EVENTS {
                return row.too_large(MOST_EVENTS, "events");
            }
            self.event = Some(event.to_owned());
        }
        let Some(now_s) = self.clock.tick(row)? else { return Ok(()) };
        let gap_m = self.gap.read(row)?;
        let speeds = (self.follower.read(row)?, self.relative.read(row)?, self.leader.read(row)?);
        let (follower_mps, leader_mps) = self.agreed(row, speeds);
        self.time_s.push(now_s);
        self.line.push(row.line);
        self.gap.values.push(gap_m);
        self.follower.values.push(follower_mps);
        self.leader.values.push(leader_mps);
        Ok(())
    }

    /// Follower's and leader's speed from any two of the three columns, or neither if they contradict one another.
    fn agreed(
        &mut self,
        row: &Row<'_>,
        (follower, relative, leader): (Option<f64>, Option<f64>, Option<f64>),
    ) -> (Option<f64>, Option<f64>) {
        let possible = |speed_mps: f64| Quantity::Speed.allows(speed_mps).then_some(speed_mps);
        match (follower, relative, leader) {
            (Some(follower), Some(relative), None) => (Some(follower), possible(follower + relative)),
            (None, Some(relative), Some(leader)) => (possible(leader - relative), Some(leader)),
            (Some(follower), Some(relative), Some(leader)) => {
                let first_error_mps = (relative - (leader - follower)).abs();
                if first_error_mps <= SPEED_AGREEMENT_MPS {
                    return (Some(follower), Some(leader));
                }
                let what = Omission::SpeedsContradict { column: RELATIVE_SPEED, count: 0, first_error_mps };
                self.contradictions.get_or_insert_with(|| (row.dropped(what), 0)).1 += 1;
                (None, None)
            }
            (follower, None, leader) => (follower, leader),
            (None, Some(_), None) => (None, None),
        }
    }

    /// Makes a platoon of the event being read, if there is one.
    fn finish_event(&mut self) {
        self.clock.restart();
        let Some(event) = self.event.take() else { return };
        let vehicle = |number, role: &str, series: &mut Series| Vehicle {
            number,
            name: Some(role.to_owned()),
            speed_mps: mem::take(&mut series.values),
        };
        let vehicles = vec![vehicle(1, "leader", &mut self.leader), vehicle(2, "follower", &mut self.follower)];
        self.platoons.push(Platoon {
            event: Some(excerpt(&event)),
            time_s: mem::take(&mut self.time_s),
            line: mem::take(&mut self.line),
            vehicles,
            gaps_m: vec![mem::take(&mut self.gap.values)],
        });
    }
}
