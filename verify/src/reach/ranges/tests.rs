use super::super::fixtures::{interval, point_box};
use super::*;

#[test]
fn a_range_is_bisected_at_an_inner_number_or_not_at_all() {
    let unit = 1.0_f64;
    let next = [unit.next_up(), unit.next_up().next_up()];
    for dimension in BoxDimension::ALL {
        let mut ranges = point_box([7.0; 8]);
        assert_eq!(ranges.bisect(dimension), None);
        // Between the first two the middle rounds to the lower one, and between the next two to the upper one.
        for [low, high] in [[unit, next[0]], next, [f64::MAX, f64::MAX]] {
            *ranges.get_mut(dimension) = interval(low, high);
            assert_eq!(ranges.bisect(dimension), None);
        }
        *ranges.get_mut(dimension) = interval(1.0, 4.0);
        let [lower, upper] = ranges.bisect(dimension).unwrap();
        assert_eq!(
            [lower.get(dimension), upper.get(dimension)],
            [interval(1.0, 2.5), interval(2.5, 4.0)]
        );
        for other in BoxDimension::ALL
            .into_iter()
            .filter(|&other| other != dimension)
        {
            assert_eq!(
                [lower.get(other), upper.get(other)],
                [Interval::point(7.0); 2]
            );
        }
    }
}
