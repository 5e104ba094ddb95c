//! The three filters of the ego vehicle and the observation that they yield.

use std::sync::Arc;

use super::gap_faults::GapFaults;
use super::{Accelerometer, DistanceEstimate, Filter, KnownChange, Sensor, Tuning};
use crate::observation::{BANDWIDTH_RAD_PER_S, Neighbour, Observation};
use crate::random::{NoiseShare, NoiseStream, Purpose};
use crate::scenario::Sensors;

/// Filter constants of an ego vehicle: one set for its position, one for both gaps.
#[derive(Debug, Clone, PartialEq)]
pub struct EgoTuning {
    position: Tuning,
    gap: Tuning,
}

impl EgoTuning {
    /// Computes the tuning for a step and sensor noise.
    #[must_use]
    pub fn new(step_s: f64, sensors: &Sensors) -> Self {
        Self {
            position: Tuning::new(step_s, sensors.position_noise_m, BANDWIDTH_RAD_PER_S),
            gap: Tuning::new(step_s, sensors.gap_noise_m, BANDWIDTH_RAD_PER_S),
        }
    }

    /// Returns error bounds of gap ahead (m), own speed and leader speed (m/s) if no measurement is lost.
    ///
    /// `spans_mps2` are the widths of the ranges in which the own and the leader's acceleration vary. Noise is bounded
    /// by `deviations` steady-state standard deviations. Only changes of the leader's acceleration cause filter errors,
    /// because the own acceleration is fed forward. For a vehicle that stops within a step, the bounds use its mean
    /// acceleration over the step; this omits a position error below a h²/8.
    pub(crate) fn worst_errors(&self, spans_mps2: [f64; 2], deviations: f64) -> [f64; 3] {
        let [own_mps2, ahead_mps2] = spans_mps2;
        let [_, speed_mps] = worst_distance_and_rate(&self.position, 0.0, deviations);
        let [gap_m, rate_mps] = worst_distance_and_rate(&self.gap, ahead_mps2, deviations);
        let stop_mps = (own_mps2 + ahead_mps2) * self.gap.step_s();
        [
            gap_m + stop_mps * self.gap.step_s(),
            speed_mps + stop_mps,
            speed_mps + rate_mps + 2.0 * stop_mps,
        ]
    }

    /// Returns the constants of the filter of the own position.
    #[must_use]
    pub fn position(&self) -> &Tuning {
        &self.position
    }

    /// Returns the constants of the filters of both gaps.
    #[must_use]
    pub fn gap(&self) -> &Tuning {
        &self.gap
    }
}

/// Returns error bounds of a filter: distance (m) and rate (m/s), if the acceleration varies by `span_mps2`.
fn worst_distance_and_rate(tuning: &Tuning, span_mps2: f64, deviations: f64) -> [f64; 2] {
    let [distance, rate, _] = tuning.steady_deviations();
    let [distance_s2, rate_s] = tuning.manoeuvre_errors();
    [
        0.5 * span_mps2 * distance_s2 + deviations * distance,
        0.5 * span_mps2 * rate_s + deviations * rate,
    ]
}

/// True state of a vehicle and its neighbours at one instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TrueState {
    /// Position of the front bumper, in metres.
    pub position_m: f64,
    /// True values of the eight quantities of an observation.
    pub observation: Observation,
}

/// Sensors and filters of one vehicle.
///
/// Three independent filters estimate own position, gap ahead and gap behind. The rate of a gap is a difference of two
/// speeds. A neighbour's speed is therefore the own speed plus (ahead) or minus (behind) the rate of its gap;
/// accelerations likewise. TTC depends only on gap and closing speed. Both come from one filter, so the error of the
/// own speed does not affect TTC, unless an estimated speed is clipped at 0.
///
/// Measured changes of the own motion are fed forward into all three filters.
#[derive(Debug, Clone)]
pub struct EgoEstimator {
    tuning: Arc<EgoTuning>,
    /// Random numbers of initial filter errors.
    initial_errors: NoiseStream,
    accelerometer: Accelerometer,
    position: (Sensor, Filter),
    ahead: (Sensor, Option<Filter>),
    behind: (Sensor, Option<Filter>),
    /// Faults of the sensors ahead and behind. Boxed, because most sensors have none.
    faults: Option<Box<[GapFaults; 2]>>,
}

impl EgoEstimator {
    /// Creates the sensors and filters of vehicle `vehicle` at the start of the scenario, whose state is `truth`. The
    /// filters are in steady state, as after a drive at constant speed.
    #[must_use]
    pub fn new(
        seed: u64,
        vehicle: usize,
        sensors: &Sensors,
        tuning: &Arc<EgoTuning>,
        truth: &TrueState,
    ) -> Self {
        Self::with_noise_shares(seed, &[], vehicle, sensors, tuning, truth)
    }

    /// Creates them with noise of shares, the first of which has the seed `seed`.
    pub(crate) fn with_noise_shares(
        seed: u64,
        shares: &[NoiseShare],
        vehicle: usize,
        sensors: &Sensors,
        tuning: &Arc<EgoTuning>,
        truth: &TrueState,
    ) -> Self {
        let own = &truth.observation;
        let mut first =
            NoiseStream::from_shares(seed, shares, Purpose::InitialEstimate, vehicle as u64);
        let position = steady_filter(
            &mut first,
            &tuning.position,
            truth.position_m,
            own.speed_mps,
        );
        let sensor = |purpose, noise_m| {
            Sensor::with_noise_shares(seed, shares, purpose, vehicle, noise_m, sensors)
        };
        let mut estimator = Self {
            tuning: Arc::clone(tuning),
            initial_errors: first,
            accelerometer: Accelerometer::new(own.speed_mps),
            position: (
                sensor(Purpose::PositionSensor, sensors.position_noise_m),
                position,
            ),
            ahead: (sensor(Purpose::GapAheadSensor, sensors.gap_noise_m), None),
            behind: (sensor(Purpose::GapBehindSensor, sensors.gap_noise_m), None),
            faults: GapFaults::new(seed, vehicle, sensors, tuning.position.step_s()),
        };
        if estimator.faults.is_none() {
            estimator.start_filters(truth, [true, true]);
        }
        estimator
    }

