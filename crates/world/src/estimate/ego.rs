//! The ego's three filters and the observation they make up.

use std::sync::Arc;

use rand_distr::{Distribution, StandardNormal};

use super::{Accelerometer, DistanceEstimate, Filter, KnownChange, Sensor, Tuning};
use crate::observation::{Neighbour, Observation};
use crate::random::{self, Purpose, Stream};
use crate::scenario::Sensors;

/// Bandwidth of all three filters, in rad/s.
///
/// At the default noise this gives closing speeds to 0.06 m/s and a neighbour's speed and acceleration to 0.07 m/s and
/// 0.29 m/s² (one sigma), and follows the onset of braking within about 0.3 s. Half of it would miss the start of an emergency brake; twice would be too noisy for a
/// controller that looks at accelerations.
pub const BANDWIDTH_RAD_PER_S: f64 = 5.0;

/// Filter constants of an ego: one set for its own position, one for both gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct EgoTuning {
    position: Tuning,
    gap: Tuning,
}

impl EgoTuning {
    /// The tuning for a step and sensor noise.
    #[must_use]
    pub fn new(step_s: f64, sensors: &Sensors) -> Self {
        Self {
            position: Tuning::new(step_s, sensors.position_noise_m, BANDWIDTH_RAD_PER_S),
            gap: Tuning::new(step_s, sensors.gap_noise_m, BANDWIDTH_RAD_PER_S),
        }
    }

    /// Bounds of the errors of gap ahead (m), own speed and speed ahead (m/s), when no measurement is lost.
    ///
    /// `spans_mps2` are the widths of the ranges in which the own acceleration and the one ahead may change as they please;
    /// noise counts up to `deviations` standard deviations, each in steady state. The own acceleration is felt and fed
    /// forward, so only the one ahead can mislead a filter. A vehicle that stops inside a step counts with its mean
    /// acceleration over the step; what that leaves out in position is less than a h²/8.
    #[must_use]
    pub(crate) fn worst_errors(&self, spans_mps2: [f64; 2], deviations: f64) -> [f64; 3] {
        let [own_mps2, ahead_mps2] = spans_mps2;
        let worst = |tuning: &Tuning, span_mps2: f64| {
            let [distance, rate, _] = tuning.steady_deviations();
            let [distance_s2, rate_s] = tuning.manoeuvre_errors();
            [0.5 * span_mps2 * distance_s2 + deviations * distance, 0.5 * span_mps2 * rate_s + deviations * rate]
        };
        let [_, speed_mps] = worst(&self.position, 0.0);
        let [gap_m, rate_mps] = worst(&self.gap, ahead_mps2);
        let stop_mps = (own_mps2 + ahead_mps2) * self.gap.step_s();
        [gap_m + stop_mps * self.gap.step_s(), speed_mps + stop_mps, speed_mps + rate_mps + 2.0 * stop_mps]
    }

    /// The constants of the filter of the own position.
    #[must_use]
    pub fn position(&self) -> &Tuning {
        &self.position
    }

    /// The constants of the filters of both gaps.
    #[must_use]
    pub fn gap(&self) -> &Tuning {
        &self.gap
    }
}

/// What is true of a vehicle and its neighbours at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueState {
    /// Front bumper, in metres.
    pub position_m: f64,
    /// The eight numbers, true.
    pub observation: Observation,
}

/// One vehicle's sensors and filters.
///
/// Three independent filters: own position, gap ahead, gap behind. With g the gap, its rate is the difference of two
/// speeds, so a neighbour's speed is the own estimated speed plus (ahead) or minus (behind) the estimated rate of its gap;
/// accelerations likewise. What TTC needs, gap and closing speed, thus comes from one filter and does not carry the
/// error of the own speed, as long as neither estimated speed is cut off at standstill.
///
/// What the ego feels of its own motion is fed forward into all three, so that only the neighbours can surprise them.
#[derive(Debug, Clone)]
pub struct EgoEstimator {
    tuning: Arc<EgoTuning>,
    /// First errors of filters.
    initial_error_stream: Stream,
    accelerometer: Accelerometer,
    position: (Sensor, Filter),
    ahead: (Sensor, Option<Filter>),
    behind: (Sensor, Option<Filter>),
}

