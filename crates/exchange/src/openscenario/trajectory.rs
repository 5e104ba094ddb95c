//! Speeds of an entity that follows a polyline with times.
//!
//! Between two vertices, the entity moves at constant speed (class `Trajectory`). Rounding of the positions is removed
//! first, and the speeds of a recording are averaged. A speed that changes little from segment to segment is read as
//! smooth; it never leaves the range of the mean speeds of the segments around it.

use super::alternations::Alternations;
use super::recorded::{Averaging, averaging_window_s, recorded_path, with_missing_vertices};
use super::speed_plan::SpeedPlan;
use super::taut_path::{Point, slope, taut_path};

/// Largest distance of a smooth reading from the polyline, in metres, beside the rounding.
const SMOOTHING_M: f64 = 0.005;
/// Largest rounding error that is removed, in metres: that of two decimals in both coordinates, and of one decimal in a
/// recording.
const MAX_ROUNDING_M: f64 = 0.00708;
const MAX_RECORDED_ROUNDING_M: f64 = 0.0708;
/// Rounding error of positions on a coarse grid without alternating accelerations, in metres: the grid is that of round
/// values.
const ROUND_VALUES_M: f64 = 0.0005;
/// Share of the times between vertices that are not longer than a step.
const USUAL_STEPS: f64 = 0.9;
/// Longest time between the vertices of a recording, in seconds.
const RECORDING_STEP_S: f64 = 0.2;
/// Smallest rounding error, in metres: that of calculations with positions.
const MIN_ROUNDING_M: f64 = 1e-7;
/// Speeds that differ by less are equal, in m/s; positions in metres.
const EQUAL_MPS: f64 = 1e-9;
const EQUAL_M: f64 = 1e-9;
/// Errors of the calculation of a mean time between vertices, as a share.
pub(super) const EQUAL_SHARE: f64 = 1e-6;
/// Segments that are shorter are none, in seconds.
const MIN_SPAN_S: f64 = 1e-9;
/// Error of the distance to a vertex where a vehicle joins the polyline, in metres.
const JOINING_M: f64 = 1e-6;
/// Largest share of the ramp from the speed before a trajectory in the time until the vehicle is at a vertex. With a
/// quarter, the speed exceeds that of the trajectory by a seventh of the change.
const JOINING_SHARE: f64 = 0.25;

/// A vertex of a trajectory.
#[derive(Debug, Clone, Copy)]
pub(super) struct PathVertex {
    pub(super) time_s: f64,
    /// Position in the direction of travel, in metres.
    pub(super) position_m: f64,
    /// Position to the left of the road's direction, in metres.
    pub(super) lateral_m: f64,
}

/// Mean speed over a time.
#[derive(Debug, Clone, Copy)]
struct MeanSpeed {
    mps: f64,
    span_s: f64,
}

/// A segment, with a speed that is linear in time.
#[derive(Debug, Clone, Copy)]
struct SpeedSegment {
    start_s: f64,
    end_s: f64,
    mean_mps: f64,
    /// Change of the speed from the middle to the end.
    rise_mps: f64,
}

impl SpeedSegment {
    fn span_s(&self) -> f64 {
        self.end_s - self.start_s
    }

    fn mean_speed(&self) -> MeanSpeed {
        MeanSpeed {
            mps: self.mean_mps,
            span_s: self.span_s(),
        }
    }

    /// Returns the rise of the speed that continues the changes to both neighbours within their mean speeds; 0 at an
    /// extreme.
    fn rise_mps(&self, before: MeanSpeed, after: MeanSpeed, limit_mps: f64) -> f64 {
        let own_share = |neighbour: MeanSpeed| self.span_s() / (self.span_s() + neighbour.span_s);
        let before_mps = self.mean_mps - before.mps;
        let after_mps = after.mps - self.mean_mps;
        if before_mps * after_mps <= 0.0 {
            return 0.0;
        }
        let [before_abs_mps, after_abs_mps] = [before_mps.abs(), after_mps.abs()];
        let rise_mps = before_abs_mps
            .min(after_abs_mps * own_share(after))
            .max(after_abs_mps.min(before_abs_mps * own_share(before)));
        before_mps.signum() * rise_mps.min(limit_mps)
    }

    fn speed_mps(&self, time_s: f64) -> f64 {
        let share = (time_s - self.start_s) / self.span_s();
        self.mean_mps + (2.0 * share - 1.0) * self.rise_mps
    }
}

/// Returns the rounding error of positions on a grid of `resolution_m`, as far as it is removed. A coarse grid is that
/// of the rounding only in a recording with accelerations that alternate, and if the rounding explains them.
pub(super) fn rounding_m(vertices: &[PathVertex], resolution_m: f64) -> f64 {
    let rounding_m = 0.5 * resolution_m;
    if rounding_m <= MAX_ROUNDING_M {
        return rounding_m.max(MIN_ROUNDING_M);
    }
    let step_s = usual_step_s(vertices).map(|step_s| step_s * (1.0 - EQUAL_SHARE));
    let is_frequent = step_s.is_some_and(|step_s| step_s <= RECORDING_STEP_S);
    if !is_frequent || rounding_m > MAX_RECORDED_ROUNDING_M {
        return MIN_ROUNDING_M;
    }
    let alternations = Alternations::from_vertices(vertices);
    if !alternations.are_found() {
        ROUND_VALUES_M
    } else if alternations.are_explained(rounding_m) {
        rounding_m
    } else {
        MIN_ROUNDING_M
    }
}

