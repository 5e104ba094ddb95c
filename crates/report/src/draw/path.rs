//! SVG path data with few points and short numbers.

use std::fmt;

/// Maximum deviation of a drawn line from its points, in pixels; well below the resolution of printers.
const TOLERANCE_PX: f64 = 0.15;

/// Width of the columns in which only the first, lowest, highest and last point are kept, in pixels.
const COLUMN_PX: f64 = 0.25;

/// A point in the figure, in pixels from its top left corner.
pub(crate) type PixelPoint = (f64, f64);

/// A number of pixels, written with at most one decimal.
#[derive(Debug, Clone, Copy)]
pub(super) struct Px(pub(super) f64);

impl fmt::Display for Px {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let tenths = if self.0.is_finite() {
            (self.0 * 10.0).round()
        } else {
            0.0
        };
        // Adding zero turns -0 into 0.
        write!(out, "{}", tenths / 10.0 + 0.0)
    }
}

impl maud::Render for Px {
    fn render_to(&self, buffer: &mut String) {
        use fmt::Write;
        // Writing to a string cannot fail.
        let _ = write!(buffer, "{self}");
    }
}

pub(super) fn polyline_data(points: &[PixelPoint]) -> String {
    path_data(&simplify(points))
}

pub(super) fn area_data(upper: &[PixelPoint], lower: &[PixelPoint]) -> String {
    let mut outline = simplify(upper);
    outline.extend(simplify(lower).into_iter().rev());
    path_data(&outline) + "Z"
}

/// Returns path data; pairs after the first one following `M` are lines.
fn path_data(points: &[PixelPoint]) -> String {
    let mut text = String::with_capacity(points.len() * 12);
    for (index, (x, y)) in points.iter().enumerate() {
        text.push_str(if index == 0 { "M" } else { " " });
        text.push_str(&format!("{} {}", Px(*x), Px(*y)));
    }
    text
}

/// Returns a subset of the finite points, including the ends, whose line stays within half a pixel of the original.
#[must_use]
pub(crate) fn simplify(points: &[PixelPoint]) -> Vec<PixelPoint> {
    let finite: Vec<PixelPoint> = points
        .iter()
        .copied()
        .filter(|(x, y)| x.is_finite() && y.is_finite())
        .collect();
    douglas_peucker(&decimate_columns(&finite))
}

/// Returns the first, lowest, highest and last point of each narrow column (Jugel et al., "M4", VLDB 2014), which loses
/// no spike. Lines that turn back in x are returned unchanged.
fn decimate_columns(points: &[PixelPoint]) -> Vec<PixelPoint> {
    let forward = points
        .windows(2)
        .all(|pair| matches!(pair, [a, b] if a.0 <= b.0));
    if !forward {
        return points.to_vec();
    }
    let mut decimated = Vec::new();
    for column in points.chunk_by(|a, b| (a.0 / COLUMN_PX).floor() == (b.0 / COLUMN_PX).floor()) {
        let ends = [
            column.first(),
            column.iter().min_by(|a, b| a.1.total_cmp(&b.1)),
            column.iter().max_by(|a, b| a.1.total_cmp(&b.1)),
            column.last(),
        ];
        let mut chosen: Vec<PixelPoint> = ends.into_iter().flatten().copied().collect();
        chosen.sort_by(|a, b| a.0.total_cmp(&b.0));
        chosen.dedup();
        decimated.extend(chosen);
    }
    decimated
}

/// Simplifies a line (Ramer 1972; Douglas and Peucker 1973), with a stack instead of recursion.
fn douglas_peucker(points: &[PixelPoint]) -> Vec<PixelPoint> {
    let Some(last) = points.len().checked_sub(1) else {
        return Vec::new();
    };
    let mut keep = vec![false; points.len()];
    let mut stack = vec![(0, last)];
    while let Some((from, to)) = stack.pop() {
        for end in [from, to] {
            if let Some(is_kept) = keep.get_mut(end) {
                *is_kept = true;
            }
        }
        let Some((&start, &end)) = points.get(from).zip(points.get(to)) else {
            continue;
        };
        let inner = points.iter().enumerate().take(to).skip(from + 1);
        let farthest = inner
            .map(|(index, &point)| (index, distance(point, start, end)))
            .max_by(|a, b| a.1.total_cmp(&b.1).then(b.0.cmp(&a.0)));
        if let Some((index, far)) = farthest
            && far > TOLERANCE_PX
        {
            stack.push((from, index));
            stack.push((index, to));
        }
    }
    points
        .iter()
        .zip(keep)
        .filter_map(|(&point, is_kept)| is_kept.then_some(point))
        .collect()
}

fn distance(point: PixelPoint, start: PixelPoint, end: PixelPoint) -> f64 {
    let dx = end.0 - start.0;
    let dy = end.1 - start.1;
    let px = point.0 - start.0;
    let py = point.1 - start.1;
    let squared = dx * dx + dy * dy;
    let along = if squared > 0.0 {
        ((px * dx + py * dy) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    };
    (px - along * dx).hypot(py - along * dy)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn simplification_keeps_close_to_every_point(
            heights in proptest::collection::vec(0.0..200.0f64, 1..400), width in 1.0..500.0f64,
        ) {
            let last = heights.len() as f64;
            let points: Vec<PixelPoint> =
                heights.iter().enumerate().map(|(i, &y)| (i as f64 / last * width, y)).collect();
            let simplified = simplify(&points);
            prop_assert_eq!(simplified.first(), points.first());
            prop_assert_eq!(simplified.last(), points.last());
            for &point in &points {
                let distances = simplified.windows(2).map(|pair| distance(point, pair[0], pair[1]));
                let near = distances.fold(f64::INFINITY, f64::min);
                prop_assert!(simplified.len() < 2 || near <= TOLERANCE_PX + COLUMN_PX, "{point:?} is {near} px off");
            }
            prop_assert!(simplified.len() as f64 <= 4.0 * (width / COLUMN_PX + 1.0));
        }
    }

    #[test]
    fn a_long_straight_line_needs_two_points() {
        let points: Vec<PixelPoint> = (0..1500)
            .map(|i| (f64::from(i) / 3.0, f64::from(i) / 7.0))
            .collect();
        assert_eq!(simplify(&points).len(), 2);
        assert_eq!(
            polyline_data(&[(0.0, -0.04), (10.0, 2.25), (f64::NAN, 0.0)]),
            "M0 0 10 2.3"
        );
        assert_eq!(polyline_data(&[]), "");
    }
}
