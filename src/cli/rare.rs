//! `crumple verify rate --rare`: estimates of rare failure rates, and their limits.

use std::fmt::Write;
use std::path::Path;

use super::output_format::OutputFormat;
use super::{CliError, exposure, interrupt, output, progress};
use crumple_core::digits;
use crumple_core::quoting::TerminalText;
use crumple_evidence::rare::{
    MAX_LEVELS, PILOT_FACTORS, RareEstimate, RareFolder, RarePlan, RareReport,
};

/// Estimates a rate, writes the estimate to `folder` and prints it. With `resume` it continues from the existing
/// results.
pub(super) fn estimate(
    plan: &RarePlan,
    resamples: u32,
    folder: &Path,
    resume: bool,
    format: OutputFormat,
    quiet: bool,
) -> Result<(), CliError> {
    let mut kept = plan.open_folder(folder, resume)?;
    let report = match kept.read_report()? {
        // The rate per hour requires estimates in resamples.
        Some(report) => {
            let bar = progress::counter("resampling", quiet);
            let report = progress::show(&bar, |observer| {
                kept.with_exposure(plan, report, resamples, observer)
            })?;
            if !kept.is_complete() {
                kept.write_report(&report)?;
            }
            report
        }
        None => {
            let report = run_estimate(plan, resamples, (&mut kept, folder), quiet)?;
            output::note(&format!("wrote {}", kept.path().display()), quiet);
            report
        }
    };
    output::print_result(format, &report, || format_report(&report))
}

/// Makes all runs of an estimate that are not in its folder.
fn run_estimate(
    plan: &RarePlan,
    resamples: u32,
    (kept, folder): (&mut RareFolder, &Path),
    quiet: bool,
) -> Result<RareReport, CliError> {
    interrupt::set_exit_message(resume_hint(plan, folder), quiet);
    let bar = progress::counter("placing levels", quiet);
    let pilot = progress::show(&bar, |observer| kept.run_pilot(plan, observer))?;
    let bar = progress::run_bar("climbing", pilot.planned_runs(), quiet);
    bar.inc(
        pilot.planned_runs() / plan.effort.repetitions.max(1) as u64 * kept.completed_repetitions(),
    );
    Ok(progress::show(&bar, |observer| {
        kept.estimate(plan, &pilot, resamples, observer)
    })?)
}

fn resume_hint(plan: &RarePlan, folder: &Path) -> String {
    match plan.controller.source.identity() {
        Some(_) => format!("the results so far are in {}: the same command with --resume continues", folder.display()),
        None => "the controller states no identity, so the work cannot resume: start again with a new --out".to_owned(),
    }
}

fn format_report(report: &RareReport) -> String {
    let mut text = String::new();
    let _ = write_report(report, &mut text);
    text
}

fn write_report(report: &RareReport, out: &mut String) -> std::fmt::Result {
    let RareReport {
        controller,
        space,
        estimator,
        seed,
        failure,
        estimate,
        effort,
        ..
    } = report;
    // Reports keep the wording of registrations, which are hashed.
    let failure = failure.replacen("vehicles touch", "collision", 1);
    writeln!(
        out,
        "{controller} in `{space}`: {}, estimator {}, seed {seed}",
        TerminalText(&failure),
        estimator.name()
    )?;
    if report.nondeterministic {
        writeln!(
            out,
            "  the controller declares that it is not deterministic: another run may give another estimate"
        )?;
    }
    let RareEstimate {
        probability,
        coefficient_of_variation,
        interval_95,
        repetitions,
        evaluations,
        levels,
        ..
    } = estimate;
    match (probability, coefficient_of_variation, interval_95) {
        (None, ..) if levels.len() == MAX_LEVELS => {
            writeln!(
                out,
                "  no failure after {MAX_LEVELS} levels, nor by any of {} pilots, each twice as large as the one \
                 before: no estimate, and no statement about the failure rate, since the levels may miss failures; \
                 more --samples may find them",
                PILOT_FACTORS.len()
            )?;
        }
        (None, ..) => {
            writeln!(
                out,
                "  no failure, and no further level: no estimate, and no proof that no failure exists"
            )?;
        }
        (Some(probability), Some(variation), Some([low, high])) => {
            writeln!(
                out,
                "  probability of a failure {}, coefficient of variation {variation:.2}",
                digits::format_rounded(*probability, 4)
            )?;
            // With one level, runs are only counted.
            let source = match levels.len() {
                1 => "Clopper-Pearson".to_owned(),
                _ => format!("from the spread of {} repetitions", repetitions.len()),
            };
            let [low, high] = [low, high].map(|end| digits::format_rounded(*end, 3));
            writeln!(out, "  95 % interval {low} to {high}, {source}")?;
        }
        (Some(_), ..) => {
            writeln!(
                out,
                "  none of {} repetitions reached a failure: estimate 0; use more --samples",
                repetitions.len()
            )?;
        }
    }
    if interval_95.is_none()
        && let Some([low, high]) = estimate.independent_interval(0.95)
    {
        let (failures, runs) = (estimate.independent_failures, estimate.independent_runs);
        let (low, high) = (
            digits::format_rounded(low, 3),
            digits::format_rounded_up(high, 4),
        );
        writeln!(
            out,
            "  {failures} of the {runs} initial random scenarios fail: between {low} and {high} at 95 %"
        )?;
    }
    let died = repetitions
        .iter()
        .filter(|estimate| **estimate == 0.0)
        .count();
    if died > 0 && died < repetitions.len() {
        writeln!(
            out,
            "  {died} of {} repetitions died out and count as 0; more --samples would help",
            repetitions.len()
        )?;
    }
    writeln!(
        out,
        "  estimate by multilevel splitting, neither a bound nor a certificate; {evaluations} runs"
    )?;
    if let Some(rate) = &report.exposure {
        out.push_str(&exposure::format_rate(rate));
    }
    let of_collisions = report.is_contact_failure();
    writeln!(
        out,
        "\n  {:>14} {:>13} {:>9} {:>7} {:>11}",
        if of_collisions {
            "smallest gap"
        } else {
            "robustness"
        },
        "probability",
        "share",
        "step",
        "acceptance"
    )?;
    for level in levels {
        let number =
            |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        let gap = match (level.step, of_collisions) {
            (None, true) => "collision".to_owned(),
            (None, false) => "failure".to_owned(),
            (Some(_), true) => format!("<= {:.3} m", level.margin),
            (Some(_), false) => format!("<= {:.3}", level.margin),
        };
        writeln!(
            out,
            "  {gap:>14} {:>13} {:>8.1} % {:>6} {:>11}",
            digits::format_rounded(level.probability, 4),
            100.0 * level.share,
            number(level.step),
            number(level.acceptance)
        )?;
    }
    if levels.len() == 1 && probability.is_some() {
        writeln!(
            out,
            "  not rare: a single level, direct count of {} runs",
            effort.samples * effort.repetitions
        )?;
    }
    Ok(())
}
