//! Printer: formulas to text that parses to an equal formula.

use std::fmt;

use super::formula::{Formula, LinearPredicate, TimeWindow};

/// An operand in parentheses, so that readers need no precedence.
struct Operand<'a>(&'a Formula);

impl fmt::Display for Operand<'_> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "({})", self.0)
    }
}

/// Writes the left operand of a chain of one operator, without parentheses: `(a) and (b) and (c)`.
fn first_operands(
    left: &Formula,
    continues_chain: bool,
    out: &mut fmt::Formatter<'_>,
) -> fmt::Result {
    if continues_chain {
        write!(out, "{left}")
    } else {
        write!(out, "{}", Operand(left))
    }
}

impl fmt::Display for Formula {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Compare(comparison) => write!(out, "{comparison}"),
            Self::Not(inner) => write!(out, "not {}", Operand(inner)),
            Self::And(left, right) => {
                first_operands(left, matches!(**left, Self::And(..)), out)?;
                write!(out, " and {}", Operand(right))
            }
            Self::Or(left, right) => {
                first_operands(left, matches!(**left, Self::Or(..)), out)?;
                write!(out, " or {}", Operand(right))
            }
            Self::Implies(left, right) => {
                write!(out, "{} implies {}", Operand(left), Operand(right))
            }
            Self::Always(window, inner) => write!(out, "always{window} {}", Operand(inner)),
            Self::Eventually(window, inner) => write!(out, "eventually{window} {}", Operand(inner)),
            Self::Until(left, window, right) => {
                write!(out, "{} until{window} {}", Operand(left), Operand(right))
            }
        }
    }
}

impl fmt::Display for TimeWindow {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        if *self == Self::ALL {
            Ok(())
        } else {
            write!(out, "[{},{}]", self.from_s(), self.to_s())
        }
    }
}

impl fmt::Display for LinearPredicate {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (position, (weight, name)) in self.terms().iter().enumerate() {
            let sign = match (position, *weight < 0.0) {
                (0, true) => "-",
                (0, false) => "",
                (_, true) => " - ",
                (_, false) => " + ",
            };
            match weight.abs() {
                1.0 => write!(out, "{sign}{name}")?,
                size => write!(out, "{sign}{size} * {name}")?,
            }
        }
        write!(out, " {} {}", self.operator(), self.bound())
    }
}

#[cfg(test)]
mod tests {
    use super::super::SyntaxProblem;
    use super::super::generate::{any_comparison, any_formula};
    use super::*;
    use proptest::prelude::*;

    fn comparison() -> impl Strategy<Value = Formula> {
        let weight = prop_oneof![Just(1.0), Just(-1.0), -1e3..1e3, proptest::num::f64::NORMAL];
        let name = prop_oneof![
            Just("a"),
            Just("b_m"),
            Just("ego.ttc_s"),
            Just("inf1"),
            Just("α")
        ];
        any_comparison(weight, name, 3, -1e9..1e9)
    }

    fn window() -> impl Strategy<Value = TimeWindow> {
        prop_oneof![
            Just(TimeWindow::ALL),
            (0.0..50.0, 0.0..50.0)
                .prop_map(|(a, b): (f64, f64)| TimeWindow::new(a, a + b).unwrap()),
            (0.0..50.0).prop_map(|a| TimeWindow::new(a, f64::INFINITY).unwrap()),
        ]
    }

    fn formula() -> impl Strategy<Value = Formula> {
        any_formula(comparison(), window(), 5, 30)
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn printed_formulas_parse_to_themselves(formula in formula()) {
            let text = formula.to_string();
            prop_assert_eq!(text.parse::<Formula>(), Ok(formula), "{}", text);
        }

        #[test]
        fn no_text_makes_the_parser_panic(text in "[a-c0-9.e()\\[\\],<>=&|!*/+ \
            -]{0,40}|(always|not|until|and|\\(|\\)|a|<|2|\\[0,1\\]| ){0,30}|.{0,30}") {
            if let Ok(formula) = text.parse::<Formula>() {
                prop_assert_eq!(formula.to_string().parse::<Formula>(), Ok(formula));
            }
        }
    }

    #[test]
    fn every_operand_is_printed_in_parentheses() {
        for (written, printed) in [
            (
                "always v2.gap_m > 1 and v1.gap_m > 5",
                "(always (v2.gap_m > 1)) and (v1.gap_m > 5)",
            ),
            (
                "a > 1 or b > 1 and c > 1",
                "(a > 1) or ((b > 1) and (c > 1))",
            ),
            (
                "a > 1 and b > 1 and c > 1",
                "(a > 1) and (b > 1) and (c > 1)",
            ),
            (
                "a > 1 and (b > 1 and c > 1)",
                "(a > 1) and ((b > 1) and (c > 1))",
            ),
            (
                "a > 1 implies b > 1 implies c > 1",
                "(a > 1) implies ((b > 1) implies (c > 1))",
            ),
            (
                "not a > 1 until[0,2] b > 1",
                "(not (a > 1)) until[0,2] (b > 1)",
            ),
            (
                "eventually[0,5] always a > 1",
                "eventually[0,5] (always (a > 1))",
            ),
        ] {
            assert_eq!(written.parse::<Formula>().unwrap().to_string(), printed);
        }
    }

