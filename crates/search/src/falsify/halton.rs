//! A randomised Halton sequence, whose points are spread more evenly than independent ones.

use rand::seq::SliceRandom;

use super::{SearchAlgorithm, UnitCube};
use crumple_sim::random::{Purpose, stream};

const BATCH_SIZE: usize = 32;

/// A Halton sequence with random permutations of every digit (Owen, A randomized Halton algorithm in R, 2017,
/// arXiv:1706.02808), without which coordinates with large bases correlate for hundreds of points.
#[derive(Debug)]
pub(super) struct Halton {
    coordinates: Vec<Coordinate>,
    next: u64,
}

/// One coordinate: a base and a permutation for each digit that a double can hold.
#[derive(Debug)]
struct Coordinate {
    base: u64,
    digit_permutations: Vec<Vec<u64>>,
}

impl Coordinate {
    fn new(base: u64, seed: u64, index: u64) -> Self {
        let mut random = stream(seed, Purpose::QuasiRandom, index);
        let positions = (53.0 / (base as f64).log2()).ceil() as usize;
        let digits = (0..positions).map(|_| {
            let mut digits: Vec<u64> = (0..base).collect();
            digits.shuffle(&mut random);
            digits
        });
        Self {
            base,
            digit_permutations: digits.collect(),
        }
    }

    /// Returns the radical inverse of `index`: its digits, permuted and mirrored at the point.
    fn radical_inverse(&self, mut index: u64) -> f64 {
        let mut weight = 1.0;
        let mut value = 0.0;
        for permutation in &self.digit_permutations {
            weight /= self.base as f64;
            let digit = permutation
                .get((index % self.base) as usize)
                .copied()
                .unwrap_or(0);
            value += digit as f64 * weight;
            index /= self.base;
        }
        value.min(1.0)
    }
}

impl Halton {
    pub(super) fn new(cube: &UnitCube, seed: u64) -> Self {
        let coordinates = primes()
            .take(cube.dimension())
            .zip(0..)
            .map(|(base, i)| Coordinate::new(base, seed, i));
        Self {
            coordinates: coordinates.collect(),
            next: 0,
        }
    }
}

fn primes() -> impl Iterator<Item = u64> {
    (2..).filter(|n| (2..).take_while(|d| d * d <= *n).all(|d| n % d != 0))
}

impl SearchAlgorithm for Halton {
    fn ask(&mut self) -> Vec<Vec<f64>> {
        let indices = self.next..self.next + BATCH_SIZE as u64;
        self.next = indices.end;
        indices
            .map(|index| {
                self.coordinates
                    .iter()
                    .map(|coordinate| coordinate.radical_inverse(index))
                    .collect()
            })
            .collect()
    }

    fn tell(&mut self, _robustness: &[f64]) {}
}

#[cfg(test)]
mod tests {
    use super::super::Method;
    use super::*;

    /// Returns the squared L2 star discrepancy (Warnock's formula).
    fn squared_discrepancy(points: &[Vec<f64>]) -> f64 {
        let (n, d) = (points.len() as f64, points[0].len() as i32);
        let single: f64 = points
            .iter()
            .map(|p| p.iter().map(|x| (1.0 - x * x) / 2.0).product::<f64>())
            .sum();
        let pairs: f64 = points
            .iter()
            .flat_map(|p| {
                points.iter().map(|q| {
                    p.iter()
                        .zip(q)
                        .map(|(x, y)| 1.0 - x.max(*y))
                        .product::<f64>()
                })
            })
            .sum();
        3f64.powi(-d) - 2.0 / n * single + pairs / (n * n)
    }

    #[test]
    fn halton_points_spread_more_evenly_than_uniform_ones() {
        for dimension in [2, 5] {
            let cube = UnitCube::new([dimension]).unwrap();
            let mean = |method: Method| {
                let estimate = |seed| {
                    let mut search = method.start(&cube, seed);
                    let points: Vec<_> = (0..8).flat_map(|_| search.ask()).collect();
                    squared_discrepancy(&points)
                };
                (0..10).map(estimate).sum::<f64>() / 10.0
            };
            assert!(
                mean(Method::Halton) < 0.35 * mean(Method::Uniform),
                "in {dimension} dimensions"
            );
        }
    }

    #[test]
    fn every_stratum_of_a_base_holds_one_point() {
        let mut halton = Halton::new(&UnitCube::new([3]).unwrap(), 4);
        let points: Vec<_> = (0..4).flat_map(|_| halton.ask()).collect();
        for (coordinate, base) in [2, 3, 5].into_iter().enumerate() {
            let strata = 25 / base * base;
            for block in points[..strata].chunks(base) {
                let mut occupied: Vec<_> = block
                    .iter()
                    .map(|p| (p[coordinate] * base as f64) as usize)
                    .collect();
                occupied.sort_unstable();
                assert_eq!(occupied, (0..base).collect::<Vec<_>>());
            }
        }
    }
}
