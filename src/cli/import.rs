//! `crumple import`: recorded platoons become scenarios.

use std::ffi::OsStr;
use std::fs;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use clap::Args;

use super::Failure;
use super::output;
use crumple_search::disk::{self, DiskError, Files};
use crumple_world::quoted::Terminal;
use crumple_world::recording::{ImportOptions, Imported, MinBrake, import};

/// Turn braking episodes of recorded platoons into scenario files
#[derive(Args)]
#[command(after_long_help = "\
Reads two formats, told apart by their first line: OpenACC CSV (speeds and bumper-to-bumper spacings of a platoon), and \
car-following events (event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps). A braking episode is one \
in which the leader's speed drops by more than --min-brake times one second within one second. Followers start at the \
recorded gaps and speeds and are under test; only the last of three or more vehicles is driven by the baseline.

A recording may have 5 million rows, 20 million speeds and gaps, 200 vehicles or 100 000 events; more is refused, with the line. A \
scenario file that is there already is left alone if it is the same, and nothing is written if one is not, unless with --force.")]
pub(super) struct Import {
    /// Recordings
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Mean deceleration over one second that makes a braking episode, in m/s² [default: 1.3]
    #[arg(long, value_name = "A", allow_hyphen_values = true)]
    min_brake: Option<f64>,
    /// Folder for the scenario files; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "episodes")]
    out: PathBuf,
    /// Overwrite scenario files that are there and say something else, such as edited ones
    #[arg(long)]
    force: bool,
}

impl Import {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let min_brake = match self.min_brake {
            None => MinBrake::default(),
            Some(mps2) => MinBrake::new(mps2).map_err(|error| Failure::Input(format!("--min-brake: {error}")))?,
        };
        let imported = import(&self.recordings, &ImportOptions { min_brake })?;
        fs::create_dir_all(&self.out).map_err(DiskError::at(&self.out))?;
        let mut files = Files::default();
        for scenario in &imported.scenarios {
            let path = self.out.join(&scenario.file_name);
            let said = scenario.toml.as_bytes();
            let found = match disk::read(&path, said.len() as u64) {
                Err(error) if error.source.kind() == ErrorKind::FileTooLarge => Some(Vec::new()),
                found => found?,
            };
            match found {
                Some(found) if found == said => {}
                Some(_) if !self.force => return Err(edited(&path)),
                _ => files.stage(&output::place(&path)?, scenario.toml.as_bytes())?,
            }
        }
        files.commit()?;
        let others = self.other_scenarios(&imported)?;
        if others > 0 {
            let out = self.out.display();
            output::note(&format!("note: {out} also holds {others} scenario files that are not of this import"), quiet);
        }
        for dropped in &imported.dropped {
            output::note(&dropped.to_string(), quiet);
        }
        let mut text = String::new();
        for source in &imported.sources {
            let plural = if source.scenarios == 1 { "" } else { "s" };
            let (path, format) = (source.path.display().to_string(), source.format.name());
            text += &format!("{}: {} scenario{plural} ({format})\n", Terminal(&path), source.scenarios);
        }
        output::print(&text)
    }

    /// Scenario files in the folder that this import did not write, such as those of an earlier one with another threshold.
    fn other_scenarios(&self, imported: &Imported) -> Result<usize, Failure> {
        let entries = fs::read_dir(&self.out).map_err(DiskError::at(&self.out))?;
        let written = |name: &OsStr| imported.scenarios.iter().any(|scenario| OsStr::new(&scenario.file_name) == name);
        let is_scenario = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "toml");
        let others = entries.flatten().map(|entry| entry.path()).filter(is_scenario);
        Ok(others.filter(|path| path.file_name().is_some_and(|name| !written(name))).count())
    }
}

/// A file that is not what this import would write.
fn edited(path: &Path) -> Failure {
    let problem = "is there and says something else: use --force to overwrite it, or another --out";
    Failure::Input(format!("{}: {problem}", path.display()))
}
