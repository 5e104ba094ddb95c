//! Studies: long computations in a run folder. An interrupted study resumes, and ends with the same bytes as an
//! uninterrupted one.
//!
//! A kind of study implements [`Study`]: its configuration, its state between two steps, a step, and its results.
//! [`StudyFolder`] does the rest for all kinds: it opens or resumes the folder, makes the steps, writes the results and
//! marks the study as finished in one atomic change, and reads the report of a finished study.

use std::path::{Path, PathBuf};

use serde_json::Value;

use crumple_core::observer::Observer;
use crumple_core::old_names;
use crumple_core::text_file;

use crate::program::OTHER_BUILD_MESSAGE;
use crate::run_folder::{
    self, CompletedRun, FolderTransaction, MANIFEST_FILE, RunFolder, RunFolderError,
    RunFolderOptions, RunState,
};

/// Result of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StudyStep {
    /// Further steps follow.
    Continue,
    /// The last step is done.
    Done,
}

/// A long computation whose results depend on its configuration only.
pub trait Study {
    /// Kind, as a noun for readers.
    const KIND: &'static str;
    /// Name of the file with the configuration.
    const CONFIGURATION_FILE: &'static str;
    /// Names of all files, folders with a slash at the end. No files may be at these paths when a study starts.
    const OUTPUTS: &'static [&'static str];

    /// Everything that the next step needs of the steps before it.
    type State;
    /// Progress that an observer receives.
    type Progress;
    /// Results of a finished study.
    type Report;
    /// Reason why a study stops.
    type Error: From<RunFolderError>;

    /// Checks everything that would fail later, before any file is written.
    ///
    /// # Errors
    /// [`Self::Error`] if the configuration allows no study.
    fn check(&self) -> Result<(), Self::Error> {
        Ok(())
    }

    /// Returns everything that decides the results.
    ///
    /// # Errors
    /// [`Self::Error`] if it cannot be encoded.
    fn configuration(&self) -> Result<String, Self::Error>;

    /// Returns the text of the configuration file; `None` if the study has none. It is the configuration by default.
    ///
    /// # Errors
    /// [`Self::Error`] if it cannot be encoded.
    fn configuration_file(&self) -> Result<Option<String>, Self::Error> {
        self.configuration().map(Some)
    }

    /// Returns two texts of one form, whose first difference a refusal to resume names: the configuration file
    /// `existing` of another study, and that of this one. Values that do not decide the results are equal.
    ///
    /// # Errors
    /// [`Self::Error`] if the configuration cannot be encoded.
    fn compared_configurations(&self, existing: &str) -> Result<[String; 2], Self::Error> {
        Ok([existing.to_owned(), self.configuration()?])
    }

    /// Returns true if a finished study with the configuration `existing` has the results of this one. By default, only
    /// the version of crumple and the order of fields may differ.
    fn is_configured_by(&self, existing: &str) -> bool {
        let file = Self::CONFIGURATION_FILE;
        self.configuration()
            .is_ok_and(|asked| differs_in_version_only(file, existing, &asked))
    }

    /// Returns the name of a controller without an identity. Such a study cannot be resumed.
    fn unidentified_controller(&self) -> Option<&str> {
        None
    }

    /// Returns true if the folder has all results. A kind whose studies may grow compares their size, too.
    ///
    /// # Errors
    /// [`Self::Error`] if a file is damaged.
    fn is_finished(&self, folder: &RunFolder) -> Result<bool, Self::Error> {
        Ok(folder.is_complete())
    }

    /// Reads the state that earlier steps saved, or returns the initial state. Makes no steps.
    ///
    /// # Errors
    /// [`Self::Error`] if a file is damaged, or belongs to another study.
    fn load(&self, folder: &RunFolder) -> Result<Self::State, Self::Error>;

    /// Makes the next step, and saves its results from time to time. Without any step left, returns
    /// [`StudyStep::Done`].
    ///
    /// # Errors
    /// [`Self::Error`] if the step fails, a file cannot be written, or `observer` stops the study.
    fn step(
        &self,
        state: &mut Self::State,
        folder: &RunFolder,
        observer: &dyn Observer<Self::Progress>,
    ) -> Result<StudyStep, Self::Error>;

    /// Adds the results to the last change of the folder, and returns the report.
    ///
    /// # Errors
    /// [`Self::Error`] if the results cannot be computed or encoded, or `observer` stops the study.
    fn finish(
        &self,
        state: Self::State,
        folder: &RunFolder,
        results: &mut FolderTransaction<'_>,
        observer: &dyn Observer<Self::Progress>,
    ) -> Result<Self::Report, Self::Error>;

    /// Reads the report of a finished study.
    ///
    /// # Errors
    /// [`Self::Error`] if a file is damaged, or `observer` stops what a report computes besides.
    fn read(
        &self,
        folder: &RunFolder,
        observer: &dyn Observer<Self::Progress>,
    ) -> Result<Self::Report, Self::Error>;

    /// Runs the study in a folder: a new study, or with `resume` the rest of the one there. Only reads a finished one.
    ///
    /// # Errors
    /// [`Self::Error`] if the folder cannot be used, a step fails, or `observer` stops the study.
    fn run(
        &self,
        folder: &Path,
        resume: bool,
        observer: &dyn Observer<Self::Progress>,
    ) -> Result<Self::Report, Self::Error>
    where
        Self: Sized,
    {
        StudyFolder::open(self, folder, resume)?.run(observer)
    }
}

