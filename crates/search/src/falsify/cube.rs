//! The search domain.

use std::ops::Range;

use crumple_spaces::ScenarioSpace;

/// The unit cube, with its coordinates in blocks: a number, or a piecewise constant signal, ordered by time.
///
/// Methods that use signals may propose fewer pieces, which are refined. Other methods ignore the blocks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct UnitCube {
    blocks: Vec<Range<usize>>,
    leader_coordinates: Vec<usize>,
}

/// The error of a cube or block without coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("a search needs at least one coordinate, and at least one in each block")]
pub struct EmptyBlock;

/// Reason why a search cannot go on with the points that it proposed.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidPoints {
    /// No points.
    #[error("must propose at least one point each time, and proposed none")]
    None,
    /// A point of another dimension.
    #[error("must propose points of {expected} coordinates, and proposed one of {found}")]
    Dimension {
        /// Number of coordinates of the space.
        expected: usize,
        /// Number of coordinates of the point.
        found: usize,
    },
    /// A point outside the unit cube.
    #[error("must propose coordinates from 0 to 1, and proposed {found}")]
    Outside {
        /// Coordinate of the point.
        found: f64,
    },
}

impl UnitCube {
    /// Creates the cube of a space: a block for each parameter, with marked coordinates of the leader's script.
    ///
    /// # Errors
    /// [`EmptyBlock`] never: a space has at least one parameter, and each has a coordinate.
    pub fn from_space(space: &ScenarioSpace) -> Result<Self, EmptyBlock> {
        let cube = Self::new(
            space
                .parameters()
                .iter()
                .map(|parameter| parameter.coordinates().len()),
        )?;
        let of_leader = space
            .parameters()
            .iter()
            .filter(|parameter| parameter.is_leader_script());
        Ok(cube.with_leader_coordinates(of_leader.flat_map(|parameter| parameter.coordinates())))
    }

    /// Creates a cube of blocks with these numbers of coordinates.
    ///
    /// # Errors
    /// [`EmptyBlock`] if there is no block, or one has length zero.
    pub fn new(lengths: impl IntoIterator<Item = usize>) -> Result<Self, EmptyBlock> {
        let mut blocks = Vec::new();
        let mut start = 0;
        for length in lengths {
            if length == 0 {
                return Err(EmptyBlock);
            }
            blocks.push(start..start + length);
            start += length;
        }
        if blocks.is_empty() {
            Err(EmptyBlock)
        } else {
            Ok(Self {
                blocks,
                leader_coordinates: Vec::new(),
            })
        }
    }

    /// Returns the number of coordinates, at least one.
    #[must_use]
    pub fn dimension(&self) -> usize {
        self.blocks.last().map_or(0, |block| block.end)
    }

    /// Returns the coordinates of each block.
    #[must_use]
    pub fn blocks(&self) -> &[Range<usize>] {
        &self.blocks
    }

    /// Marks the coordinates of the script of a leader. Ignores coordinates outside the cube.
    #[must_use]
    pub fn with_leader_coordinates(mut self, coordinates: impl IntoIterator<Item = usize>) -> Self {
        self.leader_coordinates = coordinates
            .into_iter()
            .filter(|&coordinate| coordinate < self.dimension())
            .collect();
        self
    }

    /// Returns the coordinates of the script of a leader; empty without a leader.
    #[must_use]
    pub fn leader_coordinates(&self) -> &[usize] {
        &self.leader_coordinates
    }

    /// Returns a coarse cube, whose blocks have at most `pieces` coordinates each.
    #[must_use]
    pub fn with_max_pieces(&self, pieces: usize) -> Self {
        let lengths = self
            .blocks
            .iter()
            .map(|block| block.len().min(pieces.max(1)));
        let mut start = 0;
        let blocks = lengths.map(|length| {
            start += length;
            start - length..start
        });
        Self {
            blocks: blocks.collect(),
            leader_coordinates: Vec::new(),
        }
    }

    /// Converts a point of the coarse cube: every piece takes the value of the coarse piece in which it begins.
    #[must_use]
    pub fn refine(&self, coarse: &Self, point: &[f64]) -> Vec<f64> {
        let mut refined = Vec::with_capacity(self.dimension());
        for (fine, rough) in self.blocks.iter().zip(&coarse.blocks) {
            let values = point.get(rough.clone()).unwrap_or_default();
            refined.extend((0..fine.len()).map(|i| {
                values
                    .get(i * rough.len() / fine.len())
                    .copied()
                    .unwrap_or(0.0)
            }));
        }
        refined
    }

    /// Converts a point to the nearest one of the coarse cube: the mean over each coarse piece.
    #[must_use]
    pub fn coarsen(&self, coarse: &Self, point: &[f64]) -> Vec<f64> {
        let mut means = Vec::with_capacity(coarse.dimension());
        for (fine, rough) in self.blocks.iter().zip(&coarse.blocks) {
            let values = point.get(fine.clone()).unwrap_or_default();
            means.extend((0..rough.len()).map(|piece| {
                let own = values
                    .iter()
                    .enumerate()
                    .filter(|(i, _)| i * rough.len() / fine.len() == piece)
                    .map(|(_, value)| value);
                own.clone().sum::<f64>() / own.count().max(1) as f64
            }));
        }
        means
    }

    /// Returns true if a point has the cube's dimension and lies in the cube.
    #[must_use]
    pub fn contains(&self, point: &[f64]) -> bool {
        point.len() == self.dimension() && point.iter().all(|x| (0.0..=1.0).contains(x))
    }

    /// Checks the points that a search proposed.
    ///
    /// # Errors
    /// [`InvalidPoints`] if there is no point, or one is not in the cube.
    pub fn check_points(&self, points: &[Vec<f64>]) -> Result<(), InvalidPoints> {
        let Some(wrong) = points.iter().find(|point| !self.contains(point)) else {
            return if points.is_empty() {
                Err(InvalidPoints::None)
            } else {
                Ok(())
            };
        };
        match wrong.iter().find(|x| !(0.0..=1.0).contains(*x)) {
            Some(&found) if wrong.len() == self.dimension() => {
                Err(InvalidPoints::Outside { found })
            }
            _ => Err(InvalidPoints::Dimension {
                expected: self.dimension(),
                found: wrong.len(),
            }),
        }
    }

    /// Returns the distance of two points: the sum over blocks of the mean difference, from 0 to the number of blocks.
    #[must_use]
    pub fn distance(&self, a: &[f64], b: &[f64]) -> f64 {
        self.blocks
            .iter()
            .map(|block| {
                let a = a.get(block.clone()).unwrap_or_default();
                let b = b.get(block.clone()).unwrap_or_default();
                a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>() / block.len() as f64
            })
            .sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn refined_points_coarsen_to_the_same_points(
            lengths in prop::collection::vec(1usize..25, 1..4),
            pieces in 1usize..25,
            values in prop::collection::vec(0.0..1.0f64, 75),
        ) {
            let cube = UnitCube::new(lengths).unwrap();
            let coarse = cube.with_max_pieces(pieces);
            let point = &values[..coarse.dimension()];
            let refined = cube.refine(&coarse, point);
            prop_assert_eq!(refined.len(), cube.dimension());
            for (again, value) in cube.coarsen(&coarse, &refined).iter().zip(point) {
                prop_assert!((again - value).abs() < 1e-12);
            }
            prop_assert!(cube.distance(&refined, &refined) == 0.0);
        }
    }
}
