//! Properties that a controller must have in every scenario.

use std::any::Any;
use std::fmt;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use crumple_core::digits::format_rounded;
use crumple_measure::{
    DrivingRule, JERK_WINDOW_S, RunVerdict, Specification, SpecificationError, SpeedAmplification,
    peak_jerk_mps3,
};
use crumple_search::falsify::counterexample::Avoidability;
use crumple_sim::control::IntoSource;
use crumple_sim::engine::{RunError, SimulationResult};
use crumple_sim::scenario::Scenario;

use super::{ControllerUnderTest, MetamorphicRelation};

/// Verdict of a property in one scenario.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PropertyVerdict {
    /// The property holds.
    Holds,
    /// The scenario does not test the property, for this reason.
    NotApplicable(String),
    /// The property is violated; the text says how.
    Violated(String),
}

type VerdictFn = dyn Fn(&ControllerUnderTest, &Scenario) -> Result<PropertyVerdict, SpecificationError>
    + Send
    + Sync;

/// A property that a controller must have in every scenario.
///
/// A panic or an error of the controller violates any property, and so does an answer that is not finite. The built-in
/// properties do not apply to a scenario that lacks a vehicle which the controller needs or a signal of the formula,
/// that a shield refuses, or that is shorter than the formula.
#[derive(Clone)]
pub struct Property {
    name: String,
    evaluate: Arc<VerdictFn>,
}

impl fmt::Debug for Property {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.debug_tuple("Property").field(&self.name).finish()
    }
}

impl Property {
    /// Creates a property from a function. An error violates the property, and so does a panic. A scenario does not
    /// test the property if the function returns [`PropertyVerdict::NotApplicable`]. Line breaks in the name become
    /// spaces.
    ///
    /// ```
    /// use crumple_testing::sim::control::BuiltInController;
    /// use crumple_testing::{Property, PropertyVerdict, check};
    ///
    /// let keeps_distance = Property::new("keeps a gap of 0.5 m", |controller, scenario| {
    ///     let result = controller.simulate(scenario)?;
    ///     let under_test = result.vehicles.iter().enumerate().filter(|(index, _)| scenario.is_under_test(*index));
    ///     Ok(match under_test.filter_map(|(_, vehicle)| vehicle.min_gap_m).reduce(f64::min) {
    ///         None => PropertyVerdict::NotApplicable("no vehicle is ahead".to_owned()),
    ///         Some(gap_m) if gap_m < 0.5 => PropertyVerdict::Violated(format!("the gap falls to {gap_m:.2} m")),
    ///         Some(_) => PropertyVerdict::Holds,
    ///     })
    /// });
    /// check(BuiltInController::from_name("idm").unwrap()).on("traffic").property(keeps_distance).cases(10).assert();
    /// ```
    pub fn new(
        name: impl Into<String>,
        evaluate: impl Fn(
            &ControllerUnderTest,
            &Scenario,
        ) -> Result<PropertyVerdict, SpecificationError>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self {
            name: name.into().replace(char::is_control, " "),
            evaluate: Arc::new(evaluate),
        }
    }

    /// Creates a property that does not apply to scenarios for which the controller or the property is not made.
    fn with_preconditions(
        name: impl Into<String>,
        evaluate: impl Fn(
            &ControllerUnderTest,
            &Scenario,
        ) -> Result<PropertyVerdict, SpecificationError>
        + Send
        + Sync
        + 'static,
    ) -> Self {
        Self::new(name, move |controller, scenario| {
            match evaluate(controller, scenario) {
                Err(error) if is_unmet_precondition(&error) => {
                    Ok(PropertyVerdict::NotApplicable(error.to_string()))
                }
                other => other,
            }
        })
    }

    /// No collision that some driver of the vehicles under test could have avoided, in front of them or behind.
    #[must_use]
    pub fn no_avoidable_collision() -> Self {
        Self::with_preconditions("no avoidable collision", |controller, scenario| {
            let verdict = controller.evaluate(&Specification::NoCollision, scenario)?;
            if verdict.collision.is_none() {
                return Ok(from_run(controller, scenario, &verdict));
            }
            let avoidability = Avoidability::classify_collision(scenario);
            Ok(
                match (
                    avoidability.is_avoidable(),
                    avoidability.describe().unwrap_or_default(),
                ) {
                    (Some(true), reason) => PropertyVerdict::Violated(format!(
                        "{}; {reason}",
                        describe(controller, scenario, &verdict)
                    )),
                    (Some(false), _) => PropertyVerdict::Holds,
                    (None, reason) => PropertyVerdict::NotApplicable(reason),
                },
            )
        })
    }

