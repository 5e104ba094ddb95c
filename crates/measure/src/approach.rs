//! The approach of a vehicle to its leader, from which measures of a pair are computed.

use crumple_sim::engine::{
    Collision, Impact, Motion, TIME_TOLERANCE_S, Trace, Track, VehiclePair, closest_gap_m,
};

/// Two successive vehicles at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PairState {
    /// Time, in seconds.
    pub time_s: f64,
    /// Bumper gap in metres, never negative.
    pub gap_m: f64,
    /// Speed of the leader, in m/s.
    pub front_speed_mps: f64,
    /// Speed of the follower, in m/s.
    pub rear_speed_mps: f64,
    /// Acceleration of the leader until the next state, in m/s².
    pub front_acceleration_mps2: f64,
    /// Acceleration of the follower until the next state, in m/s².
    pub rear_acceleration_mps2: f64,
}

impl PairState {
    /// Returns the closing speed, in m/s: positive when the gap closes.
    #[must_use]
    pub fn closing_mps(&self) -> f64 {
        self.rear_speed_mps - self.front_speed_mps
    }

    fn from_motions(time_s: f64, [front, rear]: [Motion; 2], front_length_m: f64) -> Self {
        Self {
            time_s,
            gap_m: front.position_m - front_length_m - rear.position_m,
            front_speed_mps: front.speed_mps,
            rear_speed_mps: rear.speed_mps,
            front_acceleration_mps2: front.acceleration_mps2,
            rear_acceleration_mps2: rear.acceleration_mps2,
        }
    }

    /// Creates the state of a leader and its follower at a sample of a trace.
    pub(super) fn from_sample(
        times_s: &[f64],
        [front, rear]: [&Track; 2],
        sample: usize,
    ) -> Option<Self> {
        let motion = [front.motion(sample)?, rear.motion(sample)?];
        Some(Self::from_motions(
            *times_s.get(sample)?,
            motion,
            front.length_m,
        ))
    }

    /// Returns the smallest gap within the next `step_s` seconds, in metres, at constant accelerations.
    fn min_gap_within_m(&self, step_s: f64) -> f64 {
        // Positions relative to the follower.
        let front = Motion {
            position_m: self.gap_m,
            speed_mps: self.front_speed_mps,
            acceleration_mps2: self.front_acceleration_mps2,
        };
        let rear = Motion {
            position_m: 0.0,
            speed_mps: self.rear_speed_mps,
            acceleration_mps2: self.rear_acceleration_mps2,
        };
        closest_gap_m(front, rear, 0.0, step_s).max(0.0)
    }
}

/// The approach of a vehicle to its leader, from the start of a trace to their collision or to the end of the trace.
/// After lane changes the leader may be another vehicle.
///
/// The approach ends at the first collision: afterwards the gap is zero, and time to collision would be a quotient of
/// rounding errors. The last state is the instant of collision. It does not depend on the sample times, nor on whether
/// the run continues after the collision. All measures therefore agree.
#[derive(Debug, Clone, PartialEq)]
pub struct Approach {
    segments: Vec<ApproachSegment>,
    has_collision: bool,
}

#[derive(Debug, Clone, PartialEq)]
struct ApproachSegment {
    front_length_m: f64,
    states: Vec<PairState>,
    /// True if a lane change ended the segment.
    interrupted: bool,
}

impl Approach {
    /// Creates the approach of vehicle `rear` to its leader; `None` without a leader or without such a vehicle.
    ///
    /// Collisions come from `impacts`, or else from the first sample without a gap. If tracks have unequal lengths, the
    /// end of the shortest is the end for all.
    #[must_use]
    pub fn from_trace(trace: &Trace, impacts: &[Impact], rear: usize) -> Option<Self> {
        let collision = impacts
            .iter()
            .map(|impact| &impact.collision)
            .find(|collision| collision.rear_vehicle == rear);
        Self::from_pairs(&trace.pairs(rear), collision)
    }

