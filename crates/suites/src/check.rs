//! Which suites are valid.

use std::path::PathBuf;

use crumple_world::scenario::file::FileError;
use crumple_world::scenario::{InvalidField, short};

use super::SUITE_VERSION;
use super::parameter::{Figure, ImpactLimit, Parameter, Unit};
use super::spec::{Lead, SuiteSpec, TestSpec, moved};

/// Most points of all grids of a suite.
const MAX_POINTS: usize = 2000;

/// Why a suite file cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteError {
    /// It cannot be read, or is not well formed.
    #[error(transparent)]
    File(#[from] FileError),
    /// A field is out of range or contradicts another.
    #[error("{}:{line}: {field}: {problem}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// Line of the field, from 1.
        line: usize,
        /// Path of the field, such as `clauses[0].tests[1].lead`.
        field: String,
        /// What is wrong.
        problem: Box<SuiteProblem>,
    },
}

/// A field of a suite that is not valid.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct InvalidSuite {
    /// Path of the field, such as `clauses[0].tests[1].lead`.
    pub field: String,
    /// The problem.
    pub problem: SuiteProblem,
}

/// What can be wrong with a field of a suite.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SuiteProblem {
    /// The file is of another format version.
    #[error("version {found} is not supported: this release reads version {SUITE_VERSION}")]
    Version {
        /// What the file says.
        found: u32,
    },
    /// A name that cannot name files.
    #[error("must be 1 to 60 small letters, digits and hyphens")]
    Name,
    /// A name that another test has.
    #[error("another test has this name")]
    DuplicateName,
    /// A text that is too long, empty or holds control characters.
    #[error("must have 1 to 2000 characters, none of them a control character")]
    Text,
    /// A list that is empty or too long.
    #[error("must have {least} to {most} entries, found {found}")]
    Length {
        /// Fewest allowed.
        min: usize,
        /// Most allowed.
        max: usize,
        /// How many there are.
        found: usize,
    },
    /// A test with a situation and a refusal, or neither.
    #[error("a test has either `lead` or `refused`")]
    LeadOrRefusal,
    /// A figure that the situation needs.
    #[error("is missing: where the lead is {lead} there must be one{}", alternative(or.as_ref()))]
    Missing {
        /// The situation.
        lead: &'static str,
        /// What may be stated in its place.
        alternative: Option<Parameter>,
    },
    /// A figure that says what another one says already.
    #[error("is there beside `{}`, which says the same: there must be one of them", other.name())]
    AlreadyStated {
        /// The other one.
        other: Parameter,
    },
    /// A contact that cannot be allowed.
    #[error("must be more than 0 and at most {most} {unit}, found {}", short(*found))]
    ImpactOutOfRange {
        /// The most, in the unit.
        max: f64,
        /// The unit.
        unit: Unit,
        /// What the file says.
        found: f64,
    },
    /// An impact speed in a unit of another quantity.
    #[error("an impact speed cannot be stated in {found}")]
    ImpactUnit {
        /// The unit.
        found: Unit,
    },
    /// A figure or direction that the situation has no place for.
    #[error("has no place where the lead is {lead}")]
    Misplaced {
        /// The situation.
        lead: &'static str,
    },
    /// A unit of another quantity.
    #[error("{} cannot be stated in {found}", parameter.words())]
    Unit {
        /// What is stated.
        parameter: Parameter,
        /// The unit.
        found: Unit,
    },
    /// A value outside its range.
    #[error("must be from {} to {} {unit}, found {}", short(range[0]), short(range[1]), short(*found))]
    OutOfRange {
        /// The range, in the unit of the figure.
        range: [f64; 2],
        /// The unit.
        unit: Unit,
        /// What the file says.
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
    /// A direction that ends within the grid.
    #[error("must lie beyond all values of {}", parameter.words())]
    NotBeyondGrid {
        /// What is pushed.
        parameter: Parameter,
    },
    /// A vehicle ahead that is not slower.
    #[error("the vehicle ahead must be slower than the vehicle under test at every point")]
    NotSlower,
    /// A range of a figure without two values.
    #[error("{} has no two values between which there is a range", parameter.words())]
    NoValueRange {
        /// The figure.
        parameter: Parameter,
    },
    /// A tolerance that is none.
    #[error("must be a number from 0 on, found {found}")]
    Tolerance {
        /// What was found.
        found: f64,
    },
    /// A range that is stated twice.
    #[error("is stated twice")]
    DuplicateRange,
    /// More points than a suite may have.
    #[error("makes {found} points, and a suite may have {MOST_POINTS}")]
    TooMany {
        /// How many there are.
        found: usize,
    },
    /// A point that is no scenario.
    #[error("{point}: makes no scenario: {why}")]
    Scenario {
        /// The point, in words.
        point: String,
        /// Why not.
        why: Box<InvalidField>,
    },
}