    /// No braking harder than the traffic justifies ([`DrivingRule::NoUnnecessaryBraking`]).
    #[must_use]
    pub fn no_unnecessary_braking() -> Self {
        Self::with_preconditions("no unnecessary braking", |controller, scenario| {
            let rule = Specification::DrivingRule(DrivingRule::NoUnnecessaryBraking);
            Ok(from_run(
                controller,
                scenario,
                &controller.evaluate(&rule, scenario)?,
            ))
        })
    }

    /// No vehicle deviates more from its speed than its leader, from the leader's first change of speed on. Meant for
    /// [`Scenarios::line_of_five`](super::Scenarios::line_of_five). This is a property of one manoeuvre: other
    /// disturbances may grow where this one shrinks ([`GainSurvey`](crumple_measure::GainSurvey)).
    #[must_use]
    pub fn no_amplification() -> Self {
        Self::with_preconditions("no amplification", |controller, scenario| {
            let result = controller.simulate(scenario)?;
            if !result.outcome.is_safe() {
                return Ok(PropertyVerdict::Violated(
                    "vehicles of the line collide".to_owned(),
                ));
            }
            let amplification = result.trace.as_ref().and_then(|trace| {
                let leader = trace.vehicles.first()?;
                let onset = leader
                    .acceleration_mps2
                    .iter()
                    .position(|&acceleration_mps2| acceleration_mps2 != 0.0)?;
                SpeedAmplification::from_trace(trace, *trace.time_s.get(onset)?)
            });
            let Some(amplification) = amplification else {
                return Ok(PropertyVerdict::NotApplicable(
                    "the line does not settle before the disturbance".to_owned(),
                ));
            };
            let worst = amplification
                .of_each
                .iter()
                .flatten()
                .fold(0.0, |worst: f64, &ratio| worst.max(ratio));
            Ok(violated_if(amplification.has_amplification(), || {
                let excess = format_rounded(100.0 * (worst - 1.0), 2);
                format!("a vehicle deviates {excess} % more from its speed than its leader")
            }))
        })
    }

    /// No larger jerk of a vehicle under test, in m/s³, as [`peak_jerk_mps3`] measures it.
    #[must_use]
    pub fn bounded_jerk(max_mps3: f64) -> Self {
        Self::with_preconditions(
            format!("jerk of at most {max_mps3} m/s³"),
            move |controller, scenario| {
                let result = controller.simulate(scenario)?;
                let trace = result.trace.as_ref().ok_or(SpecificationError::NoTrace)?;
                let under_test = trace
                    .vehicles
                    .iter()
                    .enumerate()
                    .filter(|(index, _)| scenario.is_under_test(*index));
                let of_each = under_test
                    .filter_map(|(_, track)| peak_jerk_mps3(&trace.time_s, track, JERK_WINDOW_S));
                let peak_mps3 = of_each.fold(0.0, f64::max);
                Ok(failure_of(&result).unwrap_or_else(|| {
                    violated_if(max_mps3.is_nan() || peak_mps3 > max_mps3, || {
                        format!(
                            "the jerk exceeds this by {} m/s³",
                            format_rounded(peak_mps3 - max_mps3, 2)
                        )
                    })
                }))
            },
        )
    }

    /// A specification: `no collision`, a driving rule, or a formula of signal temporal logic
    /// ([`Specification::parse`]). A scenario without the signals of the formula, or of a shorter duration, does not
    /// test it.
    ///
    /// # Errors
    /// [`SpecificationError`] for text that does not parse.
    pub fn specification(text: &str) -> Result<Self, SpecificationError> {
        text.parse::<Specification>()?;
        let text = text.to_owned();
        Ok(Self::with_preconditions(
            text.clone(),
            move |controller, scenario| {
                let verdict =
                    controller.evaluate(&Specification::parse(&text, scenario)?, scenario)?;
                Ok(from_run(controller, scenario, &verdict))
            },
        ))
    }

    /// No collision in a scenario that this reference passes.
    #[must_use]
    pub fn not_worse_than(reference: impl IntoSource) -> Self {
        let source = reference.into_source();
        Self::with_preconditions(
            "no collision that the reference avoids",
            move |controller, scenario| {
                let reference = ControllerUnderTest {
                    source: Arc::clone(&source),
                    ..controller.clone()
                };
                differs(controller, scenario, "the reference avoids it", || {
                    reference.evaluate(&Specification::NoCollision, scenario)
                })
            },
        )
    }