/// A study in its folder.
#[derive(Debug)]
pub struct StudyFolder<'a, S: Study> {
    study: &'a S,
    run_folder: RunFolder,
    progress: FolderProgress<S::State>,
}

#[derive(Debug)]
enum FolderProgress<State> {
    Unfinished(State),
    Finished,
}

impl<'a, S: Study> StudyFolder<'a, S> {
    /// Starts a study in a folder, which is created if necessary; with `resume`, continues the study there.
    ///
    /// # Errors
    /// [`Study::Error`] if the folder is in use, damaged, or has another study or one of another build, or if a
    /// controller has no identity and `resume` is set.
    pub fn open(study: &'a S, folder: &Path, resume: bool) -> Result<Self, S::Error> {
        if let Some(controller) = study.unidentified_controller().filter(|_| resume) {
            return Err(RunFolderError::NoIdentity {
                controller: controller.to_owned(),
                kind: S::KIND.to_owned(),
            }
            .into());
        }
        study.check()?;
        let run_folder = open_run_folder(study, folder, resume)?;
        if study.is_finished(&run_folder)? {
            return Ok(Self {
                study,
                run_folder,
                progress: FolderProgress::Finished,
            });
        }
        let state = study.load(&run_folder)?;
        if let Some(text) = study.configuration_file()? {
            run_folder.write(S::CONFIGURATION_FILE, text)?;
        }
        Ok(Self {
            study,
            run_folder,
            progress: FolderProgress::Unfinished(state),
        })
    }

    /// Returns the state; `None` if the study is finished.
    #[must_use]
    pub fn state(&self) -> Option<&S::State> {
        match &self.progress {
            FolderProgress::Unfinished(state) => Some(state),
            FolderProgress::Finished => None,
        }
    }

    /// Returns the path of a file.
    #[must_use]
    pub fn path(&self, name: &str) -> PathBuf {
        self.run_folder.path(name)
    }

    /// Makes the steps that are left and writes the results. Only reads a finished study.
    ///
    /// # Errors
    /// [`Study::Error`] if a step fails, a file cannot be written, or `observer` stops the study. The folder keeps the
    /// results of earlier steps.
    pub fn run(self, observer: &dyn Observer<S::Progress>) -> Result<S::Report, S::Error> {
        let Self {
            study,
            run_folder,
            progress,
        } = self;
        let mut state = match progress {
            FolderProgress::Finished => return study.read(&run_folder, observer),
            FolderProgress::Unfinished(state) => state,
        };
        while study.step(&mut state, &run_folder, observer)? == StudyStep::Continue {}
        let mut results = run_folder.transaction();
        let report = study.finish(state, &run_folder, &mut results, observer)?;
        results.finish()?;
        Ok(report)
    }
}