/// Returns the longest time between vertices but for few that are missing; `None` if there are less than two vertices.
pub(super) fn usual_step_s(vertices: &[PathVertex]) -> Option<f64> {
    let pairs = vertices.iter().zip(vertices.iter().skip(1));
    let mut steps_s: Vec<f64> = pairs.map(|(from, to)| to.time_s - from.time_s).collect();
    steps_s.sort_by(f64::total_cmp);
    let usual = (USUAL_STEPS * steps_s.len().saturating_sub(1) as f64) as usize;
    steps_s.get(usual).copied()
}

/// Lets a plan follow the vertices from the first on. `rounding_m` is the largest error of a position. `limits_mps2`
/// are the braking and the acceleration that the vehicle can drive. Returns the largest distance from the polyline, in
/// metres.
pub(super) fn follow(
    plan: &mut SpeedPlan,
    vertices: &[PathVertex],
    rounding_m: f64,
    limits_mps2: [f64; 2],
) -> f64 {
    let [start, .., end] = vertices else {
        return 0.0;
    };
    plan.cut(start.time_s);
    let smoothing_m = SMOOTHING_M + rounding_m;
    let window_s = averaging_window_s(vertices, rounding_m);
    let path = match window_s {
        Some(window_s) => recorded_path(&with_missing_vertices(vertices), rounding_m, window_s),
        None => path_to_standstill(vertices, rounding_m),
    };
    let mut segments = segments_of(&path);
    let is_recorded = window_s.is_some();
    let begin = set_begin(plan, &mut segments, (is_recorded, smoothing_m), limits_mps2);
    join(&mut segments, begin.speed_mps, limits_mps2);
    push_speeds(plan, &segments, smoothing_m, limits_mps2);
    if let Some(window_s) = window_s {
        Averaging {
            span_s: [start.time_s, end.time_s],
            window_s,
            has_own_start: begin.is_own,
        }
        .apply(plan);
    }
    largest_distance_m(plan, vertices)
}

/// Speed with which the motion along a trajectory begins.
struct BeginSpeed {
    speed_mps: f64,
    /// True for that of the trajectory instead of that of the motion before.
    is_own: bool,
}

/// Sets the changes of the speed within the segments, and returns the speed with which the motion begins: that before,
/// but an initial speed gives way to that of a recording, and to one with which the vehicle can begin the trajectory.
fn set_begin(
    plan: &mut SpeedPlan,
    segments: &mut [SpeedSegment],
    (is_recorded, smoothing_m): (bool, f64),
    limits_mps2: [f64; 2],
) -> BeginSpeed {
    let is_initial = plan.knots().len() == 1;
    let mut begin = BeginSpeed {
        speed_mps: plan.knots().last().map_or(0.0, |knot| knot.speed_mps),
        is_own: false,
    };
    if is_initial && let Some(first) = segments.first() {
        let change_mps = first.mean_mps - begin.speed_mps;
        if 0.5 * drivable_s(change_mps, limits_mps2) * change_mps.abs() > smoothing_m {
            begin.speed_mps = first.mean_mps;
        }
    }
    set_rises(segments, begin.speed_mps, smoothing_m);
    if is_initial && let Some(first) = segments.first() {
        let own_mps = first.speed_mps(first.start_s);
        // Rounding is no reason for a ramp at the start of a recording.
        if is_recorded {
            begin = BeginSpeed {
                speed_mps: own_mps,
                is_own: true,
            };
        }
        plan.set_initial_speed(begin.speed_mps);
    }
    begin
}

/// Returns the segments of a path. A small movement back is a standstill.
fn segments_of(path: &[Point]) -> Vec<SpeedSegment> {
    let pairs = path.iter().zip(path.iter().skip(1));
    pairs
        .map(|(from, to)| SpeedSegment {
            start_s: from.0,
            end_s: to.0,
            mean_mps: slope(*from, *to).max(0.0),
            rise_mps: 0.0,
        })
        .collect()
}

/// Returns the path through the vertices without their rounding. A vehicle that was faster before and does not leave
/// its last position stands there: rounding does not let it creep.
pub(super) fn path_to_standstill(vertices: &[PathVertex], rounding_m: f64) -> Vec<Point> {
    let (Some(last), Some(held_from)) = (vertices.last(), held_from(vertices, rounding_m)) else {
        return taut_path(vertices, rounding_m);
    };
    let mut path = taut_path(vertices.get(..=held_from).unwrap_or(vertices), rounding_m);
    path.push((last.time_s, last.position_m));
    path
}

