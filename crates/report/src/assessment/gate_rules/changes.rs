//! Gates on changes since an earlier assessment.

use super::{GateMetric, GateRule, GateVerdict};
use crate::assessment::{AssessConfig, AssessmentChange, AssessmentComparison};

pub(super) fn nothing_worse(_config: &AssessConfig) -> GateRule<'static> {
    GateRule::new(
        "no result is worse than in the earlier assessment".to_owned(),
        GateMetric::none_of("results that are worse, new failures, or missing"),
        None,
        |inputs| check_nothing_worse(inputs.comparison),
    )
}

fn check_nothing_worse(comparison: Option<&AssessmentComparison>) -> GateVerdict {
    let Some(comparison) = comparison else {
        return GateVerdict::fails("there is no earlier assessment; name one with --against");
    };
    if comparison.has_no_overlap() {
        return GateVerdict::fails("the earlier assessment has no result in common with this one");
    }
    let worse = regressions(comparison);
    let verdict = match worse.as_slice() {
        [] => GateVerdict::holds(format!(
            "no result is worse{}",
            comparison.describe_changed()
        )),
        [first, others @ ..] => GateVerdict::fails(format!(
            "{} results are worse, new failures, or missing; first: {}",
            1 + others.len(),
            first.description
        )),
    };
    verdict.with_value(worse.len() as f64)
}

/// Returns the worse results. A new failure, and a result other than a failure that is gone, count as worse.
fn regressions(comparison: &AssessmentComparison) -> Vec<&AssessmentChange> {
    let new = comparison.new.iter().filter(|change| change.is_failure);
    let gone = comparison.gone.iter().filter(|change| !change.is_failure);
    comparison.worse.iter().chain(new).chain(gone).collect()
}
