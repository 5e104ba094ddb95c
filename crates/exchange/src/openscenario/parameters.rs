//! Parameters: declarations, constraints, and the expressions that use them.

use std::collections::{BTreeMap, HashMap};

use super::error::ScenarioImportError;
use super::limits::{MAX_PARAMETERS, MAX_VALUE_BYTES, ensure_at_most};
use super::vocabulary::{Rule, Word as _};
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
        check_counts(node, assigned)?;
        let mut values: HashMap<&str, &str> = HashMap::new();
        for (name, value) in assigned {
            values.entry(name).or_insert(value);
        }
        for declaration in node.children() {
            declared.add(declaration, &values)?;
        }
        for declaration in node.children() {
            declared.check_constraints(declaration)?;
        }
        Ok(declared)
    }

    /// Adds a declared parameter. Its value may refer to those before it.
    fn add(
        &mut self,
        declaration: Node<'_>,
        values: &HashMap<&str, &str>,
    ) -> Result<(), ScenarioImportError> {
        declaration.only(&["ConstraintGroup"], &["name", "parameterType", "value"])?;
        let name = declaration.text("name")?;
        let text = match values.get(name.as_str()) {
            Some(value) => (*value).to_owned(),
            None => Node {
                parameters: self,
                ..declaration
            }
            .text("value")?,
        };
        if text.len() > MAX_VALUE_BYTES {
            return Err(declaration.refuse(format!(
                "the value of `{name}` has more than {MAX_VALUE_BYTES} bytes"
            )));
        }
        let number = text.trim().parse().ok();
        self.0.insert(name, DeclaredParameter { text, number });
        Ok(())
    }

    /// Refuses a value that violates a constraint in each group of its declaration.
    fn check_constraints(&self, declaration: Node<'_>) -> Result<(), ScenarioImportError> {
        let declaration = Node {
            parameters: self,
            ..declaration
        };
        let parameter = declaration.text("name")?;
        let value = self
            .get(declaration.raw("name").unwrap_or_default())
            .unwrap_or_default();
        let mut is_allowed = declaration.children().next().is_none();
        for group in declaration.children() {
            is_allowed |= satisfies_group(value, group)?;
        }
        if is_allowed {
            return Ok(());
        }
        Err(ScenarioImportError::Constraint {
            path: declaration.element.path.to_path_buf(),
            line: declaration.element.line,
            parameter,
            value: value.to_owned(),
        })
    }

    /// Returns these parameters with those that an element declares, whose constraints must hold.
    pub(super) fn extended(&self, declarations: Node<'_>) -> Result<Self, ScenarioImportError> {
        let mut declared = self.clone();
        check_counts(declarations, &[])?;
        for declaration in declarations.children() {
            declared.add(declaration, &HashMap::new())?;
        }
        for declaration in declarations.children() {
            declared.check_constraints(declaration)?;
        }
        Ok(declared)
    }

    /// Returns names and values.
    pub(super) fn iter(&self) -> impl Iterator<Item = (&str, &str)> {
        let parameters = self.0.iter();
        parameters.map(|(name, parameter)| (name.as_str(), parameter.text.as_str()))
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

/// Refuses more declarations with their constraints, or more assignments, than the limit.
fn check_counts(
    declarations: Node<'_>,
    assigned: &[(String, String)],
) -> Result<(), ScenarioImportError> {
    declarations.only(&["ParameterDeclaration"], &[])?;
    let groups = declarations.children().flat_map(Node::children);
    let count = declarations.children().count()
        + groups
            .map(|group| 1 + group.children().count())
            .sum::<usize>();
    let what = "parameters and constraints";
    ensure_at_most(declarations, count, MAX_PARAMETERS, what)?;
    ensure_at_most(
        declarations,
        assigned.len(),
        MAX_PARAMETERS,
        "assigned parameters",
    )
}

/// Returns true if a value satisfies all constraints of a group.
fn satisfies_group(value: &str, group: Node<'_>) -> Result<bool, ScenarioImportError> {
    group.only(&["ValueConstraint"], &[])?;
    let mut holds = true;
    for constraint in group.children() {
        constraint.only(&[], &["rule", "value"])?;
        let rule: Rule = constraint.word("rule")?;
        let limit = constraint.text("value")?;
        holds &= compare(value, rule, &limit).map_err(|reason| constraint.refuse(reason))?;
    }
    Ok(holds)
}

/// Reads a parameter and its value.
pub(super) fn read_assignment(node: Node<'_>) -> Result<(String, String), ScenarioImportError> {
    node.only(&[], &["parameterRef", "value"])?;
    let name = node.raw("parameterRef");
    let name = name.ok_or_else(|| node.refuse("has no attribute `parameterRef`"))?;
    // Some tools write the reference as they would write a value.
    let name = name.strip_prefix('$').unwrap_or(name);
    Ok((name.to_owned(), node.text("value")?))
}

/// Compares two values as numbers, or for equality as truth values or texts.
pub(super) fn compare(value: &str, rule: Rule, limit: &str) -> Result<bool, String> {
    let numbers = value
        .trim()
        .parse::<f64>()
        .ok()
        .zip(limit.trim().parse::<f64>().ok());
    let is_equal = match (numbers, truth(value), truth(limit)) {
        (Some((a, b)), ..) => a == b,
        (None, Some(a), Some(b)) => a == b,
        _ => value == limit,
    };
    match (rule, numbers) {
        (Rule::EqualTo, _) => Ok(is_equal),
        (Rule::NotEqualTo, _) => Ok(!is_equal),
        (Rule::GreaterThan, Some((a, b))) => Ok(a > b),
        (Rule::LessThan, Some((a, b))) => Ok(a < b),
        (Rule::GreaterOrEqual, Some((a, b))) => Ok(a >= b),
        (Rule::LessOrEqual, Some((a, b))) => Ok(a <= b),
        (_, None) => Err(format!(
            "cannot compare `{value}` and `{limit}` by the rule `{}`",
            rule.name()
        )),
    }
}

/// Returns the value of a text of the type `boolean`.
fn truth(text: &str) -> Option<bool> {
    match text.trim() {
        "true" | "1" => Some(true),
        "false" | "0" => Some(false),
        _ => None,
    }
}

/// A recursive descent parser of arithmetic expressions.
struct ExpressionParser<'a> {
    rest: &'a str,
    parameters: &'a Parameters,
    depth: usize,
}