    #[test]
    fn errors_name_words_that_are_not_operators() {
        for (text, column, word) in [
            ("globally[0,5] a > 1", 1, "globally"),
            ("G(a > 1)", 1, "G"),
            ("not historically a > 1", 5, "historically"),
            ("a > b xor c > 1", 7, "xor"),
            ("a > 1 xor c > 1", 7, "xor"),
            ("a above 1", 3, "above"),
            ("(a > 1) & (b > 1)", 9, "&"),
            ("always (a > 1 unless b > 1)", 15, "unless"),
        ] {
            let error = text.parse::<Formula>().unwrap_err();
            assert_eq!(error.column, column, "{text}: {error}");
            assert!(
                error.to_string().contains(&format!("`{word}`")),
                "{text}: {error}"
            );
            for operator in [
                "not",
                "and",
                "or",
                "implies",
                "always",
                "eventually",
                "until",
            ] {
                assert!(error.to_string().contains(operator), "{text}: {error}");
            }
        }
    }

    #[test]
    fn a_warning_names_parts_without_a_temporal_operator() {
        for (text, parts) in [
            ("always a > 1 and b > 1", &["b > 1"][..]),
            ("a > 1 and b > 1", &["(a > 1) and (b > 1)"]),
            ("a > 1", &["a > 1"]),
            ("a > 1 implies not eventually b > 1", &["a > 1"]),
            ("always (a > 1 and b > 1) or (a > 1) until (b > 1)", &[]),
        ] {
            let formula: Formula = text.parse().unwrap();
            let precedences: Vec<_> = formula
                .first_sample_parts()
                .into_iter()
                .map(ToString::to_string)
                .collect();
            assert_eq!(precedences, parts, "{text}");
        }
    }

    #[test]
    fn formulas_at_the_limits_can_be_printed_and_parsed_again() {
        let chain = |operator: &str, parts: usize| vec!["a > 1"; parts].join(operator);
        for text in [
            "not ".repeat(64) + "a > 1",
            chain(" and ", 1000),
            chain(" or ", 1000),
            chain(" implies ", 60),
        ] {
            let formula: Formula = text.parse().unwrap();
            assert_eq!(formula.to_string().parse(), Ok(formula));
        }
    }

    #[test]
    fn words_signs_and_equivalent_sums_give_the_same_formula() {
        let plain: Formula =
            "always[0,72] eventually[0,8] (a - b >= 9 implies not c < 1 and d > 2 or a > 0)"
                .parse()
                .unwrap();
        let signs: Formula =
            "□[0,72]◇[0,8]((a >= b + 9) → ((!c<1 ∧ 0.5*(2*d) > 1+1) ∨ 0 < a*3/3 - 0))"
                .parse()
                .unwrap();
        // `0 < a` keeps its order, with the signal on the right.
        assert_eq!(
            signs.to_string().replace("-a < 0", "a > 0"),
            plain.to_string()
        );
    }

    #[test]
    fn errors_point_at_the_column() {
        let column = |text: &str| text.parse::<Formula>().unwrap_err().column;
        assert_eq!(column("always[0,5] a - b"), 13, "a sum is no formula");
        assert_eq!(
            column("always[5,2] a > 1"),
            7,
            "a window that ends before it starts"
        );
        assert_eq!(column("a > 1 & b > 2"), 7, "an unknown sign");
        assert_eq!(column("a * b > 2"), 5, "a product of signals");
        assert_eq!(column("0 < a < 2"), 7, "a chain of comparisons");
        assert_eq!(
            column("(a > 0) until (a > 1) until (a > 2)"),
            23,
            "a chain of untils"
        );
        assert_eq!(column("(a > 1) + 2 > 3"), 1, "a formula is no sum");
        assert_eq!(column("a > 1 and"), 10, "the end");
        assert_eq!(
            column("◇[0,1] a > "),
            12,
            "columns are characters, not bytes"
        );
        assert_eq!(column("1 > 2"), 1, "no signal");
        assert_eq!(column("a / 0 > 2"), 1, "a weight that is not finite");
        let nested = format!("{}a > 1{}", "(".repeat(5000), ")".repeat(5000));
        assert!(matches!(
            nested.parse::<Formula>().unwrap_err().problem,
            SyntaxProblem::TooLong { .. }
        ));
        let error = "always[0 5] a > 1".parse::<Formula>().unwrap_err();
        assert_eq!(error.to_string(), "column 10: expected `,`, found 5");
    }
}
