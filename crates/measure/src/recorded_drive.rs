//! A drive behind a leader at equal intervals, as a recording holds it, so that a controller and a recorded driver can
//! be measured alike.

use crumple_sim::engine::Trace;
use crumple_sim::scenario::{RecordedMotion, RecordedSpeeds};

use super::approach::PairState;
use super::usefulness::{DriveStep, UsefulnessMeasures};

/// Time over which accelerations are measured, in seconds: the noise of recorded speeds averages out, and braking of a
/// car builds up within it.
pub const ACCELERATION_WINDOW_S: f64 = 0.5;

/// Median time gap above which a vehicle does not follow the recorded leader, in seconds: another one that is not
/// recorded may be between. In the public recordings of OpenACC, cars whose leader is recorded stay below.
pub const FAR_TIME_GAP_S: f64 = 4.5;

/// Speed from which these time gaps count, in m/s.
pub const MIN_FOLLOWING_MPS: f64 = 5.0;

/// Returns true if the median time gap of a recorded vehicle exceeds [`FAR_TIME_GAP_S`].
#[must_use]
pub fn is_far_behind(motion: &RecordedMotion) -> bool {
    let moving = |&(_, speed_mps): &(&f64, &f64)| *speed_mps >= MIN_FOLLOWING_MPS;
    let samples = || motion.gap_m.iter().zip(&motion.speed_mps).filter(moving);
    let is_far = |(gap_m, speed_mps): &(&f64, &f64)| **gap_m > FAR_TIME_GAP_S * **speed_mps;
    2 * samples().filter(is_far).count() > samples().count()
}

/// Speeds of a vehicle and its leader, and the gap between them, at equal intervals from the start on.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveSeries {
    /// Interval of the samples, in seconds.
    pub interval_s: f64,
    /// Speed of the leader, in m/s.
    pub leader_mps: Vec<f64>,
    /// Bumper gap, in metres.
    pub gap_m: Vec<f64>,
    /// Speed of the vehicle, in m/s.
    pub speed_mps: Vec<f64>,
}

/// Measures of a [`DriveSeries`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MeasuredSeries {
    /// Comfort, time gap and unnecessary braking.
    pub usefulness: UsefulnessMeasures,
    /// Hardest deceleration over [`ACCELERATION_WINDOW_S`], in m/s²; 0 without braking.
    pub peak_brake_mps2: f64,
}

impl DriveSeries {
    /// Returns the recorded motion of a vehicle behind a leader that repeats recorded speeds.
    #[must_use]
    pub fn recorded(leader: &RecordedSpeeds, motion: &RecordedMotion) -> Self {
        let times_s = (0..motion.gap_m.len()).map(|sample| sample as f64 * motion.interval_s);
        Self {
            interval_s: motion.interval_s,
            leader_mps: times_s.map(|time_s| leader.speed_at_mps(time_s)).collect(),
            gap_m: motion.gap_m.clone(),
            speed_mps: motion.speed_mps.clone(),
        }
    }

    /// Returns the simulated motion of vehicle `index` behind vehicle `index - 1`, at the samples of a trace nearest to
    /// the intervals.
    #[must_use]
    pub fn from_trace(trace: &Trace, index: usize, interval_s: f64) -> Option<Self> {
        let pair = [index.checked_sub(1)?, index].map(|vehicle| trace.vehicles.get(vehicle));
        let [Some(front), Some(rear)] = pair else {
            return None;
        };
        let mut series = Self::empty(interval_s);
        for sample in 0..trace.time_s.len() {
            let state = PairState::from_sample(&trace.time_s, [front, rear], sample)?;
            // The tolerance is for rounding, because times are sums of steps.
            while state.time_s >= series.gap_m.len() as f64 * interval_s - 1e-6 {
                series.leader_mps.push(state.front_speed_mps);
                series.gap_m.push(state.gap_m);
                series.speed_mps.push(state.rear_speed_mps);
            }
        }
        Some(series)
    }

    /// Returns a drive without samples.
    #[must_use]
    pub fn empty(interval_s: f64) -> Self {
        Self {
            interval_s,
            leader_mps: Vec::new(),
            gap_m: Vec::new(),
            speed_mps: Vec::new(),
        }
    }

    /// Returns the part of the drive until a time, in seconds.
    #[must_use]
    pub fn until(mut self, end_s: f64) -> Self {
        // 0.3 / 0.1 is less than 3.
        let intervals = (end_s / self.interval_s + 1e-6).max(0.0);
        let count = (intervals as usize).saturating_add(1);
        self.leader_mps.truncate(count);
        self.gap_m.truncate(count);
        self.speed_mps.truncate(count);
        self
    }

