//! Faults of one gap sensor.

use std::collections::VecDeque;
use std::ops::Range;

use rand::RngExt;

use super::TrueState;
use crate::observation::Neighbour;
use crate::random::{self, Purpose, Stream};
use crate::scenario::{GhostObject, SensorFaults, Sensors};

/// Faults of one gap sensor of one vehicle.
///
/// Each step, [`sense`](Self::sense) selects the target that the sensor reports, and [`degrade`](Self::degrade) applies
/// outages and resolution to its noisy measurement.
#[derive(Debug, Clone)]
pub(super) struct GapFaults {
    step_s: f64,
    bias_m: f64,
    resolution_m: f64,
    range_m: f64,
    latency_steps: usize,
    detection_steps: usize,
    /// Number of steps for which the neighbour has been in the lane and in range.
    steps_in_range: usize,
    /// Latest true gaps of the target, oldest first.
    past_gaps_m: VecDeque<f64>,
    tracked: Option<Target>,
    ghost: Option<Ghost>,
    outages: Option<Outages>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Target {
    Vehicle,
    Ghost,
}

impl GapFaults {
    /// Creates the faults of the sensors ahead and behind; `None` without faults. Only the sensor ahead reports ghosts.
    pub(super) fn new(
        seed: u64,
        vehicle: usize,
        sensors: &Sensors,
        step_s: f64,
    ) -> Option<Box<[Self; 2]>> {
        let faults = &sensors.faults;
        let sides = [
            (Purpose::GapAheadOutage, faults.ghost),
            (Purpose::GapBehindOutage, None),
        ];
        faults.is_any().then(|| {
            Box::new(sides.map(|(purpose, ghost)| {
                let outages = random::stream(seed, purpose, vehicle as u64);
                Self::for_sensor(faults, ghost, outages, step_s)
            }))
        })
    }

    fn for_sensor(
        faults: &SensorFaults,
        ghost: Option<GhostObject>,
        outages: Stream,
        step_s: f64,
    ) -> Self {
        Self {
            step_s,
            bias_m: faults.gap_bias_m,
            resolution_m: faults.gap_resolution_m,
            range_m: faults.range_m.unwrap_or(f64::INFINITY),
            latency_steps: whole_steps(faults.latency_s, step_s),
            detection_steps: whole_steps(faults.detection_delay_s, step_s),
            // Vehicles in range at the start are detected already.
            steps_in_range: usize::MAX,
            past_gaps_m: VecDeque::new(),
            tracked: None,
            ghost: ghost.map(|ghost| Ghost::new(ghost, step_s)),
            outages: Outages::new(outages, faults, step_s),
        }
    }

    /// Notes that another vehicle is the neighbour from now on.
    pub(super) fn switch_neighbour(&mut self) {
        self.steps_in_range = 0;
        self.tracked = self.tracked.filter(|&tracked| tracked == Target::Ghost);
    }

    /// Replaces the true neighbour by the target that the sensor reports, with its delayed and biased gap. `sign` is 1
    /// ahead and -1 behind. Returns true if the filter must start anew.
    pub(super) fn sense(
        &mut self,
        own: &TrueState,
        neighbour: &mut Option<Neighbour>,
        sign: f64,
    ) -> bool {
        if let Some(outages) = &mut self.outages {
            outages.advance();
        }
        let ghost = self
            .ghost
            .as_mut()
            .and_then(|ghost| ghost.advance(own.position_m, self.step_s));
        let in_range = neighbour.filter(|neighbour| neighbour.gap_m <= self.range_m);
        let detected = in_range.filter(|_| self.steps_in_range >= self.detection_steps);
        self.steps_in_range = in_range.map_or(0, |_| self.steps_in_range.saturating_add(1));
        let target = match (detected, ghost) {
            (Some(vehicle), Some(ghost)) if vehicle.gap_m <= ghost.gap_m => {
                Some((vehicle, Target::Vehicle))
            }
            (_, Some(ghost)) => Some((ghost, Target::Ghost)),
            (Some(vehicle), None) => Some((vehicle, Target::Vehicle)),
            (None, None) => None,
        };
        let kind = target.map(|(_, kind)| kind);
        let is_new = kind != self.tracked;
        self.tracked = kind;
        *neighbour = target.map(|(target, _)| {
            if is_new {
                // Assumes constant speeds before.
                let step_m = sign * (target.speed_mps - own.observation.speed_mps) * self.step_s;
                self.restart_past_gaps(target.gap_m, step_m);
            }
            Neighbour {
                gap_m: self.delayed_gap_m(target.gap_m) + self.bias_m,
                ..target
            }
        });
        is_new
    }

