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
        FAULT_FIELDS
            .iter()
            .filter_map(|field| Some((field.path, (field.value)(self)?, field.range)))
    }

    fn ghost_mut(&mut self) -> &mut GhostObject {
        self.ghost.get_or_insert(GhostObject::NEVER)
    }
}

/// A number of [`SensorFaults`].
#[derive(Debug)]
pub struct FaultField {
    /// Path after `sensors.faults.`.
    pub path: &'static str,
    /// Unit; `1` for none.
    pub unit: &'static str,
    /// Allowed minimum and maximum.
    pub range: [f64; 2],
    /// Returns the value; `None` if it is absent.
    pub value: fn(&SensorFaults) -> Option<f64>,
    /// Returns a reference to the value, and inserts one without effect if it is absent.
    pub value_mut: fn(&mut SensorFaults) -> &mut f64,
}

/// All numbers, in the order of the files. Scenario files check their ranges, and spaces may vary each of them.
pub const FAULT_FIELDS: [FaultField; 11] = [
    FaultField {
        path: "latency_s",
        unit: "s",
        range: [0.0, 2.0],
        value: |faults| Some(faults.latency_s),
        value_mut: |faults| &mut faults.latency_s,
    },
    FaultField {
        path: "gap_bias_m",
        unit: "m",
        range: [-10.0, 10.0],
        value: |faults| Some(faults.gap_bias_m),
        value_mut: |faults| &mut faults.gap_bias_m,
    },
    FaultField {
        path: "gap_resolution_m",
        unit: "m",
        range: [0.0, 10.0],
        value: |faults| Some(faults.gap_resolution_m),
        value_mut: |faults| &mut faults.gap_resolution_m,
    },
    FaultField {
        path: "outage_rate_per_s",
        unit: "1/s",
        range: [0.0, 100.0],
        value: |faults| Some(faults.outage_rate_per_s),
        value_mut: |faults| &mut faults.outage_rate_per_s,
    },
    FaultField {
        path: "outage_length_s",
        unit: "s",
        range: [0.0, 100.0],
        value: |faults| Some(faults.outage_length_s),
        value_mut: |faults| &mut faults.outage_length_s,
    },
    FaultField {
        path: "range_m",
        unit: "m",
        range: [1.0, 1e4],
        value: |faults| faults.range_m,
        value_mut: |faults| faults.range_m.get_or_insert(1e4),
    },
    FaultField {
        path: "detection_delay_s",
        unit: "s",
        range: [0.0, 10.0],
        value: |faults| Some(faults.detection_delay_s),
        value_mut: |faults| &mut faults.detection_delay_s,
    },
    FaultField {
        path: "ghost.onset_s",
        unit: "s",
        range: [0.0, 1e5],
        value: |faults| Some(faults.ghost?.onset_s),
        value_mut: |faults| &mut faults.ghost_mut().onset_s,
    },
    FaultField {
        path: "ghost.duration_s",
        unit: "s",
        range: [0.0, 1e5],
        value: |faults| Some(faults.ghost?.duration_s),
        value_mut: |faults| &mut faults.ghost_mut().duration_s,
    },
    FaultField {
        path: "ghost.gap_m",
        unit: "m",
        range: [0.1, 1e4],
        value: |faults| Some(faults.ghost?.gap_m),
        value_mut: |faults| &mut faults.ghost_mut().gap_m,
    },
    FaultField {
        path: "ghost.speed_mps",
        unit: "m/s",
        range: [0.0, 100.0],
        value: |faults| Some(faults.ghost?.speed_mps),
        value_mut: |faults| &mut faults.ghost_mut().speed_mps,
    },
];
