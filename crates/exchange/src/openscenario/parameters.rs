//! Parameters: declarations, constraints, and the expressions that use them.

use std::collections::{BTreeMap, HashMap};

use super::error::ScenarioImportError;
use super::limits::{MAX_PARAMETERS, MAX_VALUE_BYTES, ensure_at_most};
use super::xml::Node;
use crumple_core::digits::format_compact;

/// Maximum depth of parentheses in an expression.
const MAX_DEPTH: usize = 50;

/// Values of parameters by name.
#[derive(Debug, Default, Clone)]
pub(super) struct Parameters(BTreeMap<String, DeclaredParameter>);

#[derive(Debug, Clone)]
struct DeclaredParameter {
    text: String,
    /// The value of a number, which expressions may use many times.
    number: Option<f64>,
}

impl Parameters {
    /// Reads `ParameterDeclarations`; `assigned` replaces the declared values.
    pub(super) fn declare(
        declarations: Option<Node<'_>>,
        assigned: &[(String, String)],
    ) -> Result<Self, ScenarioImportError> {
        let mut declared = Self::default();
        let Some(node) = declarations else {
            return Ok(declared);
        };
        node.only(&["ParameterDeclaration"], &[])?;
        let groups = node.children().flat_map(Node::children);
        let count = node.children().count()
            + groups
                .map(|group| 1 + group.children().count())
                .sum::<usize>();
        ensure_at_most(node, count, MAX_PARAMETERS, "parameters and constraints")?;
        ensure_at_most(node, assigned.len(), MAX_PARAMETERS, "assigned parameters")?;
        let mut values: HashMap<&str, &str> = HashMap::new();
        for (name, value) in assigned {
            values.entry(name).or_insert(value);
        }
        for one in node.children() {
            one.only(&["ConstraintGroup"], &["name", "parameterType", "value"])?;
            let name = one.text("name")?;
            let text = match values.get(name.as_str()) {
                Some(value) => (*value).to_owned(),
                None => Node {
                    parameters: &declared,
                    ..one
                }
                .text("value")?,
            };
            if text.len() > MAX_VALUE_BYTES {
                return Err(one.refuse(format!(
                    "the value of `{name}` has more than {MAX_VALUE_BYTES} bytes"
                )));
            }
            let number = text.trim().parse().ok();
            declared.0.insert(name, DeclaredParameter { text, number });
        }
        for one in node.children() {
            let one = Node {
                parameters: &declared,
                ..one
            };
            let (parameter, value) = (
                one.text("name")?,
                declared.get(one.raw("name").unwrap_or_default()),
            );
            let value = value.unwrap_or_default().to_owned();
            let mut is_allowed = one.children().next().is_none();
            for group in one.children() {
                group.only(&["ValueConstraint"], &[])?;
                let mut holds = true;
                for constraint in group.children() {
                    constraint.only(&[], &["rule", "value"])?;
                    holds &= compare(
                        &value,
                        &constraint.text("rule")?,
                        &constraint.text("value")?,
                    )
                    .map_err(|why| constraint.refuse(why))?;
                }
                is_allowed |= holds;
            }
            if !is_allowed {
                let (path, line) = (one.element.path.to_path_buf(), one.element.line);
                return Err(ScenarioImportError::Constraint {
                    path,
                    line,
                    parameter,
                    value,
                });
            }
        }
        Ok(declared)
    }

    pub(super) fn contains(&self, name: &str) -> bool {
        self.0.contains_key(name)
    }

    pub(super) fn get(&self, name: &str) -> Option<&str> {
        self.0.get(name).map(|value| value.text.as_str())
    }

    /// Returns the value of an attribute: the text, a parameter `$name`, or an expression `${...}`.
    pub(super) fn resolve(&self, raw: &str) -> Result<String, String> {
        let Some(reference) = raw
            .trim()
            .strip_prefix('$')
            .filter(|_| raw.starts_with('$'))
        else {
            return Ok(raw.to_owned());
        };
        if let Some(expression) = reference
            .strip_prefix('{')
            .and_then(|rest| rest.strip_suffix('}'))
        {
            if expression.len() > MAX_VALUE_BYTES {
                return Err(format!(
                    "an expression has more than {MAX_VALUE_BYTES} bytes"
                ));
            }
            let mut parser = ExpressionParser {
                rest: expression,
                parameters: self,
                depth: 0,
            };
            let value = parser.sum()?;
            parser.skip_blanks();
            return match parser.rest {
                "" if value.is_finite() => Ok(format_compact(value)),
                "" => Err(format!("`{raw}` is not a finite number")),
                rest => Err(format!("`{rest}` is not supported in an expression")),
            };
        }
        self.get(reference)
            .map(str::to_owned)
            .ok_or_else(|| format!("there is no parameter `{reference}`"))
    }
}

/// Reads a parameter and its value.
pub(super) fn read_assignment(node: Node<'_>) -> Result<(String, String), ScenarioImportError> {
    node.only(&[], &["parameterRef", "value"])?;
    Ok((node.text("parameterRef")?, node.text("value")?))
}

