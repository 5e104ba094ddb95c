//! Search for the worst point within the ranges and tolerances that a clause allows, also between grid values.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::{Deserialize, Serialize};

use super::parameter::TestParameter;
use super::result::{FailedPoint, TestVerdict};
use super::run::{ControllerSetup, Criterion, RunResult};
use super::scenario::PointRun;
use super::spec::TestSpec;
use crumple_core::digest::sha256;
use crumple_sim::engine::FailedControllerRuns;
use crumple_sim::random::{self, Purpose, Stream};

/// Number of uniform samples; a grid with more points has one sample per point. The search then makes [`REFINEMENTS`]
/// rounds of [`SAMPLES_PER_REFINEMENT`] samples near the worst point.
const SAMPLES: usize = 256;
const REFINEMENTS: i32 = 5;
const SAMPLES_PER_REFINEMENT: usize = 48;

/// Worst point found within the ranges of a test.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct WorstInTolerance {
    /// Description of the point.
    pub point: String,
    /// Verdict at the point.
    pub verdict: TestVerdict,
    /// Smallest gap at the point, in metres.
    pub min_gap_m: Option<f64>,
    /// Number of points that were run. A search without failures proves nothing about other points.
    pub points_run: usize,
    /// Number of points that failed.
    pub failures: usize,
    /// Number of failed points without an answer of the controller, and the reason of the first.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Details of the point, if it failed.
    pub failed_point: Option<FailedPoint>,
}

pub(super) struct WorstPoint {
    pub(super) point: Vec<f64>,
    pub(super) run: PointRun,
    pub(super) result: RunResult,
    pub(super) points_run: usize,
    pub(super) failures: usize,
    pub(super) unanswered: Option<FailedControllerRuns>,
}

struct SearchRange<'t> {
    position: usize,
    figure: &'t TestParameter,
    /// True if the clause allows all values between those of the grid, not only their tolerances.
    spans_grid: bool,
}

impl SearchRange<'_> {
    fn ends(&self, point: &[f64]) -> Option<[f64; 2]> {
        let TestParameter {
            values, tolerance, ..
        } = self.figure;
        let [first, last] = match self.spans_grid {
            true => [*values.first()?, *values.last()?],
            false => [*point.get(self.position)?; 2],
        };
        Some([first - tolerance, last + tolerance])
    }
}

fn search_ranges(test: &TestSpec) -> Vec<SearchRange<'_>> {
    test.parameters
        .iter()
        .enumerate()
        .map(|(position, (parameter, figure))| SearchRange {
            position,
            figure,
            spans_grid: test.ranges.contains(&parameter),
        })
        .filter(|range| range.spans_grid || range.figure.tolerance > 0.0)
        .collect()
}

/// Finds the worst point within the ranges and tolerances of a test; `None` without them. The samples depend on the
/// test only.
pub(super) fn find_worst(
    name: &str,
    about: &str,
    test: &TestSpec,
    criterion: Criterion,
    setup: &ControllerSetup<'_>,
) -> Option<WorstPoint> {
    let ranges = search_ranges(test);
    if ranges.is_empty() {
        return None;
    }
    let grid = test.grid();
    let mut search = WorstPointSearch {
        name,
        about,
        test,
        criterion,
        setup,
        ranges,
        stream: random::stream(0, Purpose::Search, 1),
        worst: None,
        points_run: 0,
        failures: 0,
        unanswered: None,
    };
    search.sample_around(&grid);
    for round in 1..=REFINEMENTS {
        search.refine(round);
    }
    let WorstPointSearch {
        points_run,
        failures,
        unanswered,
        worst,
        ..
    } = search;
    worst.map(|(_, worst)| WorstPoint {
        points_run,
        failures,
        unanswered,
        ..worst
    })
}

/// A point of the grid, and a point near it.
type GridNeighbor<'t> = (&'t [f64], Vec<f64>);

struct WorstPointSearch<'t> {
    name: &'t str,
    about: &'t str,
    test: &'t TestSpec,
    criterion: Criterion,
    setup: &'t ControllerSetup<'t>,
    ranges: Vec<SearchRange<'t>>,
    stream: Stream,
    worst: Option<(&'t [f64], WorstPoint)>,
    points_run: usize,
    failures: usize,
    unanswered: Option<FailedControllerRuns>,
}

