//! `crumple suite map`: crash maps.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::simulate::OutputFormat;
use super::{CliError, args, feature, output, value_enums};
use crumple_report::suite::{draw_map, render_map_html, render_map_text};
use crumple_store::disk::StagedFiles;
use crumple_suites::{CrashMap, CrashMapSituation, CrashMapSpec, MapProblem};
use crumple_world::observation::EstimatorKind;
use crumple_world::sim::NamedController;

/// Draw a crash map: collisions of reference drivers and controllers over two parameters of a situation
#[derive(Args)]
#[command(after_long_help = "\
Every cell shows the scenario at its centre. Hatching marks collisions of a driver that never braked, since \
reference drivers react only to the situations that they model. Lines are closed forms: beyond the solid line even \
immediate full braking does not avoid the collision; the dashed line is that of r157-simple. On maps of cut-ins, \
dots are the rows of the AFGBV's table. A map may have 100 cells in each direction.

Maps are modelled on the documents and use a point-mass model in one lane: a result is no certification.

Examples:
  crumple suite map car-following --controller acc-aeb --controller policy --out following.svg
  crumple suite map cut-in-time --controller idm --own-speed 130 --out cut-in.html --out cut-in.svg
  crumple suite map cut-in-gap --controller idm --cells 12x8 --format json")]
pub(super) struct MapCommand {
    /// Situation
    #[arg(value_enum)]
    situation: MapKind,
    /// Controller in addition to the reference drivers (see `crumple list controllers`); may be repeated
    #[arg(long = "controller", value_name = "C", value_parser = args::parse_controller)]
    controllers: Vec<NamedController>,
    /// Estimator of the controllers; reference drivers use the true state
    #[arg(long, value_name = "ESTIMATOR", default_value = "kalman", value_parser = value_enums::estimator())]
    estimator: EstimatorKind,
    /// For car-following: initial time gap, 0.2 to 10 s [default: 1.5]
    #[arg(long, value_name = "S")]
    time_gap: Option<f64>,
    /// For cut-ins: speed of the vehicle under test, 30 to 250 km/h [default: 100]
    #[arg(long, value_name = "KM/H")]
    own_speed: Option<f64>,
    /// Horizontal and vertical number of cells, 2 to 100 each
    #[arg(long, value_name = "AxB", default_value = "24x18", value_parser = parse_cells)]
    cells: [usize; 2],
    /// Write the map to this file; may be repeated; replaces an existing file
    #[arg(long, value_name = "F.svg|F.png|F.html|F.json", value_parser = MapFile::parse)]
    out: Vec<MapFile>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum MapKind {
    /// The leader brakes: its deceleration and the initial speed of both vehicles
    CarFollowing,
    /// A slower vehicle cuts in: the speed difference and the gap at the cut-in
    CutInGap,
    /// A slower vehicle cuts in: the speed difference and the time to collision at the cut-in
    CutInTime,
}

/// A file, and the format of its extension.
#[derive(Clone)]
struct MapFile {
    path: PathBuf,
    kind: MapFileFormat,
}

#[derive(Clone, Copy)]
enum MapFileFormat {
    Svg,
    Png,
    Html,
    Json,
}

impl MapFile {
    fn parse(path: &str) -> Result<Self, String> {
        let kind = match Path::new(path).extension().and_then(|ending| ending.to_str()) {
            Some("svg") => MapFileFormat::Svg,
            Some("png") => {
                feature::PNG.require()?;
                MapFileFormat::Png
            }
            Some("html") => MapFileFormat::Html,
            Some("json") => MapFileFormat::Json,
            _ => return Err("must end in .svg, .png, .html or .json".to_owned()),
        };
        Ok(Self { path: PathBuf::from(path), kind })
    }
}

fn parse_cells(text: &str) -> Result<[usize; 2], String> {
    let pair = text.split_once('x').and_then(|(across, up)| Some([across.parse().ok()?, up.parse().ok()?]));
    pair.ok_or_else(|| "must be two numbers of cells, such as 24x18".to_owned())
}

impl MapCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let (time_gap_s, own_speed_kmph) = (self.time_gap.unwrap_or(1.5), self.own_speed.unwrap_or(100.0));
        let (situation, held) = match self.situation {
            MapKind::CarFollowing => (CrashMapSituation::CarFollowing { time_gap_s }, "--time-gap"),
            MapKind::CutInGap => (CrashMapSituation::CutInGap { own_speed_kmph }, "--own-speed"),
            MapKind::CutInTime => (CrashMapSituation::CutInTime { own_speed_kmph }, "--own-speed"),
        };
        for (option, is_given) in [("--time-gap", self.time_gap.is_some()), ("--own-speed", self.own_speed.is_some())] {
            if is_given && option != held {
                let map = situation.name();
                return Err(CliError::Input(format!("{option}: does not apply to {map}; use {held}")));
            }
        }
        let spec = CrashMapSpec::new(situation, self.cells).map_err(|problem| {
            let option = if matches!(problem, MapProblem::Cells(..)) { "--cells" } else { held };
            CliError::Input(format!("{option}: {problem}"))
        })?;
        let map = spec.run(&self.controllers, self.estimator).map_err(CliError::input)?;
        let mut files = StagedFiles::default();
        for picture in &self.out {
            files.stage(&output::resolve_output_path(&picture.path)?, picture.render(&map)?)?;
        }
        files.commit()?;
        output::print_result(self.format, &map, || render_map_text(&map))
    }
}

impl MapFile {
    fn render(&self, map: &CrashMap) -> Result<Vec<u8>, CliError> {
        Ok(match self.kind {
            MapFileFormat::Svg => draw_map(map).document().into_bytes(),
            MapFileFormat::Png => feature::render_png(&draw_map(map))?,
            MapFileFormat::Html => render_map_html(map).into_bytes(),
            MapFileFormat::Json => to_json(map)?.into_bytes(),
        })
    }
}

fn to_json(map: &CrashMap) -> Result<String, CliError> {
    Ok(serde_json::to_string(map).map_err(CliError::input)? + "\n")
}