    /// Creates the approach to vehicle `front` by its follower; `None` without a follower.
    pub(super) fn from_trace_behind(
        trace: &Trace,
        impacts: &[Impact],
        front: usize,
    ) -> Option<Self> {
        let collision = impacts
            .iter()
            .map(|impact| &impact.collision)
            .find(|collision| collision.front_vehicle == front);
        let behind = front.checked_add(1)?..trace.vehicles.len();
        let pairs = behind
            .flat_map(|rear| trace.pairs(rear))
            .filter(|pair| pair.front_vehicle == front);
        let mut pairs: Vec<VehiclePair<'_>> = pairs.collect();
        pairs.sort_by(|a, b| a.span_s[0].total_cmp(&b.span_s[0]));
        Self::from_pairs(&pairs, collision)
    }

    fn from_pairs(pairs: &[VehiclePair<'_>], collision: Option<&Collision>) -> Option<Self> {
        let until_s = collision.map_or(f64::INFINITY, |collision| {
            collision.time_s - TIME_TOLERANCE_S
        });
        let mut segments = Vec::new();
        let mut collided = false;
        for pair in pairs.iter().filter(|pair| pair.span_s[0] < until_s) {
            let mut segment = ApproachSegment {
                front_length_m: pair.front.length_m,
                states: Vec::with_capacity(pair.samples().len() + 1),
                interrupted: pair.span_s[1].is_finite(),
            };
            for state in pair_states(pair).take_while(|state| state.time_s < until_s) {
                collided = state.gap_m <= 0.0;
                segment.states.push(PairState {
                    gap_m: state.gap_m.max(0.0),
                    ..state
                });
                if collided {
                    break;
                }
            }
            segments.push(segment);
            if collided {
                break;
            }
        }
        if let (Some(collision), false, Some(last)) = (collision, collided, segments.last_mut()) {
            last.states
                .push(collision_state(collision, last.states.last()));
            collided = true;
        }
        (!segments.is_empty()).then_some(Self {
            segments,
            has_collision: collided,
        })
    }

    /// Returns the states in order of time; none for an empty trace.
    pub fn states(&self) -> impl Iterator<Item = &PairState> {
        self.segments.iter().flat_map(|segment| &segment.states)
    }

    /// Returns the states, each with the length of the leader in metres.
    pub(super) fn states_with_length_m(&self) -> impl Iterator<Item = (&PairState, f64)> {
        self.segments.iter().flat_map(|segment| {
            let length_m = segment.front_length_m;
            segment.states.iter().map(move |state| (state, length_m))
        })
    }

    /// Returns each state with the next one of the same two vehicles.
    pub(super) fn steps(&self) -> impl Iterator<Item = (&PairState, &PairState)> {
        self.segments
            .iter()
            .flat_map(|segment| segment.states.iter().zip(segment.states.iter().skip(1)))
    }

    /// Returns true if the approach ends in a collision.
    #[must_use]
    pub fn has_collision(&self) -> bool {
        self.has_collision
    }

    /// Returns the smallest bumper gap, between samples too, in metres; 0 at collision, `None` for an empty trace.
    #[must_use]
    pub fn min_gap_m(&self) -> Option<f64> {
        let at_samples = self.states().map(|state| state.gap_m);
        let between = self
            .steps()
            .map(|(state, next)| state.min_gap_within_m(next.time_s - state.time_s));
        at_samples.chain(between).reduce(f64::min)
    }

    /// Returns the bumper gap at standstill, in metres; `None` after a collision or lane change, or if a vehicle still
    /// moves.
    #[must_use]
    pub fn standstill_gap_m(&self) -> Option<f64> {
        let segment = self
            .segments
            .last()
            .filter(|segment| !segment.interrupted && !self.has_collision)?;
        let last = segment.states.last()?;
        (last.front_speed_mps == 0.0 && last.rear_speed_mps == 0.0).then_some(last.gap_m)
    }
}

/// Returns the states of a pair at its start, every sample and its end; gaps may be negative.
fn pair_states<'a>(pair: &VehiclePair<'a>) -> impl Iterator<Item = PairState> + use<'a> {
    let VehiclePair {
        time_s,
        front,
        rear,
        span_s,
        ..
    } = *pair;
    let [first, last] = span_s.map(|at_s| {
        let is_sampled = time_s
            .iter()
            .any(|sampled_s| (sampled_s - at_s).abs() <= TIME_TOLERANCE_S);
        let motion = if at_s.is_finite() && !is_sampled {
            pair.motion_at(at_s)
        } else {
            None
        };
        motion.map(|motion| PairState::from_motions(at_s, motion, front.length_m))
    });
    let samples = pair
        .samples()
        .filter_map(move |sample| PairState::from_sample(time_s, [front, rear], sample));
    first.into_iter().chain(samples).chain(last)
}

