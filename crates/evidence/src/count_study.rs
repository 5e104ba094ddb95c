//! A count as a study: `registration.json` before the first run, `progress.json` every second, `certificate.json` once
//! the checker accepts it, and the manifest `work.json`.

use std::time::{Duration, Instant};

use crumple_verify::{Certificate, Registration, Rejection, check};

use super::record::CountTally;
use super::{CountProgress, RateError, RatePlan};
use crumple_core::observer::Observer;
use crumple_store::run_folder::{FolderTransaction, RunFolder, RunFolderError, encode_json};
use crumple_store::study::{Study, StudyStep};

/// Interval between two writes of the tally.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

const REGISTRATION_FILE: &str = "registration.json";
const PROGRESS_FILE: &str = "progress.json";

/// Name of the certificate in the folder of a count.
pub const CERTIFICATE_FILE: &str = "certificate.json";

/// Reason why a count in a folder stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RateFolderError {
    /// The folder cannot be used, or a file in it is damaged.
    #[error(transparent)]
    RunFolder(#[from] RunFolderError),
    /// A run failed, or the observer stopped the count.
    #[error(transparent)]
    Run(#[from] RateError),
}

/// Results of a count.
#[derive(Debug)]
pub struct CountResult {
    /// Counts of all runs.
    pub tally: CountTally,
    /// Certificate that the checker accepts, or the reason why the counts prove nothing.
    pub certificate: Result<Certificate, Rejection>,
}

/// Counts so far, and the time when they were last written.
#[derive(Debug)]
pub struct CountState {
    tally: CountTally,
    written: Instant,
}

impl Study for RatePlan {
    const KIND: &'static str = "count";
    const CONFIGURATION_FILE: &'static str = REGISTRATION_FILE;
    const OUTPUTS: &'static [&'static str] = &[REGISTRATION_FILE, PROGRESS_FILE, CERTIFICATE_FILE];

    type State = CountState;
    type Progress = CountProgress;
    type Report = CountResult;
    type Error = RateFolderError;

    fn configuration(&self) -> Result<String, RateFolderError> {
        Ok(encode_json(REGISTRATION_FILE, self.registration())?)
    }

    fn load(&self, folder: &RunFolder) -> Result<CountState, RateFolderError> {
        Ok(CountState {
            tally: self
                .read_tally(folder)?
                .unwrap_or_else(|| self.empty_tally()),
            written: Instant::now(),
        })
    }

    fn step(
        &self,
        state: &mut CountState,
        folder: &RunFolder,
        observer: &dyn Observer<CountProgress>,
    ) -> Result<StudyStep, RateFolderError> {
        if state.tally.blocks.len() as u64 >= self.block_count() {
            return Ok(StudyStep::Done);
        }
        self.count_batch_observed(&mut state.tally, observer)?;
        if state.written.elapsed() > WRITE_INTERVAL {
            folder.write_json(PROGRESS_FILE, &state.tally)?;
            state.written = Instant::now();
        }
        Ok(StudyStep::Continue)
    }

    /// Writes the counts of all runs, and the certificate if the checker accepts it.
    fn finish(
        &self,
        state: CountState,
        _: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<CountProgress>,
    ) -> Result<CountResult, RateFolderError> {
        let tally = state.tally;
        observer
            .notify(&self.progress(&tally))
            .map_err(RateError::from)?;
        results.write_json(PROGRESS_FILE, &tally)?;
        let result = self.result(tally);
        if let Ok(certificate) = &result.certificate {
            results.write_json(CERTIFICATE_FILE, certificate)?;
        }
        Ok(result)
    }

    fn read(
        &self,
        folder: &RunFolder,
        observer: &dyn Observer<CountProgress>,
    ) -> Result<CountResult, RateFolderError> {
        let registration: Option<Registration> = folder.read_json(REGISTRATION_FILE)?;
        let plan = match &registration {
            Some(registration) => self.clone().registered_as(registration),
            None => self.clone(),
        };
        let tally = plan
            .read_tally(folder)?
            .ok_or_else(|| RunFolderError::missing(&folder.path(PROGRESS_FILE)))?;
        observer
            .notify(&plan.progress(&tally))
            .map_err(RateError::from)?;
        let result = plan.result(tally);
        let path = folder.path(CERTIFICATE_FILE);
        if result.certificate.is_ok() && !path.is_file() {
            return Err(RunFolderError::damaged(
                &path,
                "an earlier version counted here, and wrote no certificate if every run failed; count again into \
                 another folder",
            )
            .into());
        }
        Ok(result)
    }
}

