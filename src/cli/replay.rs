//! `crumple replay`: the commands of a controller on recorded drives, beside what the drivers did.

use std::fmt::Write;
use std::path::PathBuf;

use clap::Args;
use serde::Serialize;

use super::fit::ensure_distinct;
use super::import::{load_map, note_text_format, parse_min_brake};
use super::output_format::OutputFormat;
use super::{CliError, args, output, progress};
use crumple_core::digits::format_rounded;
use crumple_core::quoting::TerminalText;
use crumple_evidence::exposure::IntervalEstimate;
use crumple_exchange::recording::replay::{ReplayedBraking, ReplayedDrive, replay};
use crumple_exchange::recording::{HardestSearch, TextFormat, load_parts, merge_dropped};
use crumple_sim::engine::{NamedController, RunOptions};
use crumple_sim::observation::EstimatorKind;

/// Maximum number of brakings that the text lists; the hardest ones.
const MAX_LISTED: usize = 20;

/// Run a controller open loop on recorded drives: where and how hard it would brake
#[derive(Args)]
#[command(after_long_help = "\
Reads the same recordings as `crumple import`. The controller replaces each vehicle with a recorded leader. It \
observes the recorded gaps, speeds and accelerations, and its commands change nothing. Each braking that it would \
have begun is listed beside the driver's hardest braking until one second later. Braking is unnecessary as in \
assessments (docs/glossary.md): more than 2 m/s² beyond the deceleration that the vehicle ahead justifies. Rates have \
exact 95 % intervals of Poisson counts, which assume that unnecessary brakings are independent. Braking that would \
have prevented a situation does not show, because the recorded driver keeps the distance. A controller that would keep \
another distance can brake unnecessarily here and not where it drives itself.

Examples:
  crumple replay platoon.csv --controller acc-aeb
  crumple replay log.mf4 --map log.toml --controller aeb.toml --format json")]
pub(super) struct LogReplay {
    /// Recordings
    #[arg(required = true, value_name = "RECORDING")]
    recordings: Vec<PathBuf>,
    /// Controller: built-in (see `crumple list controllers`), a policy file, a network, a controller file (F.toml), or
    /// a command after `exec:`
    #[arg(long, value_name = "C", value_parser = args::parse_controller)]
    controller: NamedController,
    /// Meanings of the columns: a file (docs/exchange.md), or openacc, car-following, highd, ngsim or sumo-fcd
    #[arg(long, value_name = "MAP.toml|NAME")]
    map: Option<PathBuf>,
    /// Deceleration that counts as braking of the controller, in m/s² [default: 1.3]
    #[arg(long, value_name = "A", allow_hyphen_values = true, value_parser = args::number)]
    min_brake: Option<f64>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

#[derive(Serialize)]
struct ReplayReport {
    controller: String,
    min_brake_mps2: f64,
    drives: usize,
    hours: f64,
    kilometres: f64,
    brakings: Vec<BrakingReport>,
    unnecessary: UnnecessaryReport,
    /// Of the recorded drivers, for comparison.
    unnecessary_of_drivers: UnnecessaryReport,
}

#[derive(Serialize)]
struct BrakingReport {
    recording: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    event: Option<String>,
    vehicle: usize,
    from_s: f64,
    duration_s: f64,
    brake_mps2: f64,
    driver_brake_mps2: f64,
    speed_mps: f64,
    gap_m: f64,
}

/// Unnecessary brakings, with their rates and the exact intervals at 95 %.
#[derive(Serialize)]
struct UnnecessaryReport {
    count: u64,
    seconds: f64,
    per_hour: IntervalEstimate,
    /// None if the vehicles stand.
    #[serde(skip_serializing_if = "Option::is_none")]
    per_100_km: Option<IntervalEstimate>,
}

impl BrakingReport {
    fn new(recording: &str, drive: &ReplayedDrive, braking: &ReplayedBraking) -> Self {
        let &ReplayedBraking {
            from_s,
            duration_s,
            brake_mps2,
            driver_brake_mps2,
            speed_mps,
            gap_m,
        } = braking;
        let (recording, event, vehicle) = (
            recording.to_owned(),
            drive.event.clone(),
            drive.vehicle.number,
        );
        Self {
            recording,
            event,
            vehicle,
            from_s,
            duration_s,
            brake_mps2,
            driver_brake_mps2,
            speed_mps,
            gap_m,
        }
    }
}

impl LogReplay {
    pub(super) fn run(self, quiet: bool) -> Result<(), CliError> {
        let map = self.map.as_deref().map(load_map).transpose()?;
        let min_brake = parse_min_brake(self.min_brake)?.mps2();
        let options =
            RunOptions::new(self.controller.source.clone()).with_estimator(EstimatorKind::Truth);
        ensure_distinct(&self.recordings)?;
        let (mut drives, mut brakings, mut empty) = (Vec::new(), Vec::new(), Vec::new());
        for path in &self.recordings {
            let (bar, read_progress) = progress::read_bar(quiet);
            let name = path.display().to_string();
            let mut hardest = HardestSearch::default();
            let before = drives.len();
            let (mut dropped, mut text, mut replayed) = (Vec::new(), TextFormat::default(), Ok(()));
            let read = load_parts(path, map.as_ref(), Some(&read_progress), &mut |mut part| {
                merge_dropped(&mut dropped, std::mem::take(&mut part.dropped));
                hardest.add(&part);
                text = part.text.clone();
                let part_bar = progress::replay_bar(quiet);
                let advance = |done_s: f64, total_s: f64| {
                    part_bar.set_length(total_s as u64);
                    part_bar.set_position(done_s as u64);
                };
                replayed = replay(&part, &options, min_brake, &advance).map(|found| {
                    for drive in &found {
                        brakings.extend(
                            drive
                                .brakings
                                .iter()
                                .map(|braking| BrakingReport::new(&name, drive, braking)),
                        );
                    }
                    drives.extend(found);
                });
                part_bar.finish_and_clear();
                Ok(replayed.is_ok())
            });
            bar.finish_and_clear();
            read?;
            note_text_format(path, &text, quiet);
            dropped
                .iter()
                .for_each(|dropped| output::note(&dropped.to_string(), quiet));
            replayed.map_err(|error| CliError::at(path, error))?;
            if drives.len() == before {
                empty.push(format!("{name}: {}", hardest.finish()));
            }
        }
        args::ensure_trusted()?;
        if drives.is_empty() {
            let problem = format!(
                "no vehicle follows another for a second; {}",
                empty.join("; ")
            );
            return Err(CliError::NothingFound(problem));
        }
        let hours = drives.iter().map(|drive| drive.duration_s).sum::<f64>() / 3600.0;
        let kilometres = drives.iter().map(|drive| drive.distance_m).sum::<f64>() / 1000.0;
        let unnecessary = |which: usize| {
            let count = drives
                .iter()
                .map(|drive| drive.unnecessary[which].count as u64)
                .sum();
            UnnecessaryReport {
                count,
                seconds: drives
                    .iter()
                    .map(|drive| drive.unnecessary[which].time_s)
                    .sum(),
                per_hour: IntervalEstimate::poisson_rate(count, hours),
                per_100_km: (kilometres > 0.0)
                    .then(|| IntervalEstimate::poisson_rate(count, kilometres / 100.0)),
            }
        };
        let report = ReplayReport {
            controller: self.controller.name.clone(),
            min_brake_mps2: min_brake,
            drives: drives.len(),
            hours,
            kilometres,
            brakings,
            unnecessary: unnecessary(0),
            unnecessary_of_drivers: unnecessary(1),
        };
        output::print_result(self.format, &report, || format_report(&report))
    }
}

fn format_report(report: &ReplayReport) -> String {
    let mut text = String::new();
    let _ = write_report(report, &mut text);
    text
}

fn plural(count: u64) -> &'static str {
    if count == 1 { "" } else { "s" }
}

