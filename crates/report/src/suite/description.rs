//! What a run of a suite found, in words.

use crumple_suites::{
    ControllerResult, FailedPoint, ImpactLimit, Margin, MarginEnd, Prevention, SweepFailure, TestVerdict,
    WorstInTolerance,
};

/// A verdict in words.
pub(crate) fn describe_verdict(verdict: &TestVerdict) -> String {
    match verdict {
        TestVerdict::Passed => "PASSED".to_owned(),
        TestVerdict::Failed { time_s, impact_speed_mps } => {
            format!("FAILED, contact at {time_s:.2} s with {impact_speed_mps:.1} m/s")
        }
        TestVerdict::ControllerFailed { time_s, reason } => format!("CONTROLLER FAILED at {time_s:.2} s: {reason}"),
        TestVerdict::Refused { reason } => format!("REFUSED: {reason}"),
    }
}

/// Returns the verdict of a test in words. A test that passes at every stated point fails if the search within the clause fails.
pub(super) fn describe_outcome(tested: &ControllerResult) -> String {
    match &tested.worst_in_tolerance {
        Some(within) if tested.verdict.is_passed() && !tested.is_passed() => {
            format!(
                "FAILED within the ranges of the clause, though every stated point passes: {}",
                describe_verdict(&within.verdict)
            )
        }
        _ => describe_verdict(&tested.verdict),
    }
}

/// The contact at which a test passes nevertheless, in words.
pub(super) fn describe_impact_limit(limit: &ImpactLimit) -> String {
    let ImpactLimit { value, unit, origin, .. } = limit;
    format!("passes with a contact of at most {value} {unit} ({})", origin.label())
}

/// The worst point within the ranges of a clause, in words.
pub(crate) fn describe_worst_in_tolerance(within: &WorstInTolerance) -> String {
    let WorstInTolerance { point, verdict: found, min_gap_m, points_run: tried, .. } = within;
    let gap =
        min_gap_m.filter(|_| found.is_passed()).map_or(String::new(), |gap_m| format!(", smallest gap {gap_m:.2} m"));
    format!("worst of {tried} points that the clause allows: {}{gap}, at {point}", describe_verdict(found))
}

/// In each direction the least margin, in words, and of how many it is the least.
pub(crate) fn describe_min_margins(margins: &[Margin]) -> Vec<String> {
    let told = |(least, many): (&Margin, usize)| {
        let of = if many > 1 { format!(" (the least of {many})") } else { String::new() };
        describe_margin(least) + &of
    };
    min_margins(margins).into_iter().map(told).collect()
}

/// In each direction the least margin, and of how many it is the least.
pub(super) fn min_margins(margins: &[Margin]) -> Vec<(&Margin, usize)> {
    let mut directions: Vec<_> = margins.iter().map(|margin| (margin.parameter, margin.to)).collect();
    directions.dedup();
    let least = |&(push, to): &(_, f64)| {
        let along: Vec<_> = margins.iter().filter(|margin| (margin.parameter, margin.to) == (push, to)).collect();
        let less = |least, next| if passing_share(next) < passing_share(least) { next } else { least };
        Some((along.iter().copied().reduce(less)?, along.len()))
    };
    directions.iter().filter_map(least).collect()
}

/// The share of its direction that passes.
fn passing_share(margin: &Margin) -> f64 {
    match margin.end {
        MarginEnd::None { .. } => -1.0,
        MarginEnd::Holds { .. } => 1.0,
        MarginEnd::Boundary { passes_at, .. } => (passes_at - margin.from) / (margin.to - margin.from),
    }
}

/// A margin in words.
fn describe_margin(margin: &Margin) -> String {
    let Margin { parameter: push, unit, from, to, fixed_parameters: held, end } = margin;
    let held = if held.is_empty() { String::new() } else { format!(" at {held}") };
    let push = push.label();
    match end {
        MarginEnd::None { failure: beyond } => {
            format!("margin of {push}{held}: none, it {} at {from} {unit}", describe_beyond(*beyond))
        }
        MarginEnd::Holds { parts } => {
            format!("margin of {push}{held}: passes from {from} to {to} {unit} at the ends of {parts} parts")
        }
        MarginEnd::Boundary { passes_at, fails_at, failure: beyond, is_monotone, parts } => {
            let apart = (passes_at - fails_at).abs();
            // As many digits as tell the two apart.
            let digits = if apart > 0.0 { (1.0 - apart.log10().floor()).clamp(3.0, 9.0) as usize } else { 3 };
            let does = describe_beyond(*beyond);
            let words =
                format!("margin of {push}{held}: passes at {passes_at:.digits$}, {does} at {fails_at:.digits$} {unit}");
            match is_monotone {
                true => words,
                false => {
                    format!("{words}: the first end found on {parts} parts to {to} {unit}, and it passes again beyond")
                }
            }
        }
    }
}

/// What a test does where it does not pass.
fn describe_beyond(beyond: SweepFailure) -> &'static str {
    match beyond {
        SweepFailure::Fails => "fails",
        SweepFailure::Refused => "cannot be run",
    }
}

/// Who could have prevented a failure, in words.
pub(crate) fn describe_preventability(failed: &FailedPoint) -> String {
    let mut words: Vec<_> =
        failed.references.iter().map(|run| format!("{} {}", run.driver, describe_prevention(run.prevention))).collect();
    words.extend(failed.avoidability.describe());
    words.join("; ")
}

/// What a reference driver does, in words.
pub(super) fn describe_prevention(prevention: Prevention) -> &'static str {
    match prevention {
        Prevention::Prevents => "prevents it",
        Prevention::Collides => "collides",
        Prevention::DoesNotReact => "does not react",
    }
}