impl<'t> WorstPointSearch<'t> {
    /// Evaluates uniform samples around the points of the grid.
    fn sample_around(&mut self, grid: &'t [Vec<f64>]) {
        let mut samples = Vec::new();
        for grid_point in grid.iter().cycle().take(SAMPLES.max(grid.len())) {
            let sample = perturb(grid_point, grid_point, &self.ranges, |[low, high], _| {
                low + (high - low) * self.stream.random::<f64>()
            });
            samples.push((grid_point.as_slice(), sample));
        }
        self.evaluate(samples);
    }

    /// Evaluates samples near the worst point so far, nearer with each round from 1.
    fn refine(&mut self, round: i32) {
        let Some((grid_point, worst)) = &self.worst else {
            return;
        };
        let width = 0.25 * 0.5_f64.powi(round);
        let mut samples = Vec::new();
        for _ in 0..SAMPLES_PER_REFINEMENT {
            let sample = perturb(
                grid_point,
                &worst.point,
                &self.ranges,
                |[low, high], value| {
                    let normal: f64 = StandardNormal.sample(&mut self.stream);
                    value + width * (high - low) * normal
                },
            );
            samples.push((*grid_point, sample));
        }
        self.evaluate(samples);
    }

    fn evaluate(&mut self, points: Vec<GridNeighbor<'t>>) {
        let (runs, points): (Vec<PointRun>, Vec<GridNeighbor<'t>>) = points
            .into_iter()
            .filter_map(|(grid_point, point)| Some((self.point_run(&point)?, (grid_point, point))))
            .unzip();
        let results = self.setup.run_points(self.criterion, &runs);
        for (((grid_point, point), run), result) in points.into_iter().zip(runs).zip(results) {
            self.points_run += usize::from(!result.verdict.is_refusal());
            self.failures += usize::from(result.verdict.is_failure());
            FailedControllerRuns::merge(&mut self.unanswered, result.verdict.unanswered());
            let is_worse = self
                .worst
                .as_ref()
                .is_none_or(|(_, worst)| self.severity(&result) > self.severity(&worst.result));
            if is_worse {
                let worst = WorstPoint {
                    point,
                    run,
                    result,
                    points_run: 0,
                    failures: 0,
                    unanswered: None,
                };
                self.worst = Some((grid_point, worst));
            }
        }
    }

    /// Returns a point, ready to be run; `None` if it is invalid.
    fn point_run(&self, point: &[f64]) -> Option<PointRun> {
        let description = self.test.describe_point(point);
        let name = format!("{}-within-{}", self.name, sha256(&description).get(..8)?);
        let about = format!("{} ({description}.)", self.about);
        self.test.point_run(&name, &about, point).ok()
    }

    /// Returns a sort key: collisions by speed, then controller failures, then small gaps or braking without a vehicle
    /// in the way. Refused points rank last.
    fn severity(&self, result: &RunResult) -> (u8, f64) {
        match &result.verdict {
            TestVerdict::Refused { .. } => (0, 0.0),
            TestVerdict::Passed if self.criterion.lead.is_false_activation() => {
                (1, result.max_brake_mps2)
            }
            TestVerdict::Passed => (1, -result.min_gap_m.unwrap_or(f64::INFINITY)),
            TestVerdict::ControllerFailed { .. } => (2, 0.0),
            TestVerdict::Braked { max_brake_mps2, .. } => (3, *max_brake_mps2),
            TestVerdict::Failed {
                impact_speed_mps, ..
            } => (4, *impact_speed_mps),
        }
    }
}

/// Replaces each searched value of `from` by `draw(bounds, value)`, limited to its bounds around the grid point.
fn perturb(
    grid_point: &[f64],
    from: &[f64],
    ranges: &[SearchRange<'_>],
    mut draw: impl FnMut([f64; 2], f64) -> f64,
) -> Vec<f64> {
    let mut point = from.to_vec();
    for range in ranges {
        if let (Some([low, high]), Some(value)) =
            (range.ends(grid_point), point.get_mut(range.position))
        {
            *value = round_to_thousandth(draw([low, high], *value)).clamp(low, high);
        }
    }
    point
}

fn round_to_thousandth(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}
