//! The package nalgebra as an oracle: every operation agrees with it bit for bit.

use proptest::prelude::*;

use super::*;

fn oracle(matrix: &Matrix3) -> nalgebra::Matrix3<f64> {
    nalgebra::Matrix3::from_row_slice(matrix.0.as_flattened())
}

fn bits_of_oracle(matrix: &nalgebra::Matrix3<f64>) -> [[u64; 3]; 3] {
    [0, 1, 2].map(|row| [0, 1, 2].map(|column| matrix[(row, column)].to_bits()))
}

fn bits(matrix: &Matrix3) -> [[u64; 3]; 3] {
    matrix.0.map(|row| row.map(f64::to_bits))
}

fn any_matrix() -> impl Strategy<Value = Matrix3> {
    // Whole numbers also make singular matrices.
    let value = prop_oneof![-1e3..1e3, -1e-3..1e-3, (-3..4i32).prop_map(f64::from)];
    prop::array::uniform3(prop::array::uniform3(value)).prop_map(Matrix3)
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(1000))]

    #[test]
    fn matrix_sums_and_products_agree_with_the_reference(
        left in any_matrix(), right in any_matrix(), factor in -1e3..1e3,
    ) {
        let (a, b) = (oracle(&left), oracle(&right));
        prop_assert_eq!(bits(&(left + right)), bits_of_oracle(&(a + b)));
        prop_assert_eq!(bits(&(left * right)), bits_of_oracle(&(a * b)));
        prop_assert_eq!(bits(&(left * factor)), bits_of_oracle(&(a * factor)));
        prop_assert_eq!(bits(&left.transpose()), bits_of_oracle(&a.transpose()));
        let vector = right.first_column();
        let product: [f64; 3] = (a * b.column(0)).into();
        prop_assert_eq!((left * vector).map(f64::to_bits), product.map(f64::to_bits));
        let outer = a.column(0) * b.column(0).transpose();
        let product = Matrix3::outer_product(&left.first_column(), &vector);
        prop_assert_eq!(bits(&product), bits_of_oracle(&outer));
    }

    #[test]
    fn matrix_inverses_agree_with_the_reference(matrix in any_matrix()) {
        let expected = oracle(&matrix).try_inverse();
        prop_assert_eq!(matrix.inverse().map(|it| bits(&it)), expected.map(|it| bits_of_oracle(&it)));
    }

    #[test]
    fn cholesky_factors_agree_with_the_reference(root in any_matrix(), added in -10.0..1e3) {
        for matrix in [root, root * root.transpose() + Matrix3::IDENTITY * added] {
            let expected = oracle(&matrix).cholesky().map(|factor| factor.l());
            prop_assert_eq!(matrix.cholesky().map(|it| bits(&it)), expected.map(|it| bits_of_oracle(&it)));
        }
    }
}
