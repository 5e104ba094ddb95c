//! Recorded positions: the path without the rounding of its ends, and averages of the speeds.
//!
//! Rounded positions do not show how an acceleration changes in a short time. The window of the averages is that in
//! which the rounding of the positions means a small error of the acceleration.

use super::alternations::Alternations;
use super::speed_plan::SpeedPlan;
use super::taut_path::Point;
use super::trajectory::{EQUAL_SHARE, PathVertex, held_from, path_to_standstill, usual_step_s};

/// Error of the mean acceleration in a window that rounding leaves, in m/s². With two decimals, the window is 0.2 s.
const UNCERTAIN_MPS2: f64 = 0.125;
/// Longest step and smallest rounding error of a recording whose speeds are averaged over one step.
const MAX_SINGLE_STEP_S: f64 = 0.1;
const MIN_SINGLE_ROUNDING_M: f64 = 0.000_499;
/// Largest difference of equal times between vertices, as a share.
const MAX_UNEQUAL: f64 = 0.1;
/// Number of averages in a window, shortest time between them, in seconds, and number of times that all speeds are
/// averaged.
const AVERAGES_PER_WINDOW: f64 = 8.0;
const MIN_AVERAGE_STEP_S: f64 = 0.01;
const AVERAGING_PASSES: usize = 2;
/// Smallest number of vertices whose line shows the position of one of them better than its own.
const LEAST_LINE_VERTICES: f64 = 4.0;
/// Largest change of the length of a path by the rounding of its ends, as a share.
const MAX_END_SHARE: f64 = 0.01;

/// Returns the window of the averages, in seconds; `None` if the vertices are farther apart, so that rounding has
/// little influence on the acceleration.
pub(super) fn averaging_window_s(vertices: &[PathVertex], rounding_m: f64) -> Option<f64> {
    let window_s = (rounding_m / UNCERTAIN_MPS2).sqrt();
    let step_s = usual_step_s(vertices)? * (1.0 - EQUAL_SHARE);
    if step_s <= window_s {
        return Some(window_s);
    }
    let is_recording = step_s <= MAX_SINGLE_STEP_S && rounding_m >= MIN_SINGLE_ROUNDING_M;
    let is_smooth = || Alternations::from_vertices(vertices).are_explained(rounding_m);
    (is_recording && is_smooth()).then_some(step_s)
}

/// Returns the vertices of a recording, with those of which one is missing between four at equal times: on the curve of
/// the third degree through the four.
pub(super) fn with_missing_vertices(vertices: &[PathVertex]) -> Vec<PathVertex> {
    let step_s = usual_step_s(vertices).unwrap_or(0.0);
    let mut filled = Vec::new();
    for (index, vertex) in vertices.iter().enumerate() {
        let around = index
            .checked_sub(2)
            .and_then(|first| vertices.get(first..index + 2));
        filled.extend(around.and_then(|around| missing_vertex(around, step_s)));
        filled.push(*vertex);
    }
    filled
}

/// Returns the vertex that is missing in the middle of four; `None` if there is none.
fn missing_vertex(around: &[PathVertex], step_s: f64) -> Option<PathVertex> {
    let [first, before, after, last] = around else {
        return None;
    };
    let has_steps = |from: &PathVertex, to: &PathVertex, steps: f64| {
        ((to.time_s - from.time_s) / step_s - steps).abs() <= MAX_UNEQUAL
    };
    let is_missing = has_steps(first, before, 1.0)
        && has_steps(before, after, 2.0)
        && has_steps(after, last, 1.0);
    let [inner_m, outer_m] =
        [[before, after], [first, last]].map(|[from, to]| 0.5 * (from.position_m + to.position_m));
    let position_m = (4.0 * inner_m - outer_m) / 3.0;
    let is_between = (before.position_m..=after.position_m).contains(&position_m);
    (is_missing && is_between).then_some(PathVertex {
        time_s: 0.5 * (before.time_s + after.time_s),
        position_m,
        lateral_m: 0.5 * (before.lateral_m + after.lateral_m),
    })
}

