//! What a controller may see, and what it sees it through.

use serde::{Deserialize, Serialize};

/// Which estimator the vehicles under test look through.
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
    /// All of them.
    pub const ALL: [Self; 2] = [Self::Kalman, Self::Truth];

    /// The name used on the command line and in reports.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Kalman => "kalman",
            Self::Truth => "truth",
        }
    }
}

/// What is known about a neighbouring vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Neighbour {
    /// Bumper gap to it, in metres.
    pub gap_m: f64,
    /// Its speed, in m/s.
    pub speed_mps: f64,
    /// Its acceleration over the last step, in m/s².
    pub acceleration_mps2: f64,
}

/// Everything a controller may see: the paper's eight numbers, where there is a vehicle ahead and one behind.
///
/// In the paper's order: `d_fm` = `ahead.gap_m`, `d_mr` = `behind.gap_m`, `v_f`, `v_m`, `v_r`, `a_f`, `a_m`, `a_r`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    /// Own speed, in m/s.
    pub speed_mps: f64,
    /// Own acceleration over the last step, in m/s².
    pub acceleration_mps2: f64,
    /// The vehicle ahead; none for the first of the line.
    pub ahead: Option<Neighbour>,
    /// The vehicle behind; none for the last of the line.
    pub behind: Option<Neighbour>,
}
