//! Interpolation of short holes in tracks.

use super::super::parts::MAX_POINTS;
use super::super::series::interpolate_holes;
use super::{Occurrences, TrackPoint, to_ms};

const OPTIONAL_FIELDS: [fn(&mut TrackPoint) -> &mut Option<f64>; 3] = [
    |point| &mut point.position_m,
    |point| &mut point.speed_mps,
    |point| &mut point.length_m,
];

/// Fills holes of at most `longest_s` by interpolation: missing numbers, and missing points between two points of a
/// track in one lane. If vehicles have rows at different times, points at common times replace these rows.
/// Returns the line of the first filled hole and the number of filled values. The error is the line at which there are
/// too many points.
pub(super) fn fill_holes(points: &mut Vec<TrackPoint>, longest_s: f64) -> Result<Occurrences, u64> {
    let longest_ms = to_ms(longest_s);
    if longest_ms <= 0 {
        return Ok(None);
    }
    let Some(step_ms) = median_step_ms(points) else {
        return Ok(None);
    };
    let mut occurrences: Occurrences = None;
    for track in points.chunk_by_mut(|a, b| a.track == b.track) {
        fill_values(track, longest_s, &mut occurrences);
    }
    let times_ms = common_times_ms(points, step_ms, longest_ms);
    let mut filled: Vec<TrackPoint> = Vec::with_capacity(points.len());
    let mut before: Option<TrackPoint> = None;
    for b in points.drain(..) {
        let from = before.replace(b).filter(|a| {
            (a.track, a.lane) == (b.track, b.lane) && b.time_ms - a.time_ms <= longest_ms
        });
        if let Some(a) = from {
            let after = times_ms.partition_point(|time_ms| *time_ms <= a.time_ms);
            for &time_ms in times_ms
                .iter()
                .skip(after)
                .take_while(|time_ms| **time_ms < b.time_ms)
            {
                filled.push(interpolate_point(&a, &b, time_ms));
                occurrences.get_or_insert((a.line, 0)).1 += 1;
            }
        }
        // Without `b`, a vehicle would not count as absent between rows that are too far apart.
        if from.is_none() || times_ms.binary_search(&b.time_ms).is_ok() {
            filled.push(b);
        }
        if filled.len() > MAX_POINTS {
            return Err(b.line);
        }
    }
    *points = filled;
    Ok(occurrences)
}

/// Returns the median time between two points of a track.
fn median_step_ms(points: &[TrackPoint]) -> Option<i64> {
    let steps = points.windows(2).filter_map(|pair| match pair {
        [a, b] if a.track == b.track => Some(b.time_ms - a.time_ms),
        _ => None,
    });
    let mut steps: Vec<i64> = steps.collect();
    steps.sort_unstable();
    steps.get(steps.len() / 2).copied()
}

/// Fills missing numbers of a track, and counts them.
fn fill_values(track: &mut [TrackPoint], longest_s: f64, occurrences: &mut Occurrences) {
    let time_s: Vec<f64> = track
        .iter()
        .map(|point| point.time_ms as f64 / 1000.0)
        .collect();
    for field in OPTIONAL_FIELDS {
        let mut values: Vec<Option<f64>> = track.iter_mut().map(|point| *field(point)).collect();
        if let Some((count, first)) = interpolate_holes(&mut values, &time_s, longest_s) {
            track
                .iter_mut()
                .zip(values)
                .for_each(|(point, value)| *field(point) = value);
            occurrences
                .get_or_insert((track.get(first).map_or(0, |point| point.line), 0))
                .1 += count;
        }
    }
}

/// Returns the point of a track at a time between two others.
fn interpolate_point(a: &TrackPoint, b: &TrackPoint, time_ms: i64) -> TrackPoint {
    let share = (time_ms - a.time_ms) as f64 / (b.time_ms - a.time_ms) as f64;
    let between = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a + (b - a) * share);
    TrackPoint {
        time_ms,
        position_m: between(a.position_m, b.position_m),
        speed_mps: between(a.speed_mps, b.speed_mps),
        length_m: between(a.length_m, b.length_m),
        ..*a
    }
}

/// Returns the times of all rows. Omits those less than half a step after another; adds times in holes common to all
/// vehicles (at most `longest_ms`).
fn common_times_ms(points: &[TrackPoint], step_ms: i64, longest_ms: i64) -> Vec<i64> {
    let mut rows_ms: Vec<i64> = points.iter().map(|point| point.time_ms).collect();
    rows_ms.sort_unstable();
    let mut times_ms: Vec<i64> = Vec::new();
    for row_ms in rows_ms {
        let hole_ms = times_ms.last().map_or(i64::MAX, |last_ms| row_ms - last_ms);
        if 2 * hole_ms.min(step_ms) < step_ms {
            continue;
        }
        if hole_ms <= longest_ms {
            // Frame intervals are not whole milliseconds at some rates.
            let parts = (hole_ms + step_ms / 2) / step_ms;
            times_ms.extend(
                (1..parts)
                    .map(|part| row_ms - hole_ms + (2 * hole_ms * part + parts) / (2 * parts)),
            );
        }
        times_ms.push(row_ms);
    }
    times_ms
}