/// Returns the path through vertices without their rounding, also that of the ends, from which the speeds there follow.
/// The path has the length between the vertices; a vehicle that stands at the end stands there.
pub(super) fn recorded_path(vertices: &[PathVertex], rounding_m: f64, window_s: f64) -> Vec<Point> {
    let [first, .., last] = vertices else {
        return Vec::new();
    };
    let likely_m = |end: &PathVertex| likely_m(vertices, *end, rounding_m, window_s);
    let stands = held_from(vertices, rounding_m).is_some();
    let last_m = if stands {
        last.position_m
    } else {
        likely_m(last)
    };
    let mut likely = vertices.to_vec();
    if let [start, .., end] = likely.as_mut_slice() {
        start.position_m = likely_m(first);
        end.position_m = last_m;
    }
    let mut path = path_to_standstill(&likely, rounding_m);
    let start_m = path.first().map_or(0.0, |start| start.1);
    let share = (last.position_m - first.position_m) / (last_m - start_m);
    // A vehicle that hardly moves has no path without its ends.
    let is_known = (share - 1.0).abs() <= MAX_END_SHARE;
    if !is_known {
        return path_to_standstill(vertices, rounding_m);
    }
    for point in &mut path {
        point.1 = first.position_m + (point.1 - start_m) * share;
    }
    path
}

/// Returns the position of an end on the line through the vertices of a window (least squares), within its rounding.
fn likely_m(vertices: &[PathVertex], end: PathVertex, rounding_m: f64, window_s: f64) -> f64 {
    let [mut count, mut times, mut offsets, mut squares, mut products] = [0.0; 5];
    for vertex in vertices {
        let time_s = vertex.time_s - end.time_s;
        let off_m = vertex.position_m - end.position_m;
        if time_s.abs() <= window_s {
            count += 1.0;
            times += time_s;
            offsets += off_m;
            squares += time_s * time_s;
            products += time_s * off_m;
        }
    }
    let off_m = (offsets * squares - times * products) / (count * squares - times * times);
    if count >= LEAST_LINE_VERTICES && off_m.is_finite() {
        end.position_m + off_m.clamp(-rounding_m, rounding_m)
    } else {
        end.position_m
    }
}

/// Averages of the speeds in a time.
#[derive(Debug, Clone, Copy)]
pub(super) struct Averaging {
    /// Start and end, in seconds.
    pub(super) span_s: [f64; 2],
    pub(super) window_s: f64,
    /// True if the speed at the start is that of the recording, and not that of an earlier motion.
    pub(super) has_own_start: bool,
}

impl Averaging {
    /// Replaces the speeds of a plan by their averages, which are never outside of their range. The last position
    /// stays.
    pub(super) fn apply(self, plan: &mut SpeedPlan) {
        for _ in 0..AVERAGING_PASSES {
            self.average(plan);
        }
    }

    fn average(self, plan: &mut SpeedPlan) {
        let [start_s, end_s] = self.span_s;
        let wanted_s = (self.window_s / AVERAGES_PER_WINDOW).max(MIN_AVERAGE_STEP_S);
        let count = ((end_s - start_s) / wanted_s).ceil().max(1.0);
        let step_s = (end_s - start_s) / count;
        let means: Vec<Point> = (0..=count as usize)
            .map(|index| start_s + index as f64 * step_s)
            .map(|time_s| (time_s, self.mean_mps(plan, time_s, step_s)))
            .collect();
        let pairs = means.iter().zip(means.iter().skip(1));
        let covered_m: f64 = pairs
            .map(|(from, to)| 0.5 * (from.1 + to.1) * (to.0 - from.0))
            .sum();
        let length_m = plan.at(end_s).position_m - plan.at(start_s).position_m;
        // In proportion to the speed, so that a standing vehicle stands.
        let correction = if covered_m > 0.0 {
            length_m / covered_m
        } else {
            1.0
        };
        plan.cut(start_s);
        let mut means = means.into_iter();
        if let Some((_, start_mps)) = means.next().filter(|_| self.has_own_start) {
            plan.set_initial_speed(start_mps * correction);
        }
        for (time_s, mean_mps) in means {
            plan.push(time_s, mean_mps * correction);
        }
    }

