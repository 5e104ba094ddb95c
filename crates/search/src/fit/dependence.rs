//! How the numbers of episodes depend on each other: the correlation of their normal scores.

use statrs::distribution::{ContinuousCDF, Normal};

/// Correlations of normal scores: ranks over n + 1, as normal numbers. Whatever the marginal distributions are, that is as
/// good an estimate of a Gaussian copula's correlations as any that knows them, for many values (Klaassen and Wellner, Efficient
/// estimation in the bivariate normal copula model, Bernoulli 3, 1997). Equal values have the mean of their ranks.
pub(super) fn correlation(columns: &[&[f64]]) -> Vec<Vec<f64>> {
    let scores: Vec<Vec<f64>> = columns.iter().map(|values| normal_scores(values)).collect();
    let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let entry = |row: usize, column: usize| {
        if row == column {
            return 1.0;
        }
        // One order of operands, so that the matrix is symmetric to the last bit.
        let (a, b) = (&scores[row.min(column)], &scores[row.max(column)]);
        (product(a, b) / (product(a, a) * product(b, b)).sqrt()).clamp(-1.0, 1.0)
    };
    (0..scores.len()).map(|row| (0..scores.len()).map(|column| entry(row, column)).collect()).collect()
}

fn normal_scores(values: &[f64]) -> Vec<f64> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|&a, &b| values[a].total_cmp(&values[b]));
    let mut scores = vec![0.0; values.len()];
    let mut before = 0;
    for equal in order.chunk_by(|&a, &b| values[a] == values[b]) {
        let rank = before as f64 + 0.5 * (equal.len() as f64 + 1.0);
        let score = Normal::standard().inverse_cdf(rank / (values.len() as f64 + 1.0));
        equal.iter().for_each(|&index| scores[index] = score);
        before += equal.len();
    }
    scores
}
