//! Margins of a test: the largest change of a parameter that still passes.

use serde::{Deserialize, Serialize};

use super::parameter::{ParameterKind, ParameterUnit};
use super::result::TestVerdict;
use super::run::{ControllerSetup, Criterion};
use super::spec::{TestSpec, with_value};

/// Number of equal intervals of a sweep; the test is run at their ends.
const SWEEP_PARTS: usize = 16;

/// Number of bisections of the interval with the first failure: to 1/2048 of the sweep.
const BISECTIONS: usize = 7;

/// Margin of a test in one parameter, with the others fixed.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Margin {
    /// Parameter that is varied.
    #[serde(alias = "push")]
    pub parameter: ParameterKind,
    /// Unit of all values of the margin.
    pub unit: ParameterUnit,
    /// First value: the value of the grid that is nearest to `to`.
    pub from: f64,
    /// Last value.
    pub to: f64,
    /// Description of the fixed parameters.
    #[serde(alias = "held")]
    pub fixed_parameters: String,
    /// End of the margin.
    pub end: MarginEnd,
}

/// End of a margin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum MarginEnd {
    /// The test does not pass at the first value.
    None {
        /// Outcome there.
        #[serde(alias = "beyond")]
        failure: SweepFailure,
    },
    /// The test passes at the ends of all intervals; values between them were not run.
    Holds {
        /// Number of intervals.
        parts: usize,
    },
    /// The test passes at one value and does not at the next; both were run.
    Boundary {
        /// Last value that passes.
        passes_at: f64,
        /// First value that does not pass.
        fails_at: f64,
        /// Outcome there.
        #[serde(alias = "beyond")]
        failure: SweepFailure,
        /// True if no later end of an interval passes; otherwise this is only the first failure.
        is_monotone: bool,
        /// Number of intervals.
        parts: usize,
    },
}

/// Outcome of a test that does not pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SweepFailure {
    /// A collision, or no valid answer of the controller.
    Fails,
    /// The test cannot be run, for example because a shield knows no safe command.
    Refused,
}

type SweepOutcome = Result<(), SweepFailure>;

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
    fn value(&self, part: usize) -> f64 {
        self.from + (self.to - self.from) * (part as f64 / SWEEP_PARTS as f64)
    }
}

/// Finds the margins of a test: one per direction and combination of the other parameters.
pub(super) fn find_margins(
    test: &TestSpec,
    criterion: Criterion,
    driven: &ControllerSetup<'_>,
) -> Vec<Margin> {
    let lines = sweeps(test);
    let ends: Vec<(usize, f64)> = (0..lines.len())
        .flat_map(|line| (0..=SWEEP_PARTS).map(move |part| (line, part)))
        .map(|(line, part)| (line, lines[line].value(part)))
        .collect();
    let at_ends = evaluate(&lines, &ends, criterion, driven);
    let mut margin_ends: Vec<MarginEnd> = at_ends
        .chunks(SWEEP_PARTS + 1)
        .zip(&lines)
        .map(|(found, line)| grid_end(line, found))
        .collect();
    for _ in 0..BISECTIONS {
        bisect(&mut margin_ends, &lines, criterion, driven);
    }
    let margin = |(line, end): (&Sweep<'_>, MarginEnd)| Margin {
        parameter: line.parameter,
        unit: line.unit,
        from: line.from,
        to: line.to,
        fixed_parameters: line
            .test
            .describe_point_without(&line.base, Some(line.position)),
        end,
    };
    lines.iter().zip(margin_ends).map(margin).collect()
}

fn sweeps(test: &TestSpec) -> Vec<Sweep<'_>> {
    let mut lines: Vec<Sweep<'_>> = Vec::new();
    for margin in &test.margins {
        let Some((at, figure)) = test.find_parameter(margin.parameter) else {
            continue;
        };
        let (Some(&first), Some(&last)) = (figure.values.first(), figure.values.last()) else {
            continue;
        };
        let from = if margin.to > last { last } else { first };
        let bases = test
            .grid()
            .into_iter()
            .filter(|point| point.get(at) == Some(&from));
        let (push, unit, to) = (margin.parameter, figure.unit, margin.to);
        lines.extend(bases.map(|base| Sweep {
            test,
            base,
            position: at,
            parameter: push,
            unit,
            from,
            to,
        }));
    }
    lines
}

fn grid_end(line: &Sweep<'_>, found: &[SweepOutcome]) -> MarginEnd {
    let first = found
        .iter()
        .zip(0..)
        .find_map(|(found, part)| found.err().map(|beyond| (part, beyond)));
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

fn bisect(
    margin_ends: &mut [MarginEnd],
    lines: &[Sweep<'_>],
    criterion: Criterion,
    driven: &ControllerSetup<'_>,
) {
    let middle = |(line, end): (usize, &MarginEnd)| match end {
        MarginEnd::Boundary {
            passes_at,
            fails_at,
            ..
        } => Some((line, 0.5 * (passes_at + fails_at))),
        MarginEnd::None { .. } | MarginEnd::Holds { .. } => None,
    };
    let middles: Vec<_> = margin_ends.iter().enumerate().filter_map(middle).collect();
    let at_middles = evaluate(lines, &middles, criterion, driven);
    for ((line, middle), found) in middles.into_iter().zip(at_middles) {
        let Some(MarginEnd::Boundary {
            passes_at,
            fails_at,
            failure: beyond,
            ..
        }) = margin_ends.get_mut(line)
        else {
            continue;
        };
        match found {
            Ok(()) => *passes_at = middle,
            Err(found) => (*fails_at, *beyond) = (middle, found),
        }
    }
}

fn evaluate(
    lines: &[Sweep<'_>],
    values: &[(usize, f64)],
    criterion: Criterion,
    driven: &ControllerSetup<'_>,
) -> Vec<SweepOutcome> {
    let scenario = |&(line, value): &(usize, f64)| {
        let line: &Sweep<'_> = lines.get(line)?;
        line.test
            .scenario("margin", "", &with_value(&line.base, line.position, value))
            .ok()
    };
    let scenarios: Vec<_> = values.iter().map(scenario).collect();
    let valid: Vec<_> = scenarios.iter().flatten().cloned().collect();
    let mut seen = driven.run_scenarios(criterion, &valid).into_iter();
    let found = |is_valid: bool| match is_valid
        .then(|| seen.next())
        .flatten()
        .map(|seen| seen.verdict)
    {
        Some(TestVerdict::Passed) => Ok(()),
        Some(TestVerdict::Refused { .. }) | None => Err(SweepFailure::Refused),
        Some(_) => Err(SweepFailure::Fails),
    };
    scenarios.iter().map(Option::is_some).map(found).collect()
}