impl EgoEstimator {
    /// Sensors and filters of vehicle `vehicle` that have been running before the scenario starts in state `truth`, at constant
    /// speed until then.
    #[must_use]
    pub fn new(seed: u64, vehicle: usize, sensors: &Sensors, tuning: &Arc<EgoTuning>, truth: &TrueState) -> Self {
        let own = &truth.observation;
        let mut first = random::stream(seed, Purpose::InitialEstimate, vehicle as u64);
        let position = steady_filter(&mut first, &tuning.position, truth.position_m, own.speed_mps);
        let sensor = |purpose, noise_m| Sensor::new(seed, purpose, vehicle, noise_m, sensors);
        let mut estimator = Self {
            tuning: Arc::clone(tuning),
            initial_error_stream: first,
            accelerometer: Accelerometer::new(own.speed_mps),
            position: (sensor(Purpose::PositionSensor, sensors.position_noise_m), position),
            ahead: (sensor(Purpose::GapAheadSensor, sensors.gap_noise_m), None),
            behind: (sensor(Purpose::GapBehindSensor, sensors.gap_noise_m), None),
        };
        estimator.switch_neighbours(truth, [true, true]);
        estimator
    }

    /// Follows other vehicles from here on, ahead and behind where they have `changed`: as if those had been followed before, as
    /// sensors follow vehicles beside the lane too.
    pub(crate) fn switch_neighbours(&mut self, truth: &TrueState, changed: [bool; 2]) {
        let own = &truth.observation;
        let sides = [(&mut self.ahead, own.ahead, 1.0), (&mut self.behind, own.behind, -1.0)];
        for (((_, filter), neighbour, sign), _) in sides.into_iter().zip(changed).filter(|(_, changed)| *changed) {
            *filter = neighbour.map(|other| {
                steady_filter(
                    &mut self.initial_error_stream,
                    &self.tuning.gap,
                    other.gap_m,
                    sign * (other.speed_mps - own.speed_mps),
                )
            });
        }
    }

    /// Measures the true state of this step and returns what the ego makes of it.
    #[inline]
    pub fn observe(&mut self, truth: &TrueState) -> Observation {
        let tuning = &*self.tuning;
        let truly = &truth.observation;
        let felt =
            self.accelerometer.measure_change(tuning.position.step_s(), truly.speed_mps, truly.acceleration_mps2);
        let (sensor, filter) = &mut self.position;
        let own = measure((sensor, filter), &tuning.position, truth.position_m, (&felt, 1.0));
        let neighbour = |gap: DistanceEstimate, sign: f64| Neighbour {
            gap_m: gap.distance_m,
            speed_mps: (own.rate_mps + sign * gap.rate_mps).max(0.0),
            acceleration_mps2: own.acceleration_mps2 + sign * gap.acceleration_mps2,
        };
        let seen = |(sensor, filter): &mut (Sensor, Option<Filter>), other: Option<Neighbour>, sign| {
            let (filter, other) = filter.as_mut().zip(other)?;
            Some(measure((sensor, filter), &tuning.gap, other.gap_m, (&felt, sign)))
        };
        Observation {
            speed_mps: own.rate_mps.max(0.0),
            acceleration_mps2: own.acceleration_mps2,
            ahead: seen(&mut self.ahead, truly.ahead, -1.0).map(|gap| neighbour(gap, 1.0)),
            behind: seen(&mut self.behind, truly.behind, 1.0).map(|gap| neighbour(gap, -1.0)),
        }
    }
}

/// A filter that has been running: its error is the next draw.
fn steady_filter(first: &mut Stream, tuning: &Tuning, distance_m: f64, rate_mps: f64) -> Filter {
    let normals = [0; 3].map(|_| StandardNormal.sample(first));
    Filter::new_steady(tuning, distance_m, rate_mps, normals)
}

#[inline]
fn measure(
    (sensor, filter): (&mut Sensor, &mut Filter),
    tuning: &Tuning,
    distance_m: f64,
    (felt, sign): (&KnownChange, f64),
) -> DistanceEstimate {
    filter.feed_forward(tuning, felt, sign);
    filter.update(tuning, sensor.measure(distance_m))
}
