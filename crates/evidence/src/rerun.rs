//! Confirmation of the counts of a certificate, or of a pool, by repeating runs. A certificate has a hash of the
//! results of each block. A checker repeats all blocks, or a sample that is chosen after the file was fixed, and
//! compares counts and hashes. Forging k runs changes a >= ⌈k/b⌉ of the m blocks of b runs, so a sample of s blocks
//! misses the forgery with probability at most C(m - a, s)/C(m, s).

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
    /// Another release made the counts, and this one does not get them.
    #[error(
        "{difference}; `registration.configuration.crumple` is {counting_release}, and this release is {}: only the \
         release that made the counts can refute them",
        env!("CARGO_PKG_VERSION")
    )]
    OtherRelease {
        /// Release that made the counts.
        counting_release: String,
        /// Difference between this release and the certificate.
        difference: String,
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
    #[error("blocks[{block}], runs {first} to {last}{}: {problem}", describe_seed(*seed))]
    Refuted {
        /// Seed of the count, in a pool.
        seed: Option<u64>,
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

fn describe_seed(seed: Option<u64>) -> String {
    seed.map_or_else(String::new, |seed| format!(" of seed {seed}"))
}

/// Counts that can be repeated: those of one certificate, or of the certificates of a pool.
pub struct Rerun {
    /// Plan of the first certificate. The others differ from it in the seed only.
    plan: RatePlan,
    /// Counts of one seed each. All have the same number of blocks, which are numbered consecutively.
    counts: Vec<StatedCount>,
}

/// Counts that a certificate states.
struct StatedCount {
    seed: u64,
    /// Counts and digest of each block.
    blocks: Vec<([u64; 2], String)>,
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

impl StatedCount {
    /// Reads the counts of a certificate of version 2, and its registration.
    fn read(certificate: &Certificate) -> Result<(Self, &Registration), RerunError> {
        let statement = &certificate.statement;
        let nothing_counted = || RerunError::NothingCounted(statement.name());
        let ClaimSubject::Runs(registration) = statement.subject() else {
            return Err(nothing_counted());
        };
        let blocks = statement.counted_blocks().ok_or_else(nothing_counted)?;
        if certificate.is_first_version() {
            return Err(RerunError::NoBlocks);
        }
        let seed = configuration_value(registration, "seed").parse();
        let count = Self {
            seed: seed.map_err(|_| RerunError::OtherRegistration)?,
            blocks,
            digest: certificate.digest(),
        };
        Ok((count, registration))
    }
}

/// Rebuilds the plan of a registration.
fn rebuild_plan(
    certificate: &Certificate,
    registration: &Registration,
    given: &[NamedController],
    opener: Controllers,
) -> Result<RatePlan, RerunError> {
    let controllers = match binding::built_in_controllers(registration) {
        Some(controllers) => controllers,
        None => {
            let first = find_given(given, registration, "controller")?;
            let is_comparison = registration.configuration.contains_key("against");
            let second = is_comparison.then(|| find_given(given, registration, "against"));
            (first, second.transpose()?)
        }
    };
    let space = binding::read_space(certificate, opener)?;
    let plan = binding::rebuild_plan(space, registration, controllers)?;
    Ok(plan.registered_as(registration))
}

impl Rerun {
    /// Prepares a confirmation. Controllers that are not built in must be in `given`. `opener` opens the drivers that
    /// the space names as files. Another release may have made the counts.
    ///
    /// # Errors
    /// [`RerunError`] if the counts cannot be repeated.
    pub fn new(
        certificate: &Certificate,
        given: &[NamedController],
        opener: Controllers,
    ) -> Result<Self, RerunError> {
        let (count, registration) = StatedCount::read(certificate)?;
        let mut rerun = Self {
            plan: rebuild_plan(certificate, registration, given, opener)?,
            counts: Vec::new(),
        };
        rerun.push(count, registration)?;
        Ok(rerun)
    }

    /// Adds the counts of another certificate of a pool, whose registration differs in the seed only.
    ///
    /// # Errors
    /// [`RerunError`] if the counts cannot be repeated.
    pub fn add(&mut self, certificate: &Certificate) -> Result<(), RerunError> {
        let (count, registration) = StatedCount::read(certificate)?;
        self.push(count, registration)
    }

    fn push(&mut self, count: StatedCount, registration: &Registration) -> Result<(), RerunError> {
        let is_of_plan = self.plan.registration_of_seed(count.seed) == *registration
            && self.plan.block_count() == count.blocks.len() as u64;
        if !is_of_plan {
            return Err(self.difference(RerunError::OtherRegistration));
        }
        self.counts.push(count);
        Ok(())
    }

    /// Returns the error for a difference: another release may simulate other runs, which refutes nothing.
    fn difference(&self, error: RerunError) -> RerunError {
        let release = configuration_value(self.plan.registration(), "crumple");
        if release == env!("CARGO_PKG_VERSION") {
            return error;
        }
        RerunError::OtherRelease {
            counting_release: release.escape_debug().to_string(),
            difference: error.to_string(),
        }
    }

    fn block_count(&self) -> u64 {
        self.plan.block_count() * self.counts.len() as u64
    }

    /// Returns the count that contains a block, and the block's index in it.
    fn locate(&self, block: u64) -> Option<(&StatedCount, u64)> {
        let each = self.plan.block_count();
        let count = self.counts.get((block / each) as usize)?;
        Some((count, block % each))
    }

    /// Returns the number of runs of the block with an index in its count.
    fn block_run_count(&self, index: u64) -> u64 {
        let runs = self.plan.run_range(index);
        runs.end - runs.start
    }

    /// Returns the number of runs in a sample.
    #[must_use]
    pub fn run_count(&self, sample: BlockSelection) -> u64 {
        self.count_runs(&self.select_blocks(sample))
    }

    fn count_runs(&self, blocks: &[u64]) -> u64 {
        let blocks = blocks.iter().filter_map(|&block| self.locate(block));
        blocks.map(|(_, index)| self.block_run_count(index)).sum()
    }

    /// Counts a sample again.
    ///
    /// # Errors
    /// [`RerunError::Refuted`] names the first differing block of the sample, and [`RerunError::OtherRelease`] too, if
    /// another release made the counts; [`RerunError::Stopped`] if `observer` stops.
    pub fn confirm(
        &self,
        sample: BlockSelection,
        observer: &dyn Observer<RunProgress>,
    ) -> Result<Confirmation, RerunError> {
        let blocks = self.select_blocks(sample);
        let counter = ProgressCounter::new(observer, Some(self.count_runs(&blocks)));
        let located = blocks.par_iter().filter_map(|&block| self.locate(block));
        let comparisons = located.map(|(count, index)| {
            counter.add(0)?;
            self.compare_block(count, index)?;
            Ok(counter.add(self.block_run_count(index))?)
        });
        // Report the first error in order of blocks, independent of threads.
        comparisons
            .collect::<Vec<_>>()
            .into_iter()
            .collect::<Result<(), RerunError>>()?;
        Ok(Confirmation {
            blocks: blocks.len() as u64,
            total_blocks: self.block_count(),
            runs: self.count_runs(&blocks),
            total_runs: self.plan.registration().runs * self.counts.len() as u64,
            block_runs: self.block_run_count(0),
        })
    }

    /// Counts a block again, and compares it with the stated one.
    fn compare_block(&self, count: &StatedCount, index: u64) -> Result<(), RerunError> {
        let recounted = self.plan.recount_block_of_seed(count.seed, index)?;
        let Some((stated, sha256)) = count.blocks.get(index as usize) else {
            return Err(RerunError::OtherRegistration);
        };
        let problem = if let Some(problem) = self.describe_difference(*stated, &recounted) {
            problem
        } else if *sha256 != recounted.sha256 {
            "when repeated, the runs have other results than the certificate states".to_owned()
        } else {
            return Ok(());
        };
        let runs = self.plan.run_range(index);
        Err(self.difference(RerunError::Refuted {
            seed: (self.counts.len() > 1).then_some(count.seed),
            block: index,
            first: runs.start,
            last: runs.end.saturating_sub(1),
            problem,
        }))
    }

    /// Describes how stated counts of a block differ from new ones; `None` if they are equal.
    fn describe_difference(&self, stated: [u64; 2], recounted: &CountedBlock) -> Option<String> {
        let is_rate = self.plan.has_single_controller();
        let counts = match is_rate {
            true => [recounted.failures, 0],
            false => [recounted.only_first_failed, recounted.only_second_failed],
        };
        let text = match is_rate {
            _ if stated == counts => return None,
            true => format!(
                "{} runs failed when repeated, and the certificate states {}",
                counts[0], stated[0]
            ),
            false => format!(
                "when repeated, only the first controller failed in {} runs and only the second in {}, and the \
                 certificate states {} and {}",
                counts[0], counts[1], stated[0], stated[1]
            ),
        };
        Some(text)
    }

    /// Returns the blocks with the smallest hashes of index, seed and certificate, in order.
    fn select_blocks(&self, sample: BlockSelection) -> Vec<u64> {
        let all = 0..self.block_count();
        let BlockSelection::Sample { percent, seed } = sample else {
            return all.collect();
        };
        let count = self.block_count();
        let wanted =
            ((percent / 100.0 * count as f64).ceil() as u64).clamp(1, count.max(1)) as usize;
        let hashed = all.filter_map(|block| {
            let (count, index) = self.locate(block)?;
            let hash = Sha256::default()
                .with(seed.to_le_bytes())
                .with(&count.digest)
                .with(index.to_le_bytes())
                .finish();
            Some((hash, block))
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::rate_plan;
    use crumple_core::observer::Quiet;
    use crumple_store::study::Study;
    use crumple_verify::Statement;

    fn count_as(release: &str) -> Certificate {
        let plan = rate_plan("baseline", None, ("high-risk", 200), (3, 0.9));
        let mut registration = plan.registration().clone();
        let facts = &mut registration.configuration;
        facts.insert("crumple".to_owned(), release.to_owned());
        let plan = plan.registered_as(&registration);
        let folder = tempfile::tempdir().unwrap();
        plan.run(folder.path(), false, &Quiet)
            .unwrap()
            .certificate
            .unwrap()
    }

    fn confirm(certificate: &Certificate) -> Result<Confirmation, RerunError> {
        Rerun::new(certificate, &[], Controllers::default())?.confirm(BlockSelection::All, &Quiet)
    }

    fn registration(certificate: &mut Certificate) -> &mut Registration {
        match &mut certificate.statement {
            Statement::Rate(claim) => &mut claim.registration,
            other => panic!("{}", other.name()),
        }
    }

    #[test]
    fn counts_of_another_release_are_confirmed_but_never_refuted() {
        let genuine = count_as("0.0.1");
        assert!(confirm(&genuine).unwrap().is_complete());
        let mut changed = genuine.clone();
        let release = "0.0.2".to_owned();
        registration(&mut changed)
            .configuration
            .insert("crumple".to_owned(), release);
        let error = confirm(&changed).unwrap_err();
        assert!(
            matches!(&error, RerunError::OtherRelease { counting_release, .. } if counting_release == "0.0.2")
        );
        let mut changed = genuine;
        registration(&mut changed).confidence = 0.8;
        assert!(matches!(
            confirm(&changed),
            Err(RerunError::OtherRelease { .. })
        ));
        let mut changed = count_as(env!("CARGO_PKG_VERSION"));
        let Statement::Rate(claim) = &mut changed.statement else {
            panic!("a rate was counted");
        };
        claim.blocks[0].0 -= 1;
        assert!(matches!(confirm(&changed), Err(RerunError::Refuted { .. })));
    }
}
