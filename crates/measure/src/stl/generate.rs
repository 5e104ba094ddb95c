//! Random formulas for property tests of monitor and printer.

use proptest::prelude::*;

use super::formula::{ComparisonOp, Formula, LinearPredicate, TimeWindow};

/// Generates comparisons of up to `most` weighted signals with a number.
pub(super) fn any_comparison(
    weight: impl Strategy<Value = f64>,
    name: impl Strategy<Value = &'static str>,
    most: usize,
    bound: impl Strategy<Value = f64>,
) -> impl Strategy<Value = Formula> {
    let relation = prop::sample::select(vec![
        ComparisonOp::Below,
        ComparisonOp::AtMost,
        ComparisonOp::Above,
        ComparisonOp::AtLeast,
    ]);
    let terms = prop::collection::vec((weight, name.prop_map(str::to_owned)), 1..=most);
    (terms, relation, bound).prop_filter_map("no signal left", |(terms, relation, bound)| {
        LinearPredicate::new(terms, relation, bound)
            .ok()
            .map(Formula::Compare)
    })
}

/// Generates formulas over given comparisons and windows, of at most `depth` levels and about `size` nodes.
pub(super) fn any_formula(
    comparison: impl Strategy<Value = Formula> + 'static,
    window: impl Strategy<Value = TimeWindow> + 'static,
    depth: u32,
    size: u32,
) -> impl Strategy<Value = Formula> {
    let window = window.boxed();
    comparison.prop_recursive(depth, size, 2, move |inner| {
        let pair = (inner.clone(), inner.clone()).prop_map(|(a, b)| (Box::new(a), Box::new(b)));
        prop_oneof![
            inner.clone().prop_map(|a| Formula::Not(Box::new(a))),
            pair.clone().prop_map(|(a, b)| Formula::And(a, b)),
            pair.clone().prop_map(|(a, b)| Formula::Or(a, b)),
            pair.clone().prop_map(|(a, b)| Formula::Implies(a, b)),
            (window.clone(), inner.clone()).prop_map(|(w, a)| Formula::Always(w, Box::new(a))),
            (window.clone(), inner).prop_map(|(w, a)| Formula::Eventually(w, Box::new(a))),
            (pair, window.clone()).prop_map(|((a, b), w)| Formula::Until(a, w, b)),
        ]
    })
}