/// Returns the first of the vertices that hold the last position; `None` if the vehicle may creep through them.
pub(super) fn held_from(vertices: &[PathVertex], rounding_m: f64) -> Option<usize> {
    let last = vertices.last()?;
    let held = vertices
        .iter()
        .rev()
        .take_while(|vertex| vertex.position_m == last.position_m);
    let held_from = vertices.len().checked_sub(held.count())?;
    let held_s = vertices.get(held_from)?.time_s;
    // Before, the vehicle moves farther in the same time than the rounding of both distances explains.
    let moved_m = last.position_m - position_m(vertices, held_s - (last.time_s - held_s));
    (held_from + 1 < vertices.len() && moved_m > 4.0 * rounding_m + EQUAL_M).then_some(held_from)
}

/// Returns the position of the polyline at a time.
fn position_m(vertices: &[PathVertex], time_s: f64) -> f64 {
    let next = vertices.partition_point(|vertex| vertex.time_s <= time_s);
    let before = next.checked_sub(1).and_then(|before| vertices.get(before));
    match (before, vertices.get(next)) {
        (Some(from), Some(to)) => {
            let share = (time_s - from.time_s) / (to.time_s - from.time_s);
            from.position_m + share * (to.position_m - from.position_m)
        }
        (Some(only), None) | (None, Some(only)) => only.position_m,
        (None, None) => 0.0,
    }
}

/// Returns the largest distance of a plan from the polyline, in metres.
fn largest_distance_m(plan: &SpeedPlan, vertices: &[PathVertex]) -> f64 {
    let [start, .., end] = vertices else {
        return 0.0;
    };
    let knots = plan.knots().iter().map(|knot| knot.time_s);
    let knots = knots.filter(|time_s| (start.time_s..=end.time_s).contains(time_s));
    let mut times: Vec<f64> = knots
        .chain(vertices.iter().map(|vertex| vertex.time_s))
        .collect();
    times.sort_by(f64::total_cmp);
    let pairs = times.iter().zip(times.iter().skip(1));
    let extremes = pairs.filter_map(|(from_s, to_s)| extreme_s(plan, vertices, *from_s, *to_s));
    let extremes: Vec<f64> = extremes.collect();
    let distances = times.iter().chain(&extremes);
    distances
        .map(|&time_s| (plan.at(time_s).position_m - position_m(vertices, time_s)).abs())
        .fold(0.0, f64::max)
}

/// Returns the time between two knots at which the plan has the speed of the polyline: their distance is an extreme.
fn extreme_s(plan: &SpeedPlan, vertices: &[PathVertex], from_s: f64, to_s: f64) -> Option<f64> {
    let [from_m, to_m] = [from_s, to_s].map(|time_s| position_m(vertices, time_s));
    let mean_mps = (to_m - from_m) / (to_s - from_s);
    let [from_mps, to_mps] = [from_s, to_s].map(|time_s| plan.at(time_s).speed_mps - mean_mps);
    let crosses = from_mps * to_mps < 0.0;
    crosses.then(|| from_s + (to_s - from_s) * from_mps / (from_mps - to_mps))
}

/// Sets the changes of the speed within the segments. A segment at an extreme has none; the others have at most those
/// that continue one of the neighbours, and stay near the polyline.
fn set_rises(segments: &mut [SpeedSegment], before_mps: f64, smoothing_m: f64) {
    let means: Vec<MeanSpeed> = segments.iter().map(SpeedSegment::mean_speed).collect();
    for (index, segment) in segments.iter_mut().enumerate() {
        let before = match index.checked_sub(1).and_then(|before| means.get(before)) {
            Some(before) => *before,
            None => MeanSpeed {
                mps: before_mps,
                span_s: 0.0,
            },
        };
        // After the last segment, the speed is constant.
        let own = segment.mean_speed();
        let after = means.get(index + 1).copied().unwrap_or(own);
        // A rise of r over a span of h moves the position by r h / 4 in the middle.
        let limit_mps = (4.0 * smoothing_m / segment.span_s()).min(segment.mean_mps.abs());
        segment.rise_mps = segment.rise_mps(before, after, limit_mps);
    }
}

/// Adds the speeds of the segments to a plan, and ramps between them.
fn push_speeds(
    plan: &mut SpeedPlan,
    segments: &[SpeedSegment],
    smoothing_m: f64,
    limits_mps2: [f64; 2],
) {
    for (before, after) in segments.iter().zip(segments.iter().skip(1)) {
        let vertex_s = before.end_s;
        let [from_mps, to_mps] = [before.speed_mps(vertex_s), after.speed_mps(vertex_s)];
        let jump_mps = (to_mps - from_mps).abs();
        if jump_mps < EQUAL_MPS {
            plan.push(vertex_s, to_mps);
            continue;
        }
        let wanted_s =
            (8.0 * smoothing_m / jump_mps).max(drivable_s(to_mps - from_mps, limits_mps2));
        let half_s = 0.5 * wanted_s.min(before.span_s()).min(after.span_s());
        push_ramp(plan, before, after, half_s);
    }
    if let Some(last) = segments.last() {
        plan.push(last.end_s, last.speed_mps(last.end_s).max(0.0));
    }
}

