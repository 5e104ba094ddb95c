//! `crumple import`: recorded platoons become scenarios.

use std::fs;
use std::path::PathBuf;

use clap::Args;

use super::Failure;
use super::output::{self, Files};
use crate::recording::{ImportOptions, MinBrake, RecordingError, import};

/// Turn braking episodes of recorded platoons into scenario files
#[derive(Args)]
#[command(after_long_help = "\
Reads two formats, told apart by their first line: OpenACC CSV (speeds and bumper-to-bumper spacings of a platoon), and \
car-following events (event,time_s,gap_m,follower_speed_mps,relative_speed_mps,leader_speed_mps). A braking episode is one \
in which the leader's speed drops by more than --min-brake times one second within one second. Followers start at the \
recorded gaps and speeds; who drives them is up to `crumple simulate`.")]
pub(super) struct Import {
    /// Recordings
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Mean deceleration over one second that makes a braking episode, in m/s² [default: 1.3]
    #[arg(long, value_name = "A")]
    min_brake: Option<f64>,
    /// Folder for the scenario files; made if it is not there
    #[arg(long, value_name = "DIR", default_value = "episodes")]
    out: PathBuf,
}

impl Import {
    pub(super) fn run(self, quiet: bool) -> Result<(), Failure> {
        let min_brake = match self.min_brake {
            None => MinBrake::default(),
            Some(mps2) => MinBrake::new(mps2).map_err(|error| Failure::Input(format!("--min-brake: {error}")))?,
        };
        let imported = import(&self.recordings, &ImportOptions { min_brake })?;
        fs::create_dir_all(&self.out).map_err(|source| Failure::environment(&self.out, source))?;
        let mut files = Files::default();
        for scenario in &imported.scenarios {
            files.stage(&self.out.join(&scenario.file_name), scenario.toml.as_bytes())?;
        }
        files.commit()?;
        for dropped in &imported.dropped {
            output::note(&dropped.to_string(), quiet);
        }
        let mut text = String::new();
        for source in &imported.sources {
            let plural = if source.scenarios == 1 { "" } else { "s" };
            let (path, format) = (source.path.display(), source.format.name());
            text += &format!("{path}: {} scenario{plural} ({format})\n", source.scenarios);
        }
        output::print(&text)
    }
}

impl From<RecordingError> for Failure {
    fn from(error: RecordingError) -> Self {
        Self::input(error)
    }
}
