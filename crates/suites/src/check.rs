//! Validation of suites.

use std::path::PathBuf;

use crumple_core::digits::format_compact;
use crumple_core::field_error::FieldError;
use crumple_core::format_version::{UnsupportedVersion, check_version};
use crumple_core::text_file::FileError;
use crumple_sim::scenario::InvalidField;

use super::SUITE_VERSION;
use super::parameter::{ImpactLimit, ParameterKind, ParameterUnit, TestParameter};
use super::spec::{LeadManeuver, SuiteSpec, TestSpec, with_value};

const MAX_POINTS: usize = 2000;

/// Reason why a suite file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteError {
    /// The file cannot be read or parsed.
    #[error(transparent)]
    File(#[from] FileError),
    /// A field is out of range or contradicts another field.
    #[error("{}:{line}: {field}: {problem}", path.display())]
    Invalid {
        /// File that was read.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Path of the field, such as `clauses[0].tests[1].lead`.
        field: String,
        /// Problem of the field.
        problem: Box<SuiteProblem>,
    },
}

/// An invalid field of a suite.
pub type InvalidSuite = FieldError<SuiteProblem>;

/// Problem of a field of a suite.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteProblem {
    /// The file is of another format version.
    #[error(transparent)]
    Version(#[from] UnsupportedVersion),
    /// A name that is unsuitable for file names.
    #[error("must be 1 to 60 lower-case letters, digits and hyphens")]
    Name,
    /// The name of another test.
    #[error("another test has this name")]
    DuplicateName,
    /// A text that is empty, too long, or contains control characters.
    #[error("must have 1 to 2000 characters, none of them a control character")]
    Text,
    /// A list that is empty or too long.
    #[error("must have {min} to {max} entries, found {found}")]
    Length {
        /// Minimum number of entries.
        min: usize,
        /// Maximum number of entries.
        max: usize,
        /// Number of entries in the file.
        found: usize,
    },
    /// A test with both a manoeuvre and a refusal, or with neither.
    #[error("a test must have either `lead` or `refusal_reason`")]
    LeadOrRefusal,
    /// A missing parameter of the manoeuvre.
    #[error("is missing: a test with lead = {lead} needs it{}", describe_alternative(alternative.as_ref()))]
    Missing {
        /// Manoeuvre of the vehicle ahead.
        lead: &'static str,
        /// Parameter that may be stated instead.
        alternative: Option<ParameterKind>,
    },
    /// A parameter that repeats another one.
    #[error("repeats `{}`: state only one of them", other.name())]
    AlreadyStated {
        /// The other parameter.
        other: ParameterKind,
    },
    /// An impact speed that cannot be allowed.
    #[error("must be above 0 and at most {max} {unit}, found {}", format_compact(*found))]
    ImpactOutOfRange {
        /// Maximum, in `unit`.
        max: f64,
        /// Unit of the maximum.
        unit: ParameterUnit,
        /// Value in the file.
        found: f64,
    },
    /// An impact speed in a unit of another quantity.
    #[error("an impact speed cannot be stated in {found}")]
    ImpactUnit {
        /// Unit in the file.
        found: ParameterUnit,
    },
    /// A parameter or direction that the manoeuvre does not use.
    #[error("is not allowed in a test with lead = {lead}")]
    Misplaced {
        /// Manoeuvre of the vehicle ahead.
        lead: &'static str,
    },
    /// A unit of another quantity.
    #[error("{} cannot be stated in {found}", parameter.label())]
    Unit {
        /// Parameter that is stated.
        parameter: ParameterKind,
        /// Unit in the file.
        found: ParameterUnit,
    },
    /// A value outside its range.
    #[error(
        "must be from {} to {} {unit}, found {}",
        format_compact(range[0]),
        format_compact(range[1]),
        format_compact(*found)
    )]
    OutOfRange {
        /// Allowed range, in `unit`.
        range: [f64; 2],
        /// Unit of the parameter.
        unit: ParameterUnit,
        /// Value in the file.
        found: f64,
    },
    /// Values that do not increase.
    #[error("must increase, but {found} follows {before}")]
    NotIncreasing {
        /// The earlier value.
        before: f64,
        /// The value that is not larger.
        found: f64,
    },
    /// A margin whose last value is not beyond all values of the grid.
    #[error("must lie beyond all values of {}", parameter.label())]
    NotBeyondGrid {
        /// Parameter that is varied.
        parameter: ParameterKind,
    },
    /// A leader that is not slower than the vehicle under test.
    #[error("the vehicle ahead must be slower than the vehicle under test at every point")]
    NotSlower,
    /// A parameter with a range but without two values.
    #[error("{} needs two different values for a range", parameter.label())]
    NoValueRange {
        /// Parameter of the range.
        parameter: ParameterKind,
    },
    /// A tolerance that is negative or not a number.
    #[error("must be 0 or more, found {found}")]
    Tolerance {
        /// Value in the file.
        found: f64,
    },
    /// A range that is stated twice.
    #[error("is stated twice")]
    DuplicateRange,
    /// More points than the maximum.
    #[error("makes {found} points, and a suite may have at most {MAX_POINTS}")]
    TooMany {
        /// Number of points.
        found: usize,
    },
    /// A point that makes no scenario.
    #[error("{point}: is not a valid scenario: {why}")]
    Scenario {
        /// Description of the point.
        point: String,
        /// Problem of the scenario.
        why: Box<InvalidField>,
    },
}