/// Returns the time that the vehicle needs for a change of its speed.
fn drivable_s(change_mps: f64, [brake_mps2, accel_mps2]: [f64; 2]) -> f64 {
    let limit_mps2 = if change_mps < 0.0 {
        brake_mps2
    } else {
        accel_mps2
    };
    change_mps.abs() / limit_mps2
}

/// A ramp from the speed before a trajectory to another one, which the vehicle keeps, and a ramp to the speed after it.
#[derive(Debug, Clone, Copy)]
struct JoiningSpeeds {
    /// Durations of the ramps.
    ramps_s: [f64; 2],
    kept_mps: f64,
    after_mps: f64,
}

impl JoiningSpeeds {
    /// Returns the speeds within limits that cover a distance in a time; `None` if there are none. Without a speed
    /// afterwards, the vehicle keeps its own.
    fn within_limits(
        (before_mps, after_mps): (f64, Option<f64>),
        (distance_m, time_s): (f64, f64),
        limits_mps2: [f64; 2],
    ) -> Option<Self> {
        let [brake_mps2, accel_mps2] = limits_mps2;
        // In this range the ramps take no longer than the time, and the distance grows with the speed.
        let [mut low_mps, mut high_mps] = match after_mps {
            Some(after_mps) => {
                let slack_s = time_s - drivable_s(after_mps - before_mps, limits_mps2);
                if slack_s < 0.0 {
                    return None;
                }
                let change_mps = slack_s / (1.0 / brake_mps2 + 1.0 / accel_mps2);
                [
                    before_mps.min(after_mps) - change_mps,
                    before_mps.max(after_mps) + change_mps,
                ]
            }
            None => [
                before_mps - brake_mps2 * time_s,
                before_mps + accel_mps2 * time_s,
            ],
        };
        low_mps = low_mps.max(0.0);
        let joining = |kept_mps: f64| {
            let after_mps = after_mps.unwrap_or(kept_mps);
            Self {
                ramps_s: [kept_mps - before_mps, after_mps - kept_mps]
                    .map(|change_mps| drivable_s(change_mps, limits_mps2)),
                kept_mps,
                after_mps,
            }
        };
        for _ in 0..60 {
            let middle_mps = 0.5 * (low_mps + high_mps);
            if joining(middle_mps).distance_m(before_mps, time_s) < distance_m {
                low_mps = middle_mps;
            } else {
                high_mps = middle_mps;
            }
        }
        let speeds = joining(high_mps);
        let is_close = (speeds.distance_m(before_mps, time_s) - distance_m).abs() < JOINING_M;
        is_close.then_some(speeds)
    }

    /// Returns a ramp over half of a time, or a shorter one to a standstill, which covers a distance in this time.
    fn beyond_limits(before_mps: f64, (distance_m, time_s): (f64, f64)) -> Self {
        let kept_mps = (distance_m - 0.25 * before_mps * time_s) / (0.75 * time_s);
        let ramp_s = if kept_mps >= 0.0 {
            0.5 * time_s
        } else {
            2.0 * distance_m.max(0.0) / before_mps
        };
        Self {
            ramps_s: [ramp_s, 0.0],
            kept_mps: kept_mps.max(0.0),
            after_mps: kept_mps.max(0.0),
        }
    }

    /// Returns the distance that the vehicle covers in a time.
    fn distance_m(&self, before_mps: f64, time_s: f64) -> f64 {
        let [first_s, last_s] = self.ramps_s;
        self.kept_mps * time_s
            - 0.5 * (self.kept_mps - before_mps) * first_s
            - 0.5 * (self.kept_mps - self.after_mps) * last_s
    }

    /// Returns the segments between two times.
    fn segments(&self, before_mps: f64, [start_s, end_s]: [f64; 2]) -> [SpeedSegment; 3] {
        let [first_s, last_s] = self.ramps_s;
        let ramp = |[start_s, end_s]: [f64; 2], [from_mps, to_mps]: [f64; 2]| SpeedSegment {
            start_s,
            end_s,
            mean_mps: 0.5 * (from_mps + to_mps),
            rise_mps: 0.5 * (to_mps - from_mps),
        };
        let [kept_mps, kept_from_s, kept_until_s] =
            [self.kept_mps, start_s + first_s, end_s - last_s];
        [
            ramp([start_s, kept_from_s], [before_mps, kept_mps]),
            ramp([kept_from_s, kept_until_s], [kept_mps, kept_mps]),
            ramp([kept_until_s, end_s], [kept_mps, self.after_mps]),
        ]
    }
}

/// Replaces the first segments by speeds that lead from the speed before the trajectory to the polyline, unless the
/// trajectory begins with this speed.
fn join(segments: &mut Vec<SpeedSegment>, before_mps: f64, limits_mps2: [f64; 2]) {
    let first = segments
        .first()
        .filter(|first| (first.speed_mps(first.start_s) - before_mps).abs() >= EQUAL_MPS);
    let Some(start_s) = first.map(|first| first.start_s) else {
        return;
    };
    let Some((last, joining)) = joining_speeds(segments, before_mps, limits_mps2) else {
        return;
    };
    let end_s = segments.get(last).map_or(start_s, |last| last.end_s);
    let joining = joining.segments(before_mps, [start_s, end_s]).into_iter();
    let joining = joining.filter(|segment| segment.span_s() > MIN_SPAN_S);
    segments.splice(..=last, joining);
}

