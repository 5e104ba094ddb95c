//! The context of gathering evidence: its cache and its progress.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::cache::EvidenceCache;
use super::{AssessError, AssessmentPlan};
use crumple_core::observer::ProgressCounter;
use crumple_sim::engine::NamedController;

/// The plan, the cache and the progress counter of evidence that is being gathered.
pub(super) struct GatherContext<'a> {
    pub(super) plan: &'a AssessmentPlan,
    pub(super) cache: &'a EvidenceCache,
    runs: ProgressCounter<'a>,
}

impl<'a> GatherContext<'a> {
    pub(super) fn new(
        plan: &'a AssessmentPlan,
        cache: &'a EvidenceCache,
        runs: ProgressCounter<'a>,
    ) -> Self {
        Self { plan, cache, runs }
    }

    /// Fails if a controller contradicted itself or can no longer be started.
    pub(super) fn ensure_all_trusted(&self) -> Result<(), AssessError> {
        Ok(self
            .plan
            .controllers
            .iter()
            .try_for_each(NamedController::ensure_trusted)?)
    }

    /// Calls [`EvidenceCache::get_or_gather`], but caches nothing if the observer stops the assessment: runs may be
    /// incomplete. Nor is evidence of a controller that is refused meanwhile cached or reported.
    pub(super) fn get_or_gather<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        inputs: &impl Serialize,
        gather: impl FnOnce() -> Result<T, AssessError>,
    ) -> Result<T, AssessError> {
        self.cache.get_or_gather(name, inputs, || {
            let evidence = gather()?;
            self.add_runs(0)?;
            self.ensure_all_trusted()?;
            Ok(evidence)
        })
    }

    /// Adds to the number of completed runs; fails if the observer stops the assessment.
    pub(super) fn add_runs(&self, runs: u64) -> Result<(), AssessError> {
        Ok(self.runs.add(runs)?)
    }
}