fn describe_alternative(other: Option<&ParameterKind>) -> String {
    other.map_or_else(String::new, |other| format!(", or `{}`", other.name()))
}

type CheckResult = Result<(), InvalidSuite>;

fn ensure(condition: bool, field: impl Into<String>, problem: SuiteProblem) -> CheckResult {
    if condition {
        Ok(())
    } else {
        Err(InvalidSuite::new(field, problem))
    }
}

pub(super) fn check(spec: &SuiteSpec) -> CheckResult {
    check_version(spec.version, SUITE_VERSION)
        .map_err(|unsupported| InvalidSuite::new("version", SuiteProblem::from(unsupported)))?;
    check_name(&spec.name, "name")?;
    for (field, found) in [
        ("about", &spec.about),
        ("document", &spec.document),
        ("edition", &spec.edition),
        ("parameter_source", &spec.parameter_source),
    ] {
        check_text(found, field)?;
    }
    for (field, list) in [
        ("not_modelled", &spec.not_modelled),
        ("omitted_parameters", &spec.omitted_parameters),
    ] {
        check_length(list.len(), 0, 100, field)?;
        list.iter()
            .enumerate()
            .try_for_each(|(index, found)| check_text(found, format!("{field}[{index}]")))?;
    }
    check_length(spec.clauses.len(), 1, 100, "clauses")?;
    let (mut names, mut points) = (Vec::new(), 0);
    for (index, clause) in spec.clauses.iter().enumerate() {
        let place = format!("clauses[{index}]");
        check_text(&clause.clause, format!("{place}.clause"))?;
        check_text(&clause.summary, format!("{place}.summary"))?;
        check_length(clause.tests.len(), 1, 100, format!("{place}.tests"))?;
        for (index, test) in clause.tests.iter().enumerate() {
            let place = format!("{place}.tests[{index}]");
            check_name(&test.name, format!("{place}.name"))?;
            ensure(
                !names.contains(&&test.name),
                format!("{place}.name"),
                SuiteProblem::DuplicateName,
            )?;
            names.push(&test.name);
            points += check_test(test, &place, points)?;
        }
    }
    Ok(())
}

