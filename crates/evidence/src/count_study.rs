//! A count in a run folder: `registration.json` before the first run, `progress.json` every second, `certificate.json`
//! once the checker accepts it, and the manifest `work.json`.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crumple_verify::{Certificate, Rejection, check};
use serde::Serialize;

use super::record::{CountRecord, CountTally};
use super::{CountProgress, RateError, RatePlan};
use crumple_core::observer::Observer;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::{RunFolder, RunFolderError, RunFolderOptions};

/// Checkpoint interval.
const WRITE_INTERVAL: Duration = Duration::from_secs(1);

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
    /// The checker rejects the certificate.
    #[error("the counts in {} prove nothing: {rejection} ({counts})", path.display())]
    Rejected {
        /// File of the counts.
        path: PathBuf,
        /// Summary of the counts.
        counts: String,
        /// Answer of the checker.
        rejection: Rejection,
    },
}

/// A count that is registered in a folder.
pub struct RateCount<'a> {
    run_folder: RunFolder,
    plan: &'a RatePlan,
    tally: CountTally,
}

const REGISTRATION_FILE: &str = "registration.json";
const PROGRESS_FILE: &str = "progress.json";
const CERTIFICATE_FILE: &str = "certificate.json";

impl RatePlan {
    /// Registers the plan in `folder`, which is created if necessary; with `resume`, continues the count there.
    ///
    /// # Errors
    /// [`RateFolderError`] if the folder cannot be used, or holds the count of another plan or build.
    pub fn register_in(
        &self,
        folder: &Path,
        resume: bool,
    ) -> Result<RateCount<'_>, RateFolderError> {
        let work = self.record().register_in(folder, resume)?;
        let tally = match work.read(PROGRESS_FILE)? {
            None => self.empty_tally(),
            Some(bytes) => {
                let tally: CountTally = serde_json::from_slice(&bytes).map_err(|problem| {
                    RunFolderError::damaged(&work.path(PROGRESS_FILE), problem.to_string())
                })?;
                if !self.record().is_consistent(&tally) {
                    return Err(RunFolderError::damaged(
                        &work.path(PROGRESS_FILE),
                        "belongs to another registration",
                    )
                    .into());
                }
                tally
            }
        };
        Ok(RateCount {
            run_folder: work,
            plan: self,
            tally,
        })
    }
}

impl CountRecord {
    fn register_in(&self, folder: &Path, resume: bool) -> Result<RunFolder, RateFolderError> {
        let path = folder.join(REGISTRATION_FILE);
        let registration = to_json(&path, &self.registration)?;
        let asked = RunFolderOptions {
            kind: "count",
            configuration: &registration,
            configuration_file: REGISTRATION_FILE,
            resume,
            outputs: &[REGISTRATION_FILE, PROGRESS_FILE, CERTIFICATE_FILE],
        };
        let work = RunFolder::open(folder, asked)?;
        work.write(REGISTRATION_FILE, registration)?;
        Ok(work)
    }

    /// Writes the counts of all runs, and the certificate if the checker accepts it.
    fn finish_in(
        &self,
        work: &RunFolder,
        tally: &CountTally,
    ) -> Result<Certificate, RateFolderError> {
        let path = work.path(PROGRESS_FILE);
        work.write(PROGRESS_FILE, to_json(&path, tally)?)?;
        let certificate = self.certificate(tally);
        let checked = check(&certificate);
        if checked.is_ok() {
            work.write(
                CERTIFICATE_FILE,
                to_json(&work.path(CERTIFICATE_FILE), &certificate)?,
            )?;
        }
        work.finish()?;
        match checked {
            Ok(_) => Ok(certificate),
            Err(rejection) => Err(RateFolderError::Rejected {
                path,
                counts: tally.summary(self.is_comparison()),
                rejection,
            }),
        }
    }
}