/// Opens the run folder of a study.
///
/// # Errors
/// [`Study::Error`] if it is in use, damaged, or has another study or one of another build.
pub fn open_run_folder<S: Study>(
    study: &S,
    folder: &Path,
    resume: bool,
) -> Result<RunFolder, S::Error> {
    let existing = if resume {
        existing_configuration(study, folder)
    } else {
        None
    };
    let configuration = existing.map_or_else(|| study.configuration(), Ok)?;
    let options = RunFolderOptions {
        kind: S::KIND,
        configuration: &configuration,
        configuration_file: S::CONFIGURATION_FILE,
        resume,
        outputs: S::OUTPUTS,
    };
    let opened = RunFolder::open(folder, options);
    Ok(opened.map_err(|error| {
        error.with_difference(|existing| study.compared_configurations(existing).ok())
    })?)
}

/// Returns the configuration of a finished study in a folder, if the study has its results.
#[must_use]
pub fn existing_configuration<S: Study>(study: &S, folder: &Path) -> Option<String> {
    match run_folder::read_state(folder) {
        Ok(RunState::Complete(finished)) if finished.kind() == S::KIND => {
            let existing = finished.read_configuration(S::CONFIGURATION_FILE).ok()?;
            study.is_configured_by(&existing).then_some(existing)
        }
        _ => None,
    }
}

/// Returns true if two configurations, in TOML or JSON as the name of their file says, are equal but for the version of
/// crumple and the order of fields.
fn differs_in_version_only(file: &str, existing: &str, asked: &str) -> bool {
    match (parse_fields(file, existing), parse_fields(file, asked)) {
        (Some(mut existing), Some(mut asked)) => {
            existing.remove(VERSION_FIELD);
            asked.remove(VERSION_FIELD);
            with_old_names(existing) == with_old_names(asked)
        }
        _ => false,
    }
}

/// Returns the fields with the old names. Applied to both sides of a comparison, no name is ambiguous.
fn with_old_names(fields: serde_json::Map<String, Value>) -> Value {
    let mut value = Value::Object(fields);
    for names in [old_names::TRAINING, old_names::SPACE, old_names::STUDY] {
        names.restore_in_value(&mut value);
    }
    value
}

/// Field with the version of crumple.
const VERSION_FIELD: &str = "crumple";

/// Parses the fields of a configuration. Those of a registration are in a table of their own.
fn parse_fields(file: &str, text: &str) -> Option<serde_json::Map<String, Value>> {
    let path = Path::new(file);
    let fields: Value = if path
        .extension()
        .is_some_and(|extension| extension == "json")
    {
        text_file::parse_json(text, path).ok()?
    } else {
        text_file::parse_toml(text, path).ok()?
    };
    match fields {
        Value::Object(mut fields) => match fields.remove("configuration") {
            Some(Value::Object(inner)) => {
                fields.extend(inner);
                Some(fields)
            }
            Some(_) => None,
            None => Some(fields),
        },
        _ => None,
    }
}

/// Opens a finished study for reading, without a lock. `command` is the command that makes such studies.
///
/// # Errors
/// [`RunFolderError`] if the folder has no finished study of this kind, or its manifest is damaged.
pub fn open_finished<S: Study>(
    folder: &Path,
    command: &str,
) -> Result<CompletedRun, RunFolderError> {
    let kind = S::KIND;
    let problem = match run_folder::read_state(folder)? {
        RunState::Missing => format!("the folder holds no {kind}"),
        RunState::InProgress {
            kind: run_kind,
            is_of_this_build,
        } if run_kind == kind => {
            let advice = if is_of_this_build {
                format!("`{command} --resume` completes it")
            } else {
                OTHER_BUILD_MESSAGE.to_owned()
            };
            format!("the {kind} is not complete: {advice}")
        }
        RunState::Complete(finished) if finished.kind() == kind => return Ok(finished),
        RunState::InProgress { kind: run_kind, .. } => {
            return Err(other_kind(folder, run_kind, kind));
        }
        RunState::Complete(finished) => {
            return Err(other_kind(folder, finished.kind().to_owned(), kind));
        }
    };
    Err(RunFolderError::NotFinished {
        folder: folder.to_owned(),
        problem,
    })
}

fn other_kind(folder: &Path, run_kind: String, kind: &str) -> RunFolderError {
    RunFolderError::OtherKind {
        path: folder.join(MANIFEST_FILE),
        found: run_kind,
        kind: kind.to_owned(),
    }
}
