//! `crumple fit`: fits a scenario space to recorded episodes.

use std::path::PathBuf;

use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};

use super::import::{load_map, parse_min_brake};
use super::output::stage_unless_edited;
use super::output_format::OutputFormat;
use super::progress::read_bar;
use super::simulate::path_ending_in;
use super::{CliError, args, feature, output, value_enums};
use crumple_evidence::fit::{
    EpisodeCollector, EpisodeSample, ExtractionConfig, FitError, FitOptions, FitReport,
    FittedSpace, MAX_VEHICLES, fit,
};
use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::{LeaderSelection, ensure_distinct, load_parts, merge_dropped};
use crumple_report::figures;
use crumple_sim::control::BuiltInController;
use crumple_spaces::file;
use crumple_store::disk::StagedFiles;

/// Fit a scenario space to the braking episodes of recordings
#[derive(Args)]
#[command(after_long_help = "\
Reads the same recordings as `crumple import` and describes each braking episode by these parameters: the leader's \
initial speed, its mean deceleration over its hardest second, the share of its speed that it keeps, and for each \
follower its speed divided by that of the first vehicle, and its time gap. Each parameter gets the most likely of five \
families (uniform, normal, log-normal, gamma, Weibull), truncated to its range (docs/fitting.md). Leaders that stop \
have a separate probability, and so do lorries if the recordings state lengths. A Gaussian copula models the \
dependence of the parameters. The space is a file for `falsify`, `verify rate` and assessments. Searches stay inside \
the region with 99.99 % of the fitted distribution (`search_share` in the file; without it, they use the whole \
ranges). The file also states the time and distance of following in the recordings, so that failures can be given per \
hour and per 1000 km, and the parameters of the episodes, so that they can be resampled (docs/fitting.md).

The fit requires 4 episodes for each parameter: 20 with two vehicles, 8 more for each further vehicle, and 4 more \
for each vehicle that is a car in some episodes and a lorry in others. At most 1000 recordings and 10 000 episodes.

Examples:
  crumple fit platoon.csv events.csv --out following.toml --plot following.svg
  crumple fit 01_tracks.csv --map highd --vehicles 3 --min-brake 2 --out three.toml
  crumple verify rate --controller idm --space following.toml --runs 10000")]
pub(super) struct Fit {
    /// Recordings
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Meanings of the columns: a file (docs/exchange.md), or openacc, car-following, highd, ngsim or sumo-fcd
    #[arg(long, value_name = "MAP.toml|NAME")]
    map: Option<PathBuf>,
    /// Vehicles whose braking makes an episode
    #[arg(long, default_value = "any", value_parser = value_enums::one_of(value_enums::LEADERS))]
    leaders: LeaderSelection,
    /// Mean deceleration over one second that makes a braking episode, in m/s²: above 0, below 12 [default: 1.3]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = args::number)]
    min_brake: Option<f64>,
    /// Vehicles of a scenario, including the leader: 2 to 5. The fit ignores episodes with fewer vehicles; of longer
    /// lines, it takes the first vehicles
    #[arg(long, value_name = "N", default_value_t = 2)]
    #[arg(value_parser = args::whole_number::<u8>(2..=MAX_VEHICLES as u64))]
    vehicles: u8,
    /// Driver of the last of three or more vehicles, with its settings: a built-in controller, also a fitted model of a
    /// production car (see `crumple list controllers`) [default: baseline]
    #[arg(long, value_name = "DRIVER", value_parser = parse_follower)]
    follower: Option<BuiltInController>,
    /// Name of the scenario space: 1 to 100 characters
    #[arg(long, value_name = "NAME", default_value = "fitted")]
    name: String,
    /// Samples for the goodness-of-fit test of each parameter: 19 to 9999
    #[arg(long, value_name = "N", default_value_t = 199, value_parser = args::whole_number::<u32>(19..=9999))]
    samples: u32,
    /// Seed of these samples
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = args::whole_number::<u64>(0..=u64::MAX))]
    seed: u64,
    /// File for the scenario space
    #[arg(long, value_name = "SPACE.toml", value_parser = space_path())]
    out: PathBuf,
    /// Plot observed and fitted values, one panel per parameter
    #[arg(long, value_name = "F.svg|F.png", value_parser = path_ending_in(["svg", "png"]))]
    plot: Option<PathBuf>,
    /// Overwrite an existing scenario space or plot with other contents
    #[arg(long)]
    force: bool,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