impl RatePlan {
    fn read_tally(&self, folder: &RunFolder) -> Result<Option<CountTally>, RunFolderError> {
        let tally: Option<CountTally> = folder.read_json(PROGRESS_FILE)?;
        match tally {
            Some(tally) if !self.record().is_consistent(&tally) => Err(RunFolderError::damaged(
                &folder.path(PROGRESS_FILE),
                "belongs to another registration",
            )),
            tally => Ok(tally),
        }
    }

    /// Returns the certificate of a complete tally, if the checker accepts it.
    fn result(&self, tally: CountTally) -> CountResult {
        let certificate = self.certificate(&tally);
        CountResult {
            certificate: check(&certificate).map(|_| certificate),
            tally,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::rate_plan;
    use crumple_core::observer::Quiet;
    use crumple_store::run_folder::MANIFEST_FILE;
    use crumple_store::study::{StudyFolder, open_run_folder};
    use std::fs;
    use std::path::Path;

    fn plan(seed: u64) -> RatePlan {
        rate_plan("idm", None, ("paper", 1200), (seed, 0.9))
    }

    fn interrupted_folder(
        plan: &RatePlan,
        change: impl FnOnce(&mut CountTally),
    ) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        drop(StudyFolder::open(plan, folder.path(), false).unwrap());
        let mut tally = plan.empty_tally();
        plan.count_batch(&mut tally).unwrap();
        assert!(tally.runs < 1200, "one call does not count them all");
        change(&mut tally);
        let run_folder = open_run_folder(plan, folder.path(), true).unwrap();
        run_folder.write_json(PROGRESS_FILE, &tally).unwrap();
        folder
    }

    fn error(plan: &RatePlan, folder: &Path, resume: bool) -> String {
        let opened = StudyFolder::open(plan, folder, resume);
        opened.err().unwrap().to_string()
    }

    #[test]
    fn an_interrupted_count_ends_with_the_same_files() {
        let (plan, whole) = (plan(3), tempfile::tempdir().unwrap());
        plan.run(whole.path(), false, &Quiet).unwrap();
        let part = interrupted_folder(&plan, |_| ());
        let refused = error(&plan, part.path(), false);
        assert!(refused.contains("already holds a count: use --resume"));
        let refused = error(&self::plan(4), part.path(), true);
        let other = "registration.json: the count there has a different configuration: line ";
        assert!(refused.contains(other), "{refused}");
        plan.run(part.path(), true, &Quiet).unwrap();
        for name in [
            REGISTRATION_FILE,
            PROGRESS_FILE,
            CERTIFICATE_FILE,
            MANIFEST_FILE,
        ] {
            let read = |folder: &Path| fs::read_to_string(folder.join(name)).unwrap();
            assert_eq!(read(part.path()), read(whole.path()), "{name}");
        }
        let finished = StudyFolder::open(&plan, whole.path(), true).unwrap();
        assert!(finished.state().is_none());
        assert_eq!(finished.run(&Quiet).unwrap().tally.runs, 1200);
    }

    #[test]
    fn inconsistent_counts_are_not_resumed() {
        let plan = plan(3);
        let changes: [fn(&mut CountTally); 3] = [
            |tally| tally.runs = 1201,
            |tally| tally.failures = u64::MAX,
            |tally| tally.runs += 1,
        ];
        for change in changes {
            let folder = interrupted_folder(&plan, change);
            let error = error(&plan, folder.path(), true);
            assert!(
                error.ends_with("progress.json: belongs to another registration"),
                "{error}"
            );
        }
        let folder = interrupted_folder(&plan, |_| ());
        let path = folder.path().join(PROGRESS_FILE);
        let changed = fs::read_to_string(&path)
            .unwrap()
            .replace("\"runs\": 1", "\"runs\": 2");
        fs::write(&path, changed).unwrap();
        let error = error(&plan, folder.path(), true);
        assert!(
            error.ends_with("progress.json: has changed since it was written"),
            "{error}"
        );
    }

    /// Earlier versions wrote no certificate of such a count. A pool must not lose its seed without a message.
    #[test]
    fn a_count_without_the_certificate_of_its_failures_is_refused() {
        let plan = rate_plan("baseline", None, ("paper", 50), (1, 0.9));
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(
            plan.run(folder.path(), false, &Quiet)
                .unwrap()
                .tally
                .failures,
            50
        );
        let run_folder = open_run_folder(&plan, folder.path(), true).unwrap();
        fs::remove_file(folder.path().join(CERTIFICATE_FILE)).unwrap();
        let error = plan.read(&run_folder, &Quiet).unwrap_err();
        let message = error.to_string();
        assert!(
            message.contains("wrote no certificate if every run failed"),
            "{message}"
        );
    }
}
