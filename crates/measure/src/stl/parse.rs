//! Parser: text to formulas, by recursive descent.

use std::str::FromStr;

use super::formula::{Formula, FormulaError, LinearPredicate, TimeWindow};
use super::lex::{Symbol, Token, tokenize};

/// A syntax error with its column.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("column {column}: {problem}")]
pub struct FormulaParseError {
    /// Column, in characters from 1.
    pub column: usize,
    /// Problem of the text.
    pub problem: SyntaxProblem,
}

/// A problem of the text of a formula.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SyntaxProblem {
    /// A character without a meaning.
    #[error("`{found}` has no meaning in a formula: {OPERATORS}")]
    Character {
        /// Character found.
        found: char,
    },
    /// A number that is not finite.
    #[error("`{found}` is not a finite number")]
    Number {
        /// Text of the number.
        found: String,
    },
    /// A word in place of an operator.
    #[error("`{word}` is not an operator: {OPERATORS}")]
    UnknownOperator {
        /// Word found.
        word: String,
    },
    /// An unexpected token.
    #[error("expected {expected}, found {found}")]
    Expected {
        /// Expected token.
        expected: &'static str,
        /// Token found.
        found: String,
    },
    /// A sum in place of a formula.
    #[error(
        "this is a number or a sum of signals, not a formula; compare it with a number, as in `gap > 2`; {OPERATORS}"
    )]
    SumNotFormula,
    /// A formula in place of a sum.
    #[error("this is a formula, and a sum of signals is needed")]
    FormulaNotSum,
    /// A product of signals.
    #[error("only a product with a number or a quotient by one is allowed")]
    NotAffine,
    /// Two comparisons or two untils in a row.
    #[error("two in a row are ambiguous: use `and` or parentheses")]
    Chained,
    /// An invalid part.
    #[error("{0}")]
    Part(#[from] FormulaError),
    /// A text that is nested too deeply or too long.
    #[error("more than {limit} {what}")]
    TooLong {
        /// Limit.
        limit: usize,
        /// Unit of the limit.
        what: &'static str,
    },
}

/// All operators, for errors.
const OPERATORS: &str = "the operators are `not`, `and`, `or`, `implies`, `always[a,b]`, `eventually[a,b]`, \
    `until[a,b]`, `<`, `<=`, `>` and `>=`; there is no equality, use `<=` and `>=`";

/// Maximum depth of nesting, which bounds the recursion.
const MAX_DEPTH: usize = 64;
/// Maximum number of tokens; chains of operators make deep formulas too.
const MAX_TOKENS: usize = 4000;
/// Maximum number of parentheses: a printed formula has at most two for each other token.
const MAX_PARENTHESES: usize = 2 * MAX_TOKENS;

impl FromStr for Formula {
    type Err = FormulaParseError;

    fn from_str(text: &str) -> Result<Self, FormulaParseError> {
        let tokens = tokenize(text)?;
        let mut parentheses = 0;
        for (index, (column, token)) in tokens.iter().enumerate() {
            if matches!(token, Token::Symbol(Symbol::Open | Symbol::Close)) {
                parentheses += 1;
            }
            let other_tokens = index + 1 - parentheses;
            if other_tokens > MAX_TOKENS || parentheses > MAX_PARENTHESES {
                let what = "words and signs, or more than twice as many parentheses";
                return Err(FormulaParseError {
                    column: *column,
                    problem: SyntaxProblem::TooLong {
                        limit: MAX_TOKENS,
                        what,
                    },
                });
            }
        }
        let mut parser = Parser {
            tokens: &tokens,
            next: 0,
            depth: 0,
            operand_at: None,
        };
        let whole = parser.parse_implies()?;
        let formula = parser.finish_formula(whole)?;
        parser.expect_end()?;
        Ok(formula)
    }
}

/// Returns the column, in characters from 1, of the first use of a signal.
pub(crate) fn signal_column(text: &str, name: &str) -> Option<usize> {
    tokenize(text)
        .ok()?
        .into_iter()
        .find(|(_, token)| matches!(token, Token::Name(word) if word == name))
        .map(|(column, _)| column)
}

struct ParsedExpr {
    column: usize,
    kind: ExprKind,
}

enum ExprKind {
    Formula(Formula),
    Sum(LinearSum),
}

/// A sum of weighted signals and a constant.
struct LinearSum {
    terms: Vec<(f64, String)>,
    constant: f64,
}

