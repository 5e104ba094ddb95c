//! Faults of the gap sensors of vehicles under test.

use serde::{Deserialize, Serialize};

/// Faults of both gap sensors of a vehicle under test. By default there are none. The estimator `truth` ignores them.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct SensorFaults {
    /// Age of each measured gap, in seconds, rounded to steps. The filter does not compensate it.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 2.0)))]
    pub latency_s: f64,
    /// Constant error of each measured gap, in metres; positive if the gap appears larger.
    #[cfg_attr(feature = "schema", schemars(range(min = -10.0, max = 10.0)))]
    pub gap_bias_m: f64,
    /// Measured gaps are rounded to multiples of this, in metres; 0 for none.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub gap_resolution_m: f64,
    /// Mean number of outages per second of measuring; 0 for none. An outage loses all measurements of one sensor.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub outage_rate_per_s: f64,
    /// Mean length of an outage, in seconds; required with a rate. Lengths are exponential.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub outage_length_s: f64,
    /// Largest gap at which a sensor detects a vehicle, in metres. Default: unlimited.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[cfg_attr(feature = "schema", schemars(range(min = 1.0, max = 1e4)))]
    pub range_m: Option<f64>,
    /// Time from when a vehicle cuts in, or comes into range, until a sensor detects it, in seconds, rounded to steps.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub detection_delay_s: f64,
    /// An object ahead that does not exist. Default: none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ghost: Option<GhostObject>,
}

/// An object that the sensor of the gap ahead reports although it does not exist.
///
/// The object keeps its speed. The sensor reports it while it is nearer than the leader and not yet passed.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct GhostObject {
    /// Time at which it appears, in seconds, rounded to steps.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub onset_s: f64,
    /// Time for which it is reported, in seconds, rounded to steps; 0 for never.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 1e5)))]
    pub duration_s: f64,
    /// Gap ahead at which it appears, in metres.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 1e4)))]
    pub gap_m: f64,
    /// Speed, in m/s.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub speed_mps: f64,
}

impl GhostObject {
    /// A standing object that is never reported: the nominal ghost of spaces whose base has none.
    pub const NEVER: Self = Self {
        onset_s: 0.0,
        duration_s: 0.0,
        gap_m: 50.0,
        speed_mps: 0.0,
    };
}

impl SensorFaults {
    /// Returns true if the sensors have a fault.
    #[must_use]
    pub fn is_any(&self) -> bool {
        *self != Self::default()
    }

    /// Returns path, value and range of every field that is present.
    pub(super) fn limits(&self) -> impl Iterator<Item = (&'static str, f64, [f64; 2])> {
        let ghost = self.ghost;
        let fields = [
            ("latency_s", Some(self.latency_s), [0.0, 2.0]),
            ("gap_bias_m", Some(self.gap_bias_m), [-10.0, 10.0]),
            ("gap_resolution_m", Some(self.gap_resolution_m), [0.0, 10.0]),
            (
                "outage_rate_per_s",
                Some(self.outage_rate_per_s),
                [0.0, 100.0],
            ),
            ("outage_length_s", Some(self.outage_length_s), [0.0, 100.0]),
            ("range_m", self.range_m, [1.0, 1e4]),
            (
                "detection_delay_s",
                Some(self.detection_delay_s),
                [0.0, 10.0],
            ),
            (
                "ghost.onset_s",
                ghost.map(|ghost| ghost.onset_s),
                [0.0, 1e5],
            ),
            (
                "ghost.duration_s",
                ghost.map(|ghost| ghost.duration_s),
                [0.0, 1e5],
            ),
            ("ghost.gap_m", ghost.map(|ghost| ghost.gap_m), [0.1, 1e4]),
            (
                "ghost.speed_mps",
                ghost.map(|ghost| ghost.speed_mps),
                [0.0, 100.0],
            ),
        ];
        fields
            .into_iter()
            .filter_map(|(path, value, range)| Some((path, value?, range)))
    }
}
