//! From text to formulas, by recursive descent.

use std::str::FromStr;

use super::formula::{Comparison, Formula, FormulaError, Interval, Relation};
use super::lex::{Symbol, Token, tokens};

/// Why a text is not a formula, and where.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("column {column}: {problem}")]
pub struct ParseError {
    /// Where, counted in characters from 1.
    pub column: usize,
    /// What is wrong.
    pub problem: SyntaxProblem,
}

/// What can be wrong with the text of a formula.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SyntaxProblem {
    /// A character that has no meaning here.
    #[error("`{found}` has no meaning in a formula: {OPERATORS}")]
    Character {
        /// The character.
        found: char,
    },
    /// Digits that are not a finite number.
    #[error("`{found}` is not a finite number")]
    Number {
        /// The text.
        found: String,
    },
    /// A word where only an operator can stand.
    #[error("`{word}` is not an operator: {OPERATORS}")]
    UnknownOperator {
        /// The word.
        word: String,
    },
    /// Something else should stand here.
    #[error("expected {expected}, found {found}")]
    Expected {
        /// What should stand here.
        expected: &'static str,
        /// What does.
        found: String,
    },
    /// A sum where a formula is needed.
    #[error(
        "this is a number or a sum of signals, not a formula; compare it with a number, as in `gap > 2`. {OPERATORS}"
    )]
    SumNotFormula,
    /// A formula where a sum is needed.
    #[error("this is a formula, and a sum of signals is needed")]
    FormulaNotSum,
    /// A product of signals.
    #[error("only a product with a number or a quotient by one is allowed")]
    NotAffine,
    /// Two comparisons or two untils in a row.
    #[error("two in a row are ambiguous: use `and` or parentheses")]
    Chained,
    /// A part that cannot be built.
    #[error("{0}")]
    Part(#[from] FormulaError),
    /// Nested too deeply or too long.
    #[error("more than {limit} {what}")]
    TooLong {
        /// How many are allowed.
        limit: usize,
        /// Of what.
        what: &'static str,
    },
}

/// All operators, for errors.
const OPERATORS: &str = "the operators are `not`, `and`, `or`, `implies`, `always[a,b]`, `eventually[a,b]`, `until[a,b]`, `<`, `<=`, `>` and `>=`; there is no equality, use `<=` and `>=`";

/// Recursion is bounded, so that no text can exhaust the stack.
const MAX_DEPTH: usize = 64;
/// Chains of operators make deep formulas, too.
const MAX_TOKENS: usize = 4000;
/// A printed formula has at most two parentheses for each other token.
const MAX_PARENTHESES: usize = 2 * MAX_TOKENS;

impl FromStr for Formula {
    type Err = ParseError;

    fn from_str(text: &str) -> Result<Self, ParseError> {
        let tokens = tokens(text)?;
        let (mut others, mut parentheses) = (0, 0);
        for (column, token) in &tokens {
            match token {
                Token::Symbol(Symbol::Open | Symbol::Close) => parentheses += 1,
                _ => others += 1,
            }
            if others > MAX_TOKENS || parentheses > MAX_PARENTHESES {
                let what = "words and signs, or more than twice as many parentheses";
                return Err(ParseError {
                    column: *column,
                    problem: SyntaxProblem::TooLong { limit: MAX_TOKENS, what },
                });
            }
        }
        let mut parser = Parser { tokens: &tokens, next: 0, depth: 0, operand_at: None };
        let whole = parser.implies()?;
        let formula = parser.formula(whole)?;
        parser.expect_end()?;
        Ok(formula)
    }
}

/// The column, counted in characters from 1, at which a text first names a signal.
#[must_use]
pub(crate) fn signal_column(text: &str, name: &str) -> Option<usize> {
    let named = |token: &Token| matches!(token, Token::Name(found) if found == name);
    tokens(text).ok()?.into_iter().find(|(_, token)| named(token)).map(|(column, _)| column)
}

/// A part of the text that was understood, and where it starts.
struct Part {
    column: usize,
    meaning: Meaning,
}

