//! Interpolation of short holes in tracks.

use super::super::parts::MAX_POINTS;
use super::super::series::interpolate_holes;
use super::{Occurrences, TrackPoint, to_ms};

const OPTIONAL_FIELDS: [fn(&mut TrackPoint) -> &mut Option<f64>; 3] =
    [|point| &mut point.position_m, |point| &mut point.speed_mps, |point| &mut point.length_m];

/// Fills holes of at most `longest_s` by interpolation: missing numbers, and missing points between two points of a
/// track in one lane. Returns the line of the first filled hole and the number of filled values. The error is the line
/// at which there are too many points.
pub(super) fn fill_holes(points: &mut Vec<TrackPoint>, longest_s: f64) -> Result<Occurrences, u64> {
    let longest_ms = to_ms(longest_s);
    let steps = points.windows(2).filter_map(|pair| match pair {
        [a, b] if a.track == b.track && longest_ms > 0 => Some(b.time_ms - a.time_ms),
        _ => None,
    });
    let mut steps: Vec<i64> = steps.collect();
    steps.sort_unstable();
    let Some(&step_ms) = steps.get(steps.len() / 2) else { return Ok(None) };
    let mut found: Occurrences = None;
    for track in points.chunk_by_mut(|a, b| a.track == b.track) {
        let time_s: Vec<f64> = track.iter().map(|point| point.time_ms as f64 / 1000.0).collect();
        for number in OPTIONAL_FIELDS {
            let mut values: Vec<Option<f64>> = track.iter_mut().map(|point| *number(point)).collect();
            if let Some((count, first)) = interpolate_holes(&mut values, &time_s, longest_s) {
                track.iter_mut().zip(values).for_each(|(point, value)| *number(point) = value);
                found.get_or_insert((track.get(first).map_or(0, |point| point.line), 0)).1 += count;
            }
        }
    }
    let mut filled: Vec<TrackPoint> = Vec::new();
    for pair in points.windows(2) {
        let [a, b] = pair else { continue };
        let hole_ms = b.time_ms - a.time_ms;
        if (a.track, a.lane) != (b.track, b.lane) || hole_ms > longest_ms {
            continue;
        }
        // Frame intervals are not whole milliseconds at some rates.
        let parts = (hole_ms + step_ms / 2) / step_ms;
        for part in 1..parts {
            let share = part as f64 / parts as f64;
            let between = |a: f64, b: f64| a + (b - a) * share;
            filled.push(TrackPoint {
                time_ms: between(a.time_ms as f64, b.time_ms as f64).round() as i64,
                position_m: a.position_m.zip(b.position_m).map(|(a, b)| between(a, b)),
                speed_mps: a.speed_mps.zip(b.speed_mps).map(|(a, b)| between(a, b)),
                length_m: a.length_m.zip(b.length_m).map(|(a, b)| between(a, b)),
                ..*a
            });
        }
        if points.len() + filled.len() > MAX_POINTS {
            return Err(a.line);
        }
    }
    if let Some(TrackPoint { line, .. }) = filled.first() {
        found.get_or_insert((*line, 0)).1 += filled.len();
    }
    points.append(&mut filled);
    points.sort_unstable_by_key(|point| (point.track, point.time_ms));
    Ok(found)
}
