//! What the ego knows: noisy sensors and the Kalman filter behind the eight numbers a controller may see.
//!
//! The ego measures its own position and the bumper gaps ahead and behind, once a step, and knows what its own brakes and
//! engine do to it. Speeds and accelerations are estimated (paper, section "Markov decision process", paragraph S). The alternative, [`EstimatorKind::Truth`], hands the true
//! numbers over; every result says which of the two it used.

mod ego;
mod filter;
mod inertia;
mod sensor;

use serde::{Deserialize, Serialize};

pub use ego::BANDWIDTH_RAD_PER_S;
pub use ego::{EgoEstimator, EgoTuning, TrueState};
pub use filter::{Estimate, Filter, Innovation, KnownChange, Tuning};
pub use inertia::Inertia;
pub use sensor::Sensor;

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
