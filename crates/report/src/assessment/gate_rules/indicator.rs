//! Gates as safety performance indicators (ANSI/UL 4600): a metric with a threshold, tied to a claim.

use serde::Serialize;

use crate::assessment::rounded::Rounded;
use crumple_evidence::RateInterval;

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
    /// Interval of the true value, for rates and shares that random scenarios estimate.
    pub interval: Option<IndicatorInterval>,
    /// Claim of the report that the gate is about, on the runs that decide it; absent if there is none. A claim without
    /// a limit allows no violation, where the threshold may allow some.
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
    /// Returns the exact interval, in percent, of the share of runs with an event, each bound at `confidence`.
    pub(super) fn of_share(events: u64, runs: u64, confidence: f64) -> Self {
        let interval = RateInterval::clopper_pearson(events, runs, 2.0 * confidence - 1.0);
        Self::from_shares([interval.lower, interval.upper], confidence)
    }

    /// Returns an interval, in percent, of the difference of two shares of runs, each bound at `confidence`: half of
    /// the error probability for the bound of each share, whatever the dependence of the runs.
    pub(super) fn of_difference(
        own: EventCount,
        other: EventCount,
        runs: u64,
        confidence: f64,
    ) -> Self {
        let [own, other] = [own, other].map(|counted| counted.interval(runs, confidence));
        Self::from_shares(
            [own.lower - other.upper, own.upper - other.lower],
            confidence,
        )
    }

    /// Creates an interval in percent from shares, rounded outwards.
    fn from_shares([lower, upper]: [f64; 2], confidence: f64) -> Self {
        Self {
            lower: Rounded::down(100.0 * lower),
            upper: Rounded::up(100.0 * upper),
            confidence_percent: Rounded::down(100.0 * confidence),
        }
    }
}

/// Number of runs with an event, and of further runs in which it is unknown.
#[derive(Debug, Clone, Copy)]
pub(super) struct EventCount {
    pub(super) events: u64,
    pub(super) unknown: u64,
}

impl EventCount {
    /// Returns the interval of the share of events; each bound has half of the error probability of `confidence`.
    fn interval(self, runs: u64, confidence: f64) -> RateInterval {
        let counted = RateInterval::clopper_pearson(self.events, runs, confidence);
        let possible = self.events.saturating_add(self.unknown).min(runs);
        RateInterval {
            lower: counted.lower,
            upper: RateInterval::clopper_pearson(possible, runs, confidence).upper,
        }
    }
}
