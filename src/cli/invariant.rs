//! `crumple verify invariant`: computes a set of states from which a controller never collides with its leader.

use std::path::PathBuf;

use super::global_options::GlobalOptions;
use clap::{Args, ValueEnum};
use crumple_core::observer::Listener;
use crumple_verify::invariant::MotionModel;
use crumple_verify::{WorkLimit, check_with};
use indicatif::ProgressBar;

use super::output;
use super::output_format::OutputFormat;
use super::reach::write_certificate;
use super::simulate::path_ending_in;
use super::{CliError, args, feature, progress};
use crumple_evidence::{
    InvalidBox, InvariantOptions, InvariantPlan, InvariantProgress, InvariantReport, InvariantSet,
    InvariantSpec, InvariantStage,
};
use crumple_report::figures::draw_invariant_set;
use crumple_sim::engine::NamedController;
use crumple_sim::scenario::Scenario;
use crumple_store::disk::StagedFiles;

/// Own speeds of a picture.
const PICTURE_LINES: u32 = 5;

/// Prove from which states a controller never collides with the leader, for any duration
#[derive(Args)]
#[command(after_long_help = "\
The set is {gap >= h(own speed, leader's speed)}. crumple searches for the lowest h for which the controller, at each \
decision and for every leader within the limits, keeps the state in the set. The checker verifies each cell of h with \
outward rounding. The claim covers the controller alone, its decision interval, and observations within the stated \
errors. It has no time limit, and ends if a speed leaves the stated range.

With the other defaults, the search for idm takes about 25 s of processor time with 140 cells, and 9 s with 70. If \
the region has no set, the command searches up to four smaller regions, which takes several times as long.

Controllers: idm, acc-aeb, policies and networks (F.onnx, F.zip, F.toml) without a history. With --plant relative, \
the state is the gap and the closing speed alone, and the network must have no other inputs.

Exit code 1 if no set is found.

Examples:
  crumple verify invariant --controller idm --certificate idm.json
  crumple verify invariant --controller two-inputs.toml --plant relative --speed -20..20 \\
    --leader-accel 0..0")]
pub(super) struct InvariantCommand {
    /// Controller: idm, acc-aeb, with settings or without, a policy, or a network
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Scenario with the limits of the vehicle under test, the time step and the plant
    #[arg(long, value_name = "S", default_value = "paper-1")]
    scenario: PathBuf,
    /// Model of motion
    #[arg(long, value_enum, default_value = "absolute")]
    plant: InvariantPlant,
    /// Largest gap of the region, in metres
    #[arg(long, value_name = "M", default_value_t = 100.0, value_parser = |text: &str| parse_up_to(text, 1e4))]
    gap: f64,
    /// Gap beyond which the claim ends, in metres, for controllers that are made for gaps up to this one; default: none
    #[arg(long, value_name = "M", value_parser = args::number)]
    end_beyond_gap: Option<f64>,
    /// Own speeds of the region in m/s; with --plant relative, closing speeds
    #[arg(long, value_name = "A..B", default_value = "0..35", allow_hyphen_values = true, value_parser = parse_range)]
    speed: [f64; 2],
    /// Leader's speeds of the region, in m/s; the leader is never faster
    #[arg(long, value_name = "A..B", default_value = "0..35", value_parser = parse_range)]
    leader_speed: [f64; 2],
    /// Accelerations of the leader, in m/s²
    #[arg(long, value_name = "A..B", default_value = "-7.5..3", allow_hyphen_values = true, value_parser = parse_range)]
    leader_accel: [f64; 2],
    /// Largest error of the observed gap, in metres
    #[arg(long, value_name = "M", default_value_t = 1e-9, value_parser = |text: &str| parse_up_to(text, 1e2))]
    gap_error: f64,
    /// Largest error of the observed speeds, in m/s
    #[arg(long, value_name = "MPS", default_value_t = 1e-9, value_parser = |text: &str| parse_up_to(text, 1e2))]
    speed_error: f64,
    /// Cells of each speed: 4 to 1000. With too few, the search can take long and find no set
    #[arg(long, value_name = "N", default_value_t = 140, value_parser = args::whole_number::<u32>(4..=1000))]
    cells: u32,
    /// Number of times that the check may divide a cell: 0 to 4
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = args::whole_number::<u32>(0..=4))]
    splits: u32,
    /// Smallest gap of the set, in metres
    #[arg(long, value_name = "M", default_value_t = 0.0, value_parser = |text: &str| parse_up_to(text, 1e4))]
    smallest_gap: f64,
    /// File for the certificate; a policy or network goes next to it; replaces an existing file
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// Picture of the smallest gaps against the closing speed, one line for each of five own speeds
    #[arg(long, value_name = "F.svg|F.png", value_parser = path_ending_in(["svg", "png"]))]
    plot: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum InvariantPlant {
    /// Own and leader's speed; no vehicle reverses
    Absolute,
    /// Gap and closing speed alone, without standstill
    Relative,
}

/// Parses `A..B` with A at most B.
fn parse_range(text: &str) -> Result<[f64; 2], String> {
    let (low, high) = text.split_once("..").ok_or("must be two numbers, A..B")?;
    let range = [low, high].map(|text| text.trim().parse::<f64>());
    match range {
        [Ok(low), Ok(high)] if low.is_finite() && high.is_finite() && low <= high => {
            Ok([low, high])
        }
        _ => Err("must be two finite numbers A..B, with A at most B".to_owned()),
    }
}

/// Returns the option that sets a field of the claim.
fn option_of(field: &str) -> &str {
    match field {
        "region_gap_m" => "--gap",
        "ends_beyond_gap_m" => "--end-beyond-gap",
        "leader_mps2" => "--leader-accel",
        "motion" => "--plant",
        "axes" | "table" => "--speed and --leader-speed",
        "scenario" => "--scenario",
        other => other,
    }
}

/// Parses a number from 0 to a limit.
fn parse_up_to(text: &str, most: f64) -> Result<f64, String> {
    let number = text
        .parse()
        .ok()
        .filter(|number| (0.0..=most).contains(number));
    number.ok_or_else(|| format!("must be a number from 0 to {most}"))
}

impl InvariantCommand {
    pub(super) fn run(self, global: GlobalOptions) -> Result<(), CliError> {
        let GlobalOptions { quiet, controllers } = global;
        let scenario = args::load_scenario(&self.scenario, controllers)?;
        let plan = InvariantPlan::new(
            self.controller.source.clone(),
            &scenario,
            self.spec(&scenario),
        )
        .map_err(|error| self.describe_refusal(error))?;
        let bar = progress::share_bar("", quiet);
        let observer = Listener(|now: &InvariantProgress| show_progress(&bar, now));
        let Some(set) = plan
            .search(self.options(), &observer)
            .map_err(|error| self.describe_refusal(error))?
        else {
            bar.finish_and_clear();
            return Err(CliError::Unmet(format!(
                "{}: no set found; try larger --cells, --splits or --smallest-gap",
                self.controller.name
            )));
        };
        bar.set_message("checking the proof");
        let accepted = check_with(&set.certificate, plan.policy_bytes(), WorkLimit::UNLIMITED)
            .map_err(|rejection| {
                CliError::Unmet(format!("the checker rejected the proof: {rejection}"))
            })?;
        bar.set_message("searching for a leader that defeats the controller");
        let defeat = plan
            .defeat(&set.table)
            .map_err(|error| self.describe_refusal(error))?;
        bar.finish_and_clear();
        let report = InvariantReport::new(&self.controller.name, &set, &accepted, defeat)
            .ok_or_else(|| CliError::Unmet("the checker proved another claim".to_owned()))?;
        self.write_files(&plan, &set)?;
        output::print_result(self.format, &report, || report.to_text())
    }
}

/// Shows the stage of a search and the share of it that is done.
fn show_progress(bar: &ProgressBar, now: &InvariantProgress) {
    let InvariantProgress {
        own_mps,
        stage,
        done,
        total,
    } = now;
    bar.set_length(*total as u64);
    bar.set_position(*done as u64);
    bar.set_message(match stage {
        InvariantStage::Simulate => format!("up to {own_mps:.2} m/s: simulating leaders"),
        InvariantStage::Raise { pass } => {
            format!("up to {own_mps:.2} m/s: raising the boundary, pass {pass}")
        }
    });
}

impl InvariantCommand {
    fn options(&self) -> InvariantOptions {
        InvariantOptions {
            cells: self.cells,
            splits: self.splits,
            smallest_gap_m: self.smallest_gap,
        }
    }

    /// Returns the limits and the region that the arguments state.
    fn spec(&self, scenario: &Scenario) -> InvariantSpec {
        let region_leader_mps = match self.plant {
            InvariantPlant::Absolute => self.leader_speed,
            InvariantPlant::Relative => [0.0; 2],
        };
        InvariantSpec {
            version: 1,
            scenario: scenario.spec().name.clone(),
            motion: match self.plant {
                InvariantPlant::Absolute => MotionModel::Absolute,
                InvariantPlant::Relative => MotionModel::Relative,
            },
            leader_mps2: self.leader_accel,
            observation_error: [self.gap_error, self.speed_error, self.speed_error],
            region_gap_m: self.gap,
            ends_beyond_gap_m: self.end_beyond_gap,
            region_own_mps: self.speed,
            region_leader_mps,
            controller: None,
        }
    }

    /// Describes an error with the option that caused it.
    fn describe_refusal(&self, error: InvalidBox) -> CliError {
        match error {
            InvalidBox::Controller(problem) => CliError::Input(format!("--controller: {problem}")),
            InvalidBox::Mapping(invalid) => {
                let field = self.controller.field_location(&invalid.field);
                CliError::Input(format!(
                    "--controller: {field}cannot be verified: {invalid}"
                ))
            }
            InvalidBox::Field(invalid) => CliError::Input(format!(
                "{}: {}",
                option_of(&invalid.field),
                invalid.problem
            )),
            other => CliError::input(other),
        }
    }

    /// Writes the certificate and the picture, if the arguments name their files.
    fn write_files(&self, plan: &InvariantPlan, set: &InvariantSet) -> Result<(), CliError> {
        if let Some(path) = &self.certificate {
            write_certificate(
                path,
                &set.certificate,
                plan.policy_bytes().unwrap_or_default(),
            )?;
        }
        if let Some(path) = &self.plot {
            let mut files = StagedFiles::default();
            let figure = draw_invariant_set(&self.picture_lines(set), self.gap);
            files.stage(
                &output::resolve_output_path(path)?,
                &feature::encode_figure(path, &figure)?,
            )?;
            files.commit()?;
        }
        Ok(())
    }

    /// Returns the boundary against the closing speed, for some own speeds.
    fn picture_lines(&self, set: &InvariantSet) -> Vec<(String, Vec<(f64, f64)>)> {
        let [own, leader] = *set.table.axes();
        let heights = |own_mps: f64, leader_mps: f64| set.table.height_at([own_mps, leader_mps]);
        if leader.cells == 0 {
            let points = (0..own.node_count()).map(|index| own.node(index));
            let points = points.filter_map(|speed| Some((speed, heights(speed, leader.low)?)));
            return vec![("any speed".to_owned(), points.collect())];
        }
        let [low, high] = [self.speed[0], self.speed[1].min(own.high)];
        let speeds = (1..=PICTURE_LINES)
            .map(|index| low + (high - low) * f64::from(index) / f64::from(PICTURE_LINES));
        speeds
            .map(|own_mps| {
                let speeds = (0..leader.node_count())
                    .rev()
                    .map(|index| leader.node(index));
                let points =
                    speeds.filter_map(|speed| Some((own_mps - speed, heights(own_mps, speed)?)));
                (format!("{own_mps:.1} m/s"), points.collect())
            })
            .collect()
    }
}
