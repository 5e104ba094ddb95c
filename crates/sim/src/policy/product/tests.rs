use super::super::simd::available_archs;
use super::*;
use proptest::prelude::*;
use rand::RngExt;
use rand::SeedableRng;

fn numbers(seed: u64, count: usize) -> Vec<f32> {
    let mut stream = crate::random::Stream::seed_from_u64(seed);
    (0..count).map(|_| stream.random_range(-1.0..1.0)).collect()
}

fn transposed(matrix: &[f32], rows: usize, columns: usize) -> Vec<f32> {
    (0..columns)
        .flat_map(|c| (0..rows).map(move |r| matrix[r * columns + c]))
        .collect()
}

#[test]
fn a_product_does_not_depend_on_the_number_of_threads() {
    let [m, k, n] = [523, 241, 127];
    let (a, b) = (numbers(1, m * k), numbers(2, k * n));
    assert!(m * k * n > 3 * MIN_PARALLEL_MULTIPLICATIONS);
    let panels = PackedPanels::new(Rhs::Rows(&b), None, [k, n]);
    let product = |left: Lhs<'_>, threads| {
        let mut out = vec![f32::NAN; m * n];
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap();
        pool.install(|| panels.multiply_parallel(left, m, false, &mut out));
        out
    };
    let a_columns = transposed(&a, m, k);
    for left in [Lhs::Rows(&a), Lhs::Columns(&a_columns)] {
        let alone = product(left, 1);
        assert_eq!(alone, product(left, 2));
        assert_eq!(alone, product(left, 3));
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    #[test]
    fn products_are_the_sums_in_order(seed: u64, m in 1..40_usize, k in 1..50_usize, n in 1..80_usize, relu: bool) {
        let (a, b, start) = (numbers(seed, m * k), numbers(seed ^ 1, k * n), numbers(seed ^ 2, n));
        let expected: Vec<f32> = (0..m * n)
            .map(|i| {
                let sum = (0..k).fold(start[i % n], |sum, p| a[i / n * k + p].mul_add(b[p * n + i % n], sum));
                if relu { sum.max(0.0) } else { sum }
            })
            .collect();
        let (a_columns, b_columns) = (transposed(&a, m, k), transposed(&b, k, n));
        for right in [Rhs::Rows(&b), Rhs::Columns(&b_columns)] {
            let panels = PackedPanels::new(right, Some(&start), [k, n]);
            for left in [Lhs::Rows(&a), Lhs::Columns(&a_columns)] {
                for path in available_archs() {
                    let mut out = vec![f32::NAN; m * n];
                    panels.multiply_with_arch(path, left, m, relu, &mut out);
                    prop_assert_eq!(&out, &expected);
                }
            }
        }
    }

    #[test]
    fn dots_agree_with_double_precision(seed: u64, k in 0..70_usize) {
        let (a, b) = (numbers(seed, k), numbers(seed ^ 1, k));
        let expected: f64 = a.iter().zip(&b).map(|(&a, &b)| f64::from(a) * f64::from(b)).sum();
        prop_assert!((f64::from(dot(&a, &b)) - expected).abs() < 1e-5);
    }
}
