//! Descriptions of the results of a suite.

use crumple_core::digits::{format_fixed_down, format_fixed_up};
use crumple_suites::{
    ControllerResult, FailedPoint, ImpactLimit, Margin, MarginEnd, Origin, ParameterKind,
    Prevention, ReferenceRun, SweepFailure, TestParameter, TestParameters, TestVerdict,
    WarningOrigin, WorstInTolerance,
};

/// Describes the verdict of a test or of a point.
#[must_use]
pub fn describe_verdict(verdict: &TestVerdict) -> String {
    match verdict {
        TestVerdict::Passed => "PASSED".to_owned(),
        TestVerdict::Failed {
            time_s,
            impact_speed_mps,
        } => {
            format!("FAILED, collision at {time_s:.2} s with {impact_speed_mps:.1} m/s")
        }
        TestVerdict::Braked {
            max_brake_mps2,
            is_beyond_manual,
        } => {
            let beyond = if *is_beyond_manual {
                " more than its driver"
            } else {
                ""
            };
            format!(
                "FAILED: brakes with {max_brake_mps2:.1} m/s²{beyond} although nothing is in the way"
            )
        }
        TestVerdict::ControllerFailed { time_s, reason } => {
            format!("CONTROLLER FAILED at {time_s:.2} s: {reason}")
        }
        TestVerdict::Refused { reason } => format!("REFUSED: {reason}"),
    }
}

/// Describes a test. One that passes at every stated point fails if the search within the clause fails.
#[must_use]
pub fn describe_outcome(tested: &ControllerResult) -> String {
    match &tested.worst_in_tolerance {
        Some(within) if tested.verdict.is_passed() && !tested.is_passed() => {
            let verdict = describe_verdict(&within.verdict);
            format!(
                "FAILED within the tolerances of the clause; every stated point passes: {verdict}"
            )
        }
        _ => describe_verdict(&tested.verdict),
    }
}

/// Returns the number of passed points; empty if the test cannot be run.
#[must_use]
pub fn format_points(tested: &ControllerResult) -> String {
    if tested.points == 0 {
        String::new()
    } else {
        let seeds = match tested.seeds {
            1 => String::new(),
            seeds => format!(", worst of {seeds} seeds at each point"),
        };
        format!(
            ", {} of {} pass{seeds}",
            tested.passed_points, tested.points
        )
    }
}

/// Describes the impact up to which a test passes nevertheless.
#[must_use]
pub fn describe_impact_limit(limit: &ImpactLimit) -> String {
    let ImpactLimit {
        value,
        unit,
        origin,
        ..
    } = limit;
    format!(
        "passes if the impact is at most {value} {unit} ({})",
        origin.label()
    )
}

/// Describes the warning after which the driver brakes.
#[must_use]
pub fn describe_warning(warning: WarningOrigin) -> &'static str {
    match warning {
        WarningOrigin::Controller => "warning: reported by the controller",
        WarningOrigin::Reference => {
            "warning: reference warning of the suite, because the controller reports none"
        }
    }
}

/// Describes the parameters of a test: each with its values, unit and origin. `ranges` are the parameters for which the
/// document allows every value from the smallest to the largest.
#[must_use]
pub fn describe_parameters(parameters: &TestParameters, ranges: &[ParameterKind]) -> String {
    let all: Vec<String> = parameters
        .iter()
        .map(|(kind, figure)| {
            let values = describe_parameter(figure, ranges.contains(&kind));
            format!("{} {values}", kind.label())
        })
        .collect();
    all.join(", ")
}

/// Explains the times of a test with an object that does not exist; `None` for other tests.
#[must_use]
pub fn describe_ghost(parameters: &TestParameters) -> Option<&'static str> {
    parameters.ghost_time.as_ref()?;
    Some(match parameters.approach_time {
        Some(_) => {
            "the sensor reports an object that does not exist: the approach time is from the start of the test to the \
             place of this object, the closing time from its first report to this place, and the ghost time is the \
             duration of the report"
        }
        None => {
            "the sensor reports an object that does not exist: the closing time is from its first report to its place, \
             and the ghost time is the duration of the report"
        }
    })
}