    /// Restarts the filters of the neighbours that `changed` ([ahead, behind]). They start in steady state, because
    /// sensors already track vehicles beside the lane.
    pub(crate) fn switch_neighbours(&mut self, truth: &TrueState, changed: [bool; 2]) {
        match &mut self.faults {
            None => self.start_filters(truth, changed),
            Some(faults) => {
                let sides = faults
                    .iter_mut()
                    .zip(changed)
                    .filter(|(_, changed)| *changed);
                sides.for_each(|(faults, _)| faults.switch_neighbour());
            }
        }
    }

    fn start_filters(&mut self, truth: &TrueState, changed: [bool; 2]) {
        let own = &truth.observation;
        let sides = [
            (&mut self.ahead, own.ahead, 1.0),
            (&mut self.behind, own.behind, -1.0),
        ];
        for (((_, filter), neighbour, sign), _) in sides
            .into_iter()
            .zip(changed)
            .filter(|(_, changed)| *changed)
        {
            *filter = neighbour.map(|neighbour| {
                steady_filter(
                    &mut self.initial_errors,
                    &self.tuning.gap,
                    neighbour.gap_m,
                    sign * (neighbour.speed_mps - own.speed_mps),
                )
            });
        }
    }

    /// Measures the true state of this step and returns the estimated observation.
    #[inline]
    pub fn observe(&mut self, truth: &TrueState) -> Observation {
        if self.faults.is_some() {
            self.observe_with_faults(truth)
        } else {
            self.estimate(truth)
        }
    }

    /// Replaces the true neighbours by the targets that the faulty sensors report, and estimates their state.
    #[cold]
    fn observe_with_faults(&mut self, truth: &TrueState) -> Observation {
        let mut sensed = *truth;
        let mut changed = [false; 2];
        if let Some([ahead, behind]) = self.faults.as_deref_mut() {
            changed = [
                ahead.sense(truth, &mut sensed.observation.ahead, 1.0),
                behind.sense(truth, &mut sensed.observation.behind, -1.0),
            ];
        }
        self.start_filters(&sensed, changed);
        self.estimate(&sensed)
    }

    #[inline]
    fn estimate(&mut self, truth: &TrueState) -> Observation {
        let tuning = &*self.tuning;
        let true_observation = &truth.observation;
        let change = self.accelerometer.measure_change(
            tuning.position.step_s(),
            true_observation.speed_mps,
            true_observation.acceleration_mps2,
        );
        let own = measure(
            (&mut self.position.0, &mut self.position.1),
            &tuning.position,
            truth.position_m,
            (&change, 1.0),
            None,
        );
        let [ahead_faults, behind_faults] = match self.faults.as_deref() {
            Some([ahead, behind]) => [Some(ahead), Some(behind)],
            None => [None; 2],
        };
        let ahead = measure_gap(
            &mut self.ahead,
            &tuning.gap,
            true_observation.ahead,
            (&change, -1.0),
            ahead_faults,
        );
        let behind = measure_gap(
            &mut self.behind,
            &tuning.gap,
            true_observation.behind,
            (&change, 1.0),
            behind_faults,
        );
        Observation {
            speed_mps: own.rate_mps.max(0.0),
            acceleration_mps2: own.acceleration_mps2,
            ahead: ahead.map(|gap| neighbour_from(&own, &gap, 1.0)),
            behind: behind.map(|gap| neighbour_from(&own, &gap, -1.0)),
        }
    }
}

/// Returns the estimated state of a neighbour; `sign` is 1 ahead and -1 behind.
#[inline]
fn neighbour_from(own: &DistanceEstimate, gap: &DistanceEstimate, sign: f64) -> Neighbour {
    Neighbour {
        gap_m: gap.distance_m,
        speed_mps: (own.rate_mps + sign * gap.rate_mps).max(0.0),
        acceleration_mps2: own.acceleration_mps2 + sign * gap.acceleration_mps2,
    }
}

/// Creates a filter in steady state with a random initial error.
fn steady_filter(
    errors: &mut NoiseStream,
    tuning: &Tuning,
    distance_m: f64,
    rate_mps: f64,
) -> Filter {
    let normals = [0; 3].map(|_| errors.normal());
    Filter::new_steady(tuning, distance_m, rate_mps, normals)
}

/// Measures and estimates the gap to a neighbour, if there is one.
#[inline]
fn measure_gap(
    (sensor, filter): &mut (Sensor, Option<Filter>),
    tuning: &Tuning,
    neighbour: Option<Neighbour>,
    change: (&KnownChange, f64),
    faults: Option<&GapFaults>,
) -> Option<DistanceEstimate> {
    let filter = filter.as_mut()?;
    let gap_m = neighbour?.gap_m;
    Some(measure((sensor, filter), tuning, gap_m, change, faults))
}

#[inline]
fn measure(
    (sensor, filter): (&mut Sensor, &mut Filter),
    tuning: &Tuning,
    distance_m: f64,
    (change, sign): (&KnownChange, f64),
    faults: Option<&GapFaults>,
) -> DistanceEstimate {
    let measured_m = sensor.measure(distance_m);
    let measured_m = faults.map_or(measured_m, |faults| faults.degrade(measured_m));
    filter.advance(tuning, change, sign, measured_m)
}
