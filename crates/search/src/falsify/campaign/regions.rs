//! Regions of failures: a small decision tree over the points of the reference searches.

use serde::{Deserialize, Serialize};

use crumple_world::scenario::space::{ScenarioSpace, SpaceParameter};

const MAX_DEPTH: usize = 3;
const THRESHOLD_COUNT: usize = 15;
const MIN_SHARE: f64 = 0.02;
/// Maximum number of points for the tree: the first ones, which represent both reference searches.
const MAX_POINTS: usize = 40_000;

/// Points of the reference searches, with true for a failure. The points are spread evenly, so that the share of points
/// in a region estimates its share of the space.
#[derive(Debug, Clone, Default)]
pub(super) struct LabelledPoints {
    points: Vec<(Vec<f64>, bool)>,
}

/// A region of the space, with its failures.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Region {
    /// Conditions of the region, one per split; empty for the whole space.
    pub conditions: Vec<String>,
    /// Points of the reference searches in it.
    #[serde(default)]
    pub points: usize,
    /// Number of them that fail.
    #[serde(default)]
    pub failing: usize,
    /// Share of the space, in percent.
    pub space_percent: f64,
    /// Share of failing points in the region, in percent.
    pub failing_percent: f64,
    /// Share of all failing points that lie in the region, in percent.
    pub failures_percent: f64,
}

impl LabelledPoints {
    pub(super) fn add(&mut self, values: Vec<f64>, fails: bool) {
        self.points.push((values, fails));
    }

    pub(super) fn is_full(&self) -> bool {
        self.points.len() >= MAX_POINTS
    }

    /// Returns the regions, the highest share of failures first; empty if no point or every point fails.
    pub(super) fn find_regions(&self, space: &ScenarioSpace) -> Vec<Region> {
        let all: Vec<&(Vec<f64>, bool)> = self.points.iter().collect();
        let failing = count_failures(&all);
        if failing == 0 || failing == all.len() {
            return Vec::new();
        }
        let mut grower = TreeGrower { space, total: all.len(), failing, regions: Vec::new() };
        grower.grow(&all, &mut Vec::new());
        let mut found = grower.regions;
        found.sort_by(|a, b| b.failing_percent.total_cmp(&a.failing_percent));
        found
    }
}

fn count_failures(points: &[&(Vec<f64>, bool)]) -> usize {
    points.iter().filter(|(_, fails)| *fails).count()
}

struct TreeGrower<'a> {
    space: &'a ScenarioSpace,
    total: usize,
    failing: usize,
    regions: Vec<Region>,
}

#[derive(Debug, Clone, Copy)]
struct Split {
    coordinate: usize,
    threshold: f64,
}

impl TreeGrower<'_> {
    fn grow(&mut self, points: &[&(Vec<f64>, bool)], path: &mut Vec<(Split, bool)>) {
        let split = if path.len() < MAX_DEPTH { self.best_split(points) } else { None };
        let Some(split) = split else {
            let failing = count_failures(points);
            let percent = |part: usize, whole: usize| 100.0 * part as f64 / whole.max(1) as f64;
            self.regions.push(Region {
                conditions: self.conditions(path),
                points: points.len(),
                failing,
                space_percent: percent(points.len(), self.total),
                failing_percent: percent(failing, points.len()),
                failures_percent: percent(failing, self.failing),
            });
            return;
        };
        let (below, above): (Vec<_>, Vec<_>) = points.iter().partition(|(values, _)| split.is_below(values));
        for (side, below) in [(below, true), (above, false)] {
            path.push((split, below));
            self.grow(&side, path);
            path.pop();
        }
    }

    /// Returns the split that lowers the Gini impurity most (Breiman et al., Classification and Regression Trees,
    /// 1984).
    fn best_split(&self, points: &[&(Vec<f64>, bool)]) -> Option<Split> {
        let failing = count_failures(points);
        let least = (MIN_SHARE * self.total as f64).max(1.0);
        let impurity = |failing: f64, count: f64| failing * (count - failing) / count;
        let before = impurity(failing as f64, points.len() as f64);
        let mut best: Option<(f64, Split)> = None;
        for (coordinate, parameter) in self.space.coordinate_parameters().enumerate() {
            for threshold in thresholds(parameter) {
                let split = Split { coordinate, threshold };
                let below = points.iter().filter(|(values, _)| split.is_below(values));
                let (count, hits) =
                    below.fold((0.0, 0.0), |(n, k), (_, fails)| (n + 1.0, k + f64::from(u8::from(*fails))));
                let (rest, rest_hits) = (points.len() as f64 - count, failing as f64 - hits);
                if count < least || rest < least {
                    continue;
                }
                let gain = before - impurity(hits, count) - impurity(rest_hits, rest);
                if gain > 1e-3 * before && best.is_none_or(|(most, _)| gain > most) {
                    best = Some((gain, split));
                }
            }
        }
        best.map(|(_, split)| split)
    }

    fn conditions(&self, path: &[(Split, bool)]) -> Vec<String> {
        let names = self.space.coordinate_names();
        let parameters: Vec<&SpaceParameter> = self.space.coordinate_parameters().collect();
        // Combine several splits of one coordinate into one range.
        let mut coordinates: Vec<usize> = Vec::new();
        for (split, _) in path {
            if !coordinates.contains(&split.coordinate) {
                coordinates.push(split.coordinate);
            }
        }
        let condition = |coordinate: &usize| {
            let (name, parameter) = (names.get(*coordinate)?, parameters.get(*coordinate)?);
            let on = path.iter().filter(|(split, _)| split.coordinate == *coordinate);
            let bound =
                |below: bool| on.clone().filter(move |(_, side)| *side == below).map(|(split, _)| split.threshold);
            let most = bound(true).reduce(f64::min);
            let least = bound(false).reduce(f64::max);
            if parameter.has_named_values() {
                let [low, high] = parameter.range();
                return Some(format!("{name} = {}", parameter.format_value(if most.is_some() { low } else { high })));
            }
            let unit = if parameter.unit() == "1" { String::new() } else { format!(" {}", parameter.unit()) };
            Some(match (least, most) {
                (Some(least), Some(most)) => format!("{name} from {least} to {most}{unit}"),
                (Some(least), None) => format!("{name} above {least}{unit}"),
                (None, Some(most)) => format!("{name} below {most}{unit}"),
                (None, None) => return None,
            })
        };
        coordinates.iter().filter_map(condition).collect()
    }
}