    /// Returns the mean speed in a window around a time. Near a speed that is known, that before the start or a
    /// standstill at the end, the window is smaller. The speeds beyond the other ends are a mirror image, so that the
    /// ends stay in place.
    fn mean_mps(self, plan: &SpeedPlan, time_s: f64, step_s: f64) -> f64 {
        let [start_s, end_s] = self.span_s;
        let mut half_s = (0.5 * self.window_s).min(end_s - start_s);
        if !self.has_own_start {
            half_s = half_s.min(time_s - start_s);
        }
        if plan.at(end_s).speed_mps == 0.0 {
            half_s = half_s.min(end_s - time_s);
        }
        if half_s <= 0.5 * step_s {
            return plan.at(time_s).speed_mps;
        }
        let mirrored_m = |time_s: f64| {
            let inside_s = time_s.max(start_s).min(end_s);
            let mirror_m = plan.at(2.0 * inside_s - time_s).position_m;
            2.0 * plan.at(inside_s).position_m - mirror_m
        };
        (mirrored_m(time_s + half_s) - mirrored_m(time_s - half_s)) / (2.0 * half_s)
    }
}

#[cfg(test)]
mod tests {
    use super::super::resolution::grid_step_m;
    use super::super::trajectory::{follow, rounding_m};
    use super::*;
    use proptest::prelude::*;

    /// A vehicle that brakes at a rate for some time.
    #[derive(Debug, Clone, Copy)]
    struct BrakedDrive {
        start_m: f64,
        speed_mps: f64,
        onset_s: f64,
        rate_mps2: f64,
        braking_s: f64,
    }

    impl BrakedDrive {
        fn position_m(&self, time_s: f64) -> f64 {
            let braked_s = (time_s - self.onset_s).clamp(0.0, self.braking_s);
            let after_s = (time_s - self.onset_s - self.braking_s).max(0.0);
            let lost_m = self.rate_mps2 * braked_s * (0.5 * braked_s + after_s);
            self.start_m + self.speed_mps * time_s - lost_m
        }
    }

    /// Extremes of an import.
    #[derive(Debug, Clone, Copy, Default)]
    struct Extremes {
        brake_mps2: f64,
        accel_mps2: f64,
        off_m: f64,
    }

    /// Returns the vertices of a vehicle with positions that are rounded to a step.
    fn recorded(driven: BrakedDrive, step_m: f64, rate_hz: f64, end_s: f64) -> Vec<PathVertex> {
        let count = (end_s * rate_hz + 1e-9).floor() as usize;
        (0..=count)
            .map(|sample| sample as f64 / rate_hz)
            .map(|time_s| PathVertex {
                time_s,
                position_m: (driven.position_m(time_s) / step_m).round() * step_m,
                lateral_m: 0.0,
            })
            .collect()
    }

    /// Imports vertices, and returns the plan.
    fn followed(vertices: &[PathVertex], initial_mps: f64) -> SpeedPlan {
        let positions_m: Vec<f64> = vertices.iter().map(|vertex| vertex.position_m).collect();
        let rounding_m = rounding_m(vertices, grid_step_m(&positions_m));
        let mut plan = SpeedPlan::constant(positions_m[0], initial_mps);
        follow(&mut plan, vertices, rounding_m, [25.0, 25.0]);
        plan
    }

    /// Imports vertices of a vehicle, and returns the extremes in steps of 0.01 s.
    fn imported(driven: BrakedDrive, vertices: &[PathVertex]) -> Extremes {
        let plan = followed(vertices, driven.speed_mps);
        let last = vertices[vertices.len() - 1];
        let off_m = plan.at(last.time_s).position_m - last.position_m;
        assert!(off_m.abs() < 1e-3, "{off_m}");
        let mut extremes = Extremes::default();
        for step in 0..(last.time_s * 100.0) as usize {
            let [from_s, to_s] = [step, step + 1].map(|step| 0.01 * step as f64);
            let accel_mps2 = (plan.at(to_s).speed_mps - plan.at(from_s).speed_mps) * 100.0;
            let off_m = plan.at(from_s).position_m - driven.position_m(from_s);
            extremes.brake_mps2 = extremes.brake_mps2.max(-accel_mps2);
            extremes.accel_mps2 = extremes.accel_mps2.max(accel_mps2);
            extremes.off_m = extremes.off_m.max(off_m.abs());
        }
        extremes
    }