fn write_report(report: &ReplayReport, out: &mut String) -> std::fmt::Result {
    let ReplayReport {
        controller,
        min_brake_mps2,
        drives,
        hours,
        kilometres,
        brakings,
        ..
    } = report;
    let times = |count| format!("{count} time{}", plural(count));
    writeln!(
        out,
        "{drives} drive{} behind a leader: {hours:.3} h, {kilometres:.2} km",
        plural(*drives as u64)
    )?;
    let (name, count) = (TerminalText(controller), brakings.len());
    writeln!(
        out,
        "{name} would have braked {}, by at least {min_brake_mps2} m/s²",
        times(count as u64)
    )?;
    let mut hardest: Vec<_> = brakings.iter().collect();
    hardest.sort_by(|a, b| b.brake_mps2.total_cmp(&a.brake_mps2));
    if !hardest.is_empty() {
        writeln!(
            out,
            "  {:>6} {:>6} {:>6} {:>6} {:>7} {:>7}  vehicle",
            "m/s²", "driver", "for s", "m/s", "gap m", "from s"
        )?;
    }
    for one in hardest.iter().take(MAX_LISTED) {
        let BrakingReport {
            vehicle,
            from_s,
            duration_s,
            brake_mps2,
            driver_brake_mps2,
            speed_mps,
            gap_m,
            ..
        } = one;
        let event = one
            .event
            .as_ref()
            .map(|event| format!(", event {event}"))
            .unwrap_or_default();
        let place = format!("{vehicle}{event} of {}", one.recording);
        write!(
            out,
            "  {brake_mps2:>6.2} {driver_brake_mps2:>6.2} {duration_s:>6.2} {speed_mps:>6.2} {gap_m:>7.2}"
        )?;
        writeln!(out, " {from_s:>7.2}  {}", TerminalText(&place))?;
    }
    if count > MAX_LISTED {
        writeln!(out, "  {} more with --format json", count - MAX_LISTED)?;
    }
    for (who, found) in [
        ("controller", &report.unnecessary),
        ("drivers", &report.unnecessary_of_drivers),
    ] {
        let rate = |IntervalEstimate {
                        estimate,
                        lower,
                        upper,
                    }: &IntervalEstimate| {
            let [estimate, lower, upper] =
                [estimate, lower, upper].map(|value| format_rounded(*value, 3));
            format!("{estimate} ({lower} to {upper})")
        };
        let UnnecessaryReport {
            count,
            seconds,
            per_hour,
            per_100_km,
        } = found;
        let (per_hour, per_100_km) = (
            rate(per_hour),
            per_100_km.as_ref().map_or("not defined".to_owned(), rate),
        );
        writeln!(
            out,
            "unnecessary braking of the {who}, at any --min-brake: {}, {seconds:.2} s in all",
            times(*count)
        )?;
        writeln!(
            out,
            "  per hour {per_hour}, per 100 km {per_100_km}, at 95 %"
        )?;
    }
    Ok(())
}
