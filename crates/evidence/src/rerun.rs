//! Confirmation of the counts of a certificate by repeating runs. A certificate has a hash of the results of each
//! block. A checker repeats all blocks, or a sample that is chosen after the file was fixed, and compares counts and
//! hashes. Forging k runs changes a >= ⌈k/b⌉ of the m blocks of b runs, so a sample of s blocks misses the forgery with
//! probability at most C(m - a, s)/C(m, s).

use crumple_controllers::Controllers;
use crumple_verify::{Certificate, ClaimSubject, Registration};
use rayon::prelude::*;

use super::binding::{self, BindingError, configuration_value};
use super::{CountedBlock, RateError, RatePlan};
use crumple_core::digest::Sha256;
use crumple_core::observer::{Observer, ProgressCounter, RunProgress, Stopped};
use crumple_sim::engine::NamedController;

/// Selection of the blocks to count again.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum BlockSelection {
    /// All blocks.
    All,
    /// A sample of the blocks.
    Sample {
        /// Percentage of the blocks; at least one block is counted.
        percent: f64,
        /// Seed of the sample; it must be unknown when the certificate is made.
        seed: u64,
    },
}

/// Reason why counts are not confirmed.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RerunError {
    /// The certificate has no counts.
    #[error("a certificate of kind `{0}` counts no runs")]
    NothingCounted(&'static str),
    /// Another release made the counts.
    #[error(
        "`registration.configuration.crumple` is {counting_release}, and this release is {}: use the release that \
         made the counts",
        env!("CARGO_PKG_VERSION")
    )]
    OtherRelease {
        /// Release that made the counts.
        counting_release: String,
    },
    /// The certificate is of version 1, without space and hashes.
    #[error(
        "a certificate of version 1 contains neither the space nor hashes of the results: repeat the count with this \
         release"
    )]
    NoBlocks,
    /// A controller is not available.
    #[error(
        "`registration.configuration.{place}` names no built-in controller, and no --controller has its identity: \
         name the controller with --controller; a name in a certificate opens no file and starts no program, not even \
         with --allow-external"
    )]
    NoController {
        /// Field of the registration that names the controller.
        place: &'static str,
    },
    /// The registration does not match its controllers and space.
    #[error("`registration` does not match the controllers and space that it names")]
    OtherRegistration,
    /// The certificate does not match its texts.
    #[error(transparent)]
    Binding(#[from] BindingError),
    /// A run failed.
    #[error(transparent)]
    Run(#[from] RateError),
    /// The observer stopped the count.
    #[error("counting again was {0}")]
    Stopped(#[from] Stopped),
    /// The counts differ.
    #[error("blocks[{block}], runs {first} to {last}: {problem}")]
    Refuted {
        /// Index of the block.
        block: u64,
        /// First run of the block.
        first: u64,
        /// Last run of the block.
        last: u64,
        /// Difference from the statement.
        problem: String,
    },
}

/// A certificate of counts that can be counted again.
pub struct Rerun {
    plan: RatePlan,
    /// Counts and digest of each block.
    stated_blocks: Vec<([u64; 2], String)>,
    /// SHA-256 of the certificate; part of the seed of the sample.
    digest: String,
}

/// Result of a confirmation.
#[derive(Debug, Clone, PartialEq)]
pub struct Confirmation {
    /// Number of blocks that were counted again.
    pub blocks: u64,
    /// Number of all blocks.
    pub total_blocks: u64,
    /// Number of runs that were repeated.
    pub runs: u64,
    /// Number of all runs.
    pub total_runs: u64,
    /// Number of runs per block.
    pub block_runs: u64,
}

impl Confirmation {
    /// True if all runs were repeated.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.blocks == self.total_blocks
    }

    /// Returns the minimum probability of detecting a forgery of the results of `forged` runs.
    #[must_use]
    pub fn detection_probability(&self, forged: u64) -> f64 {
        let changed = forged
            .div_ceil(self.block_runs.max(1))
            .min(self.total_blocks);
        let missed = (0..changed).map(|i| {
            let left = self
                .total_blocks
                .saturating_sub(self.blocks)
                .saturating_sub(i);
            left as f64 / (self.total_blocks - i) as f64
        });
        1.0 - missed.product::<f64>()
    }
}

impl Rerun {
    /// Prepares a confirmation. Controllers that are not built in must be in `given`. `opener` opens the drivers that
    /// the space names as files.
    ///
    /// # Errors
    /// [`RerunError`] if the counts cannot be repeated.
    pub fn new(
        certificate: &Certificate,
        given: &[NamedController],
        opener: Controllers,
    ) -> Result<Self, RerunError> {
        let statement = &certificate.statement;
        let ClaimSubject::Runs(registration) = statement.subject() else {
            return Err(RerunError::NothingCounted(statement.name()));
        };
        let Some(stated) = statement.counted_blocks() else {
            return Err(RerunError::NothingCounted(statement.name()));
        };
        if certificate.is_first_version() {
            return Err(RerunError::NoBlocks);
        }
        let release = configuration_value(registration, "crumple");
        if release != env!("CARGO_PKG_VERSION") {
            return Err(RerunError::OtherRelease {
                counting_release: release.escape_debug().to_string(),
            });
        }
        let controllers = match binding::built_in_controllers(registration) {
            Some(controllers) => controllers,
            None => {
                let first = find_given(given, registration, "controller")?;
                let is_comparison = registration.configuration.contains_key("against");
                let second = is_comparison.then(|| find_given(given, registration, "against"));
                (first, second.transpose()?)
            }
        };
        let plan = binding::rebuild_plan(certificate, registration, controllers, opener)?;
        if plan.registration() != registration || plan.block_count() != stated.len() as u64 {
            return Err(RerunError::OtherRegistration);
        }
        Ok(Self {
            plan,
            stated_blocks: stated,
            digest: certificate.digest(),
        })
    }

    /// Returns the number of runs in a sample.
    #[must_use]
    pub fn run_count(&self, sample: BlockSelection) -> u64 {
        self.select_blocks(sample)
            .into_iter()
            .map(|block| self.block_run_count(block))
            .sum()
    }

    fn block_run_count(&self, block: u64) -> u64 {
        let runs = self.plan.run_range(block);
        runs.end - runs.start
    }

    /// Counts a sample again.
    ///
    /// # Errors
    /// [`RerunError::Refuted`] names the first differing block of the sample; [`RerunError::Stopped`] if `observer`
    /// stops.
    pub fn confirm(
        &self,
        sample: BlockSelection,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Confirmation, RerunError> {
        let counter = ProgressCounter::new(observer, Some(self.run_count(sample)));
        let blocks = self.select_blocks(sample);
        let comparisons = blocks.par_iter().map(|&block| {
            counter.add(0)?;
            let recounted = self.plan.recount_block(block)?;
            counter.add(self.block_run_count(block))?;
            self.compare_block(block, &recounted)
        });
        // Report the first error in order of blocks, independent of threads.
        comparisons
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<(), RerunError>>()?;
        Ok(Confirmation {
            blocks: blocks.len() as u64,
            total_blocks: self.plan.block_count(),
            runs: blocks
                .iter()
                .map(|&block| self.block_run_count(block))
                .sum(),
            total_runs: self.plan.registration().runs,
            block_runs: self.block_run_count(0),
        })
    }

    /// Returns the blocks with the smallest hashes of index, seed and certificate, in order.
    fn select_blocks(&self, sample: BlockSelection) -> Vec<u64> {
        let all = 0..self.plan.block_count();
        let BlockSelection::Sample { percent, seed } = sample else {
            return all.collect();
        };
        let count = self.plan.block_count();
        let wanted = ((percent / 100.0 * count as f64).ceil() as u64).clamp(1, count) as usize;
        let hashed = all.map(|block| {
            let hash = Sha256::default()
                .with(seed.to_le_bytes())
                .with(&self.digest)
                .with(block.to_le_bytes())
                .finish();
            (hash, block)
        });
        let mut order: Vec<([u8; 32], u64)> = hashed.collect();
        order.sort_unstable();
        let mut blocks: Vec<u64> = order
            .into_iter()
            .take(wanted)
            .map(|(_, block)| block)
            .collect();
        blocks.sort_unstable();
        blocks
    }

    fn compare_block(&self, block: u64, recounted: &CountedBlock) -> Result<(), RerunError> {
        let is_rate = self.plan.has_single_controller();
        let counts = if is_rate {
            [recounted.failures, 0]
        } else {
            [recounted.only_first_failed, recounted.only_second_failed]
        };
        let Some((stated, sha256)) = self.stated_blocks.get(block as usize) else {
            return Err(RerunError::OtherRegistration);
        };
        let problem = if *stated != counts && is_rate {
            format!(
                "{} runs failed when repeated, and the certificate states {}",
                counts[0], stated[0]
            )
        } else if *stated != counts {
            format!(
                "when repeated, only the first controller failed in {} runs and only the second in {}, and the \
                 certificate states {} and {}",
                counts[0], counts[1], stated[0], stated[1]
            )
        } else if *sha256 != recounted.sha256 {
            "when repeated, the runs have other results than the certificate states".to_owned()
        } else {
            return Ok(());
        };
        let runs = self.plan.run_range(block);
        Err(RerunError::Refuted {
            block,
            first: runs.start,
            last: runs.end.saturating_sub(1),
            problem,
        })
    }
}

/// Returns the given controller with the identity that is registered for a role, under its registered name.
fn find_given(
    given: &[NamedController],
    registration: &Registration,
    role: &'static str,
) -> Result<NamedController, RerunError> {
    let identity = configuration_value(
        registration,
        match role {
            "controller" => "controller_sha256",
            _ => "against_sha256",
        },
    );
    let controller = given
        .iter()
        .find(|controller| controller.source.identity().as_deref() == Some(identity))
        .ok_or(RerunError::NoController { place: role })?;
    Ok(NamedController {
        name: configuration_value(registration, role).to_owned(),
        source: controller.source.clone(),
    })
}