impl RateCount<'_> {
    /// Counts the remaining runs and writes the certificate. If `observer` stops the count, the folder keeps the tally.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run fails, a file cannot be written, the certificate is rejected, or the count is
    /// stopped.
    pub fn certify(
        &mut self,
        observer: &dyn Observer<CountProgress>,
    ) -> Result<Certificate, RateFolderError> {
        let path = self.run_folder.path(PROGRESS_FILE);
        let mut written = Instant::now();
        while (self.tally.blocks.len() as u64) < self.plan.block_count() {
            self.plan.count_batch_observed(&mut self.tally, observer)?;
            if written.elapsed() > WRITE_INTERVAL {
                self.run_folder
                    .write(PROGRESS_FILE, to_json(&path, &self.tally)?)?;
                written = Instant::now();
            }
        }
        observer
            .notify(&self.plan.progress(&self.tally))
            .map_err(RateError::from)?;
        self.plan.record().finish_in(&self.run_folder, &self.tally)
    }

    /// Returns the tally so far.
    #[must_use]
    pub fn tally(&self) -> &CountTally {
        &self.tally
    }

    /// Returns the path of the certificate.
    #[must_use]
    pub fn certificate_path(&self) -> PathBuf {
        self.run_folder.path(CERTIFICATE_FILE)
    }
}

fn to_json(path: &Path, value: &impl Serialize) -> Result<String, RunFolderError> {
    let text =
        serde_json::to_string_pretty(value).map_err(|error| DiskError::at(path)(error.into()))?;
    Ok(text + "\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::rate_plan;
    use crumple_core::observer::Quiet;
    use std::fs;

    fn plan(seed: u64) -> RatePlan {
        rate_plan("idm", None, ("paper", 1200), (seed, 0.9))
    }

    fn interrupted_folder(
        plan: &RatePlan,
        change: impl FnOnce(&mut CountTally),
    ) -> tempfile::TempDir {
        let folder = tempfile::tempdir().unwrap();
        let mut count = plan.register_in(folder.path(), false).unwrap();
        plan.count_batch(&mut count.tally).unwrap();
        assert!(
            count.tally().runs < 1200,
            "one call does not count them all"
        );
        change(&mut count.tally);
        count
            .run_folder
            .write(
                PROGRESS_FILE,
                to_json(Path::new(PROGRESS_FILE), count.tally()).unwrap(),
            )
            .unwrap();
        folder
    }

    #[test]
    fn an_interrupted_count_ends_with_the_same_files() {
        let (plan, whole) = (plan(3), tempfile::tempdir().unwrap());
        plan.register_in(whole.path(), false)
            .unwrap()
            .certify(&Quiet)
            .unwrap();
        let part = interrupted_folder(&plan, |_| ());
        let error = |plan: &RatePlan, resume| {
            plan.register_in(part.path(), resume)
                .err()
                .map(|error| error.to_string())
        };
        assert!(
            error(&plan, false)
                .unwrap()
                .contains("already holds a count: use --resume")
        );
        let other = "registration.json: the count there has a different configuration";
        assert!(
            error(&self::plan(4), true).unwrap().ends_with(other),
            "{:?}",
            error(&self::plan(4), true)
        );
        plan.register_in(part.path(), true)
            .unwrap()
            .certify(&Quiet)
            .unwrap();
        for name in [
            REGISTRATION_FILE,
            PROGRESS_FILE,
            CERTIFICATE_FILE,
            crumple_store::run_folder::MANIFEST_FILE,
        ] {
            let read = |folder: &Path| fs::read_to_string(folder.join(name)).unwrap();
            assert_eq!(read(part.path()), read(whole.path()), "{name}");
        }
        let read_again = plan.register_in(whole.path(), true).unwrap();
        assert_eq!(
            (read_again.run_folder.is_complete(), read_again.tally().runs),
            (true, 1200)
        );
    }

    #[test]
    fn counts_that_were_not_made_are_not_gone_on_with() {
        let plan = plan(3);
        let changes: [fn(&mut CountTally); 3] = [
            |tally| tally.runs = 1201,
            |tally| tally.failures = u64::MAX,
            |tally| tally.runs += 1,
        ];
        for change in changes {
            let folder = interrupted_folder(&plan, change);
            let error = plan
                .register_in(folder.path(), true)
                .err()
                .unwrap()
                .to_string();
            assert!(
                error.ends_with("progress.json: belongs to another registration"),
                "{error}"
            );
        }
        let folder = interrupted_folder(&plan, |_| ());
        let path = folder.path().join(PROGRESS_FILE);
        fs::write(
            &path,
            fs::read_to_string(&path)
                .unwrap()
                .replace("\"runs\": 1", "\"runs\": 2"),
        )
        .unwrap();
        let error = plan
            .register_in(folder.path(), true)
            .err()
            .unwrap()
            .to_string();
        assert!(
            error.ends_with("progress.json: has changed since it was written"),
            "{error}"
        );
    }
}