    /// Sets the past gaps of a new target, whose gap grew by `step_m` per step.
    fn restart_past_gaps(&mut self, gap_m: f64, step_m: f64) {
        let past = (1..=self.latency_steps).rev();
        self.past_gaps_m = past.map(|steps| gap_m - steps as f64 * step_m).collect();
    }

    /// Records a gap, and returns that before the latency.
    fn delayed_gap_m(&mut self, gap_m: f64) -> f64 {
        self.past_gaps_m.push_back(gap_m);
        self.past_gaps_m.pop_front().unwrap_or(gap_m)
    }

    /// Applies outages and resolution to a measurement.
    pub(super) fn degrade(&self, measured_m: Option<f64>) -> Option<f64> {
        let is_lost = self.outages.as_ref().is_some_and(|outages| outages.is_lost);
        let measured_m = measured_m.filter(|_| !is_lost)?;
        let resolution_m = self.resolution_m;
        Some(if resolution_m > 0.0 {
            (measured_m / resolution_m).round() * resolution_m
        } else {
            measured_m
        })
    }
}

/// A ghost object in progress.
#[derive(Debug, Clone)]
struct Ghost {
    object: GhostObject,
    /// Steps in which it is reported.
    steps: Range<usize>,
    step: usize,
    position_m: f64,
}

fn whole_steps(time_s: f64, step_s: f64) -> usize {
    (time_s / step_s).round() as usize
}

impl Ghost {
    fn new(object: GhostObject, step_s: f64) -> Self {
        let onset = whole_steps(object.onset_s, step_s);
        Self {
            steps: onset..onset + whole_steps(object.duration_s, step_s),
            step: 0,
            position_m: 0.0,
            object,
        }
    }

    /// Returns the ghost of this step, unless it is not reported, and moves it by a step.
    fn advance(&mut self, own_position_m: f64, step_s: f64) -> Option<Neighbour> {
        let GhostObject {
            gap_m, speed_mps, ..
        } = self.object;
        if self.step == self.steps.start {
            self.position_m = own_position_m + gap_m;
        }
        let ahead_m = self.position_m - own_position_m;
        let is_reported = self.steps.contains(&self.step) && ahead_m > 0.0;
        self.step += 1;
        self.position_m += speed_mps * step_s;
        is_reported.then_some(Neighbour {
            gap_m: ahead_m,
            speed_mps,
            acceleration_mps2: 0.0,
        })
    }
}

/// Outages as a continuous-time Markov chain with two states, sampled once per step.
///
/// The chain leaves the available state at rate λ and the outage at rate µ, the reciprocal of the mean length. Over a
/// step h, it changes from available to lost with probability λ/(λ+µ) (1 - exp(-(λ+µ) h)). Share and correlation of
/// outages therefore do not depend on the step.
#[derive(Debug, Clone)]
struct Outages {
    stream: Stream,
    /// Probabilities of a change per step, from available and from lost.
    change: [f64; 2],
    is_lost: bool,
}

impl Outages {
    fn new(mut stream: Stream, faults: &SensorFaults, step_s: f64) -> Option<Self> {
        let rate_per_s = faults.outage_rate_per_s;
        let length_s = faults.outage_length_s;
        let lost_share = rate_per_s * length_s / (1.0 + rate_per_s * length_s);
        (lost_share > 0.0).then(|| {
            let mixing = -(-(rate_per_s + 1.0 / length_s) * step_s).exp_m1();
            let is_lost = stream.random::<f64>() < lost_share;
            Self {
                stream,
                change: [lost_share * mixing, (1.0 - lost_share) * mixing],
                is_lost,
            }
        })
    }

    fn advance(&mut self) {
        self.is_lost ^= self.stream.random::<f64>() < self.change[usize::from(self.is_lost)];
    }
}

#[cfg(test)]
mod tests;
