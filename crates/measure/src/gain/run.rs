//! Runs of a line of vehicles: settling, and steady oscillation.

use std::f64::consts::TAU;
use std::sync::Arc;

use super::amplitude::Wave;
use super::{GainError, MeasuredGain, NoGain, OSCILLATION_AMPLITUDE_MPS, OperatingPoint};
use crumple_sim::control::ControllerSource;
use crumple_sim::engine::{
    Outcome, RecordingLevel, Run, RunError, RunOptions, SimulationResult, Trace, Track,
    simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{FollowingLine, PAPER_STEP_S, Scenario, SpeedOscillation};

/// Vehicles under test in the line.
const VEHICLES: usize = 3;

/// Initial time gap of vehicles that settle, in seconds, and their initial excess speed, in m/s. A controller that only
/// keeps its speed does not settle.
const START_TIME_GAP_S: f64 = 1.5;
const START_CLOSING_MPS: f64 = 2.0;

/// Durations of settling, in seconds: the longer one for vehicles that have not settled after the shorter one.
const SETTLING_S: [f64; 2] = [200.0, 1200.0];

/// Time before the end of settling in which speed and gap must be constant, in seconds.
const SETTLED_S: f64 = 60.0;

/// Largest deviation from the leader's speed of a settled vehicle, in m/s: a tenth of the oscillation.
const SETTLED_SPEED_MPS: f64 = 0.1 * OSCILLATION_AMPLITUDE_MPS;

/// Largest change of the gap of a settled vehicle within [`SETTLED_S`], in metres.
const SETTLED_GAP_M: f64 = 0.3;

/// Least duration of a window that measures an amplitude, in seconds.
const WINDOW_S: f64 = 15.0;

/// Least times before the first window, in seconds: the longer one if the oscillation is not steady after the shorter.
/// The amplitude grows in the first half.
const TRANSIENT_S: [f64; 2] = [60.0, 400.0];

/// Largest difference of a vehicle's amplitudes in two successive windows of a steady oscillation, relative to that of
/// the leader.
const STEADY_TOLERANCE: f64 = 3e-4;

/// Smallest amplitude of a vehicle that its follower's gain refers to, relative to that of the leader.
const MIN_AMPLITUDE: f64 = 0.03;

/// Runs of lines of vehicles with one controller, which observes the true state.
pub(super) struct LineRuns {
    options: RunOptions,
    /// Settled gaps by mean speed.
    settled: Vec<(f64, SettledGaps)>,
}

type SettledGaps = Result<Vec<f64>, NoGain>;

impl LineRuns {
    pub(super) fn new(controller: &Arc<dyn ControllerSource>) -> Self {
        let options = RunOptions::new(controller.clone()).with_estimator(EstimatorKind::Truth);
        Self {
            options,
            settled: Vec::new(),
        }
    }

    /// Measures the gain at each point. A point whose oscillation is not steady is repeated with a longer transient.
    pub(super) fn measure(
        &mut self,
        points: &[OperatingPoint],
    ) -> Result<Vec<MeasuredGain>, GainError> {
        self.settle(points)?;
        let mut measured: Vec<MeasuredGain> = points
            .iter()
            .map(|&at| MeasuredGain {
                at,
                gain: Err(NoGain::NotSteady),
            })
            .collect();
        for transient_s in TRANSIENT_S {
            let mut prepared = Vec::new();
            for (index, point) in measured
                .iter_mut()
                .enumerate()
                .filter(|(_, point)| point.gain == Err(NoGain::NotSteady))
            {
                match self.settled_gaps(point.at.mean_speed_mps) {
                    Ok(gaps_m) => {
                        prepared.push((index, Windows::new(point.at, transient_s), gaps_m))
                    }
                    Err(reason) => point.gain = Err(reason),
                }
            }
            let lines = prepared
                .iter()
                .map(|(index, windows, gaps_m)| windows.line(measured[*index].at, gaps_m));
            let lines = lines.collect::<Result<Vec<_>, _>>()?;
            let gains = self.simulate(&lines, |line, trace| prepared[line].1.gain(trace))?;
            for ((index, ..), gain) in prepared.iter().zip(gains) {
                measured[*index].gain = gain;
            }
        }
        Ok(measured)
    }

    /// Lets the vehicles settle behind a leader at each speed that is not known yet.
    fn settle(&mut self, points: &[OperatingPoint]) -> Result<(), GainError> {
        let mut pending: Vec<f64> = Vec::new();
        for speed_mps in points.iter().map(|point| point.mean_speed_mps) {
            if self
                .settled
                .iter()
                .all(|(settled, _)| *settled != speed_mps)
                && !pending.contains(&speed_mps)
            {
                pending.push(speed_mps);
            }
        }
        for (attempt, duration_s) in SETTLING_S.into_iter().enumerate() {
            let lines = pending
                .iter()
                .map(|&speed_mps| settling_line(speed_mps, duration_s));
            let lines = lines.collect::<Result<Vec<_>, _>>()?;
            let gaps_m = self.simulate(&lines, |_, trace| settled_gaps_m(trace))?;
            let is_last = attempt + 1 == SETTLING_S.len();
            let (done, again): (Vec<_>, Vec<_>) = pending
                .into_iter()
                .zip(gaps_m)
                .partition(|(_, gaps_m)| is_last || *gaps_m != Err(NoGain::NotSettled));
            self.settled.extend(done);
            pending = again.into_iter().map(|(speed_mps, _)| speed_mps).collect();
        }
        Ok(())
    }

    fn settled_gaps(&self, speed_mps: f64) -> SettledGaps {
        let settled = self.settled.iter().find(|(speed, _)| *speed == speed_mps);
        match settled {
            // A collision on the way to the equilibrium says nothing about oscillations.
            None | Some((_, Err(NoGain::Collision))) => Err(NoGain::NotSettled),
            Some((_, gaps_m)) => gaps_m.clone(),
        }
    }

    fn simulate<T: Send>(
        &self,
        lines: &[Scenario],
        read: impl Fn(usize, &Trace) -> Result<T, NoGain> + Sync,
    ) -> Result<Vec<Result<T, NoGain>>, RunError> {
        let runs = lines
            .iter()
            .map(|line| Run::new(line, self.options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(simulate_batch(
            &runs,
            RecordingLevel::Trace,
            |index, result| read(index, complete_trace(&result)?),
        ))
    }
}

fn complete_trace(result: &SimulationResult) -> Result<&Trace, NoGain> {
    match &result.outcome {
        Outcome::ControllerFailed(failed) => Err(NoGain::Unanswered(failed.reason())),
        Outcome::Collision(_) => Err(NoGain::Collision),
        Outcome::NoCollision => result.trace.as_ref().ok_or(NoGain::NotSettled),
    }
}

fn to_steps(duration_s: f64) -> usize {
    (duration_s / PAPER_STEP_S).round() as usize
}

fn settling_line(mean_speed_mps: f64, duration_s: f64) -> Result<Scenario, GainError> {
    let gaps_m = vec![START_TIME_GAP_S * mean_speed_mps; VEHICLES];
    let line = FollowingLine {
        mean_speed_mps,
        closing_mps: START_CLOSING_MPS,
        gaps_m,
    };
    Ok(line.scenario(None, to_steps(duration_s))?)
}

/// Returns the final gaps, if all vehicles keep the leader's speed and their gaps at the end.
fn settled_gaps_m(trace: &Trace) -> SettledGaps {
    let from = trace.len().saturating_sub(to_steps(SETTLED_S));
    let leader_mps = trace
        .vehicles
        .first()
        .and_then(|leader| leader.speed_mps.first())
        .ok_or(NoGain::NotSettled)?;
    (1..trace.vehicles.len())
        .map(|rear| settled_gap_m(trace, rear, from, *leader_mps))
        .collect::<Option<Vec<_>>>()
        .ok_or(NoGain::NotSettled)
}

/// Returns the final gap of a vehicle, if it keeps the leader's speed and its gap from sample `from` on.
fn settled_gap_m(trace: &Trace, rear: usize, from: usize, leader_mps: f64) -> Option<f64> {
    let late_mps = trace.vehicles.get(rear)?.speed_mps.get(from..)?;
    let gaps_m = trace.gaps_m(rear);
    let first_m = gaps_m.get(from).copied().flatten()?;
    let last_m = gaps_m.last().copied().flatten()?;
    let keeps_speed = late_mps
        .iter()
        .all(|speed_mps| (speed_mps - leader_mps).abs() <= SETTLED_SPEED_MPS);
    (keeps_speed && (last_m - first_m).abs() <= SETTLED_GAP_M).then_some(last_m)
}

/// Two successive windows of whole periods after a transient, in steps.
struct Windows {
    transient: usize,
    window: usize,
    /// Periods in a window.
    periods: usize,
}

impl Windows {
    fn new(at: OperatingPoint, transient_s: f64) -> Self {
        let period_s = TAU / at.frequency_rad_per_s;
        let periods = (WINDOW_S / period_s).ceil().max(1.0);
        let window = to_steps(periods * period_s);
        let transient = window * to_steps(transient_s).div_ceil(window);
        Self {
            transient,
            window,
            periods: periods as usize,
        }
    }

    /// Returns the scenario. Its frequency differs by less than 0.1 % from that of the point, so that the windows are
    /// whole numbers of periods and of steps.
    fn line(&self, at: OperatingPoint, gaps_m: &[f64]) -> Result<Scenario, GainError> {
        let line = FollowingLine {
            mean_speed_mps: at.mean_speed_mps,
            closing_mps: 0.0,
            gaps_m: gaps_m.to_vec(),
        };
        let oscillation = SpeedOscillation {
            amplitude_mps: OSCILLATION_AMPLITUDE_MPS,
            frequency_rad_per_s: TAU * self.periods as f64 / (self.window as f64 * PAPER_STEP_S),
            build_up_s: 0.5 * self.transient as f64 * PAPER_STEP_S,
        };
        Ok(line.scenario(Some(oscillation), self.transient + 2 * self.window)?)
    }

    /// Returns the largest ratio of the amplitudes of a vehicle and of the vehicle ahead in the last window.
    fn gain(&self, trace: &Trace) -> Result<f64, NoGain> {
        let wave = Wave::new(self.periods, self.window);
        let mut amplitudes_mps: Vec<f64> = Vec::with_capacity(trace.vehicles.len());
        let mut mean_of_leader_mps = None;
        for track in &trace.vehicles {
            let [_, before_mps] = self.project(&wave, track, 0)?;
            let [mean_mps, amplitude_mps] = self.project(&wave, track, 1)?;
            let off_mps = mean_mps - *mean_of_leader_mps.get_or_insert(mean_mps);
            let change_mps = amplitude_mps - before_mps;
            if change_mps.abs() > STEADY_TOLERANCE * OSCILLATION_AMPLITUDE_MPS
                || off_mps.abs() > SETTLED_SPEED_MPS
            {
                return Err(NoGain::NotSteady);
            }
            amplitudes_mps.push(amplitude_mps);
        }
        let pairs = amplitudes_mps.iter().zip(amplitudes_mps.iter().skip(1));
        let moving =
            pairs.filter(|(ahead_mps, _)| **ahead_mps >= MIN_AMPLITUDE * OSCILLATION_AMPLITUDE_MPS);
        Ok(moving
            .map(|(ahead_mps, own_mps)| own_mps / ahead_mps)
            .fold(0.0, f64::max))
    }

    /// Returns mean and amplitude of a vehicle's speed in the first (0) or second (1) window, in m/s.
    fn project(&self, wave: &Wave, track: &Track, window: usize) -> Result<[f64; 2], NoGain> {
        let from = self.transient + window * self.window;
        let speed_mps = track
            .speed_mps
            .get(from..from + self.window)
            .ok_or(NoGain::NotSteady)?;
        Ok(wave.project(speed_mps))
    }
}