fn describe_parameter(figure: &TestParameter, is_range: bool) -> String {
    let values: Vec<String> = figure.values.iter().map(f64::to_string).collect();
    let values = match values.as_slice() {
        [first, .., last] if is_range || figure.origin == Origin::Ends => {
            format!("{first} to {last}")
        }
        _ => values.join(" or "),
    };
    let tolerance = match figure.tolerance {
        0.0 => String::new(),
        tolerance => format!(" ± {tolerance}"),
    };
    let chosen = match figure.origin {
        Origin::Chosen => " (chosen)",
        Origin::Document | Origin::Ends => "",
    };
    format!("{values}{tolerance} {}{chosen}", figure.unit)
}

/// Describes the worst point within the ranges and tolerances of a clause.
#[must_use]
pub fn describe_worst_in_tolerance(within: &WorstInTolerance) -> String {
    let WorstInTolerance {
        point,
        verdict,
        min_gap_m,
        points_run,
        ..
    } = within;
    let gap = min_gap_m
        .filter(|_| verdict.is_passed())
        .map_or(String::new(), |gap_m| {
            format!(", smallest gap {gap_m:.2} m")
        });
    format!(
        "worst of {points_run} points within the tolerances: {}{gap}, at {point}",
        describe_verdict(verdict)
    )
}

/// The least margin in a direction.
#[derive(Debug, Clone, Copy)]
pub struct MinMargin<'m> {
    /// Index among all margins of the test.
    pub index: usize,
    /// The margin.
    pub margin: &'m Margin,
    /// Number of margins in the direction.
    pub count: usize,
}

impl MinMargin<'_> {
    /// Describes the margin, and of how many it is the smallest.
    #[must_use]
    pub fn describe(&self) -> String {
        let margin = describe_margin(self.margin);
        match (self.count, self.margin.end) {
            (0 | 1, _) => margin,
            (count, MarginEnd::Holds { .. }) => {
                format!("{margin} (the same for all {count} combinations of the other values)")
            }
            (count, _) => {
                format!(
                    "{margin} (the smallest margin of {count} combinations of the other values)"
                )
            }
        }
    }
}

/// Describes the least margin in each direction, and the number of margins.
pub(crate) fn describe_min_margins(margins: &[Margin]) -> Vec<String> {
    min_margins(margins)
        .iter()
        .map(MinMargin::describe)
        .collect()
}

/// Returns the least margin in each direction.
#[must_use]
pub fn min_margins(margins: &[Margin]) -> Vec<MinMargin<'_>> {
    let mut directions: Vec<_> = margins
        .iter()
        .map(|margin| (margin.parameter, margin.to))
        .collect();
    directions.dedup();
    directions
        .into_iter()
        .filter_map(|direction| {
            let along = margins
                .iter()
                .enumerate()
                .filter(|(_, margin)| (margin.parameter, margin.to) == direction);
            let count = along.clone().count();
            let (index, margin) = along.reduce(|least, next| {
                if passing_share(next.1) < passing_share(least.1) {
                    next
                } else {
                    least
                }
            })?;
            Some(MinMargin {
                index,
                margin,
                count,
            })
        })
        .collect()
}

/// Returns the share of the direction that passes, or -1 if none does.
fn passing_share(margin: &Margin) -> f64 {
    match margin.end {
        MarginEnd::None { .. } => -1.0,
        MarginEnd::Holds { .. } => 1.0,
        MarginEnd::Boundary { passes_at, .. } => {
            (passes_at - margin.from) / (margin.to - margin.from)
        }
    }
}

fn describe_margin(margin: &Margin) -> String {
    let fixed = if margin.fixed_parameters.is_empty() {
        String::new()
    } else {
        format!(" at {}", margin.fixed_parameters)
    };
    let end = describe_margin_end(margin);
    format!("margin of {}{fixed}: {end}", margin.parameter.label())
}