/// What may be stated in place of a figure, in words.
fn describe_alternative(other: Option<&Parameter>) -> String {
    other.map_or_else(String::new, |other| format!(", or `{}`", other.name()))
}

type CheckResult = Result<(), InvalidSuite>;

fn ensure(condition: bool, field: impl Into<String>, problem: SuiteProblem) -> CheckResult {
    if condition { Ok(()) } else { Err(invalid(field, problem)) }
}

fn invalid(field: impl Into<String>, problem: SuiteProblem) -> InvalidSuite {
    InvalidSuite { field: field.into(), problem }
}

pub(super) fn check(spec: &SuiteSpec) -> CheckResult {
    holds(spec.version == SUITE_VERSION, "version", SuiteProblem::Version { found: spec.version })?;
    name(&spec.name, "name")?;
    for (field, found) in [
        ("about", &spec.about),
        ("document", &spec.document),
        ("edition", &spec.edition),
        ("figures_from", &spec.figures_from),
    ] {
        text(found, field)?;
    }
    for (field, list) in [("outside", &spec.outside), ("left_out", &spec.left_out)] {
        length(list.len(), 0, 100, field)?;
        list.iter().enumerate().try_for_each(|(index, found)| text(found, format!("{field}[{index}]")))?;
    }
    length(spec.clauses.len(), 1, 100, "clauses")?;
    let (mut names, mut points) = (Vec::new(), 0);
    for (index, clause) in spec.clauses.iter().enumerate() {
        let place = format!("clauses[{index}]");
        text(&clause.clause, format!("{place}.clause"))?;
        text(&clause.says, format!("{place}.says"))?;
        length(clause.tests.len(), 1, 100, format!("{place}.tests"))?;
        for (index, test) in clause.tests.iter().enumerate() {
            let place = format!("{place}.tests[{index}]");
            name(&test.name, format!("{place}.name"))?;
            holds(!names.contains(&&test.name), format!("{place}.name"), SuiteProblem::Twice)?;
            names.push(&test.name);
            points += check_test(test, &place, points)?;
        }
    }
    Ok(())
}

/// Checks a test after so many points of others; how many it has.
fn check_test(test: &TestSpec, place: &str, before: usize) -> Result<usize, InvalidSuite> {
    let lead = match (test.lead, &test.refused) {
        (Some(lead), None) => lead,
        (None, Some(why)) => {
            text(why, format!("{place}.refused"))?;
            let misplaced = test.figures.stated().next().is_some()
                || test.impact_at_most.is_some()
                || !test.margins.is_empty()
                || !test.ranges.is_empty();
            return holds(!misplaced, place, SuiteProblem::Either).map(|()| 0);
        }
        _ => return Err(invalid(place, SuiteProblem::Either)),
    };
    check_parameters(test, lead, place)?;
    if let Some(ImpactLimit { value, unit, note, .. }) = &test.impact_at_most {
        let (at, found) = (|name: &str| format!("{place}.impact_at_most.{name}"), *unit);
        holds(Parameter::OwnSpeed.units().contains(&found), at("unit"), SuiteProblem::ImpactUnit { found })?;
        // To nine digits, so that it is 360 km/h.
        let most = (Parameter::OwnSpeed.range()[1] / unit.si_factor() * 1e9).round() / 1e9;
        holds(*value > 0.0 && *value <= most, at("value"), SuiteProblem::Impact { most, unit: *unit, found: *value })?;
        holds(note.is_empty() || text(note, "").is_ok(), at("note"), SuiteProblem::Text)?;
    }
    let found = before.saturating_add(test.points());
    holds(found <= MOST_POINTS, format!("{place}.figures"), SuiteProblem::TooMany { found })?;
    let grid = test.grid();
    grid.iter().try_for_each(|point| check_point(test, lead, point, &format!("{place}.figures")))?;
    for (index, &parameter) in test.ranges.iter().enumerate() {
        let field = format!("{place}.ranges[{index}]");
        let has_range = test.place(parameter).is_some_and(|(_, figure)| figure.values.len() > 1);
        holds(has_range, &field, SuiteProblem::NoRange { parameter })?;
        holds(!test.ranges[..index].contains(&parameter), field, SuiteProblem::RangeTwice)?;
    }
    for (at, (parameter, figure)) in test.figures.stated().enumerate().filter(|(_, (_, figure))| figure.tolerance > 0.0)
    {
        let field = format!("{place}.figures.{}.tolerance", parameter.name());
        for point in &grid {
            for tolerance in [-figure.tolerance, figure.tolerance] {
                let value = point.get(at).map_or(0.0, |value| value + tolerance);
                check_point(test, lead, &moved(point, at, value), &field)?;
            }
        }
    }
    length(test.margins.len(), 0, 10, format!("{place}.margins"))?;
    for (index, margin) in test.margins.iter().enumerate() {
        let field = format!("{place}.margins[{index}]");
        let Some((at, stated)) = test.place(margin.push) else {
            return Err(invalid(format!("{field}.push"), SuiteProblem::Misplaced { lead: lead.name() }));
        };
        value(margin.push, margin.to, stated.unit, &format!("{field}.to"))?;
        let is_within = stated.values.iter().any(|&value| value >= margin.to)
            && stated.values.iter().any(|&value| value <= margin.to);
        holds(!is_within, format!("{field}.to"), SuiteProblem::Within { parameter: margin.push })?;
        for point in &grid {
            check_point(test, lead, &moved(point, at, margin.to), &format!("{field}.to"))?;
        }
    }
    Ok(grid.len())
}