const DEFAULT_FOLLOWER: &str = "baseline";

fn parse_follower(text: &str) -> Result<BuiltInController, String> {
    match BuiltInController::parse(text) {
        Some(controller) => controller.map_err(|error| error.to_string()),
        None => Err("is no built-in controller (see `crumple list controllers`)".to_owned()),
    }
}

fn space_path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.extension() {
        Some(extension) if extension == "toml" => Ok(path),
        _ => Err("must end in .toml"),
    })
}

impl Fit {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let follower = self.follower()?;
        let map = self.map.as_deref().map(load_map).transpose()?;
        let extraction = ExtractionConfig {
            vehicles: usize::from(self.vehicles),
            min_brake: parse_min_brake(self.min_brake)?,
            leaders: self.leaders,
        };
        ensure_distinct(&self.recordings)?;
        let sample = self.collect_episodes(map.as_ref(), extraction, quiet)?;
        let options = FitOptions {
            name: self.name.clone(),
            follower,
            samples: self.samples,
            seed: self.seed,
        };
        let fitted = fit(&sample, &options).map_err(CliError::input)?;
        self.write_files(&fitted)?;
        let report = FitReport::new(&sample, &fitted);
        let object = report.to_json().map_err(CliError::input)?;
        output::print_result(self.format, &object, || report.to_text())
    }

    /// Returns the driver of the last of three or more vehicles; of two, the last one is under test.
    fn follower(&self) -> Result<BuiltInController, CliError> {
        match &self.follower {
            Some(_) if self.vehicles < 3 => Err(CliError::Input(
                "--follower: needs --vehicles 3 or more; of two vehicles, the last one is under test"
                    .to_owned(),
            )),
            Some(follower) => Ok(follower.clone()),
            None => parse_follower(DEFAULT_FOLLOWER).map_err(CliError::Input),
        }
    }

    fn collect_episodes(
        &self,
        map: Option<&RecordingMap>,
        extraction: ExtractionConfig,
        quiet: bool,
    ) -> Result<EpisodeSample, CliError> {
        let mut collector = EpisodeCollector::new(extraction).map_err(|error| match error {
            FitError::MinBrake { .. } => CliError::about("--min-brake", error),
            other => CliError::input(other),
        })?;
        for path in &self.recordings {
            let (bar, progress) = read_bar(quiet);
            let mut dropped = Vec::new();
            let mut added = Ok(());
            let read = load_parts(path, map, Some(&progress), &mut |mut part| {
                merge_dropped(&mut dropped, std::mem::take(&mut part.dropped));
                added = collector.add(&part);
                Ok(added.is_ok())
            });
            bar.finish_and_clear();
            read?;
            added.map_err(CliError::input)?;
            dropped
                .iter()
                .for_each(|dropped| output::note(&dropped.to_string(), quiet));
        }
        collector.finish().map_err(CliError::input)
    }

    /// Writes the space, and the plot if the arguments name its file.
    fn write_files(&self, fitted: &FittedSpace) -> Result<(), CliError> {
        let text = file::to_toml(&fitted.space).map_err(CliError::input)?;
        let mut files = StagedFiles::default();
        stage_unless_edited(&mut files, &self.out, text.as_bytes(), self.force)?;
        if let Some(path) = &self.plot {
            stage_unless_edited(
                &mut files,
                path,
                &feature::encode_figure(path, &figures::draw_fit(fitted))?,
                self.force,
            )?;
        }
        Ok(files.commit()?)
    }
}
