//! `crumple fit`: fits a scenario space to recorded episodes.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs::Metadata;
use std::io::{self, BufReader, Read};
use std::path::{Path, PathBuf};

use clap::Args;
use clap::builder::{PathBufValueParser, TypedValueParser};
use serde_json::json;

use super::import::{load_map, parse_min_brake, render_figure};
use super::output_folder::stage_unless_edited;
use super::output_format::OutputFormat;
use super::progress::read_bar;
use super::simulate::path_ending_in;
use super::{CliError, args, output, value_enums};
use crumple_core::digits;
use crumple_core::quoting::TerminalText;
use crumple_core::regular_file;
use crumple_evidence::fit::{
    EpisodeCollector, EpisodeSample, ExtractionConfig, FamilyFit, FittedFeature, FittedSize,
    FittedSpace, MAX_VEHICLES, fit, format_p_value,
};
use crumple_exchange::recording::{LeaderSelection, load_parts, merge_dropped};
use crumple_report::figures;
use crumple_spaces::file;
use crumple_store::disk::StagedFiles;

/// Fit a scenario space to the braking episodes of recordings
#[derive(Args)]
#[command(after_long_help = "\
Reads the same recordings as `crumple import` and describes each braking episode by these parameters: the leader's \
initial speed, its mean deceleration over its hardest second, the share of its speed that it keeps, and for each \
follower the speed relative to the leader and the time gap. Each parameter gets the most likely of five families \
(uniform, normal, log-normal, gamma, Weibull), truncated to the values that a scenario may have. Leaders that stop \
have a separate probability, as have lorries if the recordings state lengths. A Gaussian copula models the \
dependence of the parameters. The space is a file for `falsify`, `verify rate` and assessments. \
Searches stay inside the region with 99.99 % of the fitted distribution (`search_share` in the file; without it, they \
use the whole ranges). The file also states the \
driving time and distance of the recordings, so that failures can be given per hour and per 1000 km, and the \
parameters of the episodes, so that they can be resampled (docs/fitting.md).

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
    /// Vehicles of a scenario, including the leader: 2 to 5. Episodes with fewer are ignored; of more, the first ones
    /// count
    #[arg(long, value_name = "N", default_value_t = 2)]
    #[arg(value_parser = args::whole_number::<u8>(2..=MAX_VEHICLES as u64))]
    vehicles: u8,
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

fn space_path() -> impl TypedValueParser<Value = PathBuf> {
    PathBufValueParser::new().try_map(|path| match path.extension() {
        Some(extension) if extension == "toml" => Ok(path),
        _ => Err("must end in .toml"),
    })
}

/// Refuses recordings with the content of another one, which would count episodes and hours twice and understate the
/// uncertainty.
pub(super) fn ensure_distinct(recordings: &[PathBuf]) -> Result<(), CliError> {
    let mut by_length: BTreeMap<u64, Vec<&PathBuf>> = BTreeMap::new();
    for path in recordings {
        // A pipe has no content yet.
        let Some(length) = path
            .metadata()
            .ok()
            .filter(Metadata::is_file)
            .map(|file| file.len())
        else {
            continue;
        };
        let known = by_length.entry(length).or_default();
        if let Some(other) = known
            .iter()
            .find(|other| have_same_content(path, other).unwrap_or(false))
        {
            return Err(CliError::at(
                path,
                format!(
                    "this recording is given twice: {} is equal",
                    other.display()
                ),
            ));
        }
        known.push(path);
    }
    Ok(())
}

fn have_same_content(a: &Path, b: &Path) -> io::Result<bool> {
    let bytes = |path: &Path| -> io::Result<_> {
        Ok(BufReader::new(regular_file::open(path)?)
            .bytes()
            .map_while(Result::ok))
    };
    Ok(bytes(a)?.eq(bytes(b)?))
}

