//! Arguments with a few named values.

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use crumple_evidence::rare::RareMethod;
use crumple_search::falsify::campaign::EvaluationLog;
use crumple_search::worst_case::{AttackObjective, EscapeKind};
use crumple_world::observation::EstimatorKind;
use crumple_world::recording::LeaderSelection;
use crumple_world::sim::AfterContact;

/// A value, its name, and its description in the long help.
type ArgValue<T> = (T, &'static str, &'static str);

pub(super) const ESTIMATORS: &[ArgValue<EstimatorKind>] = &[
    (EstimatorKind::Kalman, "kalman", "Noisy sensors and a Kalman filter"),
    (EstimatorKind::Truth, "truth", "The true state"),
];

pub(super) const AFTER_CONTACT: &[ArgValue<AfterContact>] = &[
    (AfterContact::Stop, "stop", "End the run at the instant of contact"),
    (
        AfterContact::Continue,
        "continue",
        "Let the two stick together with common momentum and go on, so that a pile-up can be counted",
    ),
];

pub(super) const AIMS: &[ArgValue<AttackObjective>] = &[
    (AttackObjective::Mildest, AttackObjective::Mildest.name(), "A collision with the least ∫ a² of the leader"),
    (AttackObjective::LeastPeak, AttackObjective::LeastPeak.name(), "A collision with the least peak of its braking"),
    (AttackObjective::Severest, AttackObjective::Severest.name(), "The fastest impact"),
];

pub(super) const ESCAPES: &[ArgValue<EscapeKind>] = &[
    (EscapeKind::LargestGap, "largest-gap", "The one with the largest smallest gap"),
    (
        EscapeKind::Gentlest,
        "gentlest",
        "The one with the least ∫ a² that keeps half that gap, if the brake behind fires no later than for that: of all \
         escapes with that firing, not of those with another, which may be gentler",
    ),
    (
        EscapeKind::LeastJerk,
        "least-jerk",
        "Likewise the one whose acceleration changes least, of all escapes with that firing",
    ),
];

/// Vehicles whose braking makes an episode of a recording.
pub(super) const LEADERS: &[ArgValue<LeaderSelection>] = &[
    (LeaderSelection::Any, "any", "Every vehicle with another behind it"),
    (LeaderSelection::First, "first", "Those that had no recorded vehicle ahead of them"),
];

pub(super) const RARE_METHODS: &[ArgValue<RareMethod>] = &[
    (RareMethod::Splitting, "splitting", "Populations climb level by level"),
    (
        RareMethod::Importance,
        "importance",
        "Draws from a law fitted to where such populations arrive, with exact weights",
    ),
];

pub(super) const LOGS: &[ArgValue<EvaluationLog>] = &[
    (EvaluationLog::Full, "full", "Every evaluation, as a row of a compressed CSV file"),
    (EvaluationLog::Summary, "summary", "Nothing: the summary and the counterexamples alone"),
];

/// Returns a clap parser that selects one of `choices` by its name.
pub(super) fn one_of<T: Copy + Send + Sync + 'static>(
    choices: &'static [ArgValue<T>],
) -> impl TypedValueParser<Value = T> {
    let possible = choices.iter().map(|&(_, name, help)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(possible)
        .try_map(|name| choices.iter().find(|choice| choice.1 == name).map(|choice| choice.0).ok_or("unknown"))
}
