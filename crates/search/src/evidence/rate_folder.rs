//! A count in a folder: `registration.json` before the first run, `progress.json` after every block, `certificate.json` once the
//! checker has accepted it.

use std::path::{Path, PathBuf};

use crumple_verify::{Certificate, Registration, Rejection, check};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use super::{RateError, RatePlan, Tally};
use crate::disk::{self, DiskError};
use crate::program::{self, OTHER_BUILD};

/// Why a count in a folder stops.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RateFolderError {
    /// A file or folder cannot be read or written.
    #[error(transparent)]
    Disk(#[from] DiskError),
    /// A count is registered in the folder.
    #[error("{}: something is registered there: --resume goes on with it", path.display())]
    Taken {
        /// The registration.
        path: PathBuf,
    },
    /// Another count is registered in the folder.
    #[error("{}: something else was registered", path.display())]
    OtherRegistration {
        /// The registration.
        path: PathBuf,
    },
    /// What was counted is of another registration.
    #[error("{}: not of this registration, or counts of blocks that do not add up to it", path.display())]
    OtherTally {
        /// What was counted.
        path: PathBuf,
    },
    /// Another build of crumple counted the runs so far.
    #[error("{}: {OTHER_BUILD}", path.display())]
    OtherBuild {
        /// What was counted.
        path: PathBuf,
    },
    /// A file is not what a count leaves behind.
    #[error("{}: {problem}", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Which field, line and column.
        problem: serde_json::Error,
    },
    /// A run cannot be made.
    #[error(transparent)]
    Run(#[from] RateError),
    /// The checker does not accept what the counts would show.
    #[error("nothing is shown by {}: {rejection}", path.display())]
    Rejected {
        /// What was counted.
        path: PathBuf,
        /// What the checker says.
        rejection: Rejection,
    },
}

/// A count that is on record in a folder.
pub struct RateCount<'a> {
    plan: &'a RatePlan,
    folder: PathBuf,
    tally: Tally,
}

/// The file `progress.json`.
#[derive(Serialize, Deserialize)]
struct Counted {
    /// [`program::identity`] of the program that counted.
    #[serde(default)]
    program: String,
    #[serde(flatten)]
    tally: Tally,
}

impl RatePlan {
    /// Puts the plan on record in `folder`, which is made if it is not there; where `resume` says so, takes up what was counted
    /// there.
    ///
    /// # Errors
    /// [`RateFolderError`] if the folder cannot be used, or holds another count, or another build's.
    pub fn register_in(&self, folder: &Path, resume: bool) -> Result<RateCount<'_>, RateFolderError> {
        disk::make_folder(folder)?;
        let mut count = RateCount { plan: self, folder: folder.to_owned(), tally: self.tally() };
        let path = folder.join("registration.json");
        match read::<Registration>(&path) {
            Ok(None) => disk::write_json(&path, self.registration())?,
            _ if !resume => return Err(RateFolderError::Taken { path }),
            Ok(Some(found)) if found == *self.registration() => {}
            Ok(Some(_)) => return Err(RateFolderError::OtherRegistration { path }),
            Err(error) => return Err(error),
        }
        let path = count.progress_path();
        if let Some(Counted { program, tally }) = read(&path)?.filter(|_| resume) {
            if tally.registration_sha256 != count.tally.registration_sha256 || !self.is_sound(&tally) {
                return Err(RateFolderError::OtherTally { path });
            }
            // A count that is complete is no longer half done, and may be read.
            if tally.runs < self.registration().runs && program != program::identity()? {
                return Err(RateFolderError::OtherBuild { path });
            }
            count.tally = tally;
        }
        Ok(count)
    }
}

impl RateCount<'_> {
    /// Counts what is left, and writes the certificate. `progress` hears how many runs are done, before every block.
    ///
    /// # Errors
    /// [`RateFolderError`] if a run cannot be made, a file not written, or nothing is shown.
    pub fn certificate(&mut self, progress: &mut dyn FnMut(u64)) -> Result<Certificate, RateFolderError> {
        let path = self.progress_path();
        while self.tally.runs < self.plan.registration().runs {
            progress(self.tally.runs);
            self.plan.count_block(&mut self.tally)?;
            let program = program::identity()?.to_owned();
            disk::write_json(&path, &Counted { program, tally: self.tally.clone() })?;
        }
        let certificate = self.plan.certificate(&self.tally);
        check(&certificate).map_err(|rejection| RateFolderError::Rejected { path, rejection })?;
        disk::write_json(&self.certificate_path(), &certificate)?;
        Ok(certificate)
    }

    /// What has been counted so far.
    #[must_use]
    pub fn tally(&self) -> &Tally {
        &self.tally
    }

    /// Where the certificate goes.
    #[must_use]
    pub fn certificate_path(&self) -> PathBuf {
        self.folder.join("certificate.json")
    }

    fn progress_path(&self) -> PathBuf {
        self.folder.join("progress.json")
    }
}

fn read<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, RateFolderError> {
    let Some(bytes) = disk::read(path)? else { return Ok(None) };
    let damaged = |problem| RateFolderError::Damaged { path: path.to_owned(), problem };
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::RateConfig;
    use crumple_world::control::ControllerSpec;
    use crumple_world::observation::EstimatorKind;
    use crumple_world::scenario::space::built_in_space;
    use serde_json::Value;
    use std::fs;

    #[test]
    fn a_count_goes_on_only_in_the_build_that_began_it() {
        let plan = RatePlan::new(RateConfig {
            controllers: (ControllerSpec::named("idm").unwrap().into(), None),
            space: built_in_space("paper").unwrap(),
            seed: 3,
            estimator: EstimatorKind::Truth,
            runs: 200,
            confidence: 0.9,
        })
        .unwrap();
        let folder = tempfile::tempdir().unwrap();
        plan.register_in(folder.path(), false).unwrap().certificate(&mut |_| ()).unwrap();
        let path = folder.path().join("progress.json");
        let whole: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
        // What is said of the file when fields of it are others; `None` takes a field away.
        let error = |fields: &[(&str, Option<Value>)]| {
            let mut counted = whole.as_object().unwrap().clone();
            for (field, value) in fields {
                match value {
                    Some(value) => counted.insert((*field).to_owned(), value.clone()),
                    None => counted.remove(*field),
                };
            }
            fs::write(&path, serde_json::to_vec(&counted).unwrap()).unwrap();
            plan.register_in(folder.path(), true).err().map(|error| error.to_string())
        };
        let other = ("program", Some(Value::from("0".repeat(64))));
        let half = ("runs", Some(Value::from(100)));
        let blocks = ("blocks", Some(Value::from(vec![whole["blocks"][0].clone()])));
        let place = path.display();
        assert_eq!(error(std::slice::from_ref(&other)), None, "a complete count may be read");
        for part in [[other, half.clone(), blocks.clone()], [("program", None), half.clone(), blocks.clone()]] {
            assert_eq!(error(&part).unwrap(), format!("{place}: {OTHER_BUILD}"));
        }
        assert_eq!(error(&[half.clone(), blocks]), None);
        for unsound in [half, ("runs", Some(Value::from(201))), ("failures", Some(Value::from(7)))] {
            assert!(error(&[unsound]).unwrap().contains("not of this registration"));
        }
        let damaged = error(&[("runs", None)]).unwrap();
        assert!(damaged.starts_with(&format!("{place}: missing field `runs`")), "{damaged}");
        assert!(matches!(plan.register_in(folder.path(), false), Err(RateFolderError::Taken { .. })));
    }
}
