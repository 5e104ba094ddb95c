use num_rational::BigRational;
use proptest::prelude::*;

use super::super::fixtures::interval;
use super::*;

fn rational(number: f64) -> BigRational {
    BigRational::from_float(number).unwrap()
}

fn size(range: Interval) -> BigRational {
    rational(range.high()) - rational(range.low())
}

/// Generates shares of very different magnitudes, powers of 1/2 among them.
fn any_share() -> impl Strategy<Value = f64> {
    prop_oneof![
        0.0..1.0_f64,
        (0..60_i32).prop_map(|cuts| 0.5_f64.powi(cuts)),
        (0.0..1.0_f64, 0..60_i32).prop_map(|(x, n)| x * 0.5_f64.powi(n))
    ]
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn shares_add_up_to_the_nearest_number_below(a in any_share(), b in any_share()) {
        let (sum, actual) = (rational(a) + rational(b), add_shares(a, b));
        prop_assert!(rational(actual) <= sum && sum < rational(actual.next_up()), "{a} + {b}: {actual}");
    }

    /// An exact half has half of the share, even if its width is no floating-point number.
    #[test]
    fn an_exact_half_has_half_the_share(
        a in -2.0..2.0_f64, b in -2.0..2.0_f64, places in 30..52_i32, share in any_share(),
    ) {
        // On a grid with an exact middle; some widths need more digits than a number has.
        let unit = 0.5_f64.powi(places);
        let [low, high] = [a.min(b), a.max(b)].map(|end| (end / unit).round() * unit);
        prop_assume!(low < high);
        let (below, above) = (low.next_down(), high.next_up());
        for [low, high] in [[low, high], [below, high], [low, above], [below, above]] {
            let (middle, whole) = (0.5 * low + 0.5 * high, interval(low, high));
            for part in [interval(low, middle), interval(middle, high)] {
                let (actual, expected) = (part_share(share, part, whole), rational(share) * size(part) / size(whole));
                prop_assert!(rational(actual) <= expected);
                if size(part) + size(part) == size(whole) {
                    prop_assert_eq!(actual, 0.5 * share);
                } else {
                    prop_assert!(rational(actual) >= expected * rational(1.0 - 1e-14), "{} of {:?}", actual, whole);
                }
            }
        }
    }
}

/// With one number in between, the middle is exact; with two, it is not.
#[test]
fn the_share_of_a_range_of_few_numbers_is_exact() {
    let numbers: Vec<f64> = std::iter::successors(Some(1.0_f64), |number| Some(number.next_up()))
        .take(4)
        .collect();
    assert_eq!(
        part_share(
            1.0,
            interval(numbers[0], numbers[1]),
            interval(numbers[0], numbers[2])
        ),
        0.5
    );
    let third = part_share(
        1.0,
        interval(numbers[0], numbers[1]),
        interval(numbers[0], numbers[3]),
    );
    assert!(third <= 1.0 / 3.0 && third > 1.0 / 3.0 - 1e-14);
    // Neither width is a floating-point number, but their ratio is 1/2.
    let (low, high) = (-1.0_f64.next_down(), 1.0_f64.next_up());
    let middle = 0.5 * low + 0.5 * high;
    assert_eq!(
        part_share(0.7, interval(low, middle), interval(low, high)),
        0.35
    );
}
