//! Gain from vehicle to vehicle: the growth of speed oscillations along a line of vehicles with one controller.
//!
//! A leader drives at a mean speed plus an oscillation. The gain of a vehicle is the amplitude of its speed divided by
//! that of the vehicle ahead, once the oscillation is steady. A line whose largest gain over all frequencies and speeds
//! is at most 1 damps every small disturbance at these speeds (L2 string stability of the linearized line: Ploeg, van
//! de Wouw and Nijmeijer 2014, "Lp string stability of cascaded systems: application to vehicle platooning", IEEE
//! Transactions on Control Systems Technology 22, 786-793). A single manoeuvre cannot show this.

mod amplitude;
mod run;

use std::sync::Arc;

use serde::{Deserialize, Serialize};

use self::run::LineRuns;
use crumple_sim::control::ControllerSource;
use crumple_sim::engine::RunError;
use crumple_sim::scenario::InvalidField;

/// Amplitude of the leader's speed, in m/s.
pub const OSCILLATION_AMPLITUDE_MPS: f64 = 0.3;

/// Lowest and highest frequency of the standard survey, in rad/s.
pub const GAIN_FREQUENCIES_RAD_PER_S: [f64; 2] = [0.05, 2.0];

/// Mean speeds of the standard survey, in m/s, before refinement.
pub const GAIN_SPEEDS_MPS: [f64; 8] = [4.0, 5.0, 6.5, 8.0, 11.0, 15.0, 22.0, 30.0];

/// Operating points of a survey.
struct GainGrid {
    speeds_mps: &'static [f64],
    /// Number of frequencies, in geometric progression.
    frequencies: usize,
    /// Rounds of refinement around the largest gain; each halves the distance to the neighbouring points.
    refinements: usize,
}

const STANDARD_GRID: GainGrid = GainGrid {
    speeds_mps: &GAIN_SPEEDS_MPS,
    frequencies: 10,
    refinements: 3,
};

/// Operating points for controller processes, which need some hundred times as long for a decision.
const PROCESS_GRID: GainGrid = GainGrid {
    speeds_mps: &[4.0, 8.0, 15.0, 30.0],
    frequencies: 6,
    refinements: 0,
};

/// One frequency at one mean speed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct OperatingPoint {
    /// Mean speed, in m/s.
    pub mean_speed_mps: f64,
    /// Frequency, in rad/s.
    pub frequency_rad_per_s: f64,
}

/// A gain at an operating point, or the reason why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredGain {
    /// Operating point.
    pub at: OperatingPoint,
    /// Largest gain of a vehicle of the line.
    pub gain: Result<f64, NoGain>,
}

/// Reason why there is no gain at an operating point.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[non_exhaustive]
pub enum NoGain {
    /// The vehicles do not reach the leader's speed, or keep no constant gap.
    NotSettled,
    /// The speeds do not become periodic with the leader's period.
    NotSteady,
    /// Vehicles collide.
    Collision,
    /// A controller gave no answer: time and reason.
    Unanswered(String),
}

