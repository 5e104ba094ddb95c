//! `crumple assess`: gather the evidence and write the report.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;

use super::output::{self, Files};
use super::{Failure, progress};
use crate::report::{Plan, assess};

/// Compare controllers and write the report: HTML, Markdown and JSON
#[derive(Args)]
#[command(after_long_help = "\
Without a file, every built-in controller on the paper's scenarios and 1000 draws of its distribution. The report also says what \
anyone could have made of each scenario (see avoid), the mildest lead braking that makes each controller collide (see \
worst-case), and what is proved of shields (see verify shield). A file says more:

  version = 1
  controllers = [\"baseline\", \"idm\"]   # the first is compared with all others
  estimator = \"kalman\"
  draws = 1000
  seed = 0
  scenarios = [\"episodes\"]            # scenario files, and folders of them, relative to this file")]
pub(super) struct Assess {
    /// What to assess; built-in defaults without it
    #[arg(value_name = "FILE.toml")]
    config: Option<PathBuf>,
    /// Folder for the report; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "crumple-report")]
    out: PathBuf,
}

impl Assess {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let plan = match &self.config {
            None => Plan::built_in(),
            Some(path) => Plan::load(path)?,
        };
        let bar = progress::bar("assessing", plan.runs(), quiet);
        let assessment = assess(&plan, &|done| bar.set_position(done)).map_err(Failure::input)?;
        bar.finish_and_clear();
        let page = self.out.join("assessment.html");
        fs::create_dir_all(&self.out).map_err(|source| Failure::environment(&self.out, source))?;
        let mut files = Files::default();
        files.stage(&page, assessment.html().as_bytes())?;
        files.stage(&self.out.join("assessment.md"), assessment.markdown().as_bytes())?;
        files.stage(&self.out.join("assessment.json"), assessment.json().map_err(Failure::input)?.as_bytes())?;
        files.commit()?;
        output::note(&format!("wrote {} (and .md, .json)", shown(&page)), quiet);
        output::print(&format!("{}\n", assessment.summary.paragraph))
    }
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}