impl Fit {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let map = self.map.as_deref().map(load_map).transpose()?;
        let taken = ExtractionConfig {
            vehicles: usize::from(self.vehicles),
            min_brake: parse_min_brake(self.min_brake)?,
            leaders: self.leaders,
        };
        ensure_distinct(&self.recordings)?;
        let mut collector = EpisodeCollector::new(taken).map_err(CliError::input)?;
        for path in &self.recordings {
            let (bar, progress) = read_bar(quiet);
            let (mut dropped, mut added) = (Vec::new(), Ok(()));
            let read = load_parts(path, map.as_ref(), Some(&progress), &mut |mut part| {
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
        let sample = collector.finish().map_err(CliError::input)?;
        let fitted = fit(&sample, &self.name, self.samples, self.seed).map_err(CliError::input)?;
        let text = file::to_toml(&fitted.space).map_err(CliError::input)?;
        let mut files = StagedFiles::default();
        stage_unless_edited(&mut files, &self.out, text.as_bytes(), self.force)?;
        if let Some(path) = &self.plot {
            stage_unless_edited(
                &mut files,
                path,
                &render_figure(&figures::draw_fit(&fitted), path)?,
                self.force,
            )?;
        }
        files.commit()?;
        output::print_result(self.format, &to_json(&sample, &fitted), || {
            format_fit(&sample, &fitted)
        })
    }
}

fn to_json(sample: &EpisodeSample, fitted: &FittedSpace) -> serde_json::Value {
    json!({
        "space": fitted.space.name(),
        "exposure": sample.exposure,
        "waves": cluster_count(sample),
        "left_out": sample.exclusions,
        "numbers": fitted.features,
        "sizes": fitted.sizes,
        "depending": fitted.copula_parameters,
        "correlation": fitted.correlation,
    })
}

fn cluster_count(sample: &EpisodeSample) -> u32 {
    sample
        .observed
        .braking_clusters
        .iter()
        .max()
        .map_or(0, |last| last + 1)
}

fn format_fit(sample: &EpisodeSample, fitted: &FittedSpace) -> String {
    let mut text = String::new();
    let _ = write_fit(sample, fitted, &mut text);
    text
}

fn write_fit(sample: &EpisodeSample, fitted: &FittedSpace, out: &mut String) -> std::fmt::Result {
    let EpisodeSample {
        exposure,
        extraction: taken,
        exclusions: left_out,
        sizes,
        most_out_of_range: outside_by,
        ..
    } = sample;
    let clusters = cluster_count(sample);
    writeln!(
        out,
        "{} braking episodes in {clusters} waves, of {} vehicles",
        exposure.episodes, taken.vehicles
    )?;
    for source in &exposure.sources {
        let (name, hours, kilometres) =
            (TerminalText(&source.name), source.hours, source.kilometres);
        writeln!(
            out,
            "  {name}: {} episodes in {hours:.4} h, {kilometres:.2} km of following",
            source.episodes
        )?;
    }
    if exposure.undescribed_brakings > 0 {
        let all = exposure.episodes + exposure.undescribed_brakings;
        writeln!(
            out,
            "  of {all} brakings in these hours {} could be used",
            exposure.episodes
        )?;
    }
    let left_out = left_out.sentences(taken.vehicles);
    left_out
        .iter()
        .try_for_each(|words| writeln!(out, "  {words}"))?;
    if let Some(by) = outside_by {
        writeln!(out, "  Most often outside the ranges: {by}")?;
    }
    sizes
        .iter()
        .enumerate()
        .try_for_each(|(index, sizes)| writeln!(out, "  {}", sizes.sentence(index)))?;
    for number in &fitted.features {
        write_feature(number, out)?;
    }
    for FittedSize { name, values, .. } in &fitted.sizes {
        let each = values.iter().map(|value| {
            let [low, high] = value.interval_95;
            format!(
                "{:.1} m in {:.4} ({low:.4} to {high:.4})",
                value.at, value.probability
            )
        });
        writeln!(out, "\n{name}: {}", each.collect::<Vec<_>>().join(", "))?;
    }
    writeln!(
        out,
        "\ndependence of the parameters: correlations of the Gaussian copula"
    )?;
    for (name, row) in fitted.copula_parameters.iter().zip(&fitted.correlation) {
        let entries: Vec<_> = row.iter().map(|entry| format!("{entry:>6.2}")).collect();
        writeln!(out, "  {name:<18} {}", entries.join(" "))?;
    }
    writeln!(
        out,
        "\np-values: the share of {} samples of the fitted distribution, fitted again, that are at least as far from \
         their fit. They tend to be too large, because the same values chose the family. A Gaussian copula has no tail \
         dependence.",
        fitted
            .features
            .first()
            .map_or(0, |number| number.goodness.samples)
    )
}

fn write_feature(number: &FittedFeature, out: &mut String) -> std::fmt::Result {
    let FittedFeature {
        name,
        unit,
        point_mass,
        chosen,
        others,
        impossible,
        goodness,
        tails,
        sorted,
        ..
    } = number;
    let unit = if *unit == "1" { "" } else { unit };
    writeln!(
        out,
        "\n{name}: {}, {}",
        chosen.family.name(),
        format_estimates(chosen)
    )?;
    if let Some(point) = point_mass {
        let ([low, high], all) = (point.interval_95, sorted.len());
        writeln!(
            out,
            "  {} {unit} in {} of {all}: probability {:.4} ({low:.4} to {high:.4}); the fit describes the other \
             episodes",
            point.at, point.count, point.probability
        )?;
    }
    let (ks, cvm) = (goodness.kolmogorov_smirnov, goodness.cramer_von_mises);
    let (ks_p, cvm_p) = (
        format_p_value(goodness.kolmogorov_smirnov_p),
        format_p_value(goodness.cramer_von_mises_p),
    );
    writeln!(
        out,
        "  Kolmogorov-Smirnov {ks:.3}, p {ks_p}; Cramér-von Mises {cvm:.3}, p {cvm_p}"
    )?;
    writeln!(
        out,
        "  tails: {} below the smallest of {}, {:.3} {unit} ({} in the lowest tenth); {} beyond the largest, {:.3} \
         {unit} ({} in the highest)",
        digits::format_rounded(tails.below_smallest, 3),
        sorted.len() as u64 - point_mass.map_or(0, |point| point.count),
        tails.smallest,
        tails.in_lower_tenth,
        digits::format_rounded(tails.beyond_largest, 3),
        tails.largest,
        tails.in_upper_tenth
    )?;
    let row = |fit: &FamilyFit| format!("{} {:.1} / {:.1}", fit.family.name(), fit.aic, fit.bic);
    let rows: Vec<_> = std::iter::once(chosen).chain(others).map(row).collect();
    writeln!(out, "  AIC / BIC: {}", rows.join(", "))?;
    for (family, why) in impossible {
        writeln!(out, "  not {}: {why}", family.name())?;
    }
    Ok(())
}

fn format_estimates(fit: &FamilyFit) -> String {
    let of = |which: usize| {
        let estimate = format!("{} {:.4}", fit.parameter_names[which], fit.estimates[which]);
        match fit.intervals_95 {
            Some(intervals) => format!(
                "{estimate} ({:.4} to {:.4})",
                intervals[which][0], intervals[which][1]
            ),
            None => format!("{estimate} (no interval: the likelihood is flat, or at its limit)"),
        }
    };
    format!("{}, {}", of(0), of(1))
}
