//! Validation of suites.

use std::path::PathBuf;

use crumple_core::digits::format_compact;
use crumple_core::field_error::FieldError;
use crumple_core::format_version::{UnsupportedVersion, check_version};
use crumple_core::requirement::{InvalidRequirement, check_requirements};
use crumple_core::text_file::FileError;
use crumple_sim::scenario::InvalidField;

use super::SUITE_VERSION;
use super::parameter::{ImpactLimit, ParameterKind, ParameterUnit, TestParameter};
use super::spec::{LeadManeuver, SuiteSpec, TestSpec, with_value};

const MAX_POINTS: usize = 2000;
const MAX_SEEDS: u32 = 100;

/// Reason why a suite file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteError {
    /// The file cannot be read or parsed.
    #[error(transparent)]
    File(#[from] FileError),
    /// A field is out of range or contradicts another field.
    #[error("{}:{line}: {invalid}", path.display())]
    Invalid {
        /// File that was read.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Field, such as `clauses[0].tests[1].lead`, and problem.
        invalid: Box<InvalidSuite>,
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
    /// Names of requirements that are not allowed.
    #[error(transparent)]
    Requirement(#[from] InvalidRequirement),
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
    /// A parameter without another one that belongs to it.
    #[error("is missing: a test with `{}` needs it", other.name())]
    MissingBeside {
        /// The other parameter.
        other: ParameterKind,
    },
    /// An event before the start of a test without a vehicle in the way.
    #[error(
        "`closing_time` and `manual_closing_time` must be less than `approach_time` at every point, so that the object \
        appears, and the driver brakes, after the start"
    )]
    BeforeStart,
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
    /// A number of seeds outside its range.
    #[error("must be from 1 to {MAX_SEEDS}, found {found}")]
    Seeds {
        /// Value in the file.
        found: u32,
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

fn describe_alternative(alternative: Option<&ParameterKind>) -> String {
    alternative.map_or_else(String::new, |parameter| {
        format!(", or `{}`", parameter.name())
    })
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
    for (field, text) in [
        ("about", &spec.about),
        ("document", &spec.document),
        ("edition", &spec.edition),
        ("parameter_source", &spec.parameter_source),
    ] {
        check_text(text, field)?;
    }
    for (field, list) in [
        ("not_modelled", &spec.not_modelled),
        ("omitted_parameters", &spec.omitted_parameters),
    ] {
        check_length(list.len(), 0, 100, field)?;
        list.iter()
            .enumerate()
            .try_for_each(|(index, text)| check_text(text, format!("{field}[{index}]")))?;
    }
    if let Some(found) = spec.seeds {
        ensure(
            (1..=MAX_SEEDS).contains(&found),
            "seeds",
            SuiteProblem::Seeds { found },
        )?;
    }
    check_length(spec.clauses.len(), 1, 100, "clauses")?;
    let mut names = Vec::new();
    let mut points = 0;
    for (index, clause) in spec.clauses.iter().enumerate() {
        let path = format!("clauses[{index}]");
        check_text(&clause.clause, format!("{path}.clause"))?;
        check_text(&clause.summary, format!("{path}.summary"))?;
        check_length(clause.tests.len(), 1, 100, format!("{path}.tests"))?;
        for (index, test) in clause.tests.iter().enumerate() {
            let path = format!("{path}.tests[{index}]");
            check_name(&test.name, format!("{path}.name"))?;
            ensure(
                !names.contains(&&test.name),
                format!("{path}.name"),
                SuiteProblem::DuplicateName,
            )?;
            names.push(&test.name);
            points += check_test(test, &path, points)?;
        }
    }
    Ok(())
}

/// Checks a test, given the number of points of the earlier tests, and returns its number of points.
fn check_test(test: &TestSpec, path: &str, before: usize) -> Result<usize, InvalidSuite> {
    check_requirements(&test.requirement).map_err(|invalid| {
        InvalidSuite::new(format!("{path}.requirement"), SuiteProblem::from(invalid))
    })?;
    let Some(lead) = check_lead(test, path)? else {
        return Ok(0);
    };
    check_parameters(test, lead, path)?;
    if let Some(limit) = &test.impact_at_most {
        check_impact_limit(limit, &format!("{path}.impact_at_most"))?;
    }
    let points = before.saturating_add(test.point_count());
    ensure(
        points <= MAX_POINTS,
        format!("{path}.parameters"),
        SuiteProblem::TooMany { found: points },
    )?;
    let grid = test.grid();
    grid.iter()
        .try_for_each(|point| check_point(test, lead, point, &format!("{path}.parameters")))?;
    check_ranges(test, path)?;
    check_tolerances(test, lead, &grid, path)?;
    check_margins(test, lead, &grid, path)?;
    Ok(grid.len())
}

/// Returns the manoeuvre of a test; `None` for a test that only has a reason why it cannot be run.
fn check_lead(test: &TestSpec, path: &str) -> Result<Option<LeadManeuver>, InvalidSuite> {
    match (test.lead, &test.refusal_reason) {
        (Some(lead), None) => Ok(Some(lead)),
        (None, Some(reason)) => {
            check_text(reason, format!("{path}.refusal_reason"))?;
            let has_only_a_reason = test.parameters.iter().next().is_none()
                && test.impact_at_most.is_none()
                && test.margins.is_empty()
                && test.ranges.is_empty()
                && !test.holds_speed;
            ensure(has_only_a_reason, path, SuiteProblem::LeadOrRefusal)?;
            Ok(None)
        }
        _ => Err(InvalidSuite::new(path, SuiteProblem::LeadOrRefusal)),
    }
}

fn check_impact_limit(limit: &ImpactLimit, path: &str) -> CheckResult {
    let ImpactLimit {
        value, unit, note, ..
    } = limit;
    let is_speed = ParameterKind::OwnSpeed.allowed_units().contains(unit);
    ensure(
        is_speed,
        format!("{path}.unit"),
        SuiteProblem::ImpactUnit { found: *unit },
    )?;
    // Rounded to nine digits, so that the maximum is exactly 360 km/h.
    let max = (ParameterKind::OwnSpeed.range()[1] / unit.si_factor() * 1e9).round() / 1e9;
    let problem = SuiteProblem::ImpactOutOfRange {
        max,
        unit: *unit,
        found: *value,
    };
    ensure(
        *value > 0.0 && *value <= max,
        format!("{path}.value"),
        problem,
    )?;
    ensure(
        note.is_empty() || check_text(note, "").is_ok(),
        format!("{path}.note"),
        SuiteProblem::Text,
    )
}

fn check_ranges(test: &TestSpec, path: &str) -> CheckResult {
    for (index, &parameter) in test.ranges.iter().enumerate() {
        let field = format!("{path}.ranges[{index}]");
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
    Ok(())
}

/// Checks that each point remains a scenario at both ends of each tolerance.
fn check_tolerances(
    test: &TestSpec,
    lead: LeadManeuver,
    grid: &[Vec<f64>],
    path: &str,
) -> CheckResult {
    for (position, (parameter, figure)) in test
        .parameters
        .iter()
        .enumerate()
        .filter(|(_, (_, figure))| figure.tolerance > 0.0)
    {
        let field = format!("{path}.parameters.{}.tolerance", parameter.name());
        for point in grid {
            for tolerance in [-figure.tolerance, figure.tolerance] {
                let value = point.get(position).map_or(0.0, |value| value + tolerance);
                check_point(test, lead, &with_value(point, position, value), &field)?;
            }
        }
    }
    Ok(())
}

/// Checks that each margin ends beyond the grid, and at a scenario.
fn check_margins(
    test: &TestSpec,
    lead: LeadManeuver,
    grid: &[Vec<f64>],
    path: &str,
) -> CheckResult {
    check_length(test.margins.len(), 0, 10, format!("{path}.margins"))?;
    for (index, margin) in test.margins.iter().enumerate() {
        let field = format!("{path}.margins[{index}]");
        let Some((position, figure)) = test.find_parameter(margin.parameter) else {
            return Err(InvalidSuite::new(
                format!("{field}.parameter"),
                SuiteProblem::Misplaced { lead: lead.name() },
            ));
        };
        let field = format!("{field}.to");
        check_value(margin.parameter, margin.to, figure.unit, &field)?;
        let is_within = figure.values.iter().any(|&value| value >= margin.to)
            && figure.values.iter().any(|&value| value <= margin.to);
        let problem = SuiteProblem::NotBeyondGrid {
            parameter: margin.parameter,
        };
        ensure(!is_within, &field, problem)?;
        for point in grid {
            let end = with_value(point, position, margin.to);
            check_point(test, lead, &end, &field)?;
        }
    }
    Ok(())
}

fn check_parameters(test: &TestSpec, lead: LeadManeuver, path: &str) -> CheckResult {
    for (parameter, figure) in test.parameters.iter() {
        let field = parameter_field(path, parameter);
        let mut allowed = lead.parameters().iter().chain(lead.optional_parameters());
        ensure(
            allowed.any(|group| group.contains(&parameter)),
            &field,
            SuiteProblem::Misplaced { lead: lead.name() },
        )?;
        check_parameter(parameter, figure, &field)?;
    }
    for needed in lead.parameters() {
        let mut stated = needed
            .iter()
            .filter(|parameter| test.parameters.get(**parameter).is_some());
        match (stated.next(), stated.next(), needed) {
            (Some(&other), Some(&twice), _) => {
                return Err(InvalidSuite::new(
                    parameter_field(path, twice),
                    SuiteProblem::AlreadyStated { other },
                ));
            }
            (None, _, [first, others @ ..]) => {
                let missing = SuiteProblem::Missing {
                    lead: lead.name(),
                    alternative: others.first().copied(),
                };
                return Err(InvalidSuite::new(parameter_field(path, *first), missing));
            }
            _ => {}
        }
    }
    lead.optional_parameters()
        .iter()
        .try_for_each(|group| check_group(test, group, path))
}

/// Checks that all parameters of a group are stated, or none.
fn check_group(test: &TestSpec, group: &[ParameterKind], path: &str) -> CheckResult {
    let is_stated = |parameter: &&ParameterKind| test.parameters.get(**parameter).is_some();
    let stated = group.iter().find(is_stated);
    let missing = group.iter().find(|parameter| !is_stated(parameter));
    match stated.zip(missing) {
        Some((&other, &missing)) => Err(InvalidSuite::new(
            parameter_field(path, missing),
            SuiteProblem::MissingBeside { other },
        )),
        None => Ok(()),
    }
}

fn parameter_field(test_path: &str, parameter: ParameterKind) -> String {
    format!("{test_path}.parameters.{}", parameter.name())
}

fn check_point(test: &TestSpec, lead: LeadManeuver, point: &[f64], field: &str) -> CheckResult {
    if lead.requires_slower_lead() {
        let is_slower = test.si_value(point, ParameterKind::LeadSpeed) + 0.1
            <= test.si_value(point, ParameterKind::OwnSpeed);
        ensure(is_slower, field, SuiteProblem::NotSlower)?;
    }
    ensure(
        test.begins_before_events(point),
        field,
        SuiteProblem::BeforeStart,
    )?;
    test.scenario("point", "", point).map(drop).map_err(|why| {
        InvalidSuite::new(
            field,
            SuiteProblem::Scenario {
                point: test.describe_point(point),
                why: why.into(),
            },
        )
    })
}

fn check_parameter(parameter: ParameterKind, figure: &TestParameter, field: &str) -> CheckResult {
    let TestParameter {
        values,
        unit,
        tolerance,
        note,
        ..
    } = figure;
    ensure(
        parameter.allowed_units().contains(unit),
        format!("{field}.unit"),
        SuiteProblem::Unit {
            parameter,
            found: *unit,
        },
    )?;
    check_parameter_values(parameter, figure, &format!("{field}.values"))?;
    let tolerance_field = format!("{field}.tolerance");
    ensure(
        *tolerance >= 0.0 && tolerance.is_finite(),
        &tolerance_field,
        SuiteProblem::Tolerance { found: *tolerance },
    )?;
    let lowest = values.first().map(|first| first - tolerance);
    let highest = values.last().map(|last| last + tolerance);
    for end in lowest.into_iter().chain(highest) {
        check_value(parameter, end, *unit, &tolerance_field)?;
    }
    if note.is_empty() {
        Ok(())
    } else {
        check_text(note, format!("{field}.note"))
    }
}

/// Checks that the values are in the range of the parameter and increase.
fn check_parameter_values(
    parameter: ParameterKind,
    figure: &TestParameter,
    field: &str,
) -> CheckResult {
    check_length(figure.values.len(), 1, 100, field)?;
    for (index, &value) in figure.values.iter().enumerate() {
        check_value(parameter, value, figure.unit, &format!("{field}[{index}]"))?;
    }
    for (pair, index) in figure.values.windows(2).zip(1..) {
        if let &[before, found] = pair {
            ensure(
                before < found,
                format!("{field}[{index}]"),
                SuiteProblem::NotIncreasing { before, found },
            )?;
        }
    }
    Ok(())
}

fn check_value(
    parameter: ParameterKind,
    value: f64,
    unit: ParameterUnit,
    field: &str,
) -> CheckResult {
    // Rounded to nine digits, so that 0.5 m/s is exactly 1.8 km/h.
    let range = parameter
        .range()
        .map(|end| (end / unit.si_factor() * 1e9).round() / 1e9);
    ensure(
        (range[0]..=range[1]).contains(&value),
        field,
        SuiteProblem::OutOfRange {
            range,
            unit,
            found: value,
        },
    )
}

fn check_name(name: &str, field: impl Into<String>) -> CheckResult {
    let is_plain = name
        .bytes()
        .all(|letter| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == b'-');
    ensure(
        (1..=60).contains(&name.len()) && is_plain,
        field,
        SuiteProblem::Name,
    )
}

fn check_text(text: &str, field: impl Into<String>) -> CheckResult {
    let is_short = (1..=2000).contains(&text.chars().count());
    ensure(
        is_short && !text.chars().any(char::is_control),
        field,
        SuiteProblem::Text,
    )
}

fn check_length(length: usize, min: usize, max: usize, field: impl Into<String>) -> CheckResult {
    ensure(
        (min..=max).contains(&length),
        field,
        SuiteProblem::Length {
            min,
            max,
            found: length,
        },
    )
}
