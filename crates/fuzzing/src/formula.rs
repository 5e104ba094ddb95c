//! Generation of STL formulas from bytes.

use crumple_measure::stl::{ComparisonOp, Formula, FormulaError, LinearPredicate, TimeWindow};
use crumple_testing::generator::Choices;

const MAX_DEPTH: u32 = 3;

/// Reads a formula over some signals, with windows of whole steps.
///
/// # Errors
/// [`FormulaError`] if the name of a signal cannot be written in a formula.
pub fn formula_from_bytes(
    bytes: &[u8],
    names: &[&str],
    step_s: f64,
) -> Result<Formula, FormulaError> {
    FormulaReader {
        choices: Choices::new(bytes),
        names,
        step_s,
    }
    .formula(MAX_DEPTH)
}

struct FormulaReader<'a> {
    choices: Choices<'a>,
    names: &'a [&'a str],
    step_s: f64,
}

impl FormulaReader<'_> {
    fn formula(&mut self, depth: u32) -> Result<Formula, FormulaError> {
        let kind = if depth == 0 {
            0
        } else {
            self.choices.byte() % 8
        };
        Ok(match kind {
            0 => Formula::Compare(self.comparison()?),
            1 => Formula::Not(self.boxed(depth)?),
            2 => Formula::And(self.boxed(depth)?, self.boxed(depth)?),
            3 => Formula::Or(self.boxed(depth)?, self.boxed(depth)?),
            4 => Formula::Implies(self.boxed(depth)?, self.boxed(depth)?),
            5 => Formula::Always(self.window()?, self.boxed(depth)?),
            6 => Formula::Eventually(self.window()?, self.boxed(depth)?),
            _ => Formula::Until(self.boxed(depth)?, self.window()?, self.boxed(depth)?),
        })
    }

    fn boxed(&mut self, depth: u32) -> Result<Box<Formula>, FormulaError> {
        self.formula(depth - 1).map(Box::new)
    }

    fn comparison(&mut self) -> Result<LinearPredicate, FormulaError> {
        let relations = [
            ComparisonOp::Above,
            ComparisonOp::AtLeast,
            ComparisonOp::Below,
            ComparisonOp::AtMost,
        ];
        let relation = self
            .choices
            .choose(&relations)
            .unwrap_or(ComparisonOp::Above);
        let name = self.choices.choose(self.names).unwrap_or("x");
        let subtrahend = self.choices.choose(self.names).unwrap_or("x");
        let weight = self.choices.around(1.0, [-2.0, 2.0]);
        let weight = if weight == 0.0 { 1.0 } else { weight };
        let bound = self.choices.around(0.0, [-30.0, 30.0]);
        let single = name == subtrahend || self.choices.chance(128);
        let terms = [(weight, name.to_owned()), (-1.0, subtrahend.to_owned())];
        LinearPredicate::new(
            terms.into_iter().take(if single { 1 } else { 2 }),
            relation,
            bound,
        )
    }

    fn window(&mut self) -> Result<TimeWindow, FormulaError> {
        let first = self.choices.byte() % 12;
        let more = self.choices.byte();
        if more == 0 {
            return Ok(TimeWindow::ALL);
        }
        let [from_s, to_s] = [first, first + more % 25].map(|steps| f64::from(steps) * self.step_s);
        TimeWindow::new(from_s, to_s)
    }
}
