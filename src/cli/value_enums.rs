//! Arguments with a few named values.

use clap::Args;
use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use crumple_exchange::recording::LeaderSelection;
use crumple_search::falsify::campaign::EvaluationLog;
use crumple_search::worst_case::AttackObjective;
use crumple_sim::engine::AfterCollision;
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::PlantKind;

/// A value, its name, and its description in the long help.
type ArgValue<T> = (T, &'static str, &'static str);

const ESTIMATORS: &[ArgValue<EstimatorKind>] = &[
    (
        EstimatorKind::Kalman,
        "kalman",
        "Noisy sensors and a Kalman filter",
    ),
    (EstimatorKind::Truth, "truth", "The true state"),
];

const AFTER_COLLISION: &[ArgValue<AfterCollision>] = &[
    (
        AfterCollision::Stop,
        "stop",
        "End the run at the instant of the collision",
    ),
    (
        AfterCollision::Continue,
        "continue",
        "Both vehicles move on as one body, at the common speed that conserves momentum, under the \
         sum of the forces that their controllers command; later collisions are counted",
    ),
    (
        AfterCollision::Hold,
        "hold",
        "As continue, but a vehicle that has hit its leader brakes at 6 m/s² to standstill, \
         instead of obeying its controller",
    ),
    (
        AfterCollision::Coast,
        "coast",
        "As continue, but a vehicle that has hit its leader neither brakes nor accelerates, \
         instead of obeying its controller",
    ),
];

pub(super) const PLANTS: &[ArgValue<PlantKind>] = &[
    (
        PlantKind::PointMass,
        PlantKind::PointMass.name(),
        "A point mass with an ideal brake",
    ),
    (
        PlantKind::MultiBody,
        PlantKind::MultiBody.name(),
        "A body with suspension, wheels, tyres, brake pressure and an anti-lock braking system",
    ),
];

pub(super) const AIMS: &[ArgValue<AttackObjective>] = &[
    (
        AttackObjective::Mildest,
        AttackObjective::Mildest.name(),
        "A collision with the least ∫ a² of the leader",
    ),
    (
        AttackObjective::LeastPeak,
        AttackObjective::LeastPeak.name(),
        "A collision with the least peak of its braking",
    ),
    (
        AttackObjective::Severest,
        AttackObjective::Severest.name(),
        "The fastest impact",
    ),
];

/// Vehicles whose braking makes an episode of a recording.
pub(super) const LEADERS: &[ArgValue<LeaderSelection>] = &[
    (LeaderSelection::Any, "any", "Every vehicle with a follower"),
    (
        LeaderSelection::First,
        "first",
        "Vehicles without a recorded vehicle ahead",
    ),
];

pub(super) const LOGS: &[ArgValue<EvaluationLog>] = &[
    (
        EvaluationLog::Full,
        "full",
        "Every evaluation, as a row of a compressed CSV file",
    ),
    (
        EvaluationLog::Summary,
        "summary",
        "Only the summary and the counterexamples",
    ),
];

/// Returns the clap parser of the option `--estimator`.
pub(super) fn estimator() -> impl TypedValueParser<Value = EstimatorKind> {
    one_of(ESTIMATORS)
}

/// The option `--after-collision`.
#[derive(Args)]
pub(super) struct AfterCollisionArgs {
    /// Behaviour after a collision
    #[arg(
        long = "after-collision",
        alias = "after-contact",
        value_name = "AFTER_COLLISION",
        default_value = "stop",
        value_parser = one_of(AFTER_COLLISION)
    )]
    pub(super) behaviour: AfterCollision,
}

/// Returns a clap parser that selects one of `choices` by its name.
pub(super) fn one_of<T: Copy + Send + Sync + 'static>(
    choices: &'static [ArgValue<T>],
) -> impl TypedValueParser<Value = T> {
    let possible = choices
        .iter()
        .map(|&(_, name, help)| PossibleValue::new(name).help(help));
    PossibleValuesParser::new(possible).try_map(|name| {
        choices
            .iter()
            .find(|choice| choice.1 == name)
            .map(|choice| choice.0)
            .ok_or("unknown")
    })
}
