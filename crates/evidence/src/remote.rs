//! Blocks of a count that another process or machine simulates.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::{CountedBlock, RatePlan};
use crumple_core::observer::{Observer, RunProgress, Stopped};

/// Counted blocks with the digest of their registration, so that no block of another configuration is taken.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CountedBlocks {
    /// Digest of the registration.
    pub registration_sha256: String,
    /// Index of the first block.
    pub first: u64,
    /// Blocks in order.
    pub blocks: Vec<CountedBlock>,
}

/// Reason why a source yields no usable blocks.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RemoteCountError {
    /// The source failed.
    #[error("{0}")]
    Source(String),
    /// The blocks belong to another registration, or to another place in it.
    #[error(
        "a worker counted other runs than requested: it may have another release of crumple, or other files"
    )]
    OtherRuns,
    /// The user stopped the count.
    #[error("the count was {0}")]
    Stopped(#[from] Stopped),
}

/// Source of counted blocks.
pub trait BlockSource: Send + Sync {
    /// Waits for the next blocks of a plan, of which `first` is the first one. Returns at least one block.
    ///
    /// # Errors
    /// [`RemoteCountError`] if there are none.
    fn next_blocks(
        &self,
        plan: &RatePlan,
        first: u64,
    ) -> Result<Vec<CountedBlock>, RemoteCountError>;
}

impl CountedBlocks {
    /// Counts blocks of a plan.
    ///
    /// # Errors
    /// [`RateError`](super::RateError) names the failed run, or says that `observer` stopped.
    pub fn count(
        plan: &RatePlan,
        blocks: Range<u64>,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Self, super::RateError> {
        Ok(Self {
            registration_sha256: plan.registration().digest(),
            first: blocks.start,
            blocks: plan.count_blocks(blocks, observer)?,
        })
    }

    /// Returns the blocks if they are the next ones of a plan from `first` on, with possible counts.
    ///
    /// # Errors
    /// [`RemoteCountError::OtherRuns`] if they are not.
    pub fn into_blocks_of(
        self,
        plan: &RatePlan,
        first: u64,
    ) -> Result<Vec<CountedBlock>, RemoteCountError> {
        let left = plan.block_count().saturating_sub(first);
        let mut indexed = (first..).zip(&self.blocks);
        let is_of_plan = self.registration_sha256 == plan.registration().digest()
            && self.first == first
            && (1..=left).contains(&(self.blocks.len() as u64))
            && indexed.all(|(index, block)| plan.record().is_possible_block(index, block));
        match is_of_plan {
            true => Ok(self.blocks),
            false => Err(RemoteCountError::OtherRuns),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::fixtures::{count_all, rate_plan};
    use crumple_core::observer::Quiet;

    fn plan(seed: u64) -> RatePlan {
        rate_plan("baseline", None, ("high-risk", 750), (seed, 0.9))
    }

    /// Counts blocks in pairs by a plan of its own, whose seed may differ.
    struct Worker {
        seed: u64,
        change: fn(&mut CountedBlocks),
    }

    impl BlockSource for Worker {
        fn next_blocks(
            &self,
            asked: &RatePlan,
            first: u64,
        ) -> Result<Vec<CountedBlock>, RemoteCountError> {
            let plan = plan(self.seed);
            let end = (first + 2).min(plan.block_count());
            let mut counted = CountedBlocks::count(&plan, first..end, &Quiet).unwrap();
            (self.change)(&mut counted);
            counted.into_blocks_of(asked, first)
        }
    }

    #[test]
    fn blocks_of_a_worker_give_the_same_tally() {
        let worker = Worker {
            seed: 5,
            change: |_| (),
        };
        let remote = plan(5).with_block_source(Arc::new(worker));
        let tally = count_all(&remote);
        assert!(tally.failures > 0);
        assert_eq!(tally, count_all(&plan(5)));
    }

    type BlockChange = fn(&mut CountedBlocks);

    #[test]
    fn blocks_of_another_configuration_place_or_number_are_refused() {
        let changes: [(u64, BlockChange); 5] = [
            (6, |_| ()),
            (5, |counted| counted.first += 1),
            (5, |counted| counted.blocks.clear()),
            (5, |counted| counted.blocks[0].failures = 101),
            (5, |counted| {
                counted.blocks.extend(vec![CountedBlock::default(); 9])
            }),
        ];
        for (seed, change) in changes {
            let remote = plan(5).with_block_source(Arc::new(Worker { seed, change }));
            let mut tally = remote.empty_tally();
            let refused = remote.count_batch(&mut tally).unwrap_err();
            assert!(
                refused.to_string().contains("other runs than requested"),
                "{refused}"
            );
            assert_eq!(tally, remote.empty_tally());
        }
    }
}