fn compare(value: &str, rule: &str, other: &str) -> Result<bool, String> {
    let numbers = value
        .trim()
        .parse::<f64>()
        .ok()
        .zip(other.trim().parse::<f64>().ok());
    let is_equal = numbers.map_or(value == other, |(a, b)| a == b);
    match (rule, numbers) {
        ("equalTo", _) => Ok(is_equal),
        ("notEqualTo", _) => Ok(!is_equal),
        ("greaterThan", Some((a, b))) => Ok(a > b),
        ("lessThan", Some((a, b))) => Ok(a < b),
        ("greaterOrEqual", Some((a, b))) => Ok(a >= b),
        ("lessOrEqual", Some((a, b))) => Ok(a <= b),
        _ => Err(format!(
            "cannot compare `{value}` and `{other}` by the rule `{rule}`"
        )),
    }
}

/// A recursive descent parser of arithmetic expressions.
struct ExpressionParser<'a> {
    rest: &'a str,
    parameters: &'a Parameters,
    depth: usize,
}

impl ExpressionParser<'_> {
    fn skip_blanks(&mut self) {
        self.rest = self.rest.trim_start();
    }

    fn take(&mut self, letter: char) -> bool {
        self.skip_blanks();
        let rest = self.rest.strip_prefix(letter);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }

    fn take_while(&mut self, accepts: impl Fn(char) -> bool) -> &str {
        let end = self
            .rest
            .find(|letter| !accepts(letter))
            .unwrap_or(self.rest.len());
        let (taken, rest) = self.rest.split_at(end);
        self.rest = rest;
        taken
    }

    fn sum(&mut self) -> Result<f64, String> {
        self.chain(&['+', '-'], |parser| {
            parser.chain(&['*', '/', '%'], Self::factor)
        })
    }

    /// Parses values between operators of one precedence.
    fn chain(
        &mut self,
        operators: &[char],
        value: impl Fn(&mut Self) -> Result<f64, String>,
    ) -> Result<f64, String> {
        let mut result = value(self)?;
        while let Some(operator) = operators.iter().find(|operator| self.take(**operator)) {
            let other = value(self)?;
            result = match operator {
                '+' => result + other,
                '-' => result - other,
                '*' => result * other,
                '/' => result / other,
                _ => result % other,
            };
        }
        Ok(result)
    }

    fn factor(&mut self) -> Result<f64, String> {
        self.depth += 1;
        if self.depth > MAX_DEPTH {
            return Err(format!("the expression is nested deeper than {MAX_DEPTH}"));
        }
        let value = if self.take('-') {
            -self.factor()?
        } else if self.take('(') {
            self.closed_list()?.pop().ok_or("an empty expression")?
        } else if self.take('$') {
            let name = self
                .take_while(|letter| letter.is_alphanumeric() || letter == '_')
                .to_owned();
            let value = self
                .parameters
                .0
                .get(&name)
                .ok_or_else(|| format!("there is no parameter `{name}`"))?;
            value.number.ok_or_else(|| {
                format!("the parameter `{name}` = `{}` is not a number", value.text)
            })?
        } else if self
            .rest
            .starts_with(|letter: char| letter.is_ascii_alphabetic())
        {
            let name = self
                .take_while(|letter| letter.is_ascii_alphanumeric())
                .to_owned();
            let values = if self.take('(') {
                self.closed_list()?
            } else {
                Vec::new()
            };
            match (name.as_str(), values.as_slice()) {
                ("round", [a]) => a.round(),
                ("floor", [a]) => a.floor(),
                ("ceil", [a]) => a.ceil(),
                ("sqrt", [a]) => a.sqrt(),
                ("abs", [a]) => a.abs(),
                ("sign", [a]) => f64::from(i8::from(*a > 0.0) - i8::from(*a < 0.0)),
                ("pow", [a, b]) => libm::pow(*a, *b),
                ("min", [a, b]) => a.min(*b),
                ("max", [a, b]) => a.max(*b),
                _ => {
                    return Err(format!(
                        "`{name}` with {} values is not supported in an expression",
                        values.len()
                    ));
                }
            }
        } else {
            let digits = self
                .take_while(|letter| letter.is_ascii_digit() || letter == '.')
                .to_owned();
            let mut number = digits;
            if self.rest.starts_with(['e', 'E']) {
                number += self.take_while(|letter| {
                    matches!(letter, 'e' | 'E' | '+' | '-') || letter.is_ascii_digit()
                });
            }
            number
                .parse()
                .map_err(|_| format!("a number was expected before `{}`", self.rest))?
        };
        self.depth -= 1;
        Ok(value)
    }

    fn closed_list(&mut self) -> Result<Vec<f64>, String> {
        let mut values = vec![self.sum()?];
        while self.take(',') {
            values.push(self.sum()?);
        }
        if self.take(')') {
            Ok(values)
        } else {
            Err("a parenthesis is not closed".to_owned())
        }
    }
}
