//! Text widths, and places for labels that overlap neither each other nor, if possible, data.

use super::path::PixelPoint;

/// A rectangle in the figure, in pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PixelRect {
    /// Left edge.
    pub left: f64,
    /// Top edge.
    pub top: f64,
    /// Width.
    pub width: f64,
    /// Height.
    pub height: f64,
}

impl PixelRect {
    /// Creates the rectangle of that size around a centre.
    #[must_use]
    pub fn from_center((x, y): PixelPoint, width: f64, height: f64) -> Self {
        Self {
            left: x - width / 2.0,
            top: y - height / 2.0,
            width,
            height,
        }
    }

    /// Returns the right edge.
    #[must_use]
    pub fn right(&self) -> f64 {
        self.left + self.width
    }

    /// Returns the bottom edge; y grows downwards.
    #[must_use]
    pub fn bottom(&self) -> f64 {
        self.top + self.height
    }

    #[must_use]
    pub(crate) fn overlaps(&self, other: &Self) -> bool {
        self.left < other.right()
            && other.left < self.right()
            && self.top < other.bottom()
            && other.top < self.bottom()
    }

    #[must_use]
    pub(crate) fn encloses(&self, other: &Self) -> bool {
        self.left <= other.left
            && other.right() <= self.right()
            && self.top <= other.top
            && other.bottom() <= self.bottom()
    }

    /// True if the point lies inside.
    #[must_use]
    pub fn contains(&self, (x, y): PixelPoint) -> bool {
        (self.left..=self.right()).contains(&x) && (self.top..=self.bottom()).contains(&y)
    }
}

/// Returns a width that `text` hardly exceeds in any of the requested fonts, in pixels. The reader's font is unknown,
/// so the estimate uses classes of letters, as wide as in relatives of Verdana.
#[must_use]
pub fn text_width(text: &str, size: f64) -> f64 {
    let em: f64 = text
        .chars()
        .map(|letter| match letter {
            'i' | 'j' | 'l' | 'I' | '.' | ',' | ':' | ';' | '\'' | '|' | '!' | ' ' => 0.34,
            'f' | 't' | 'r' | '(' | ')' | '[' | ']' | '/' | '-' | '1' => 0.43,
            'm' | 'w' | 'M' | 'W' | '%' | '@' => 0.95,
            'A'..='Z' => 0.7,
            letter if u32::from(letter) < 0x2e80 => 0.61,
            _ => 1.0,
        })
        .sum();
    em * size
}

/// Truncates `text` to `width` pixels, with an ellipsis.
#[must_use]
pub(crate) fn truncate_to_width(text: &str, size: f64, width: f64) -> String {
    if text_width(text, size) <= width {
        return text.to_owned();
    }
    let mut letters: Vec<char> = text.chars().collect();
    while letters.pop().is_some() {
        let start: String = letters.iter().collect();
        let candidate = format!("{}\u{2026}", start.trim_end());
        if text_width(&candidate, size) <= width {
            return candidate;
        }
    }
    String::new()
}

/// Breaks `text` between words into lines of at most `width` pixels; a single word may be wider.
#[must_use]
pub(crate) fn wrap_to_width(text: &str, size: f64, width: f64) -> Vec<String> {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if text_width(&format!("{line} {word}"), size) <= width => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines
}

/// Returns positions near `wanted`, in its order, within `limits`, and `spacing` apart or as far as there is room.
#[must_use]
pub(crate) fn spread_evenly(wanted: &[f64], spacing: f64, limits: (f64, f64)) -> Vec<f64> {
    let mut order: Vec<usize> = (0..wanted.len()).collect();
    order.sort_by(|&a, &b| {
        let wanted_a = finite_or(wanted, a, limits.0);
        wanted_a.total_cmp(&finite_or(wanted, b, limits.0))
    });
    let room = (limits.1 - limits.0).max(0.0);
    let spacing = spacing.min(room / (order.len().saturating_sub(1).max(1)) as f64);

    // Least squares under an ordering: subtract the spacing, pool adjacent violators (Ayer et al., 1955), and add it.
    let mut pools: Vec<(f64, usize)> = Vec::new();
    for (rank, &index) in order.iter().enumerate() {
        let wanted_here = finite_or(wanted, index, limits.0);
        let mut pool = (wanted_here - rank as f64 * spacing, 1);
        while let Some(&(mean, count)) = pools.last()
            && mean > pool.0
        {
            pools.pop();
            pool = (
                (mean * count as f64 + pool.0 * pool.1 as f64) / (count + pool.1) as f64,
                count + pool.1,
            );
        }
        pools.push(pool);
    }
    let top = limits.1 - order.len().saturating_sub(1) as f64 * spacing;
    let mut placed = vec![0.0; wanted.len()];
    let bases = pools
        .iter()
        .flat_map(|&(mean, count)| std::iter::repeat_n(mean, count));
    for ((rank, &index), base) in order.iter().enumerate().zip(bases) {
        if let Some(position) = placed.get_mut(index) {
            *position = base.min(top).max(limits.0) + rank as f64 * spacing;
        }
    }
    placed
}

/// Returns the value of that index, or the default for a value that is not finite.
fn finite_or(values: &[f64], index: usize, default: f64) -> f64 {
    let value = values.get(index).copied().filter(|value| value.is_finite());
    value.unwrap_or(default)
}

const CANDIDATES: usize = 64;

/// Distance to other lines beyond which a place is not better, in pixels.
const MAX_CLEARANCE_PX: f64 = 22.0;