impl LinearSum {
    fn from_constant(constant: f64) -> Self {
        Self {
            terms: Vec::new(),
            constant,
        }
    }

    fn from_signal(name: String) -> Self {
        Self {
            terms: vec![(1.0, name)],
            constant: 0.0,
        }
    }

    /// Applies a linear function to each weight and the constant.
    fn map(self, linear: impl Fn(f64) -> f64) -> Self {
        Self {
            terms: self
                .terms
                .into_iter()
                .map(|(weight, name)| (linear(weight), name))
                .collect(),
            constant: linear(self.constant),
        }
    }

    /// Adds `sign` times another sum.
    fn add(&mut self, sign: f64, summand: Self) {
        let terms = summand.terms.into_iter();
        self.terms
            .extend(terms.map(|(weight, name)| (sign * weight, name)));
        self.constant += sign * summand.constant;
    }
}

impl ParsedExpr {
    fn into_formula(self) -> Result<Formula, FormulaParseError> {
        match self.kind {
            ExprKind::Formula(formula) => Ok(formula),
            ExprKind::Sum(_) => Err(FormulaParseError {
                column: self.column,
                problem: SyntaxProblem::SumNotFormula,
            }),
        }
    }

    fn into_sum(self) -> Result<LinearSum, FormulaParseError> {
        match self.kind {
            ExprKind::Sum(sum) => Ok(sum),
            ExprKind::Formula(_) => Err(FormulaParseError {
                column: self.column,
                problem: SyntaxProblem::FormulaNotSum,
            }),
        }
    }
}

struct Parser<'a> {
    tokens: &'a [(usize, Token)],
    next: usize,
    depth: usize,
    /// Index of the token after the latest unary operator. A parenthesis at this index does not increase the depth.
    operand_at: Option<usize>,
}

