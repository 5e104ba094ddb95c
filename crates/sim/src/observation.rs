//! Observations and estimators.

mod quantity;

use serde::{Deserialize, Serialize};

pub use quantity::ObservedQuantity;

/// Bandwidth of the three filters whose estimates a controller observes, in rad/s.
///
/// At the default noise, the standard deviations are 0.06 m/s for closing speeds, and 0.07 m/s and 0.29 m/s² for the
/// speed and acceleration of a neighbour; the filters follow the onset of braking within about 0.3 s. Half the
/// bandwidth would miss the start of an emergency brake; twice would be too noisy for controllers that read
/// accelerations.
pub const BANDWIDTH_RAD_PER_S: f64 = 5.0;

/// Default gap that stands for an absent neighbour, in metres.
pub const EMPTY_GAP_M: f64 = 80.0;

/// Estimator of the vehicles under test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum EstimatorKind {
    /// Noisy sensors and a Kalman filter.
    #[default]
    Kalman,
    /// The true state.
    Truth,
}

impl EstimatorKind {
    /// All estimators.
    pub const ALL: [Self; 2] = [Self::Kalman, Self::Truth];

    /// Returns the name on the command line and in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kalman => "kalman",
            Self::Truth => "truth",
        }
    }
}

/// Observed state of a neighbouring vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Gap between the bumpers, in metres.
    pub gap_m: f64,
    /// Speed, in m/s.
    pub speed_mps: f64,
    /// Acceleration over the last step, in m/s².
    pub acceleration_mps2: f64,
}

/// An observation: the paper's eight numbers if the vehicle has a leader and a follower.
///
/// Order of the paper: `d_fm` = `ahead.gap_m`, `d_mr` = `behind.gap_m`, `v_f`, `v_m`, `v_r`, `a_f`, `a_m`, `a_r`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Own speed, in m/s.
    pub speed_mps: f64,
    /// Own acceleration over the last step, in m/s².
    pub acceleration_mps2: f64,
    /// The leader; `None` for the first vehicle of the lane.
    pub ahead: Option<Neighbour>,
    /// The follower; `None` for the last vehicle of the lane.
    pub behind: Option<Neighbour>,
}

impl Observation {
    /// Returns the observation without the follower, if it is hidden.
    #[inline]
    pub(crate) fn hiding_follower(self, is_hidden: bool) -> Self {
        Self {
            behind: self.behind.filter(|_| !is_hidden),
            ..self
        }
    }
}
