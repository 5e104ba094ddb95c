//! Recorded motion in whose place a controller drives.

use serde::{Deserialize, Serialize};

/// Largest number of samples of a recorded motion.
pub(super) const MAX_SAMPLES: usize = 100_000;

/// Recorded motion of a vehicle, at equal intervals from the start of the scenario on.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct RecordedMotion {
    /// Interval of the samples, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 10.0)))]
    pub interval_s: f64,
    /// Bumper gap to the leader at each sample, in metres; at most 100 000 samples.
    pub gap_m: Vec<f64>,
    /// Speed at each sample, in m/s.
    pub speed_mps: Vec<f64>,
}