/// Returns centres for one label on each line, where the lines are far apart; `None` if there is no room. `lines` run
/// from left to right; `sizes` are widths and heights of the labels. Labels stay inside `frame` and avoid `occupied`,
/// to which they are added.
pub(crate) fn place_line_labels(
    lines: &[Vec<PixelPoint>],
    sizes: &[(f64, f64)],
    frame: PixelRect,
    occupied: &mut Vec<PixelRect>,
) -> Vec<Option<PixelPoint>> {
    let mut centres = Vec::with_capacity(lines.len());
    for (index, &size) in sizes.iter().enumerate().take(lines.len()) {
        let centre = place_label(lines, index, size, frame, occupied);
        occupied.extend(
            centre.map(|centre| PixelRect::from_center(centre, size.0 + 2.0, size.1 + 2.0)),
        );
        centres.push(centre);
    }
    centres
}

/// Returns the centre of a label on the line with that index, as far from other lines as possible.
fn place_label(
    lines: &[Vec<PixelPoint>],
    index: usize,
    (width, height): (f64, f64),
    frame: PixelRect,
    occupied: &[PixelRect],
) -> Option<PixelPoint> {
    let line = lines.get(index)?;
    let from = line.first().map_or(0.0, |point| point.0);
    let to = line.last().map_or(0.0, |point| point.0);
    let mut best: Option<(f64, PixelPoint)> = None;
    for step in 0..=CANDIDATES {
        let x = from + (to - from) * step as f64 / CANDIDATES as f64;
        let Some(y) = interpolate_y(line, x) else {
            continue;
        };
        let label = PixelRect::from_center((x, y), width, height);
        if !frame.encloses(&label) || occupied.iter().any(|other| other.overlaps(&label)) {
            continue;
        }
        let others = lines
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index);
        let clearance = others
            .flat_map(|(_, other)| {
                [x - width / 2.0, x, x + width / 2.0].map(|x| interpolate_y(other, x))
            })
            .flatten()
            .map(|other_y| (other_y - y).abs())
            .fold(MAX_CLEARANCE_PX, f64::min);
        if best.is_none_or(|(score, _)| clearance > score) {
            best = Some((clearance, (x, y)));
        }
    }
    best.map(|(_, centre)| centre)
}

/// Returns y at `x` of a line that runs from left to right; `None` outside it.
fn interpolate_y(line: &[PixelPoint], x: f64) -> Option<f64> {
    let after = line.partition_point(|point| point.0 < x);
    let &(x1, y1) = line.get(after)?;
    let Some(&(x0, y0)) = after.checked_sub(1).and_then(|before| line.get(before)) else {
        return (x1 == x).then_some(y1);
    };
    if x1 > x0 {
        Some(y0 + (y1 - y0) * (x - x0) / (x1 - x0))
    } else {
        Some(y1)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn spread_labels_keep_their_distance_and_order(wanted in proptest::collection::vec(-50.0..350.0f64, 1..20)) {
            let placed = spread_evenly(&wanted, 14.0, (0.0, 280.0));
            for (i, a) in placed.iter().enumerate() {
                prop_assert!((-1e-9..=280.0 + 1e-9).contains(a));
                for (j, b) in placed.iter().enumerate().skip(i + 1) {
                    prop_assert!((a - b).abs() >= 14.0 - 1e-9);
                    prop_assert!(wanted[i] == wanted[j] || (wanted[i] < wanted[j]) == (a < b));
                }
            }
        }

        #[test]
        fn labels_on_lines_cover_neither_each_other_nor_occupied_rectangles(
            heights in proptest::collection::vec(proptest::collection::vec(0.0..240.0f64, 2..30), 1..20),
        ) {
            let frame = PixelRect { left: 0.0, top: 0.0, width: 200.0, height: 240.0 };
            let lines: Vec<Vec<PixelPoint>> = heights
                .iter()
                .map(|line| line.iter().enumerate().map(|(i, &y)| (i as f64 * 6.0, y)).collect())
                .collect();
            let sizes = vec![(16.0, 14.0); lines.len()];
            let corner = PixelRect { left: 100.0, top: 120.0, width: 100.0, height: 120.0 };
            let mut occupied = vec![corner];
            let places = place_line_labels(&lines, &sizes, frame, &mut occupied);
            let labels: Vec<_> = places.iter().flatten().map(|&at| PixelRect::from_center(at, 16.0, 14.0)).collect();
            for (i, label) in labels.iter().enumerate() {
                prop_assert!(frame.encloses(label) && !label.overlaps(&corner));
                prop_assert!(labels.iter().skip(i + 1).all(|other| !other.overlaps(label)));
            }
        }
    }

    #[test]
    fn labels_with_enough_distance_keep_their_positions() {
        assert_eq!(
            spread_evenly(&[10.0, 90.0, 50.0], 14.0, (0.0, 100.0)),
            [10.0, 90.0, 50.0]
        );
        assert_eq!(
            spread_evenly(&[50.0, 50.0], 10.0, (0.0, 100.0)),
            [45.0, 55.0]
        );
        assert_eq!(spread_evenly(&[], 10.0, (0.0, 100.0)), Vec::<f64>::new());
    }

    #[test]
    fn long_names_end_in_an_ellipsis() {
        assert_eq!(truncate_to_width("ego", 12.0, 100.0), "ego");
        assert_eq!(
            truncate_to_width("a follower with a long name", 12.0, 90.0),
            "a follower w\u{2026}"
        );
    }
}
