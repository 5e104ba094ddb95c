//! `crumple verify reach`: computes the share of a box of initial states from which a policy avoids collisions.

use std::path::{Path, PathBuf};

use clap::Args;
use crumple_core::observer::Listener;
use crumple_store::disk::StagedFiles;
use crumple_verify::{Certificate, WorkLimit, check_with};

use super::output;
use super::output_format::OutputFormat;
use super::{CliError, args, progress};
use crumple_core::text_file;
use crumple_evidence::{BoxSpec, InvalidBox, ReachPlan, ReachReport, VolumeShares};
use crumple_sim::engine::NamedController;
use crumple_store::output_folder::stage;

/// Prove from which part of a box of initial states a policy or a network avoids every collision
#[derive(Args)]
#[command(after_long_help = "\
crumple bounds the network, the vehicles and the follower's emergency brake for all members of a box at once, \
rounding included. It bisects undecided boxes up to --depth times and up to a million boxes; the rest stays \
undecided. The policy observes the true state, or values within the stated errors. The policy file is written \
next to the certificate; `crumple-verify` needs only these two files.

An imported network (F.onnx, F.zip, or a controller file F.toml) is written there as crumple read it. The \
certificate assumes that the source file means the same; `crumple check --policy F.onnx` reads the source again. The \
inputs must be sums and differences of present observations, each with offset, scale and limits: no time gaps, no \
history, no previous output.

A box is a file in TOML: `version = 1`, `scenario` (paper-1, or another built-in one with a leader that brakes, one \
vehicle under test and at most one behind it), and under `[ranges]` the changed values, each a number or \
`{ low = A, high = B }`: gap_ahead_m, gap_behind_m, leader_speed_mps, ego_speed_mps, follower_speed_mps, \
leader_brake_mps2, follower_brake_mps2, onset_s. `observation_error` may state the error of each of the eight inputs \
of a policy (docs/controllers.md); `leader_brakes_at_most_mps2 = B` replaces the leader's script by any braking of 0 \
to B in each step; `follower_drives = \"idm\"` (or `acc-aeb`, or either with settings, \
`{ idm = { time_headway_s = 1.2 } }`) is the follower's controller in place of the latched emergency brake. Exit code \
1 if no part of the box is verified.

Examples:
  crumple verify reach --controller policy --box paper-1 --depth 6 --certificate reach/paper-1.json
  crumple verify reach --controller acc.toml --box my-box.toml --certificate reach/acc.json")]
pub(super) struct ReachCommand {
    /// Policy (`policy`, or a policy file), or network (F.onnx, F.zip, F.toml)
    #[arg(long, value_name = "C", default_value = "policy", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Box of initial states: the built-in paper-1 or paper-2, or a file
    #[arg(long = "box", value_name = "BOX")]
    starts: PathBuf,
    /// Maximum number of bisections of one box: 0 to 40
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = args::whole_number::<u32>(0..=40))]
    depth: u32,
    /// File for the certificate; the policy or network goes next to it; replaces an existing file
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

pub(super) const BUILT_IN_BOXES: [(&str, &str); 2] = [
    ("paper-1", include_str!("boxes/paper-1.toml")),
    ("paper-2", include_str!("boxes/paper-2.toml")),
];

fn load_box_text(path: &Path) -> Result<String, CliError> {
    let built_in = BUILT_IN_BOXES
        .iter()
        .find(|(name, _)| Path::new(name) == path);
    match built_in {
        Some((_, text)) if !path.exists() => Ok((*text).to_owned()),
        None if path.extension().is_none() && !path.exists() => {
            let names = BUILT_IN_BOXES.map(|(name, _)| name).join(", ");
            Err(CliError::Input(format!(
                "--box: `{}` is neither a built-in box ({names}) nor a file",
                path.display()
            )))
        }
        _ => Ok(text_file::read_at_most(path, text_file::MAX_TOML_BYTES)?),
    }
}

impl ReachCommand {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let text = load_box_text(&self.starts)?;
        let plan = ReachPlan::new(
            self.controller.source.clone(),
            &BoxSpec::from_toml(&text, &self.starts)?,
        )
        .map_err(|error| self.describe_refusal(error, &text))?;
        let bar = progress::depth_line("cutting", u64::from(self.depth), quiet);
        let observer = Listener(|shares: &VolumeShares| {
            bar.set_position(u64::from(shares.depth));
            bar.set_message(shares.to_line());
        });
        let partition = plan
            .partition(self.depth, &observer)
            .map_err(|error| self.describe_refusal(error, &text))?;
        bar.finish_and_clear();
        let policy = plan.policy_bytes();
        let accepted = check_with(&partition.certificate, Some(policy), WorkLimit::UNLIMITED)
            .map_err(|rejection| {
                CliError::Unmet(format!("the checker rejected the proof: {rejection}"))
            })?;
        if let Some(path) = &self.certificate {
            write_certificate(path, &partition.certificate, policy)?;
        }
        let report = ReachReport::new(&self.controller.name, &self.starts, &partition, &accepted)
            .with_certificate(self.certificate.as_deref());
        let printed = output::print_result(self.format, &report, || report.to_text());
        CliError::verdict_first(self.check_verified(&report), printed)
    }

    /// Describes an error with the option or the line of the box that caused it.
    fn describe_refusal(&self, error: InvalidBox, text: &str) -> CliError {
        let file = self.starts.display();
        match error {
            InvalidBox::Field(invalid) => CliError::Input(format!(
                "{file}:{}: {invalid}",
                text_file::line_in_toml(text, &invalid.field)
            )),
            InvalidBox::Controller(problem) => CliError::Input(format!("--controller: {problem}")),
            InvalidBox::Mapping(invalid) => {
                let field = self.controller.field_location(&invalid.field);
                CliError::Input(format!(
                    "--controller: {field}cannot be verified: {invalid}"
                ))
            }
            other => CliError::Input(format!("{file}: {other}")),
        }
    }

    fn check_verified(&self, report: &ReachReport<'_>) -> Result<(), CliError> {
        if report.is_verified() {
            return Ok(());
        }
        let deeper = if report.is_undecided() {
            "; try a larger --depth"
        } else {
            ""
        };
        Err(CliError::Unmet(format!(
            "{}: no part of the box was verified{deeper}",
            self.starts.display()
        )))
    }
}

/// Writes a certificate, and its network file next to it. Keeps another network in that place.
pub(super) fn write_certificate(
    path: &Path,
    certificate: &Certificate,
    network: &[u8],
) -> Result<(), CliError> {
    let mut files = StagedFiles::default();
    let text = serde_json::to_string_pretty(certificate).map_err(CliError::input)? + "\n";
    files.stage(&output::resolve_output_path(path)?, text.as_bytes())?;
    if let Some((name, _)) = certificate.policy_reference() {
        let sibling = path.parent().unwrap_or(Path::new("")).join(name);
        let other =
            "is not the network of the certificate: move it, or write the certificate elsewhere";
        stage(&mut files, &sibling, network, |_| false, other)?;
    }
    Ok(files.commit()?)
}