    /// No collision that disappears in a harder scenario: with less of a gap, less friction, or a later reaction.
    #[must_use]
    pub fn metamorphic(relation: MetamorphicRelation) -> Self {
        Self::with_preconditions(
            format!("{relation} makes nothing worse"),
            move |controller, scenario| {
                let reason = format!("there is none {}", relation.describe_partner());
                let Some(partner) = relation.partner(scenario) else {
                    return Ok(PropertyVerdict::NotApplicable(
                        "the partner scenario would be invalid".to_owned(),
                    ));
                };
                differs(controller, scenario, &reason, || {
                    controller.evaluate(&Specification::NoCollision, &partner)
                })
            },
        )
    }

    /// Equal runs of a scenario, without a panic and with an answer to every observation.
    #[must_use]
    pub fn deterministic() -> Self {
        Self::with_preconditions("deterministic", |controller, scenario| {
            let [first, second] = [
                controller.simulate(scenario)?,
                controller.simulate(scenario)?,
            ];
            Ok(failure_of(&first).unwrap_or_else(|| {
                violated_if(first != second, || {
                    "two runs of the scenario differ".to_owned()
                })
            }))
        })
    }

    /// Returns the name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// Evaluates a controller in a scenario, with a step that suits its decision interval.
    #[must_use]
    pub fn evaluate(
        &self,
        controller: &ControllerUnderTest,
        scenario: &Scenario,
    ) -> PropertyVerdict {
        match catch_unwind(AssertUnwindSafe(|| {
            (self.evaluate)(controller, &controller.adapt(scenario))
        })) {
            Ok(Ok(verdict)) => verdict,
            Ok(Err(error)) => {
                PropertyVerdict::Violated(format!("the property ends with an error: {error}"))
            }
            Err(panic) => {
                let message = panic_message(panic.as_ref());
                PropertyVerdict::Violated(format!(
                    "the controller or the property panics: {message}"
                ))
            }
        }
    }
}

/// Returns true if the controller or the property is not made for the scenario.
fn is_unmet_precondition(error: &SpecificationError) -> bool {
    matches!(
        error,
        SpecificationError::UnknownSignal { .. }
            | SpecificationError::HorizonTooLong { .. }
            | SpecificationError::Run(RunError::MissingNeighbour { .. } | RunError::Shield { .. })
    )
}

fn violated_if(condition: bool, finding: impl FnOnce() -> String) -> PropertyVerdict {
    if condition {
        PropertyVerdict::Violated(finding())
    } else {
        PropertyVerdict::Holds
    }
}

fn from_run(
    controller: &ControllerUnderTest,
    scenario: &Scenario,
    verdict: &RunVerdict,
) -> PropertyVerdict {
    violated_if(verdict.is_violation(), || {
        describe(controller, scenario, verdict)
    })
}

/// Returns the verdict of a run that may collide only if the run to compare with does, too.
fn differs(
    controller: &ControllerUnderTest,
    scenario: &Scenario,
    reason: &str,
    evaluate_partner: impl FnOnce() -> Result<RunVerdict, SpecificationError>,
) -> Result<PropertyVerdict, SpecificationError> {
    let own = controller.evaluate(&Specification::NoCollision, scenario)?;
    let is_worse = own.is_violation() && !evaluate_partner()?.is_violation();
    Ok(violated_if(is_worse, || {
        format!("{}; {reason}", describe(controller, scenario, &own))
    }))
}

fn describe(controller: &ControllerUnderTest, scenario: &Scenario, verdict: &RunVerdict) -> String {
    let robustness = format_rounded(verdict.robustness, 3);
    match (verdict.failure, verdict.collision) {
        (Some((time_s, vehicle)), _) => {
            // A verdict has no reason of the failure.
            let again = controller.simulate(scenario).ok();
            let failed = again
                .as_ref()
                .and_then(|result| result.outcome.failed_controller());
            failed.map_or_else(
                || format!("the controller of vehicle {vehicle} fails at {time_s:.2} s"),
                |f| f.to_string(),
            )
        }
        // In the words of `Collision`, whose further fields a verdict does not have.
        (None, Some(collision)) => format!(
            "at {:.2} s: vehicle {} hits vehicle {} at {:.1} m/s (robustness {robustness})",
            collision.time_s,
            collision.rear_vehicle,
            collision.front_vehicle,
            collision.impact_speed_mps
        ),
        (None, None) => format!("robustness {robustness}"),
    }
}

fn failure_of(result: &SimulationResult) -> Option<PropertyVerdict> {
    result
        .outcome
        .failed_controller()
        .map(|failed| PropertyVerdict::Violated(failed.to_string()))
}

fn panic_message(panic: &(dyn Any + Send)) -> &str {
    let text = panic.downcast_ref::<String>().map(String::as_str);
    text.or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("no message")
}