/// Returns joining speeds, and the index of the segment at whose end the vehicle is on the polyline again: the first
/// one in whose time the ramp takes a small part. If the vehicle cannot join the polyline, the ramp exceeds its limits.
fn joining_speeds(
    segments: &[SpeedSegment],
    before_mps: f64,
    limits_mps2: [f64; 2],
) -> Option<(usize, JoiningSpeeds)> {
    let first = segments.first()?;
    // A longer way to the polyline would be far from it.
    let enough_s = 2.0 / JOINING_SHARE * drivable_s(first.mean_mps - before_mps, limits_mps2);
    let mut distance_m = 0.0;
    let mut least_share = f64::INFINITY;
    let mut best = None;
    for (index, segment) in segments.iter().enumerate() {
        distance_m += segment.mean_mps * segment.span_s();
        let time_s = segment.end_s - first.start_s;
        let next = segments.get(index + 1);
        let after_mps = next.map(|next| next.speed_mps(next.start_s));
        let speeds_mps = (before_mps, after_mps);
        let path = (distance_m, time_s);
        let joining = JoiningSpeeds::within_limits(speeds_mps, path, limits_mps2);
        let Some(joining) = joining.filter(|joining| joining.ramps_s[0] < least_share * time_s)
        else {
            continue;
        };
        least_share = joining.ramps_s[0] / time_s;
        best = Some((index, joining));
        if least_share <= JOINING_SHARE || time_s > enough_s {
            break;
        }
    }
    best.or_else(|| {
        let path = (first.mean_mps * first.span_s(), first.span_s());
        Some((0, JoiningSpeeds::beyond_limits(before_mps, path)))
    })
}