impl Split {
    fn is_below(self, values: &[f64]) -> bool {
        values.get(self.coordinate).is_some_and(|value| *value < self.threshold)
    }
}

/// Returns thresholds evenly over a parameter's range on its own scale, rounded to be readable.
fn thresholds(parameter: &SpaceParameter) -> Vec<f64> {
    let [low, high] = parameter.range();
    if parameter.is_choice() {
        return vec![0.5 * (low + high)];
    }
    let at = |i: usize| parameter.value(i as f64 / (THRESHOLD_COUNT + 1) as f64);
    let rounded = |i: usize| {
        let digits = (1.0 - (at(i) - at(i - 1)).log10().floor()).clamp(0.0, 12.0);
        let scale = 10f64.powf(digits);
        (at(i) * scale).round() / scale
    };
    let mut thresholds: Vec<f64> = (1..=THRESHOLD_COUNT).map(rounded).collect();
    thresholds.dedup();
    thresholds
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::scenario::space::built_in_space;

    #[test]
    fn a_failure_region_is_found_and_reported_in_units() {
        let space = built_in_space("high-risk").unwrap();
        let mut sample = LabelledPoints::default();
        for index in 0..4000 {
            let values = space.values(&space.draw_point(3, index));
            // Small gap ahead of a heavy follower.
            let fails = values[2] < 22.0 && values[10] == 1.0;
            sample.add(values, fails);
        }
        let regions = sample.find_regions(&space);
        let first = &regions[0];
        assert!(first.failing_percent > 90.0 && first.failures_percent > 90.0, "{regions:?}");
        assert!(first.conditions.iter().any(|c| c == "follower_class = heavy"), "{regions:?}");
        assert!(
            first.conditions.iter().any(|c| c.starts_with("gap_behind_m below 2") && c.ends_with(" m")),
            "{regions:?}"
        );
        assert!(regions.iter().map(|region| region.points).sum::<usize>() == 4000);
        assert!((first.failing_percent - 100.0 * first.failing as f64 / first.points as f64).abs() < 1e-9);
        let space_percent: f64 = regions.iter().map(|region| region.space_percent).sum();
        assert!((space_percent - 100.0).abs() < 1e-9);
    }

    #[test]
    fn thresholds_lie_evenly_on_the_parameters_own_scale() {
        let space = built_in_space("high-risk").unwrap();
        let of = |name: &str| thresholds(space.parameters().iter().find(|p| p.name() == name).unwrap());
        let gaps = of("gap_ahead_m");
        assert_eq!(
            (gaps.len(), gaps[7]),
            (THRESHOLD_COUNT, 12.6),
            "the middle of 2 to 80 by logarithm is 12.65: {gaps:?}"
        );
        assert!(gaps.windows(2).all(|pair| (1.2..1.32).contains(&(pair[1] / pair[0]))), "{gaps:?}");
        let onsets = of("lead_onset_s");
        assert_eq!((onsets[0], onsets[7], onsets[14]), (0.66, 1.75, 2.84));
    }
}
