//! Studies of subcommands: how to resume one, for the user who interrupts it.

use std::path::Path;

use super::{interrupt, output};
use crumple_store::study::{Study, StudyFolder};

/// Opens the folder of a study. If Ctrl-C interrupts the study, the program says how to resume it.
pub(super) fn open<'a, S: Study>(
    study: &'a S,
    folder: &Path,
    resume: bool,
    quiet: bool,
) -> Result<StudyFolder<'a, S>, S::Error> {
    output::note_nothing_to_resume(resume, folder, quiet);
    let opened = StudyFolder::open(study, folder, resume)?;
    if opened.state().is_some() {
        let results = format!("the results so far are in {}", folder.display());
        let hint = match study.unidentified_controller() {
            None => format!("{results}: the same command with --resume continues"),
            Some(_) => format!(
                "{results}; the controller states no identity, so the {} cannot resume",
                S::KIND
            ),
        };
        interrupt::set_exit_message(hint, quiet);
    }
    Ok(opened)
}
