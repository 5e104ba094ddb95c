//! `crumple describe`: metadata of external controller files. Starts no program and loads no library.

use std::path::{Path, PathBuf};

use clap::Args;

use super::error::is_caused_by_environment;
use super::output_format::OutputFormat;
use super::{CliError, describe_fmu, file_kind, output};
use crumple_controllers::controller_file::ControllerFileDraft;
use crumple_controllers::{Controllers, UnknownController};
use crumple_networks::network::{FoundStatistics, NetworkDescription, NetworkError, NetworkFile};

/// Inspect an ONNX/SB3 network and print a starter controller file, or inspect an FMU
#[derive(Args)]
#[command(after_long_help = "\
The command starts no program and loads no library, whatever the file is. For an FMU it lists the variables of \
modelDescription.xml.

For a model of Stable-Baselines3 it prints the algorithm, the spaces of observations and actions, and whether the \
model was trained with VecNormalize; for any network it prints the layers. The output is a controller file that \
runs, with this information as comments. No file of a network states which quantity each input is, in which order \
and unit, so the printed file has guesses: correct them before you rely on a result. It contains the path of the \
network as given here, which crumple reads relative to the folder of the controller file.

Examples:
  crumple describe ppo.zip
  crumple describe ppo.zip > ppo.toml
  crumple describe acc.onnx --format json
  crumple describe acc.fmu")]
pub(super) struct Describe {
    /// Network, F.onnx or F.zip of Stable-Baselines3, or FMU, F.fmu
    #[arg(value_name = "FILE")]
    file: PathBuf,
    /// Output format: text (for a network, a controller file with comments), or one JSON object
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

impl Describe {
    pub(super) fn run(self) -> Result<(), CliError> {
        let path = &self.file;
        if path.extension().is_some_and(|extension| extension == "fmu") {
            return describe_fmu::describe(path, self.format);
        }
        let network = NetworkFile::load(path).map_err(|error| self.not_a_network_error(&error))?;
        let statistics = FoundStatistics::find(&network, path);
        let file = path.display().to_string();
        let drives_as_it_is = is_controller(path);
        let draft = ControllerFileDraft {
            path: &file,
            network: &network,
            normalisation: statistics.normalisation.as_ref(),
            drives_as_it_is,
        };
        let controller_file = draft.to_toml();
        let description =
            NetworkDescription::new(file, &network, statistics, drives_as_it_is, controller_file);
        output::print_result(self.format, &description, || description.to_text())
    }

    /// Returns the error for a file that is not a network, with a note if crumple can drive with it directly.
    fn not_a_network_error(&self, error: &NetworkError) -> CliError {
        let path = self.file.display();
        let names_no_network = !NetworkFile::is_network(&self.file);
        match file_kind::detect(&self.file) {
            Some(what) => {
                CliError::Input(format!("{path}: is not an imported network, but {what}"))
            }
            None if names_no_network && is_controller(&self.file) => CliError::Input(format!(
                "{path}: is not an imported network, but a controller: use it with --controller of other commands"
            )),
            None if names_no_network => CliError::Input(format!(
                "{path}: `describe` takes a network (.onnx, or .zip for a model of Stable-Baselines3) or an FMU (.fmu)"
            )),
            None if is_caused_by_environment(error) => CliError::Environment(error.to_string()),
            None => CliError::input(error),
        }
    }
}

/// Returns true if the file is a controller. A program counts, and is not started.
fn is_controller(file: &Path) -> bool {
    matches!(
        Controllers::default().find(&file.to_string_lossy(), Path::new("")),
        Ok(_) | Err(UnknownController::StartRefused(_))
    )
}