    /// Drives with values of few digits, whose rounded positions may lie on a coarser grid, and others.
    fn steady_drive() -> impl Strategy<Value = BrakedDrive> {
        let rates_mps2 = vec![1.0, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.5, 8.0, 10.0];
        let round = (
            10_u8..=35,
            prop::sample::select(rates_mps2),
            8_u8..16,
            2_u8..14,
        );
        let round = round.prop_map(|(speed, rate_mps2, onset, braking)| {
            [
                f64::from(speed),
                rate_mps2,
                0.25 * f64::from(onset),
                0.25 * f64::from(braking),
            ]
        });
        let odd = (10.0_f64..35.0, 0.5_f64..10.0, 2.0_f64..4.0, 0.5_f64..3.5);
        let odd = odd.prop_map(|(speed_mps, rate_mps2, onset_s, braking_s)| {
            [speed_mps, rate_mps2, onset_s, braking_s]
        });
        let start_m = prop_oneof![Just(0.0), Just(100.0), 0.0_f64..100.0];
        (prop_oneof![round, odd], start_m).prop_map(|(values, start_m)| {
            let [speed_mps, rate_mps2, onset_s, braking_s] = values;
            BrakedDrive {
                start_m,
                speed_mps,
                onset_s,
                rate_mps2,
                braking_s: braking_s.min((speed_mps - 2.0) / rate_mps2),
            }
        })
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(1024))]

        /// Rounding changes the acceleration by at most 0.75 m/s². At 10 Hz, it is 1.6 m/s² with a missing vertex, and
        /// 8 m/s² in brief braking with one decimal, which looks like a step of the speed.
        #[test]
        fn rounded_braking_from_a_steady_speed_is_as_hard_as_driven(
            driven in steady_drive(),
            rate_hz in prop::sample::select(vec![10.0, 25.0, 30.0, 50.0]),
            decimals in 1..=3,
            missing in prop::option::of(0.05_f64..0.95),
        ) {
            let step_m = libm::pow(10.0, -f64::from(decimals));
            let end_s = driven.onset_s + driven.braking_s + 2.0;
            let mut vertices = recorded(driven, step_m, rate_hz, end_s);
            if let Some(share) = missing {
                vertices.remove((share * vertices.len() as f64) as usize);
            }
            let is_brief = decimals == 1 && driven.braking_s <= 1.25;
            let bound_mps2 = match (rate_hz == 10.0, is_brief, missing) {
                (true, true, _) => 8.0,
                (true, false, Some(_)) => 1.6,
                _ => 0.75,
            };
            let extremes = imported(driven, &vertices);
            prop_assert!(extremes.brake_mps2 <= driven.rate_mps2 + bound_mps2, "{extremes:?}");
            prop_assert!(extremes.accel_mps2 <= bound_mps2, "{extremes:?}");
        }

        /// Steps of the speed are no rounding, if it is constant for six segments after each of them.
        #[test]
        fn a_speed_in_steps_is_kept(
            rate_hz in prop::sample::select(vec![10.0, 25.0]),
            segments in 6_usize..20,
            change_mps in prop::sample::select(vec![-2.0, -1.0, 1.0, 2.0]),
        ) {
            let mut vertices = Vec::new();
            let mut position_m = 0.0;
            for sample in 0..=6 * segments {
                let time_s = sample as f64 / rate_hz;
                vertices.push(PathVertex { time_s, position_m, lateral_m: 0.0 });
                position_m += (15.0 + change_mps * (sample / segments) as f64) / rate_hz;
            }
            let plan = followed(&vertices, 15.0);
            for step in 0..6 {
                let middle_s = (step as f64 + 0.5) * segments as f64 / rate_hz;
                let off_mps = plan.at(middle_s).speed_mps - 15.0 - change_mps * step as f64;
                prop_assert!(off_mps.abs() <= 0.01, "{off_mps}");
            }
        }
    }

    /// Steps of metres, feet and binary fractions, and rates at which they are averaged.
    const STEPS_M: [f64; 11] = [
        0.1, 0.0625, 0.05, 0.03048, 0.02, 0.01, 0.0078125, 0.003048, 0.001, 0.0003048, 0.0001,
    ];
    const RATES_HZ: [f64; 6] = [10.0, 20.0, 25.0, 30.0, 50.0, 100.0];

    fn is_averaged(step_m: f64, rate_hz: f64) -> bool {
        0.5 * step_m * rate_hz * rate_hz >= UNCERTAIN_MPS2 * (1.0 - 1e-9)
    }

    /// Rounding neither adds hard braking, nor at the ends of a recording, nor removes braking.
    #[test]
    fn a_recorded_vehicle_brakes_as_hard_as_it_did() {
        for (step_m, rate_hz) in STEPS_M
            .iter()
            .flat_map(|step_m| RATES_HZ.map(|hz| (*step_m, hz)))
        {
            for (rate_mps2, index) in [1.0, 3.0, 6.0]
                .into_iter()
                .flat_map(|rate| [(rate, 0), (rate, 1), (rate, 2)])
            {
                let phase = 0.37 * f64::from(index);
                let driven = BrakedDrive {
                    start_m: phase,
                    speed_mps: 20.13 + 1.7 * phase,
                    onset_s: 3.05 + phase,
                    rate_mps2,
                    braking_s: f64::min(4.0, 18.0 / rate_mps2),
                };
                let extremes = imported(driven, &recorded(driven, step_m, rate_hz, 11.3 + phase));
                let context = format!("{step_m} m, {rate_hz} Hz, {driven:?}: {extremes:?}");
                if !is_averaged(step_m, rate_hz) {
                    continue;
                }
                assert!(extremes.brake_mps2 <= rate_mps2 + 0.7, "{context}");
                assert!(extremes.brake_mps2 >= 0.95 * rate_mps2, "{context}");
                assert!(extremes.accel_mps2 <= 0.4, "{context}");
                assert!(
                    extremes.off_m <= step_m * (1.2 + 0.5 * rate_mps2) + 0.005,
                    "{context}"
                );
            }
        }
    }

    #[test]
    fn a_recorded_vehicle_at_constant_speed_neither_brakes_nor_accelerates() {
        for (step_m, rate_hz) in STEPS_M
            .iter()
            .flat_map(|step_m| RATES_HZ.map(|hz| (*step_m, hz)))
        {
            for speed_mps in [0.83, 8.0, 13.9, 20.37, 25.03, 33.333] {
                let driven = BrakedDrive {
                    start_m: 0.21,
                    speed_mps,
                    onset_s: 99.0,
                    rate_mps2: 0.0,
                    braking_s: 0.0,
                };
                let extremes = imported(driven, &recorded(driven, step_m, rate_hz, 8.0));
                let context = format!("{step_m} m, {rate_hz} Hz, {driven:?}: {extremes:?}");
                assert!(
                    extremes.brake_mps2.max(extremes.accel_mps2) <= 0.5,
                    "{context}"
                );
                assert!(extremes.off_m <= 1.5 * step_m, "{context}");
            }
        }
    }

    /// A vehicle that brakes to a standstill stands from then on.
    #[test]
    fn a_recorded_vehicle_that_stops_stands() {
        for step_m in STEPS_M {
            let driven = BrakedDrive {
                start_m: 0.3,
                speed_mps: 12.0,
                onset_s: 2.0,
                rate_mps2: 3.0,
                braking_s: 4.0,
            };
            let vertices = recorded(driven, step_m, 25.0, 10.0);
            let mut plan = SpeedPlan::constant(vertices[0].position_m, 12.0);
            follow(&mut plan, &vertices, 0.5 * step_m, [25.0, 25.0]);
            for time_s in [7.5, 8.5, 10.0, 20.0] {
                assert_eq!(plan.at(time_s).speed_mps, 0.0, "{step_m}, {time_s}");
            }
        }
    }
}