/// Checks that there is every figure that the situation needs, once, and no other.
fn check_parameters(test: &TestSpec, lead: Lead, place: &str) -> CheckResult {
    let field = |parameter: Parameter| format!("{place}.figures.{}", parameter.name());
    for (parameter, found) in test.figures.stated() {
        let is_needed = lead.parameters().concat().contains(&parameter);
        holds(is_needed, field(parameter), SuiteProblem::Misplaced { lead: lead.name() })?;
        figure(parameter, found, &field(parameter))?;
    }
    for needed in lead.parameters() {
        let mut stated = needed.iter().filter(|parameter| test.figures.get(**parameter).is_some());
        match (stated.next(), stated.next(), needed) {
            (Some(&other), Some(&twice), _) => return Err(invalid(field(twice), SuiteProblem::Both { other })),
            (None, _, [first, others @ ..]) => {
                let missing = SuiteProblem::Missing { lead: lead.name(), or: others.first().copied() };
                return Err(invalid(field(*first), missing));
            }
            _ => {}
        }
    }
    Ok(())
}

fn check_point(test: &TestSpec, lead: Lead, point: &[f64], field: &str) -> CheckResult {
    if lead.is_slower() {
        let is_slower = test.si(point, Parameter::LeadSpeed) + 0.1 <= test.si(point, Parameter::OwnSpeed);
        holds(is_slower, field, SuiteProblem::NotSlower)?;
    }
    let point_in_words = || test.in_words(point);
    test.scenario("point", "", point)
        .map(drop)
        .map_err(|why| invalid(field, SuiteProblem::Scenario { point: point_in_words(), why: why.into() }))
}

fn check_parameter(parameter: Parameter, figure: &Figure, field: &str) -> CheckResult {
    let at = |name: &str| format!("{field}.{name}");
    let found = figure.unit;
    holds(parameter.units().contains(&found), at("unit"), SuiteProblem::Unit { parameter, found })?;
    length(figure.values.len(), 1, 100, at("values"))?;
    for (index, &found) in figure.values.iter().enumerate() {
        value(parameter, found, figure.unit, &format!("{field}.values[{index}]"))?;
    }
    for (pair, index) in figure.values.windows(2).zip(1..) {
        if let &[before, found] = pair {
            let field = format!("{field}.values[{index}]");
            holds(before < found, field, SuiteProblem::NotIncreasing { before, found })?;
        }
    }
    let Figure { values, tolerance, .. } = figure;
    holds(*tolerance >= 0.0 && tolerance.is_finite(), at("tolerance"), SuiteProblem::Tolerance { found: *tolerance })?;
    for end in values.iter().take(1).map(|first| first - tolerance).chain(values.last().map(|last| last + tolerance)) {
        value(parameter, end, figure.unit, &at("tolerance"))?;
    }
    if figure.note.is_empty() { Ok(()) } else { text(&figure.note, at("note")) }
}

/// A value that is a number in the range of what it is.
fn check_value(parameter: Parameter, found: f64, unit: Unit, field: &str) -> CheckResult {
    // To nine digits, so that 0.5 m/s is 1.8 km/h.
    let range = parameter.range().map(|end| (end / unit.si_factor() * 1e9).round() / 1e9);
    holds((range[0]..=range[1]).contains(&found), field, SuiteProblem::OutOfRange { range, unit, found })
}

fn check_name(found: &str, field: impl Into<String>) -> CheckResult {
    let is_plain = |letter: u8| letter.is_ascii_lowercase() || letter.is_ascii_digit() || letter == b'-';
    holds((1..=60).contains(&found.len()) && found.bytes().all(is_plain), field, SuiteProblem::Name)
}

fn check_text(found: &str, field: impl Into<String>) -> CheckResult {
    let is_short = (1..=2000).contains(&found.chars().count());
    holds(is_short && !found.chars().any(char::is_control), field, SuiteProblem::Text)
}

fn check_length(found: usize, least: usize, most: usize, field: impl Into<String>) -> CheckResult {
    holds((least..=most).contains(&found), field, SuiteProblem::Length { least, most, found })
}