    /// Returns the duration, in seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.gap_m.len().saturating_sub(1) as f64 * self.interval_s
    }

    /// Returns the distance of the vehicle, in metres: the integral of its speed (trapezoid).
    #[must_use]
    pub fn distance_m(&self) -> f64 {
        let means = self.speed_mps.windows(2).map(|pair| match pair {
            [from, to] => 0.5 * (from + to),
            _ => 0.0,
        });
        means.sum::<f64>() * self.interval_s
    }

    /// Measures the drive, with accelerations over the last [`ACCELERATION_WINDOW_S`].
    #[must_use]
    pub fn measure(&self) -> MeasuredSeries {
        let steps = self.steps();
        let braking = steps.iter().map(|step| -step.acceleration_mps2);
        MeasuredSeries {
            peak_brake_mps2: braking.fold(0.0, f64::max),
            usefulness: UsefulnessMeasures::from_steps(1, &steps),
        }
    }

    /// Returns the root mean square of the difference of the gap to other gaps at the same times, in metres, over their
    /// common duration; `None` without a common sample.
    #[must_use]
    pub fn rms_gap_difference_m(&self, other_gaps_m: &[f64]) -> Option<f64> {
        let squares = self
            .gap_m
            .iter()
            .zip(other_gaps_m)
            .map(|(own, others)| (own - others).powi(2));
        let count = self.gap_m.len().min(other_gaps_m.len());
        (count > 0).then(|| (squares.sum::<f64>() / count as f64).sqrt())
    }

    fn steps(&self) -> Vec<DriveStep> {
        let samples = self.leader_mps.iter().zip(&self.gap_m).zip(&self.speed_mps);
        let steps = samples
            .enumerate()
            .map(|(sample, ((&leader_mps, &gap_m), &speed_mps))| {
                let time_s = sample as f64 * self.interval_s;
                let [front, rear] = [&self.leader_mps, &self.speed_mps]
                    .map(|speeds_mps| self.acceleration_mps2(speeds_mps, sample));
                DriveStep {
                    time_s,
                    duration_s: self.interval_s,
                    speed_mps,
                    acceleration_mps2: rear,
                    ahead: Some(PairState {
                        time_s,
                        gap_m,
                        front_speed_mps: leader_mps,
                        rear_speed_mps: speed_mps,
                        front_acceleration_mps2: front,
                        rear_acceleration_mps2: rear,
                    }),
                }
            });
        steps.collect()
    }

    /// Returns the mean acceleration over the window before a sample, in m/s². Samples before the end of the first
    /// window have its mean, because a shorter window has more noise.
    fn acceleration_mps2(&self, speeds_mps: &[f64], sample: usize) -> f64 {
        let window = ((ACCELERATION_WINDOW_S / self.interval_s).round() as usize).max(1);
        let end = sample.max(window).min(speeds_mps.len().saturating_sub(1));
        let start = end.saturating_sub(window);
        let seconds = (end - start) as f64 * self.interval_s;
        match (speeds_mps.get(start), speeds_mps.get(end)) {
            (Some(from), Some(to)) if end > start => (to - from) / seconds,
            _ => 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{driven_track, trace};

    /// A trace and the series of its samples have the same measures, up to the window of accelerations.
    #[test]
    fn a_simulated_drive_is_measured_as_its_recording_would_be() {
        let front = driven_track(
            4.0,
            44.0,
            20.0,
            &[(5.0, 0.0), (3.0, -2.0), (12.0, 0.0)],
            0.01,
        );
        let rear = driven_track(
            4.0,
            0.0,
            20.0,
            &[(6.0, 0.0), (3.0, -2.0), (11.0, 0.0)],
            0.01,
        );
        let motion = trace(vec![front, rear], 0.01);
        let series = DriveSeries::from_trace(&motion, 1, 0.1).unwrap();
        assert_eq!(series.gap_m.len(), 201);
        assert!((series.duration_s() - 20.0).abs() < 1e-9);
        // 120 m + 20 * 3 - 9 m + 14 * 11 m.
        assert!((series.distance_m() - (120.0 + 51.0 + 154.0)).abs() < 0.1);
        for samples in 0..200 {
            let end_s = 0.1 * f64::from(samples);
            assert_eq!(
                series.clone().until(end_s).gap_m.len(),
                samples as usize + 1
            );
        }
        let MeasuredSeries {
            usefulness: alike,
            peak_brake_mps2,
        } = series.measure();
        assert!((peak_brake_mps2 - 2.0).abs() < 1e-6);
        let exact = UsefulnessMeasures::from_trace(&motion, &[], 1).unwrap();
        let gaps =
            [exact, alike].map(|measures| measures.following.unwrap().mean_time_gap_s.unwrap());
        assert!((gaps[0] - gaps[1]).abs() < 0.01, "{gaps:?}");
        // A jump of 2 m/s² within the window of 0.5 s: twice five steps of 4 m/s³ in 201 steps of 0.1 s.
        let jerk_mps3 = (10.0 * 16.0 / 200.0_f64).sqrt();
        assert!(
            (alike.rms_jerk_mps3.unwrap() - jerk_mps3).abs() < 0.01,
            "{alike:?}"
        );
        assert!(alike.unnecessary.is_empty());
    }

    #[test]
    fn gaps_differ_by_their_root_mean_square() {
        let series = |gap_m: &[f64]| DriveSeries {
            interval_s: 0.1,
            leader_mps: vec![20.0; gap_m.len()],
            gap_m: gap_m.to_vec(),
            speed_mps: vec![20.0; gap_m.len()],
        };
        let difference = series(&[30.0, 30.0]).rms_gap_difference_m(&[33.0, 26.0, 99.0]);
        assert!((difference.unwrap() - 12.5_f64.sqrt()).abs() < 1e-12);
        assert_eq!(series(&[]).rms_gap_difference_m(&[1.0]), None);
    }
}
