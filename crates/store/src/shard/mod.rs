//! Shard I of N: a part of a run that is divided over several machines.
//!
//! A shard is a pure function of the configuration of the whole run, of I and of N. Its folder contains all of these.

mod parts;

use std::fmt;
use std::ops::Range;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

pub use parts::{MergeError, MissingShards, Parts};

/// Maximum number of shards of a run.
pub const MAX_SHARDS: u32 = 10_000;

/// Shard I of N, counted from 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct ShardId {
    count: u32,
    index: u32,
}

/// The error of a text or number that does not name a shard.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a shard: write I/N, shard I of N, with 1 <= I <= N <= {MAX_SHARDS}")]
pub struct InvalidShard(String);

/// The error of more shards than parts.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("shard {shard}: there are {parts} {parts_name}, which make {parts} shards at most")]
pub struct TooManyShards {
    /// Requested shard.
    pub shard: ShardId,
    /// Number of parts.
    pub parts: u64,
    /// Name of the parts, in the plural.
    pub parts_name: &'static str,
}

impl ShardId {
    /// Creates shard `index` of `of`, counted from 1.
    ///
    /// # Errors
    /// [`InvalidShard`] unless 1 ≤ `index` ≤ `of` ≤ [`MAX_SHARDS`].
    pub fn new(index: u32, of: u32) -> Result<Self, InvalidShard> {
        match (1..=of).contains(&index) && of <= MAX_SHARDS {
            true => Ok(Self { count: of, index }),
            false => Err(InvalidShard(format!("{index}/{of}"))),
        }
    }

    /// Returns the index of the shard, from 1.
    #[must_use]
    pub fn index(self) -> u32 {
        self.index
    }

    /// Returns the number of shards.
    #[must_use]
    pub fn count(self) -> u32 {
        self.count
    }

    /// Returns the contiguous range of this shard in `parts` parts, counted from 0. Lengths differ by at most one.
    ///
    /// # Errors
    /// [`TooManyShards`] if some shard would be empty; `what` names the parts.
    pub fn range(self, parts: u64, what: &'static str) -> Result<Range<u64>, TooManyShards> {
        if u64::from(self.count) > parts {
            return Err(TooManyShards { shard: self, parts, parts_name: what });
        }
        // At most 2^64 parts, so the quotient fits.
        let before = |shards: u32| (u128::from(parts) * u128::from(shards) / u128::from(self.count)) as u64;
        Ok(before(self.index - 1)..before(self.index))
    }
}

impl fmt::Display for ShardId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}/{}", self.index, self.count)
    }
}

impl From<ShardId> for String {
    fn from(shard: ShardId) -> Self {
        shard.to_string()
    }
}

impl TryFrom<String> for ShardId {
    type Error = InvalidShard;

    fn try_from(text: String) -> Result<Self, InvalidShard> {
        text.parse()
    }
}

impl FromStr for ShardId {
    type Err = InvalidShard;

    fn from_str(text: &str) -> Result<Self, InvalidShard> {
        let number = |digits: &str| digits.parse().ok().filter(|number: &u32| number.to_string() == digits);
        let shard = text.split_once('/').and_then(|(index, of)| Self::new(number(index)?, number(of)?).ok());
        shard.ok_or_else(|| InvalidShard(text.to_owned()))
    }
}

/// Formats sorted numbers in the array syntax of Slurm: `1,4-6`.
#[must_use]
pub fn format_ranges(numbers: &[u32]) -> String {
    let mut runs: Vec<Range<u32>> = Vec::new();
    for &number in numbers {
        match runs.last_mut() {
            Some(run) if run.end == number => run.end += 1,
            _ => runs.push(number..number.saturating_add(1)),
        }
    }
    let words = runs.into_iter().map(|run| match run.end - run.start {
        1 => run.start.to_string(),
        _ => format!("{}-{}", run.start, run.end - 1),
    });
    words.collect::<Vec<_>>().join(",")
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// The shards partition the parts in order, and none is empty.
        #[test]
        fn shards_divide_any_count(parts in 1..=u64::MAX, of in 1..=200_u32) {
            let shards = (1..=of).map(|index| ShardId::new(index, of).unwrap());
            let ranges: Vec<_> = shards.map(|shard| shard.range(parts, "parts")).collect();
            if u64::from(of) > parts {
                prop_assert!(ranges.iter().all(Result::is_err));
            } else {
                let mut end = 0;
                for range in ranges {
                    let range = range.unwrap();
                    prop_assert!(range.start == end && range.end > end);
                    prop_assert!(range.end - range.start <= parts / u64::from(of) + 1);
                    end = range.end;
                }
                prop_assert_eq!(end, parts);
            }
        }

        #[test]
        fn a_shard_is_read_as_it_is_written(of in 1..=MAX_SHARDS, index in 1..=MAX_SHARDS) {
            prop_assume!(index <= of);
            let shard = ShardId::new(index, of).unwrap();
            prop_assert_eq!(shard.to_string().parse(), Ok(shard));
        }
    }

    #[test]
    fn invalid_shards_are_refused() {
        for text in [
            "",
            "/",
            "1",
            "0/3",
            "4/3",
            "1/0",
            "+1/3",
            "01/3",
            " 1/3",
            "1/3 ",
            "1/10001",
            "1/2/3",
            "-1/3",
            "1/99999999999",
        ] {
            assert_eq!(text.parse::<ShardId>(), Err(InvalidShard(text.to_owned())));
        }
    }

    #[test]
    fn numbers_in_a_row_are_one_range() {
        assert_eq!(format_ranges(&[]), "");
        assert_eq!(format_ranges(&[1, 3, 4, 5, 8, 9]), "1,3-5,8-9");
    }
}