/// Adds a ramp from `half_s` before to `half_s` after the vertex between two segments, which keeps the distance.
fn push_ramp(plan: &mut SpeedPlan, before: &SpeedSegment, after: &SpeedSegment, half_s: f64) {
    let vertex_s = before.end_s;
    let start_mps = before.speed_mps(vertex_s - half_s);
    let end_mps = after.speed_mps(vertex_s + half_s);
    let covered_mps = 0.5 * (start_mps + before.speed_mps(vertex_s))
        + 0.5 * (after.speed_mps(vertex_s) + end_mps);
    let middle_mps = covered_mps - 0.5 * (start_mps + end_mps);
    plan.push(vertex_s - half_s, start_mps.max(0.0));
    plan.push(vertex_s, middle_mps.max(0.0));
    plan.push(vertex_s + half_s, end_mps.max(0.0));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::collection::vec;
    use proptest::prelude::*;

    fn vertices(points: impl Iterator<Item = Point>) -> Vec<PathVertex> {
        points
            .map(|(time_s, position_m)| PathVertex {
                time_s,
                position_m,
                lateral_m: 0.0,
            })
            .collect()
    }

    fn accelerations(plan: &SpeedPlan, end_s: f64) -> Vec<f64> {
        let speeds: Vec<f64> = (0..=(end_s * 100.0) as usize)
            .map(|step| plan.at(step as f64 * 0.01).speed_mps)
            .collect();
        speeds
            .windows(2)
            .map(|pair| (pair[1] - pair[0]) * 100.0)
            .collect()
    }

    /// A vehicle that drives at 20 m/s, brakes at 3 m/s² to 8 m/s, and accelerates at 1.5 m/s².
    fn driven_m(time_s: f64) -> f64 {
        let braked_s = (time_s - 3.0).clamp(0.0, 4.0);
        let after_s = (time_s - 7.0).max(0.0);
        20.0 * time_s.min(3.0)
            + (20.0 - 1.5 * braked_s) * braked_s
            + (8.0 + 0.75 * after_s) * after_s
    }

    const LIMITS_MPS2: [f64; 2] = [8.0, 4.0];

    /// Follows points at a speed, and compares the motion, integrated in small steps, with the stated distance.
    fn followed(points: &[Point], speed_mps: f64, rounding_m: f64) -> (SpeedPlan, f64) {
        // The entity was there before: its speed is not an initial one.
        let mut plan = SpeedPlan::constant(points[0].1 - speed_mps, speed_mps);
        plan.push(1.0, speed_mps);
        let moved: Vec<Point> = points
            .iter()
            .map(|point| (point.0 + 1.0, point.1))
            .collect();
        let vertices = vertices(moved.iter().copied());
        let stated_m = follow(&mut plan, &vertices, rounding_m, LIMITS_MPS2);
        let mut reached_m = points[0].1;
        let mut largest_m: f64 = 0.0;
        // A jump of the speed within a step means an error of up to 1.5 mm.
        let steps = ((points[points.len() - 1].0) * 1e4).round() as usize;
        for step in 0..steps {
            let time_s = 1.0 + 1e-4 * step as f64;
            let off_m = reached_m - position_m(&vertices, time_s);
            largest_m = largest_m.max(off_m.abs());
            assert!(plan.at(time_s).speed_mps >= 0.0);
            reached_m += 1e-4 * plan.at(time_s + 0.5e-4).speed_mps;
        }
        assert!(
            largest_m <= stated_m + 0.002,
            "{points:?}: {largest_m}, not {stated_m}"
        );
        assert!(
            stated_m <= largest_m + 0.02,
            "{points:?}: {largest_m}, not {stated_m}"
        );
        (plan, stated_m)
    }

    /// A position that is held is reached by a ramp at the limit, half of it after the vertex.
    #[test]
    fn a_position_that_is_held_is_not_overrun() {
        let (plan, off_m) = followed(&[(0.0, 0.0), (3.0, 60.0), (6.0, 60.0)], 20.0, 0.0);
        assert!((plan.at(7.0).position_m - 60.0).abs() < 1e-6);
        assert!((off_m - 20.0 * 20.0 / 8.0 / 8.0).abs() < 0.01, "{off_m}");
        let hardest = accelerations(&plan, 6.0).into_iter().fold(0.0, f64::min);
        assert!(hardest >= -8.001, "{hardest}");
    }

    /// A vehicle with another speed joins the polyline within its limits, and the speed exceeds that of the polyline by
    /// a sixth of the change at most.
    #[test]
    fn a_vehicle_with_another_speed_joins_the_polyline() {
        for (speed_mps, path_mps) in [(10.0, 20.0), (20.0, 10.0), (19.9, 20.0), (12.0, 0.5)] {
            let points: Vec<Point> = (0..=400)
                .map(|sample| (0.1 * f64::from(sample), path_mps * 0.1 * f64::from(sample)))
                .collect();
            let (plan, off_m) = followed(&points, speed_mps, 0.0);
            let end_m = points[400].1;
            assert!((plan.at(41.0).position_m - end_m).abs() < 1e-6);
            let change_mps: f64 = path_mps - speed_mps;
            let limit_mps2 = if change_mps < 0.0 { 8.0 } else { 4.0 };
            let lag_m = 0.5 * change_mps * change_mps / limit_mps2;
            assert!(off_m <= 1.4 * lag_m + 0.01, "{off_m}, not {lag_m}");
            for time_s in (100..4100).map(|step| 0.01 * f64::from(step)) {
                let beyond = (plan.at(time_s).speed_mps - path_mps) / change_mps;
                assert!((-1.001..=1.0 / 6.0).contains(&beyond), "{time_s}: {beyond}");
            }
            for rate_mps2 in accelerations(&plan, 41.0) {
                assert!(
                    (-8.01..=4.01).contains(&rate_mps2),
                    "{speed_mps}: {rate_mps2}"
                );
            }
        }
    }

    /// Positions with two decimals do not show when a vehicle at 5 cm/s stands.
    #[test]
    fn a_creeping_vehicle_goes_on() {
        let points: Vec<Point> = (0..=99)
            .map(|sample| {
                (
                    0.1 * f64::from(sample),
                    (0.5 * f64::from(sample)).floor() / 100.0,
                )
            })
            .collect();
        let (plan, _) = followed(&points, 0.05, 0.005);
        let last_mps = plan.at(11.0).speed_mps;
        assert!((0.03..0.07).contains(&last_mps), "{last_mps}");
    }

    #[test]
    fn a_small_movement_back_is_a_standstill() {
        let points = [
            (0.0, 0.0),
            (0.1, 0.008),
            (0.2, 0.006),
            (1.0, 0.006),
            (2.0, 2.0),
        ];
        followed(&points, 0.0, 0.0);
    }

    /// Many vertices on a line are one segment, in spite of the errors of their calculation.
    #[test]
    fn a_jump_between_dense_vertices_is_within_the_limits() {
        let points: Vec<Point> = (0..=400)
            .map(|sample| {
                let time_s = 0.02 * f64::from(sample);
                let position_m = 20.0 * time_s.min(4.0) + 17.7 * (time_s - 4.0).max(0.0);
                (time_s, 1e3 + position_m / 0.3 * 0.3)
            })
            .collect();
        let (plan, _) = followed(&points, 20.0, MIN_ROUNDING_M);
        for rate_mps2 in accelerations(&plan, 8.0) {
            assert!((-8.01..=0.01).contains(&rate_mps2), "{rate_mps2}");
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// A polyline states mean speeds only. If the acceleration changes by at most D from segment to segment, the
        /// speed is within D h S / (2 (h + S)) of the driven one for adjacent segments of h and S seconds, except in
        /// the first segment, in which the vehicle joins the polyline, and near the end, after which the polyline
        /// states nothing. For equal segments this is D h / 4: speeds that alternate by c have the same mean speeds as
        /// a constant one, and D = 4 c / h, so no reading is nearer.
        #[test]
        fn the_speed_is_as_near_as_mean_speeds_permit(
            pieces in vec((0.01_f64..0.05, -6.0_f64..6.0), 3..60),
        ) {
            // The vehicle joins the polyline in the first segment.
            let pieces = [vec![(0.05, 0.0)], pieces].concat();
            let mut driven = vec![(0.0, 25.0)];
            let mut points = vec![(0.0, 100.0)];
            for &(span_s, rate_mps2) in &pieces {
                let [(time_s, from_mps), (_, from_m)] = [driven[driven.len() - 1], points[points.len() - 1]];
                let to_mps = from_mps + rate_mps2 * span_s;
                driven.push((time_s + span_s, to_mps));
                points.push((time_s + span_s, from_m + 0.5 * (from_mps + to_mps) * span_s));
            }
            let bound_mps = pieces
                .windows(2)
                .map(|pair| (pair[1].1 - pair[0].1).abs())
                .fold(0.0, f64::max)
                * pieces
                    .windows(2)
                    .map(|pair| 0.5 * pair[0].0 * pair[1].0 / (pair[0].0 + pair[1].0))
                    .fold(0.0, f64::max);
            let mut plan = SpeedPlan::constant(100.0, 25.0);
            follow(&mut plan, &vertices(points.into_iter()), MIN_ROUNDING_M, [8.0, 8.0]);
            for pair in driven.windows(2).take(pieces.len() - 2).skip(1) {
                for share in [0.0, 0.1, 0.25, 0.5, 0.75, 0.9] {
                    let time_s = pair[0].0 + share * (pair[1].0 - pair[0].0);
                    let true_mps = pair[0].1 + share * (pair[1].1 - pair[0].1);
                    let off_mps = (plan.at(time_s).speed_mps - true_mps).abs();
                    prop_assert!(off_mps <= bound_mps + 1e-3, "{time_s}: {off_mps}, not {bound_mps}");
                }
            }
        }

        /// The motion is within the rounding of the polyline, and 5 mm and the rounding for each of the smooth speeds
        /// and the ramps at vertices. Averages add up to three steps at accelerations of up to 3 m/s².
        #[test]
        fn rounded_positions_are_passed_within_the_bound(
            pieces in vec((1.0_f64..3.0, -3.0_f64..3.0), 2..6),
            rate_hz in prop_oneof![Just(2.0), Just(5.0), Just(10.0), Just(25.0)],
            decimals in prop_oneof![Just(2), Just(3)],
            phase in 0.0_f64..1.0,
        ) {
            let step_m = libm::pow(10.0, -f64::from(decimals));
            let mut knots = vec![(0.0, 20.0)];
            for (span_s, rate_mps2) in pieces {
                let (time_s, speed_mps): (f64, f64) = knots[knots.len() - 1];
                let to_mps = (speed_mps + rate_mps2 * span_s).clamp(2.0, 40.0);
                knots.push((time_s + span_s, to_mps));
            }
            let mut driven = SpeedPlan::constant(phase, 20.0);
            for &(time_s, speed_mps) in &knots {
                driven.push(time_s, speed_mps);
            }
            let end_s = knots[knots.len() - 1].0;
            let samples = (0..=(end_s * rate_hz) as usize).map(|sample| {
                let time_s = sample as f64 / rate_hz;
                (time_s, (driven.at(time_s).position_m / step_m).round() * step_m)
            });
            let vertices = vertices(samples);
            let rounding_m = rounding_m(&vertices, step_m);
            prop_assert_eq!(rounding_m, 0.5 * step_m);
            let mut plan = SpeedPlan::constant(vertices[0].position_m, 20.0);
            let off_m = follow(&mut plan, &vertices, rounding_m, [30.0, 30.0]);
            let averaged_m = match averaging_window_s(&vertices, rounding_m) {
                // Averages over a single step have an error of 3 a h² / 4.
                Some(window_s) => f64::max(6.0 * rounding_m, 0.75 * window_s * window_s),
                None => 0.0,
            };
            // The ramp from the initial speed to that at the start of the first segment takes `change / 30` seconds.
            // A smooth speed at the start differs from the mean speed of the segment by up to `rise_mps`.
            let first_s = vertices[1].time_s;
            let first_mps = (vertices[1].position_m - vertices[0].position_m) / first_s;
            let rise_mps = 4.0 * (SMOOTHING_M + rounding_m) / first_s;
            let change_mps = (first_mps - 20.0).abs() + rise_mps;
            let ramp_m = 0.5 * change_mps * change_mps / 30.0;
            let bound_m = 3.0 * rounding_m + 0.01 + averaged_m + 1.5 * ramp_m;
            prop_assert!(off_m <= bound_m, "{off_m}, not {bound_m}");
        }

        /// The stated distance is that of the motion, whatever the polyline.
        #[test]
        fn the_stated_distance_is_that_of_the_motion(
            segments in vec((0.5..4.5, prop_oneof![4 => 0.0..30.0, 1 => Just(0.0)]), 1..10),
            start_mps in 0.0..30.0,
            is_rounded: bool,
        ) {
            let mut points = vec![(0.0, 0.0)];
            for (span_s, speed_mps) in segments {
                let (time_s, position_m) = points[points.len() - 1];
                points.push((time_s + span_s, position_m + speed_mps * span_s));
            }
            followed(&points, start_mps, if is_rounded { 0.005 } else { 0.0 });
        }
    }

    /// A coarse grid is that of a recording if the accelerations alternate.
    #[test]
    fn a_coarse_grid_is_removed_only_from_recordings() {
        let rounded = |rate_hz: f64| {
            let samples = (0..=(12.0 * rate_hz) as usize).map(move |sample| {
                let time_s = sample as f64 / rate_hz;
                (time_s, (driven_m(time_s) * 10.0).round() / 10.0)
            });
            vertices(samples)
        };
        assert_eq!(rounding_m(&rounded(10.0), 0.1), 0.05);
        // The times between vertices are not exactly 0.2 s.
        assert_eq!(rounding_m(&rounded(5.0), 0.1), 0.05);
        assert_eq!(rounding_m(&rounded(2.0), 0.1), MIN_ROUNDING_M);
        assert_eq!(rounding_m(&rounded(10.0), 1.0), MIN_ROUNDING_M);
        assert_eq!(rounding_m(&rounded(2.0), 0.01), 0.005);
        let constant = vertices((0..50).map(|sample| {
            let time_s = 0.1 * f64::from(sample);
            (time_s, 18.0 * time_s)
        }));
        assert_eq!(rounding_m(&constant, 0.1), ROUND_VALUES_M);
    }

    #[test]
    fn rounded_positions_do_not_become_braking_that_was_not_driven() {
        for rate_hz in [10.0, 25.0] {
            let samples = (0..=(12.0 * rate_hz) as usize).map(|sample| {
                let time_s = sample as f64 / rate_hz;
                (time_s, (driven_m(time_s) * 100.0).round() / 100.0)
            });
            let vertices = vertices(samples);
            let mut plan = SpeedPlan::constant(0.0, 20.0);
            let off_m = follow(&mut plan, &vertices, 0.005, [8.0, 8.0]);
            assert!(off_m <= 0.02, "{off_m}");
            for vertex in &vertices {
                let off_m = plan.at(vertex.time_s).position_m - vertex.position_m;
                assert!(off_m.abs() <= 0.02, "{rate_hz} Hz, {vertex:?}: {off_m}");
            }
            let rates_mps2 = accelerations(&plan, 12.0);
            let lowest_mps2 =
                |from: usize, to: usize| rates_mps2[from..to].iter().copied().fold(0.0, f64::min);
            assert!(
                lowest_mps2(0, 260) > -0.1,
                "{rate_hz} Hz: {}",
                lowest_mps2(0, 260)
            );
            assert!(
                lowest_mps2(300, 700) > -3.7,
                "{rate_hz} Hz: {}",
                lowest_mps2(300, 700)
            );
            assert!(
                lowest_mps2(740, 1200) > -0.05,
                "{rate_hz} Hz: {}",
                lowest_mps2(740, 1200)
            );
        }
    }

    #[test]
    fn a_change_of_the_speed_does_not_swing() {
        let samples = (0..=30).map(|sample| {
            let time_s = 0.5 * f64::from(sample);
            (
                time_s,
                150.0 + 20.0 * time_s.min(4.0) + 18.0 * (time_s - 4.0).max(0.0),
            )
        });
        let mut plan = SpeedPlan::constant(150.0, 20.0);
        let off_m = follow(&mut plan, &vertices(samples), 0.0, [10.0, 10.0]);
        for step in 0..1500 {
            let time_s = f64::from(step) * 0.01;
            let speed_mps = plan.at(time_s).speed_mps;
            let expected_mps = if time_s < 4.0 { 20.0 } else { 18.0 };
            if (time_s - 4.0).abs() > 0.11 {
                assert!(
                    (speed_mps - expected_mps).abs() < 1e-9,
                    "{time_s}: {speed_mps}"
                );
            }
            assert!((18.0 - 1e-9..=20.0 + 1e-9).contains(&speed_mps));
        }
        assert!((off_m - 0.05).abs() < 1e-6, "{off_m}");
    }

    #[test]
    fn between_far_vertices_the_speed_is_constant() {
        let path = [
            (0.0, 0.0),
            (2.0, 40.0),
            (4.0, 70.0),
            (6.0, 90.0),
            (9.0, 90.0),
            (10.0, 95.0),
        ];
        let mut plan = SpeedPlan::constant(0.0, 20.0);
        follow(&mut plan, &vertices(path.into_iter()), 0.0, [1e9, 1e9]);
        for pair in path.windows(2) {
            for share in [0.0, 0.25, 0.5, 0.75, 1.0] {
                let time_s = pair[0].0 + share * (pair[1].0 - pair[0].0);
                let position_m = pair[0].1 + share * (pair[1].1 - pair[0].1);
                let off_m = plan.at(time_s).position_m - position_m;
                assert!(off_m.abs() < 0.0051, "{time_s}: {off_m}");
            }
        }
    }
}