enum Meaning {
    Formula(Formula),
    /// A sum of weighted signals and a constant.
    Sum(Vec<(f64, String)>, f64),
}

impl Part {
    fn formula(self) -> Result<Formula, ParseError> {
        match self.meaning {
            Meaning::Formula(formula) => Ok(formula),
            Meaning::Sum(..) => Err(ParseError { column: self.column, problem: SyntaxProblem::SumNotFormula }),
        }
    }

    fn sum(self) -> Result<(Vec<(f64, String)>, f64), ParseError> {
        match self.meaning {
            Meaning::Sum(terms, constant) => Ok((terms, constant)),
            Meaning::Formula(_) => Err(ParseError { column: self.column, problem: SyntaxProblem::FormulaNotSum }),
        }
    }
}

struct Parser<'a> {
    tokens: &'a [(usize, Token)],
    next: usize,
    depth: usize,
    /// The token behind the latest unary operator: a parenthesis there adds no depth to that of the operator.
    operand_at: Option<usize>,
}

impl Parser<'_> {
    fn peek(&self) -> (usize, &Token) {
        self.tokens.get(self.next).or(self.tokens.last()).map_or((1, &Token::End), |(column, token)| (*column, token))
    }

    fn take(&mut self, symbol: Symbol) -> bool {
        let found = *self.peek().1 == Token::Symbol(symbol);
        self.next += usize::from(found);
        found
    }

    fn expected<T>(&self, expected: &'static str) -> Result<T, ParseError> {
        let (column, token) = self.peek();
        Err(ParseError { column, problem: SyntaxProblem::Expected { expected, found: token.to_string() } })
    }

    /// Returns the error about a token that stands where only an operator, a parenthesis or the end can.
    fn expected_operator<T>(&self, expected: &'static str) -> Result<T, ParseError> {
        let token = |index: usize| self.tokens.get(index).map(|(_, token)| token);
        let begins_operand = match self.next.checked_sub(2).and_then(token) {
            Some(Token::Symbol(symbol)) => symbol.precedes_formula(),
            Some(_) => false,
            None => true,
        };
        // `globally x > 1` and `globally[0,5] ...` name the operator first, and `x above 1` names it second.
        let is_before = begins_operand
            && match token(self.next) {
                Some(Token::Symbol(symbol)) => symbol.begins_operand(),
                Some(Token::Name(_)) => {
                    matches!(token(self.next + 1), Some(Token::Symbol(symbol)) if *symbol != Symbol::Open)
                }
                _ => false,
            };
        let word = if is_before { self.next.checked_sub(1) } else { Some(self.next) };
        match word.and_then(|index| self.tokens.get(index)) {
            Some((column, Token::Name(word))) => {
                Err(ParseError { column: *column, problem: SyntaxProblem::UnknownOperator { word: word.clone() } })
            }
            _ => self.expected(expected),
        }
    }

    fn expect(&mut self, symbol: Symbol, expected: &'static str) -> Result<(), ParseError> {
        if self.take(symbol) { Ok(()) } else { self.expected(expected) }
    }

    fn expect_end(&self) -> Result<(), ParseError> {
        if *self.peek().1 == Token::End { Ok(()) } else { self.expected_operator("an operator or the end") }
    }

    fn implies(&mut self) -> Result<Part, ParseError> {
        // Right-associative without recursion: collect the chain, then fold it from its end.
        let mut chain = vec![self.or()?];
        while self.take(Symbol::Implies) {
            chain.push(self.or()?);
        }
        let mut parts = chain.into_iter().rev();
        let Some(mut whole) = parts.next() else { return self.expected("a formula") };
        for part in parts {
            let column = part.column;
            let meaning = Formula::Implies(Box::new(part.formula()?), Box::new(whole.formula()?));
            whole = Part { column, meaning: Meaning::Formula(meaning) };
        }
        Ok(whole)
    }

    fn or(&mut self) -> Result<Part, ParseError> {
        self.chain(Symbol::Or, Self::and, |left, right| Formula::Or(Box::new(left), Box::new(right)))
    }

    fn and(&mut self) -> Result<Part, ParseError> {
        self.chain(Symbol::And, Self::until, |left, right| Formula::And(Box::new(left), Box::new(right)))
    }

    fn chain(
        &mut self,
        symbol: Symbol,
        operand: fn(&mut Self) -> Result<Part, ParseError>,
        join: fn(Formula, Formula) -> Formula,
    ) -> Result<Part, ParseError> {
        let mut whole = operand(self)?;
        while self.take(symbol) {
            let column = whole.column;
            let joined = join(whole.formula()?, operand(self)?.formula()?);
            whole = Part { column, meaning: Meaning::Formula(joined) };
        }
        Ok(whole)
    }

    fn until(&mut self) -> Result<Part, ParseError> {
        let left = self.unary()?;
        if !self.take(Symbol::Until) {
            return Ok(left);
        }
        let column = left.column;
        let window = self.window()?;
        let right = self.unary()?.formula()?;
        self.refuse_another(&[Symbol::Until])?;
        let until = Formula::Until(Box::new(left.formula()?), window, Box::new(right));
        Ok(Part { column, meaning: Meaning::Formula(until) })
    }

    fn unary(&mut self) -> Result<Part, ParseError> {
        let column = self.peek().0;
        let formula = if self.take(Symbol::Not) {
            Formula::Not(Box::new(self.operand()?))
        } else if self.take(Symbol::Always) {
            let window = self.window()?;
            Formula::Always(window, Box::new(self.operand()?))
        } else if self.take(Symbol::Eventually) {
            let window = self.window()?;
            Formula::Eventually(window, Box::new(self.operand()?))
        } else {
            return self.comparison();
        };
        Ok(Part { column, meaning: Meaning::Formula(formula) })
    }

    /// Parses the operand of a unary operator.
    fn operand(&mut self) -> Result<Formula, ParseError> {
        self.operand_at = Some(self.next);
        let operand = self.nested(Self::unary)?;
        self.formula(operand)
    }

    /// Returns the formula that has been parsed. A lone signal before another operand was meant as an operator.
    fn formula(&self, part: Part) -> Result<Formula, ParseError> {
        let precedes_operand = match self.peek().1 {
            Token::Name(_) => true,
            Token::Symbol(symbol) => symbol.begins_operand(),
            Token::Number(_) | Token::End => false,
        };
        match part.meaning {
            Meaning::Sum(..) if precedes_operand => self.expected_operator("an operator"),
            _ => part.formula(),
        }
    }

    fn nested(&mut self, inner: fn(&mut Self) -> Result<Part, ParseError>) -> Result<Part, ParseError> {
        if self.depth == MAX_DEPTH {
            let problem = SyntaxProblem::TooLong { limit: MAX_DEPTH, what: "nested operators and parentheses" };
            return Err(ParseError { column: self.peek().0, problem });
        }
        self.depth += 1;
        let part = inner(self);
        self.depth -= 1;
        part
    }

    fn window(&mut self) -> Result<Interval, ParseError> {
        let column = self.peek().0;
        if !self.take(Symbol::WindowOpen) {
            return Ok(Interval::ALL);
        }
        let from_s = self.seconds()?;
        self.expect(Symbol::Comma, "`,`")?;
        let to_s = if self.take(Symbol::Infinity) { f64::INFINITY } else { self.seconds()? };
        self.expect(Symbol::WindowClose, "`]`")?;
        Interval::new(from_s, to_s).map_err(|error| ParseError { column, problem: error.into() })
    }

    fn seconds(&mut self) -> Result<f64, ParseError> {
        match self.peek().1 {
            &Token::Number(seconds) => {
                self.next += 1;
                Ok(seconds)
            }
            _ => self.expected("a number of seconds, not negative"),
        }
    }

    fn comparison(&mut self) -> Result<Part, ParseError> {
        let left = self.sum()?;
        let Some(relation) = self.relation() else { return Ok(left) };
        let column = left.column;
        let right = self.sum()?;
        self.refuse_another(&[Symbol::Below, Symbol::AtMost, Symbol::Above, Symbol::AtLeast])?;
        let (mut terms, left_constant) = left.sum()?;
        let (subtracted, right_constant) = right.sum()?;
        terms.extend(subtracted.into_iter().map(|(weight, name)| (-weight, name)));
        let comparison = Comparison::new(terms, relation, right_constant - left_constant)
            .map_err(|error| ParseError { column, problem: error.into() })?;
        Ok(Part { column, meaning: Meaning::Formula(Formula::Compare(comparison)) })
    }

    fn relation(&mut self) -> Option<Relation> {
        [
            (Symbol::Below, Relation::Below),
            (Symbol::AtMost, Relation::AtMost),
            (Symbol::Above, Relation::Above),
            (Symbol::AtLeast, Relation::AtLeast),
        ]
        .into_iter()
        .find_map(|(symbol, relation)| self.take(symbol).then_some(relation))
    }

    fn refuse_another(&self, symbols: &[Symbol]) -> Result<(), ParseError> {
        match self.peek() {
            (column, Token::Symbol(symbol)) if symbols.contains(symbol) => {
                Err(ParseError { column, problem: SyntaxProblem::Chained })
            }
            _ => Ok(()),
        }
    }

    fn sum(&mut self) -> Result<Part, ParseError> {
        let mut whole = self.product()?;
        loop {
            let sign = if self.take(Symbol::Plus) {
                1.0
            } else if self.take(Symbol::Minus) {
                -1.0
            } else {
                return Ok(whole);
            };
            let column = whole.column;
            let (mut terms, constant) = whole.sum()?;
            let (added, more) = self.product()?.sum()?;
            terms.extend(added.into_iter().map(|(weight, name)| (sign * weight, name)));
            whole = Part { column, meaning: Meaning::Sum(terms, constant + sign * more) };
        }
    }

    fn product(&mut self) -> Result<Part, ParseError> {
        let mut whole = self.factor()?;
        loop {
            let divides = self.take(Symbol::Over);
            if !divides && !self.take(Symbol::Times) {
                return Ok(whole);
            }
            let Part { column, .. } = whole;
            let right_column = self.peek().0;
            let not_affine = ParseError { column: right_column, problem: SyntaxProblem::NotAffine };
            let (left, right) = (whole.sum()?, self.factor()?.sum()?);
            let ((terms, constant), number) = match (left, right) {
                (sum, (none, number)) if none.is_empty() => (sum, number),
                ((none, number), sum) if none.is_empty() && !divides => (sum, number),
                _ => return Err(not_affine),
            };
            let scaled = |x: f64| if divides { x / number } else { x * number };
            let terms = terms.into_iter().map(|(weight, name)| (scaled(weight), name)).collect();
            whole = Part { column, meaning: Meaning::Sum(terms, scaled(constant)) };
        }
    }

    fn factor(&mut self) -> Result<Part, ParseError> {
        let (column, token) = self.peek();
        let meaning = match token {
            Token::Number(number) => Meaning::Sum(Vec::new(), *number),
            Token::Name(name) => Meaning::Sum(vec![(1.0, name.clone())], 0.0),
            Token::Symbol(Symbol::Minus) => {
                self.next += 1;
                let (terms, constant) = self.nested(Self::factor)?.sum()?;
                let terms = terms.into_iter().map(|(weight, name)| (-weight, name)).collect();
                return Ok(Part { column, meaning: Meaning::Sum(terms, -constant) });
            }
            Token::Symbol(Symbol::Open) => {
                let is_operand = self.operand_at == Some(self.next);
                self.next += 1;
                let part = if is_operand { self.implies()? } else { self.nested(Self::implies)? };
                if !self.take(Symbol::Close) {
                    return self.expected_operator("an operator or `)`");
                }
                return Ok(Part { column, meaning: part.meaning });
            }
            _ => return self.expected("a formula, a signal or a number"),
        };
        self.next += 1;
        Ok(Part { column, meaning })
    }
}
