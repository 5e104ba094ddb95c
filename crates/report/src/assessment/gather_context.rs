//! Gathering evidence: where it is kept, and its progress.

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::AssessError;
use super::cache::EvidenceCache;
use crumple_core::observer::ProgressCounter;
use crumple_world::sim::NamedController;

/// Evidence being gathered.
pub(super) struct GatherContext<'a> {
    pub(super) cache: &'a EvidenceCache,
    runs: ProgressCounter<'a>,
    /// Whose runs they are.
    controllers: &'a [NamedController],
}

impl<'a> GatherContext<'a> {
    pub(super) fn new(store: &'a EvidenceCache, runs: ProgressCounter<'a>) -> Self {
        Self { cache: store, runs, controllers: &[] }
    }

    /// The same, of runs of these controllers: what was gathered with one that was refused on the way is neither kept nor told.
    pub(super) fn with_controllers(self, controllers: &'a [NamedController]) -> Self {
        Self { controllers, ..self }
    }

    /// Whether what was gathered says something of the controllers.
    pub(super) fn ensure_all_trusted(&self) -> Result<(), AssessError> {
        Ok(self.controllers.iter().try_for_each(NamedController::ensure_trusted)?)
    }

    /// Returns the evidence that [`Store::get`] returns. Evidence that was gathered while the observer stopped the assessment is not kept,
    /// because runs may have ended early.
    pub(super) fn get_or_gather<T: Serialize + DeserializeOwned>(
        &self,
        name: &str,
        inputs: &impl Serialize,
        gather: impl FnOnce() -> Result<T, AssessError>,
    ) -> Result<T, AssessError> {
        self.cache.get_or_gather(name, inputs, || {
            let found = gather()?;
            self.add_runs(0)?;
            self.ensure_all_trusted()?;
            Ok(found)
        })
    }

    /// So many runs more are done; an error if that is to be all.
    pub(super) fn add_runs(&self, runs: u64) -> Result<(), AssessError> {
        Ok(self.runs.add(runs)?)
    }
}