impl Parser<'_> {
    fn peek(&self) -> (usize, &Token) {
        self.tokens
            .get(self.next)
            .or(self.tokens.last())
            .map_or((1, &Token::End), |(column, token)| (*column, token))
    }

    fn eat(&mut self, symbol: Symbol) -> bool {
        let is_next = *self.peek().1 == Token::Symbol(symbol);
        self.next += usize::from(is_next);
        is_next
    }

    fn token(&self, index: usize) -> Option<&Token> {
        self.tokens.get(index).map(|(_, token)| token)
    }

    fn fail_expected<T>(&self, expected: &'static str) -> Result<T, FormulaParseError> {
        let (column, token) = self.peek();
        Err(FormulaParseError {
            column,
            problem: SyntaxProblem::Expected {
                expected,
                found: token.to_string(),
            },
        })
    }

    /// Returns the error for a token in place of an operator, a parenthesis or the end.
    fn fail_expected_operator<T>(&self, expected: &'static str) -> Result<T, FormulaParseError> {
        let second_last = self.next.checked_sub(2);
        let begins_operand = match second_last.and_then(|index| self.token(index)) {
            Some(Token::Symbol(symbol)) => symbol.precedes_formula(),
            Some(_) => false,
            None => true,
        };
        // The unknown operator comes first in `globally x > 1` and `globally[0,5] ...`, and second in `x above 1`.
        let is_before = begins_operand
            && match self.token(self.next) {
                Some(Token::Symbol(symbol)) => symbol.begins_operand(),
                Some(Token::Name(_)) => {
                    matches!(self.token(self.next + 1), Some(Token::Symbol(symbol)) if *symbol != Symbol::Open)
                }
                _ => false,
            };
        let word = if is_before {
            self.next.checked_sub(1)
        } else {
            Some(self.next)
        };
        match word.and_then(|index| self.tokens.get(index)) {
            Some((column, Token::Name(word))) => Err(FormulaParseError {
                column: *column,
                problem: SyntaxProblem::UnknownOperator { word: word.clone() },
            }),
            _ => self.fail_expected(expected),
        }
    }

    fn expect(&mut self, symbol: Symbol, expected: &'static str) -> Result<(), FormulaParseError> {
        if self.eat(symbol) {
            Ok(())
        } else {
            self.fail_expected(expected)
        }
    }

    fn expect_end(&self) -> Result<(), FormulaParseError> {
        if *self.peek().1 == Token::End {
            Ok(())
        } else {
            self.fail_expected_operator("an operator or the end")
        }
    }

    fn parse_implies(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        // Right-associative without recursion: folds the chain from its end.
        let mut chain = vec![self.parse_or()?];
        while self.eat(Symbol::Implies) {
            chain.push(self.parse_or()?);
        }
        let mut parts = chain.into_iter().rev();
        let Some(mut whole) = parts.next() else {
            return self.fail_expected("a formula");
        };
        for part in parts {
            let column = part.column;
            let meaning = Formula::Implies(
                Box::new(part.into_formula()?),
                Box::new(whole.into_formula()?),
            );
            whole = ParsedExpr {
                column,
                kind: ExprKind::Formula(meaning),
            };
        }
        Ok(whole)
    }

    fn parse_or(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        self.parse_chain(Symbol::Or, Self::parse_and, |left, right| {
            Formula::Or(Box::new(left), Box::new(right))
        })
    }

    fn parse_and(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        self.parse_chain(Symbol::And, Self::parse_until, |left, right| {
            Formula::And(Box::new(left), Box::new(right))
        })
    }

    fn parse_chain(
        &mut self,
        symbol: Symbol,
        operand: fn(&mut Self) -> Result<ParsedExpr, FormulaParseError>,
        join: fn(Formula, Formula) -> Formula,
    ) -> Result<ParsedExpr, FormulaParseError> {
        let mut whole = operand(self)?;
        while self.eat(symbol) {
            let column = whole.column;
            let joined = join(whole.into_formula()?, operand(self)?.into_formula()?);
            whole = ParsedExpr {
                column,
                kind: ExprKind::Formula(joined),
            };
        }
        Ok(whole)
    }

    fn parse_until(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let left = self.parse_unary()?;
        if !self.eat(Symbol::Until) {
            return Ok(left);
        }
        let column = left.column;
        let window = self.parse_window()?;
        let right = self.parse_unary()?.into_formula()?;
        self.refuse_another(|symbol| symbol == Symbol::Until)?;
        let until = Formula::Until(Box::new(left.into_formula()?), window, Box::new(right));
        Ok(ParsedExpr {
            column,
            kind: ExprKind::Formula(until),
        })
    }

    fn parse_unary(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let column = self.peek().0;
        let formula = if self.eat(Symbol::Not) {
            Formula::Not(Box::new(self.parse_operand()?))
        } else if self.eat(Symbol::Always) {
            let window = self.parse_window()?;
            Formula::Always(window, Box::new(self.parse_operand()?))
        } else if self.eat(Symbol::Eventually) {
            let window = self.parse_window()?;
            Formula::Eventually(window, Box::new(self.parse_operand()?))
        } else {
            return self.parse_comparison();
        };
        Ok(ParsedExpr {
            column,
            kind: ExprKind::Formula(formula),
        })
    }

    fn parse_operand(&mut self) -> Result<Formula, FormulaParseError> {
        self.operand_at = Some(self.next);
        let operand = self.parse_nested(Self::parse_unary)?;
        self.finish_formula(operand)
    }

    /// Returns the parsed formula. If an operand follows a lone signal, as in `globally x > 1`, the signal is reported
    /// as an unknown operator.
    fn finish_formula(&self, part: ParsedExpr) -> Result<Formula, FormulaParseError> {
        let precedes_operand = match self.peek().1 {
            Token::Name(_) => true,
            Token::Symbol(symbol) => symbol.begins_operand(),
            Token::Number(_) | Token::End => false,
        };
        match part.kind {
            ExprKind::Sum(_) if precedes_operand => self.fail_expected_operator("an operator"),
            _ => part.into_formula(),
        }
    }

    fn parse_nested(
        &mut self,
        inner: fn(&mut Self) -> Result<ParsedExpr, FormulaParseError>,
    ) -> Result<ParsedExpr, FormulaParseError> {
        if self.depth == MAX_DEPTH {
            let problem = SyntaxProblem::TooLong {
                limit: MAX_DEPTH,
                what: "nested operators and parentheses",
            };
            return Err(FormulaParseError {
                column: self.peek().0,
                problem,
            });
        }
        self.depth += 1;
        let part = inner(self);
        self.depth -= 1;
        part
    }

    fn parse_window(&mut self) -> Result<TimeWindow, FormulaParseError> {
        let column = self.peek().0;
        if !self.eat(Symbol::WindowOpen) {
            return Ok(TimeWindow::ALL);
        }
        let from_s = self.parse_seconds()?;
        self.expect(Symbol::Comma, "`,`")?;
        let to_s = if self.eat(Symbol::Infinity) {
            f64::INFINITY
        } else {
            self.parse_seconds()?
        };
        self.expect(Symbol::WindowClose, "`]`")?;
        TimeWindow::new(from_s, to_s).map_err(|error| FormulaParseError {
            column,
            problem: error.into(),
        })
    }

    fn parse_seconds(&mut self) -> Result<f64, FormulaParseError> {
        match self.peek().1 {
            &Token::Number(seconds) => {
                self.next += 1;
                Ok(seconds)
            }
            _ => self.fail_expected("a number of seconds, not negative"),
        }
    }

    fn parse_comparison(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let left = self.parse_sum()?;
        let &Token::Symbol(Symbol::Compare(relation)) = self.peek().1 else {
            return Ok(left);
        };
        self.next += 1;
        let column = left.column;
        let right = self.parse_sum()?;
        self.refuse_another(|symbol| matches!(symbol, Symbol::Compare(_)))?;
        let left = left.into_sum()?;
        let right = right.into_sum()?;
        let bound = right.constant - left.constant;
        let mut terms = left.terms;
        let subtracted = right.terms.into_iter();
        terms.extend(subtracted.map(|(weight, name)| (-weight, name)));
        let comparison =
            LinearPredicate::new(terms, relation, bound).map_err(|error| FormulaParseError {
                column,
                problem: error.into(),
            })?;
        Ok(ParsedExpr {
            column,
            kind: ExprKind::Formula(Formula::Compare(comparison)),
        })
    }

    fn refuse_another(&self, is_refused: impl Fn(Symbol) -> bool) -> Result<(), FormulaParseError> {
        match self.peek() {
            (column, Token::Symbol(symbol)) if is_refused(*symbol) => Err(FormulaParseError {
                column,
                problem: SyntaxProblem::Chained,
            }),
            _ => Ok(()),
        }
    }

    fn parse_sum(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let mut whole = self.parse_product()?;
        loop {
            let sign = if self.eat(Symbol::Plus) {
                1.0
            } else if self.eat(Symbol::Minus) {
                -1.0
            } else {
                return Ok(whole);
            };
            let column = whole.column;
            let mut sum = whole.into_sum()?;
            sum.add(sign, self.parse_product()?.into_sum()?);
            whole = ParsedExpr {
                column,
                kind: ExprKind::Sum(sum),
            };
        }
    }

    fn parse_product(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let mut whole = self.parse_factor()?;
        loop {
            let divides = self.eat(Symbol::Over);
            if !divides && !self.eat(Symbol::Times) {
                return Ok(whole);
            }
            let ParsedExpr { column, .. } = whole;
            let right_column = self.peek().0;
            let not_affine = FormulaParseError {
                column: right_column,
                problem: SyntaxProblem::NotAffine,
            };
            let left = whole.into_sum()?;
            let right = self.parse_factor()?.into_sum()?;
            let product = if right.terms.is_empty() {
                let number = right.constant;
                left.map(|x| if divides { x / number } else { x * number })
            } else if left.terms.is_empty() && !divides {
                let number = left.constant;
                right.map(|x| x * number)
            } else {
                return Err(not_affine);
            };
            whole = ParsedExpr {
                column,
                kind: ExprKind::Sum(product),
            };
        }
    }

    fn parse_factor(&mut self) -> Result<ParsedExpr, FormulaParseError> {
        let (column, token) = self.peek();
        let kind = match token {
            Token::Number(number) => {
                let number = *number;
                self.next += 1;
                ExprKind::Sum(LinearSum::from_constant(number))
            }
            Token::Name(name) => {
                let name = name.clone();
                self.next += 1;
                ExprKind::Sum(LinearSum::from_signal(name))
            }
            Token::Symbol(Symbol::Minus) => {
                self.next += 1;
                let negated = self.parse_nested(Self::parse_factor)?.into_sum()?;
                ExprKind::Sum(negated.map(|x| -x))
            }
            Token::Symbol(Symbol::Open) => self.parse_parentheses()?,
            _ => return self.fail_expected("a formula, a signal or a number"),
        };
        Ok(ParsedExpr { column, kind })
    }

    fn parse_parentheses(&mut self) -> Result<ExprKind, FormulaParseError> {
        let is_operand = self.operand_at == Some(self.next);
        self.next += 1;
        let part = if is_operand {
            self.parse_implies()?
        } else {
            self.parse_nested(Self::parse_implies)?
        };
        if !self.eat(Symbol::Close) {
            return self.fail_expected_operator("an operator or `)`");
        }
        Ok(part.kind)
    }
}