fn describe_margin_end(margin: &Margin) -> String {
    let Margin { unit, from, to, .. } = margin;
    match margin.end {
        MarginEnd::None { failure } => {
            format!(
                "none, because the test {} at {from} {unit}, the first value tried",
                describe_sweep_failure(failure)
            )
        }
        MarginEnd::Holds { parts } => {
            let values = parts + 1;
            format!("passes at all {values} equally spaced values from {from} to {to} {unit}")
        }
        MarginEnd::Boundary {
            passes_at,
            fails_at,
            failure,
            is_monotone,
            parts,
        } => {
            let distance = (passes_at - fails_at).abs();
            // Use as many digits as distinguish the two.
            let digits = if distance > 0.0 {
                (1.0 - distance.log10().floor()).clamp(3.0, 9.0) as usize
            } else {
                3
            };
            let fails = describe_sweep_failure(failure);
            let [passes, no_longer] = format_boundary(passes_at, fails_at, digits);
            let boundary = format!("passes at {passes}, {fails} at {no_longer} {unit}");
            if is_monotone {
                return boundary;
            }
            format!(
                "{boundary}: the first boundary on {parts} parts to {to} {unit}; the test passes again beyond"
            )
        }
    }
}

/// Returns the last value that passes and the first that does not, rounded away from each other: the boundary lies
/// between the rounded values too.
pub(super) fn format_boundary(passes_at: f64, fails_at: f64, decimals: usize) -> [String; 2] {
    if passes_at < fails_at {
        [
            format_fixed_down(passes_at, decimals),
            format_fixed_up(fails_at, decimals),
        ]
    } else {
        [
            format_fixed_up(passes_at, decimals),
            format_fixed_down(fails_at, decimals),
        ]
    }
}

fn describe_sweep_failure(failure: SweepFailure) -> &'static str {
    match failure {
        SweepFailure::Fails => "fails",
        SweepFailure::Refused => "cannot be run",
    }
}

/// Describes the reference drivers that could have prevented a failure, and its avoidability.
pub(crate) fn describe_preventability(failed: &FailedPoint) -> String {
    // Only collisions have reference drivers.
    let is_collision = !failed.references.is_empty();
    let references = is_collision.then(|| describe_references(&failed.references));
    let not_examined = || is_collision.then(|| "avoidability not examined".to_owned());
    let avoidability = failed.avoidability.describe().or_else(not_examined);
    let mut parts: Vec<String> = references.into_iter().chain(avoidability).collect();
    if failed.escape_survives_multi_body == Some(false) {
        parts.push("with the multi-body plant the escape COLLIDES".to_owned());
    }
    if failed.survives_multi_body == Some(false) {
        parts.push("with the multi-body plant the point passes".to_owned());
    }
    parts.join("; ")
}

/// Groups the reference drivers by their behaviour in place of the controller.
fn describe_references(references: &[ReferenceRun]) -> String {
    let groups = [
        (Prevention::Prevents, "that prevent it"),
        (Prevention::Collides, "that collide"),
        (Prevention::DoesNotReact, "that do not react"),
    ];
    let groups: Vec<String> = groups
        .into_iter()
        .filter_map(|(prevention, behaviour)| {
            let drivers: Vec<&str> = references
                .iter()
                .filter(|run| run.prevention == prevention)
                .map(|run| run.driver.as_str())
                .collect();
            (!drivers.is_empty()).then(|| format!("{behaviour}: {}", drivers.join(", ")))
        })
        .collect();
    format!("reference drivers {}", groups.join("; "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_ends_of_a_boundary_are_rounded_away_from_each_other() {
        assert_eq!(format_boundary(75.0117, 75.0634, 3), ["75.011", "75.064"]);
        assert_eq!(format_boundary(0.9989, 0.9951, 3), ["0.999", "0.995"]);
        assert_eq!(format_boundary(120.906, 120.955, 2), ["120.90", "120.96"]);
    }

    #[test]
    fn reference_drivers_are_grouped_by_their_behaviour() {
        let run = |driver: &str, prevention| ReferenceRun {
            driver: driver.to_owned(),
            prevention,
        };
        let references = [
            run("idm", Prevention::Prevents),
            run("baseline", Prevention::Collides),
            run("human", Prevention::DoesNotReact),
            run("road", Prevention::Prevents),
        ];
        assert_eq!(
            describe_references(&references),
            "reference drivers that prevent it: idm, road; that collide: baseline; that do not react: human"
        );
        assert_eq!(
            describe_references(&references[1..2]),
            "reference drivers that collide: baseline"
        );
    }
}