fn collision_state(collision: &Collision, before: Option<&PairState>) -> PairState {
    PairState {
        time_s: collision.time_s,
        gap_m: 0.0,
        front_speed_mps: collision.front_speed_mps,
        rear_speed_mps: collision.rear_speed_mps,
        front_acceleration_mps2: before.map_or(0.0, |state| state.front_acceleration_mps2),
        rear_acceleration_mps2: before.map_or(0.0, |state| state.rear_acceleration_mps2),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::{driven_track, impact, pair_trace, trace};

    #[test]
    fn the_smallest_gap_between_samples_is_found() {
        // Gap 10 m, rear 20 m/s brakes at 5 m/s² behind a steady 15 m/s: equal speeds after 1 s, 5² / (2 * 5) = 2.5 m
        // closer. Samples at 0, 0.8 and 1.6 s miss that instant.
        let pair = pair_trace(10.0, [(15.0, &[(1.6, 0.0)]), (20.0, &[(1.6, -5.0)])], 0.8);
        let approach = Approach::from_trace(&pair, &[], 1).unwrap();
        assert!((approach.min_gap_m().unwrap() - 7.5).abs() < 1e-12);
        assert!(!approach.has_collision());
        assert_eq!(approach.standstill_gap_m(), None, "both still move");
    }

    #[test]
    fn an_approach_ends_at_the_collision_and_not_before_or_after() {
        // Gap 10 m closes at 4 m/s: collision after 2.5 s, between the samples at 2 and 3 s.
        let trace = pair_trace(10.0, [(10.0, &[(5.0, 0.0)]), (14.0, &[(5.0, 0.0)])], 1.0);
        let approach = Approach::from_trace(&trace, &[impact(2.5, 0, 10.0, 14.0)], 1).unwrap();
        assert_eq!(
            approach.states().map(|s| s.time_s).collect::<Vec<_>>(),
            [0.0, 1.0, 2.0, 2.5]
        );
        assert_eq!(
            (approach.has_collision(), approach.min_gap_m()),
            (true, Some(0.0))
        );

        let by_gap_alone = Approach::from_trace(&trace, &[], 1).unwrap();
        assert_eq!(
            by_gap_alone.states().count(),
            4,
            "ends at the first sample without a gap"
        );
        assert_eq!(
            (by_gap_alone.has_collision(), by_gap_alone.min_gap_m()),
            (true, Some(0.0))
        );
    }

    #[test]
    fn standstill_gaps_are_those_at_rest() {
        // 10 m/s at 5 m/s² takes 10 m, 12 m/s at 6 m/s² takes 12 m: 8 m become 6 m.
        let pair = pair_trace(8.0, [(10.0, &[(3.0, -5.0)]), (12.0, &[(3.0, -6.0)])], 0.5);
        let approach = Approach::from_trace(&pair, &[], 1).unwrap();
        assert!((approach.standstill_gap_m().unwrap() - 6.0).abs() < 1e-12);
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// For any motion and any stop within a step, a hundred times finer sampling finds the same gap.
        #[test]
        fn the_smallest_gap_does_not_depend_on_the_sampling(
            gap_m in 30.0..60.0f64,
            speeds in prop::array::uniform2(0.0..20.0f64),
            front in prop::collection::vec(-8.0..2.0f64, 4),
            rear in prop::collection::vec(-8.0..2.0f64, 4),
        ) {
            let pieces = |a: &[f64]| a.iter().map(|&a| (0.5, a)).collect::<Vec<_>>();
            let min_gap = |step_s: f64| {
                let front = driven_track(4.0, gap_m + 4.0, speeds[0], &pieces(&front), step_s);
                let rear = driven_track(4.0, 0.0, speeds[1], &pieces(&rear), step_s);
                Approach::from_trace(&trace(vec![front, rear], step_s), &[], 1).unwrap().min_gap_m().unwrap()
            };
            let (coarse, fine) = (min_gap(0.5), min_gap(0.005));
            prop_assert!((coarse - fine).abs() < 1e-9, "{coarse} against {fine}");
        }
    }
}
