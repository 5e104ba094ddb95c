//! Operations on affine forms keep every member, compared with rational arithmetic.

use crumple_verify::Interval;
use crumple_verify::reach::form::AffineForm;
use num_rational::BigRational;
use num_traits::{One, Signed};
use proptest::prelude::*;

use crate::support::{contains, rational};

const SYMBOLS: usize = 3;

/// Generates numbers of magnitudes at which sums and products round, and often zero or one.
fn number() -> impl Strategy<Value = f64> {
    prop_oneof![2 => -10.0..10.0_f64, 1 => -1e-9..1e-9_f64, 1 => -1e9..1e9_f64, 2 => Just(0.0), 1 => Just(1.0)]
}

fn unit() -> impl Strategy<Value = f64> {
    prop_oneof![2 => -1.0..1.0_f64, 1 => Just(1.0), 1 => Just(-1.0)]
}

prop_compose! {
    fn interval()(a in number(), b in number(), is_point in any::<bool>(), inside in 0.0..=1.0_f64) -> (Interval, f64) {
        let (low, high) = if is_point { (a, a) } else { (a.min(b), a.max(b)) };
        (Interval::new(low, high).unwrap(), (low + inside * (high - low)).clamp(low, high))
    }
}

prop_compose! {
    /// Generates a form with some of the symbols, and a position of its `rest`.
    fn form()(
        centre in number(),
        terms in prop::collection::vec(number(), 0..=SYMBOLS),
        rest in prop_oneof![Just(0.0), 0.0..2.0_f64],
        place in unit(),
    ) -> (AffineForm, f64) {
        let mut form = AffineForm::constant(Interval::point(centre));
        for (symbol, &term) in terms.iter().enumerate() {
            form.add_scaled(&AffineForm::symbol(symbol, Interval::new(-1.0, 1.0).unwrap()), Interval::point(term));
        }
        if rest > 0.0 {
            form.widen(rest);
        }
        (form, place)
    }
}

fn without_rest(form: &AffineForm, symbols: &[f64; SYMBOLS]) -> BigRational {
    let terms = form
        .terms()
        .iter()
        .zip(symbols)
        .map(|(&term, &symbol)| rational(term) * rational(symbol));
    terms.fold(rational(form.centre()), |sum, term| sum + term)
}

fn member((form, place): &(AffineForm, f64), symbols: &[f64; SYMBOLS]) -> BigRational {
    without_rest(form, symbols) + rational(form.rest()) * rational(*place)
}

fn holds(form: &AffineForm, symbols: &[f64; SYMBOLS], value: &BigRational) -> bool {
    (value - without_rest(form, symbols)).abs() <= rational(form.rest())
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(2000))]

    #[test]
    fn affine_forms_contain_the_exact_results(
        x in form(),
        y in form(),
        (factor, by) in interval(),
        symbols in prop::array::uniform3(unit()),
    ) {
        let (of_x, of_y) = (member(&x, &symbols), member(&y, &symbols));
        let (x, y) = (x.0, y.0);
        let holds = |form: &AffineForm, exact: &BigRational| {
            holds(form, &symbols, exact) && contains(form.range(), exact)
        };
        prop_assert!(holds(&x, &of_x));
        prop_assert!(holds(&AffineForm::constant(factor), &rational(by)));
        prop_assert!(holds(&x.clone().plus(&y), &(&of_x + &of_y)));
        prop_assert!(holds(&x.clone().minus(&y), &(&of_x - &of_y)));
        prop_assert!(holds(&x.scaled(factor), &(&of_x * rational(by))));
        prop_assert!(holds(&x.times(&y), &(&of_x * &of_y)));
        let mut sum = x.clone();
        sum.add_scaled(&y, factor);
        prop_assert!(holds(&sum, &(&of_x + rational(by) * &of_y)));
        let mut shifted = x.clone();
        shifted.shift(factor);
        prop_assert!(holds(&shifted, &(&of_x + rational(by))));
        prop_assert!(holds(&x.join(&y), &of_x) && holds(&x.join(&y), &of_y));
        let mut wide = x.clone();
        wide.widen(by.abs());
        prop_assert!(holds(&wide, &(&of_x + rational(by))) && holds(&wide, &(&of_x - rational(by))));
        prop_assert!(!x.is_zero() || of_x == rational(0.0));
    }

    /// A joined form keeps common parts, stays in the hull, and is as far from either form as from the other.
    #[test]
    fn the_join_of_forms_stays_within_the_hull((x, _) in form(), (y, _) in form(), by in 0.1..10.0_f64) {
        let joined = x.join(&y).range();
        let both = x.range().hull(y.range());
        let slack = 1e-11 * (1e-280 + both.low().abs().max(both.high().abs()));
        prop_assert!(both.low() - slack <= joined.low() && joined.high() <= both.high() + slack, "{joined:?} {both:?}");
        let mut farther = x.clone();
        farther.shift(Interval::point(by));
        let joined = x.join(&farther);
        let size = 1.0 + x.centre().abs() + x.radius();
        prop_assert_eq!(joined.terms().len(), x.terms().len());
        for (actual, term) in joined.terms().iter().zip(x.terms()) {
            prop_assert_eq!(actual, term);
        }
        prop_assert!((joined.rest() - x.rest() - 0.5 * by).abs() <= 1e-10 * size);
    }

    /// Checks for at least half a unit in the last place per product and sum.
    #[test]
    fn small_numbers_are_rounded_too(c in 1e-4..1e-2_f64, d in 1e-4..1e-2_f64, factor in 1e-3..0.5_f64) {
        let mut sum = AffineForm::constant(Interval::point(c));
        sum.add_scaled(&AffineForm::constant(Interval::point(d)), Interval::point(factor));
        let least = 0.5 * f64::EPSILON * (factor * d + c + factor * d);
        prop_assert!(sum.rest() >= least && sum.rest() <= 5.0 * least);
    }

    /// Common parts cancel: bounds are as tight as rounding permits.
    #[test]
    fn shared_symbols_cancel((x, _) in form(), symbols in prop::array::uniform3(unit())) {
        let rests = rational(x.rest()) * rational(2.0);
        let rounding = rational(1e-14) * (rational(x.centre().abs()) + rational(x.radius())) + rational(1e-290);
        let difference = x.clone().minus(&x);
        prop_assert!(rational(difference.radius()) <= rests * (BigRational::one() + rational(1e-9)) + rounding);
        prop_assert_eq!(AffineForm::constant(Interval::point(x.centre())).rest(), 0.0);
        prop_assert_eq!(x.join(&x), x.clone());
        // A symbol may replace the rest: the set stays the same.
        let settled = x.clone().with_rest_as_symbol(SYMBOLS);
        prop_assert!((settled.radius() - x.radius()).abs() <= 1e-14 * x.radius());
        prop_assert!(settled.rest() == 0.0 || settled.rest() <= 1e-9 && settled == x);
        // The radius is the sum of the magnitudes.
        let reach = rational(x.radius());
        prop_assert!((without_rest(&x, &symbols) - rational(x.centre())).abs() <= reach);
        let terms = x.terms().iter().fold(rational(x.rest()), |sum, &term| sum + rational(term).abs());
        prop_assert!(reach >= terms && reach <= terms * (BigRational::one() + rational(1e-11)) + rational(1e-290));
    }
}
