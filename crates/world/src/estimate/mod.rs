//! What the ego knows: noisy sensors and the Kalman filter behind the eight numbers a controller may see.
//!
//! The ego measures its own position and the bumper gaps ahead and behind, once a step, and knows what its own brakes and
//! engine do to it. Speeds and accelerations are estimated (paper, section "Markov decision process", paragraph S). The alternative, [`EstimatorKind::Truth`](crate::observation::EstimatorKind::Truth), hands the true
//! numbers over; every result says which of the two it used.

mod accelerometer;
mod ego;
mod filter;
mod sensor;

pub use accelerometer::Accelerometer;
pub use ego::BANDWIDTH_RAD_PER_S;
pub use ego::{EgoEstimator, EgoTuning, TrueState};
pub use filter::{DistanceEstimate, Filter, Innovation, KnownChange, Tuning};
pub use sensor::Sensor;