/// Checks a test, given the number of points of the earlier tests, and returns its number of points.
fn check_test(test: &TestSpec, place: &str, before: usize) -> Result<usize, InvalidSuite> {
    let lead = match (test.lead, &test.refusal_reason) {
        (Some(lead), None) => lead,
        (None, Some(why)) => {
            check_text(why, format!("{place}.refusal_reason"))?;
            let misplaced = test.parameters.iter().next().is_some()
                || test.impact_at_most.is_some()
                || !test.margins.is_empty()
                || !test.ranges.is_empty();
            return ensure(!misplaced, place, SuiteProblem::LeadOrRefusal).map(|()| 0);
        }
        _ => return Err(InvalidSuite::new(place, SuiteProblem::LeadOrRefusal)),
    };
    check_parameters(test, lead, place)?;
    if let Some(ImpactLimit {
        value, unit, note, ..
    }) = &test.impact_at_most
    {
        let (at, found) = (|name: &str| format!("{place}.impact_at_most.{name}"), *unit);
        let is_speed = ParameterKind::OwnSpeed.allowed_units().contains(&found);
        ensure(is_speed, at("unit"), SuiteProblem::ImpactUnit { found })?;
        // Rounded to nine digits, so that the maximum is exactly 360 km/h.
        let max = (ParameterKind::OwnSpeed.range()[1] / unit.si_factor() * 1e9).round() / 1e9;
        let problem = SuiteProblem::ImpactOutOfRange {
            max,
            unit: *unit,
            found: *value,
        };
        ensure(*value > 0.0 && *value <= max, at("value"), problem)?;
        ensure(
            note.is_empty() || check_text(note, "").is_ok(),
            at("note"),
            SuiteProblem::Text,
        )?;
    }
    let found = before.saturating_add(test.point_count());
    ensure(
        found <= MAX_POINTS,
        format!("{place}.parameters"),
        SuiteProblem::TooMany { found },
    )?;
    let grid = test.grid();
    grid.iter()
        .try_for_each(|point| check_point(test, lead, point, &format!("{place}.parameters")))?;
    for (index, &parameter) in test.ranges.iter().enumerate() {
        let field = format!("{place}.ranges[{index}]");
        let has_range = test
            .find_parameter(parameter)
            .is_some_and(|(_, figure)| figure.values.len() > 1);
        ensure(has_range, &field, SuiteProblem::NoValueRange { parameter })?;
        ensure(
            !test.ranges[..index].contains(&parameter),
            field,
            SuiteProblem::DuplicateRange,
        )?;
    }
    for (at, (parameter, figure)) in test
        .parameters
        .iter()
        .enumerate()
        .filter(|(_, (_, figure))| figure.tolerance > 0.0)
    {
        let field = format!("{place}.parameters.{}.tolerance", parameter.name());
        for point in &grid {
            for tolerance in [-figure.tolerance, figure.tolerance] {
                let value = point.get(at).map_or(0.0, |value| value + tolerance);
                check_point(test, lead, &with_value(point, at, value), &field)?;
            }
        }
    }
    check_length(test.margins.len(), 0, 10, format!("{place}.margins"))?;
    for (index, margin) in test.margins.iter().enumerate() {
        let field = format!("{place}.margins[{index}]");
        let Some((at, stated)) = test.find_parameter(margin.parameter) else {
            return Err(InvalidSuite::new(
                format!("{field}.parameter"),
                SuiteProblem::Misplaced { lead: lead.name() },
            ));
        };
        check_value(
            margin.parameter,
            margin.to,
            stated.unit,
            &format!("{field}.to"),
        )?;
        let is_within = stated.values.iter().any(|&value| value >= margin.to)
            && stated.values.iter().any(|&value| value <= margin.to);
        ensure(
            !is_within,
            format!("{field}.to"),
            SuiteProblem::NotBeyondGrid {
                parameter: margin.parameter,
            },
        )?;
        for point in &grid {
            check_point(
                test,
                lead,
                &with_value(point, at, margin.to),
                &format!("{field}.to"),
            )?;
        }
    }
    Ok(grid.len())
}

