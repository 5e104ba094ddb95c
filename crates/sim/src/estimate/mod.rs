//! Observations from noisy sensors and Kalman filters.
//!
//! Once a step, the ego vehicle measures its position and the bumper gaps ahead and behind with noise, and changes of
//! its own motion exactly. Kalman filters estimate speeds and accelerations (paper, section "Markov decision process",
//! paragraph S). The alternative, [`EstimatorKind::Truth`](crate::observation::EstimatorKind::Truth), returns the true
//! state. Every result names its estimator.

mod accelerometer;
mod ego;
mod filter;
mod gap_faults;
mod sensor;

pub use accelerometer::Accelerometer;
pub use ego::{EgoEstimator, EgoTuning, TrueState};
pub use filter::{DistanceEstimate, Filter, Innovation, KnownChange, Tuning};
pub use sensor::Sensor;
