//! How far a test can be pushed in a direction until it fails.

use serde::{Deserialize, Serialize};

use super::parameter::{ParameterKind, ParameterUnit};
use super::result::TestVerdict;
use super::run::{ControllerSetup, Criterion};
use super::spec::{TestSpec, with_value};

/// Equal parts of a direction, at whose ends the test is run.
const SWEEP_PARTS: usize = 16;

/// How often the part with the first failure is halved: to a 2048th of the direction.
const BISECTIONS: usize = 7;

/// How far a test can be pushed in a direction, the other figures held.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Margin {
    /// What is pushed.
    #[serde(rename = "push")]
    pub parameter: ParameterKind,
    /// The unit of all values here.
    pub unit: ParameterUnit,
    /// From where: the value of the grid that is next to `to`.
    pub from: f64,
    /// How far at most.
    pub to: f64,
    /// The other figures, in words.
    #[serde(rename = "held")]
    pub fixed_parameters: String,
    /// Where it ends.
    pub end: MarginEnd,
}

/// Where a margin ends.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MarginEnd {
    /// The test does not pass from where it is pushed.
    None {
        /// What it does there.
        #[serde(rename = "beyond")]
        failure: SweepFailure,
    },
    /// It passes at the ends of all parts: nothing between them was run.
    Holds {
        /// How many parts.
        parts: usize,
    },
    /// It passes on one side, and does not on the other; both were run.
    Boundary {
        /// The last value that passes.
        passes_at: f64,
        /// The first that does not.
        fails_at: f64,
        /// What it does there.
        #[serde(rename = "beyond")]
        failure: SweepFailure,
        /// Whether it passes nowhere beyond on the grid of parts. If it does, this is the first failure that was found there.
        is_monotone: bool,
        /// How many parts the grid has.
        parts: usize,
    },
}

/// How a test does not pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepFailure {
    /// A contact, or no usable answer of the controller.
    Fails,
    /// It cannot be run, as where a shield knows no way to keep off what it is shown.
    Refused,
}

/// What a test does at a value: it passes, or does not in some way.
type SweepOutcome = Result<(), SweepFailure>;

/// A direction from a base.
struct Sweep<'t> {
    test: &'t TestSpec,
    base: Vec<f64>,
    position: usize,
    parameter: ParameterKind,
    unit: ParameterUnit,
    from: f64,
    to: f64,
}

impl Sweep<'_> {
    /// The end of a part.
    fn value(&self, part: usize) -> f64 {
        self.from + (self.to - self.from) * (part as f64 / SWEEP_PARTS as f64)
    }
}

/// The margins of a test: a line a direction and combination of the other figures.
pub(super) fn find_margins(test: &TestSpec, criterion: Criterion, driven: &ControllerSetup<'_>) -> Vec<Margin> {
    let lines = sweeps(test);
    let ends: Vec<(usize, f64)> = (0..lines.len())
        .flat_map(|line| (0..=SWEEP_PARTS).map(move |part| (line, part)))
        .map(|(line, part)| (line, lines[line].value(part)))
        .collect();
    let at_ends = evaluate(&lines, &ends, criterion, driven);
    let mut margin_ends: Vec<MarginEnd> =
        at_ends.chunks(SWEEP_PARTS + 1).zip(&lines).map(|(found, line)| grid_end(line, found)).collect();
    for _ in 0..BISECTIONS {
        bisect(&mut margin_ends, &lines, criterion, driven);
    }
    let margin = |(line, end): (&Sweep<'_>, MarginEnd)| Margin {
        parameter: line.parameter,
        unit: line.unit,
        from: line.from,
        to: line.to,
        fixed_parameters: line.test.describe_point_without(&line.base, Some(line.position)),
        end,
    };
    lines.iter().zip(margin_ends).map(margin).collect()
}

fn sweeps(test: &TestSpec) -> Vec<Sweep<'_>> {
    let mut lines: Vec<Sweep<'_>> = Vec::new();
    for margin in &test.margins {
        let Some((at, figure)) = test.find_parameter(margin.parameter) else { continue };
        let (Some(&first), Some(&last)) = (figure.values.first(), figure.values.last()) else { continue };
        let from = if margin.to > last { last } else { first };
        let bases = test.grid().into_iter().filter(|point| point.get(at) == Some(&from));
        let (push, unit, to) = (margin.parameter, figure.unit, margin.to);
        lines.extend(bases.map(|base| Sweep { test, base, position: at, parameter: push, unit, from, to }));
    }
    lines
}

/// What the ends of the parts say.
fn grid_end(line: &Sweep<'_>, found: &[SweepOutcome]) -> MarginEnd {
    let first = found.iter().zip(0..).find_map(|(found, part)| found.err().map(|beyond| (part, beyond)));
    match first {
        None => MarginEnd::Holds { parts: SWEEP_PARTS },
        Some((0, beyond)) => MarginEnd::None { failure: beyond },
        Some((first, beyond)) => MarginEnd::Boundary {
            passes_at: line.value(first - 1),
            fails_at: line.value(first),
            failure: beyond,
            is_monotone: !found.iter().skip(first).any(Result::is_ok),
            parts: SWEEP_PARTS,
        },
    }
}

/// Halves every part with a boundary.
fn bisect(margin_ends: &mut [MarginEnd], lines: &[Sweep<'_>], criterion: Criterion, driven: &ControllerSetup<'_>) {
    let middle = |(line, end): (usize, &MarginEnd)| match end {
        MarginEnd::Boundary { passes_at, fails_at, .. } => Some((line, 0.5 * (passes_at + fails_at))),
        MarginEnd::None { .. } | MarginEnd::Holds { .. } => None,
    };
    let middles: Vec<_> = margin_ends.iter().enumerate().filter_map(middle).collect();
    let at_middles = evaluate(lines, &middles, criterion, driven);
    for ((line, middle), found) in middles.into_iter().zip(at_middles) {
        let Some(MarginEnd::Boundary { passes_at, fails_at, failure: beyond, .. }) = margin_ends.get_mut(line) else {
            continue;
        };
        match found {
            Ok(()) => *passes_at = middle,
            Err(found) => (*fails_at, *beyond) = (middle, found),
        }
    }
}

/// What the test does at values of lines.
fn evaluate(
    lines: &[Sweep<'_>],
    values: &[(usize, f64)],
    criterion: Criterion,
    driven: &ControllerSetup<'_>,
) -> Vec<SweepOutcome> {
    let scenario = |&(line, value): &(usize, f64)| {
        let line: &Sweep<'_> = lines.get(line)?;
        line.test.scenario("margin", "", &with_value(&line.base, line.position, value)).ok()
    };
    let scenarios: Vec<_> = values.iter().map(scenario).collect();
    let valid: Vec<_> = scenarios.iter().flatten().cloned().collect();
    let mut seen = driven.run_scenarios(criterion, &valid).into_iter();
    let found = |is_valid: bool| match is_valid.then(|| seen.next()).flatten().map(|seen| seen.verdict) {
        Some(TestVerdict::Passed) => Ok(()),
        Some(TestVerdict::Failed { .. } | TestVerdict::ControllerFailed { .. }) => Err(SweepFailure::Fails),
        Some(TestVerdict::Refused { .. }) | None => Err(SweepFailure::Refused),
    };
    scenarios.iter().map(Option::is_some).map(found).collect()
}