impl<'a> ExpressionParser<'a> {
    fn skip_blanks(&mut self) {
        self.rest = self.rest.trim_start();
    }

    fn take(&mut self, letter: char) -> bool {
        self.skip_blanks();
        let rest = self.rest.strip_prefix(letter);
        self.rest = rest.unwrap_or(self.rest);
        rest.is_some()
    }

    fn take_while(&mut self, accepts: impl Fn(char) -> bool) -> &'a str {
        let rest = self.rest.trim_start_matches(accepts);
        let prefix = self.rest.strip_suffix(rest).unwrap_or_default();
        self.rest = rest;
        prefix
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
            let operand = value(self)?;
            result = match operator {
                '+' => result + operand,
                '-' => result - operand,
                '*' => result * operand,
                '/' => result / operand,
                _ => result % operand,
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
            self.parameter_value()?
        } else if self
            .rest
            .starts_with(|letter: char| letter.is_ascii_alphabetic())
        {
            self.function_value()?
        } else {
            self.number()?
        };
        self.depth -= 1;
        Ok(value)
    }

    /// Parses the name of a parameter, and returns its value.
    fn parameter_value(&mut self) -> Result<f64, String> {
        let name = self.take_while(|letter| letter.is_alphanumeric() || letter == '_');
        let DeclaredParameter { text, number } = self
            .parameters
            .0
            .get(name)
            .ok_or_else(|| format!("there is no parameter `{name}`"))?;
        number.ok_or_else(|| format!("the parameter `{name}` = `{text}` is not a number"))
    }

    /// Parses the name of a function and its arguments, and returns its value.
    fn function_value(&mut self) -> Result<f64, String> {
        let name = self.take_while(|letter| letter.is_ascii_alphanumeric());
        let arguments = if self.take('(') {
            self.closed_list()?
        } else {
            Vec::new()
        };
        Ok(match (name, arguments.as_slice()) {
            ("pi", []) => std::f64::consts::PI,
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
                    arguments.len()
                ));
            }
        })
    }

    fn number(&mut self) -> Result<f64, String> {
        let digits = self.take_while(|letter| letter.is_ascii_digit() || letter == '.');
        let mut number = digits.to_owned();
        if self.rest.starts_with(['e', 'E']) {
            number += self.take_while(|letter| {
                matches!(letter, 'e' | 'E' | '+' | '-') || letter.is_ascii_digit()
            });
        }
        number
            .parse()
            .map_err(|_| format!("a number was expected before `{}`", self.rest))
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
