//! Gates as safety performance indicators (ANSI/UL 4600): a metric with a threshold, tied to a claim.

use serde::Serialize;

use crate::assessment::rounded::Rounded;

/// A gate as a safety performance indicator: the metric, its threshold and its measured value.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SafetyIndicator {
    /// Metric in words.
    pub metric: &'static str,
    /// Unit of the metric: `1` for numbers without unit, `%`.
    pub unit: &'static str,
    /// Largest value with which the gate can hold.
    pub threshold: Rounded<4>,
    /// Measured value; absent if nothing was measured.
    pub value: Option<Rounded<4>>,
    /// Interval of the true value, for values that random scenarios estimate.
    pub interval: Option<IndicatorInterval>,
    /// Claim of the report that the gate is about; absent if there is none.
    pub claim: Option<String>,
}

/// The interval of the true value of a metric.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct IndicatorInterval {
    /// Lower bound, in the unit of the metric.
    pub lower: Rounded<4>,
    /// Upper bound, in the unit of the metric.
    pub upper: Rounded<4>,
    /// Confidence level of each bound, in percent.
    pub confidence_percent: Rounded<4>,
}

/// A metric in words, its unit, and the largest value with which a gate can hold.
#[derive(Debug, Clone, Copy)]
pub(super) struct GateMetric {
    name: &'static str,
    unit: &'static str,
    threshold: f64,
}

impl GateMetric {
    /// A number of runs, failures or results of which none may exist.
    pub(super) fn none_of(name: &'static str) -> Self {
        Self::number(name, 0.0)
    }

    pub(super) fn number(name: &'static str, threshold: f64) -> Self {
        Self {
            name,
            unit: "1",
            threshold,
        }
    }

    pub(super) fn percent(name: &'static str, threshold: f64) -> Self {
        Self {
            name,
            unit: "%",
            threshold,
        }
    }

    pub(super) fn indicator(
        self,
        value: Option<f64>,
        interval: Option<IndicatorInterval>,
        claim: Option<String>,
    ) -> SafetyIndicator {
        SafetyIndicator {
            metric: self.name,
            unit: self.unit,
            threshold: Rounded::new(self.threshold),
            value: value.map(Rounded::new),
            interval,
            claim,
        }
    }
}

impl IndicatorInterval {
    /// Creates an interval in percent from shares, rounded outwards.
    pub(super) fn from_shares([lower, upper]: [f64; 2], confidence: f64) -> Self {
        Self {
            lower: Rounded::down(100.0 * lower),
            upper: Rounded::up(100.0 * upper),
            confidence_percent: Rounded::down(100.0 * confidence),
        }
    }
}