fn check_parameters(test: &TestSpec, lead: LeadManeuver, place: &str) -> CheckResult {
    let field = |parameter: ParameterKind| format!("{place}.parameters.{}", parameter.name());
    for (parameter, found) in test.parameters.iter() {
        let is_needed = lead.parameters().concat().contains(&parameter);
        ensure(
            is_needed,
            field(parameter),
            SuiteProblem::Misplaced { lead: lead.name() },
        )?;
        check_parameter(parameter, found, &field(parameter))?;
    }
    for needed in lead.parameters() {
        let mut stated = needed
            .iter()
            .filter(|parameter| test.parameters.get(**parameter).is_some());
        match (stated.next(), stated.next(), needed) {
            (Some(&other), Some(&twice), _) => {
                return Err(InvalidSuite::new(
                    field(twice),
                    SuiteProblem::AlreadyStated { other },
                ));
            }
            (None, _, [first, others @ ..]) => {
                let missing = SuiteProblem::Missing {
                    lead: lead.name(),
                    alternative: others.first().copied(),
                };
                return Err(InvalidSuite::new(field(*first), missing));
            }
            _ => {}
        }
    }
    Ok(())
}

fn check_point(test: &TestSpec, lead: LeadManeuver, point: &[f64], field: &str) -> CheckResult {
    if lead.requires_slower_lead() {
        let is_slower = test.si_value(point, ParameterKind::LeadSpeed) + 0.1
            <= test.si_value(point, ParameterKind::OwnSpeed);
        ensure(is_slower, field, SuiteProblem::NotSlower)?;
    }
    let point_in_words = || test.describe_point(point);
    test.scenario("point", "", point).map(drop).map_err(|why| {
        InvalidSuite::new(
            field,
            SuiteProblem::Scenario {
                point: point_in_words(),
                why: why.into(),
            },
        )
    })
}

fn check_parameter(parameter: ParameterKind, figure: &TestParameter, field: &str) -> CheckResult {
    let at = |name: &str| format!("{field}.{name}");
    let found = figure.unit;
    ensure(
        parameter.allowed_units().contains(&found),
        at("unit"),
        SuiteProblem::Unit { parameter, found },
    )?;
    check_length(figure.values.len(), 1, 100, at("values"))?;
    for (index, &found) in figure.values.iter().enumerate() {
        check_value(
            parameter,
            found,
            figure.unit,
            &format!("{field}.values[{index}]"),
        )?;
    }
    for (pair, index) in figure.values.windows(2).zip(1..) {
        if let &[before, found] = pair {
            let field = format!("{field}.values[{index}]");
            ensure(
                before < found,
                field,
                SuiteProblem::NotIncreasing { before, found },
            )?;
        }
    }
    let TestParameter {
        values, tolerance, ..
    } = figure;
    ensure(
        *tolerance >= 0.0 && tolerance.is_finite(),
        at("tolerance"),
        SuiteProblem::Tolerance { found: *tolerance },
    )?;
    for end in values
        .iter()
        .take(1)
        .map(|first| first - tolerance)
        .chain(values.last().map(|last| last + tolerance))
    {
        check_value(parameter, end, figure.unit, &at("tolerance"))?;
    }
    if figure.note.is_empty() {
        Ok(())
    } else {
        check_text(&figure.note, at("note"))
    }
}

fn check_value(
    parameter: ParameterKind,
    found: f64,
    unit: ParameterUnit,
    field: &str,
) -> CheckResult {
    // Rounded to nine digits, so that 0.5 m/s is exactly 1.8 km/h.
    let range = parameter
        .range()
        .map(|end| (end / unit.si_factor() * 1e9).round() / 1e9);
    ensure(
        (range[0]..=range[1]).contains(&found),
        field,
        SuiteProblem::OutOfRange { range, unit, found },
    )
}

fn check_name(found: &str, field: impl Into<String>) -> CheckResult {
    let is_plain =
        |letter: u8| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == b'-';
    ensure(
        (1..=60).contains(&found.len()) && found.bytes().all(is_plain),
        field,
        SuiteProblem::Name,
    )
}

fn check_text(found: &str, field: impl Into<String>) -> CheckResult {
    let is_short = (1..=2000).contains(&found.chars().count());
    ensure(
        is_short && !found.chars().any(char::is_control),
        field,
        SuiteProblem::Text,
    )
}

fn check_length(found: usize, least: usize, most: usize, field: impl Into<String>) -> CheckResult {
    ensure(
        (least..=most).contains(&found),
        field,
        SuiteProblem::Length {
            min: least,
            max: most,
            found,
        },
    )
}