/// Reason why gains cannot be measured.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum GainError {
    /// A line of vehicles is no valid scenario.
    #[error(transparent)]
    Scenario(#[from] InvalidField),
    /// A line of vehicles cannot be run.
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Gains of a line of vehicles at operating points: those of a grid first, then those around the largest gain.
#[derive(Debug, Clone, PartialEq)]
pub struct GainSurvey {
    /// All operating points, in the order of their measurement.
    pub points: Vec<MeasuredGain>,
}

impl GainSurvey {
    /// Measures the gains of a controller with the true state at [`GAIN_SPEEDS_MPS`] and
    /// [`GAIN_FREQUENCIES_RAD_PER_S`]; those of a process at four of the speeds and six frequencies.
    ///
    /// # Errors
    /// [`GainError`] if the controller cannot drive in a line of vehicles.
    pub fn new(controller: &Arc<dyn ControllerSource>) -> Result<Self, GainError> {
        let is_process = controller.program_field().is_some();
        let grid = if is_process {
            PROCESS_GRID
        } else {
            STANDARD_GRID
        };
        Self::on_grid(controller, grid.speeds_mps, &grid)
    }

    /// Measures the gains at these mean speeds, in m/s, and [`GAIN_FREQUENCIES_RAD_PER_S`], and then around the largest
    /// gain, within the range of the speeds.
    ///
    /// # Errors
    /// [`GainError`] if the controller cannot drive in a line of vehicles, or a speed is impossible.
    pub fn at_speeds(
        controller: &Arc<dyn ControllerSource>,
        speeds_mps: &[f64],
    ) -> Result<Self, GainError> {
        Self::on_grid(controller, speeds_mps, &STANDARD_GRID)
    }

    fn on_grid(
        controller: &Arc<dyn ControllerSource>,
        speeds_mps: &[f64],
        grid: &GainGrid,
    ) -> Result<Self, GainError> {
        let frequencies = grid.frequencies_rad_per_s();
        let points = speeds_mps.iter().flat_map(|&mean_speed_mps| {
            frequencies
                .iter()
                .map(move |&frequency_rad_per_s| OperatingPoint {
                    mean_speed_mps,
                    frequency_rad_per_s,
                })
        });
        let mut runs = LineRuns::new(controller);
        let mut survey = Self {
            points: runs.measure(&points.collect::<Vec<_>>())?,
        };
        let mut steps = [speed_step(speeds_mps), grid.frequency_step()].map(f64::sqrt);
        for _ in 0..grid.refinements {
            let Some((largest, _)) = survey.largest() else {
                break;
            };
            let around = survey.points_around(largest, steps, speeds_mps);
            survey.points.extend(runs.measure(&around)?);
            steps = steps.map(f64::sqrt);
        }
        Ok(survey)
    }

    /// Returns the largest gain with its operating point; `None` if none was measured.
    #[must_use]
    pub fn largest(&self) -> Option<(OperatingPoint, f64)> {
        let gains = self
            .points
            .iter()
            .filter_map(|point| Some((point.at, *point.gain.as_ref().ok()?)));
        gains.max_by(|(_, a), (_, b)| a.total_cmp(b))
    }

    /// Returns frequencies, in rad/s, and gains of the grid at a mean speed of the grid, in order of frequency.
    #[must_use]
    pub fn curve(&self, mean_speed_mps: f64) -> Vec<(f64, f64)> {
        let at_speed = self
            .points
            .iter()
            .filter(|point| point.at.mean_speed_mps == mean_speed_mps);
        let mut curve: Vec<_> = at_speed
            .filter_map(|point| Some((point.at.frequency_rad_per_s, *point.gain.as_ref().ok()?)))
            .collect();
        curve.sort_by(|(a, _), (b, _)| a.total_cmp(b));
        curve
    }

    /// Returns the eight neighbours of a point within the ranges that were not measured yet. Each is a factor away.
    fn points_around(
        &self,
        centre: OperatingPoint,
        [speed_factor, frequency_factor]: [f64; 2],
        speeds_mps: &[f64],
    ) -> Vec<OperatingPoint> {
        let [low_mps, high_mps] = extent(speeds_mps);
        let [lowest, highest] = GAIN_FREQUENCIES_RAD_PER_S;
        let mut around: Vec<OperatingPoint> = Vec::new();
        for (speed_power, frequency_power) in
            (-1..=1).flat_map(|speed| (-1..=1).map(move |frequency| (speed, frequency)))
        {
            let mean_speed_mps =
                (centre.mean_speed_mps * speed_factor.powi(speed_power)).clamp(low_mps, high_mps);
            let frequency_rad_per_s = (centre.frequency_rad_per_s
                * frequency_factor.powi(frequency_power))
            .clamp(lowest, highest);
            let point = OperatingPoint {
                mean_speed_mps,
                frequency_rad_per_s,
            };
            if !around.contains(&point) && self.points.iter().all(|measured| measured.at != point) {
                around.push(point);
            }
        }
        around
    }
}

impl GainGrid {
    /// Returns the frequencies of the grid, in rad/s.
    fn frequencies_rad_per_s(&self) -> Vec<f64> {
        let [lowest, highest] = GAIN_FREQUENCIES_RAD_PER_S;
        let inner = (1..self.frequencies - 1)
            .map(|index| lowest * self.frequency_step().powi(index as i32));
        std::iter::once(lowest)
            .chain(inner)
            .chain([highest])
            .collect()
    }

    /// Returns the factor between successive frequencies of the grid.
    fn frequency_step(&self) -> f64 {
        let [lowest, highest] = GAIN_FREQUENCIES_RAD_PER_S;
        (highest / lowest).powf(1.0 / (self.frequencies - 1) as f64)
    }
}

/// Returns the mean factor between successive speeds; 1 for a single speed.
fn speed_step(speeds_mps: &[f64]) -> f64 {
    let [lowest, highest] = extent(speeds_mps);
    match speeds_mps.len() {
        0 | 1 => 1.0,
        count => (highest / lowest).powf(1.0 / (count - 1) as f64),
    }
}

fn extent(values: &[f64]) -> [f64; 2] {
    values
        .iter()
        .fold([f64::INFINITY, 0.0], |[low, high], &value| {
            [value.min(low), value.max(high)]
        })
}

#[cfg(test)]
mod tests;
