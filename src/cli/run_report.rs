//! Report of `crumple simulate` about a run: one line of JSON, or text.

use std::path::Path;

use serde::Serialize;

use crumple_core::quoting::TerminalText;
use crumple_measure::stl::FormulaPart;
use crumple_measure::{BrakeInstant, UnnecessaryBraking, UsefulnessMeasures};
use crumple_sim::engine::{Impact, Intervention, Outcome, SimulationResult, VehicleSummary};
use crumple_sim::scenario::{Driver, LaneChange, Scenario, VehicleSpec};

#[derive(Serialize)]
pub(super) struct RunReport<'a> {
    pub(super) scenario: &'a str,
    pub(super) controller: &'a str,
    pub(super) estimator: &'static str,
    pub(super) dt_s: f64,
    pub(super) seed: u64,
    /// Plant of the vehicles that a controller drives, if `--plant` sets it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) plant: Option<&'static str>,
    /// True if the controller declares that it is not deterministic.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub(super) nondeterministic: bool,
    pub(super) outcome: Outcome,
    pub(super) vehicles: &'a [VehicleSummary],
    pub(super) impacts: &'a [Impact],
    pub(super) vehicles_involved: usize,
    /// Lane changes, including scheduled ones that did not happen.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) lane_changes: Vec<LaneChanges>,
    #[serde(skip_serializing_if = "<[Intervention]>::is_empty")]
    pub(super) interventions: &'a [Intervention],
    /// One entry per vehicle under test.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    #[serde(rename = "braking_without_cause")]
    pub(super) unnecessary_braking: Vec<UnnecessaryBrakingReport>,
    /// Vehicles under test that are far slower than their leader at the end.
    #[serde(rename = "left_behind", skip_serializing_if = "Vec::is_empty")]
    pub(super) fell_behind: Vec<usize>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) specifications: Vec<SpecificationResult>,
}

#[derive(Serialize)]
pub(super) struct UnnecessaryBrakingReport {
    pub(super) vehicle: usize,
    #[serde(flatten)]
    pub(super) braking: UnnecessaryBraking,
}

#[derive(Serialize)]
pub(super) struct SpecificationResult {
    pub(super) specification: String,
    pub(super) satisfied: bool,
    /// Negative if and only if the specification is violated.
    #[serde(with = "crumple_core::non_finite")]
    pub(super) robustness: f64,
    /// The formula and its parts, of `--parts`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(super) parts: Vec<PartReport>,
}

/// Robustness of a part of a formula, at each step `dt_s` of the run.
#[derive(Serialize)]
pub(super) struct PartReport {
    depth: usize,
    formula: String,
    robustness: Vec<Robustness>,
    #[serde(skip)]
    pub(super) part: FormulaPart,
}

#[derive(Serialize)]
struct Robustness(#[serde(with = "crumple_core::non_finite")] f64);

impl From<FormulaPart> for PartReport {
    fn from(part: FormulaPart) -> Self {
        let robustness = part.robustness.iter().copied().map(Robustness).collect();
        Self {
            depth: part.depth,
            formula: part.formula.to_string(),
            robustness,
            part,
        }
    }
}

impl PartReport {
    /// Returns the least robustness, and the times between which the part is violated.
    fn describe(&self, step_s: f64) -> String {
        let time_s = |sample: usize| sample as f64 * step_s;
        let (sample, least) = self.part.least().unwrap_or_default();
        let is_violated = |value: &f64| *value < 0.0;
        let first = self.part.robustness.iter().position(is_violated);
        let last = self.part.robustness.iter().rposition(is_violated);
        let violated = match first.zip(last) {
            Some((first, last)) => format!(
                ", below 0 between {:.2} and {:.2} s",
                time_s(first),
                time_s(last)
            ),
            None => String::new(),
        };
        let (indent, formula) = ("  ".repeat(self.depth), &self.formula);
        format!(
            "    {indent}least {least:.3} at {:.2} s{violated}: {formula}",
            time_s(sample)
        )
    }
}

/// Times at which a vehicle entered and left the lane, in seconds; `None` for an event that did not happen.
#[derive(Serialize)]
pub(super) struct LaneChanges {
    vehicle: usize,
    entered_s: Option<f64>,
    left_s: Option<f64>,
}

pub(super) fn describe(report: &RunReport<'_>, scenario: &Scenario) -> String {
    let mut text = String::new();
    let RunReport {
        scenario: name,
        controller,
        estimator,
        dt_s,
        seed,
        ..
    } = report;
    let mut line = |line: String| {
        text += &format!("{}\n", TerminalText(line.trim_end()));
    };
    let plant = report
        .plant
        .map_or_else(String::new, |plant| format!(", plant {plant}"));
    line(format!(
        "{name}: {controller}, estimator {estimator}, dt {dt_s} s, seed {seed}{plant}"
    ));
    if report.nondeterministic {
        line("  the controller declares that it is not deterministic: another run may give another result".to_owned());
    }
    match &report.outcome {
        Outcome::ControllerFailed(failed) => line(format!("  CONTROLLER FAILED: {failed}")),
        _ if report.impacts.is_empty() => line("  no collision".to_owned()),
        _ => {}
    }
    for (index, impact) in report.impacts.iter().enumerate() {
        let contact = impact.contact;
        line(format!(
            "  {} at {:.2} s: vehicle {} hits vehicle {} at {:.1} m/s ({:.1} against {:.1} m/s)",
            if index == 0 { "COLLISION" } else { "then     " },
            contact.time_s,
            contact.rear_vehicle,
            contact.front_vehicle,
            contact.impact_speed_mps,
            contact.rear_speed_mps,
            contact.front_speed_mps
        ));
    }
    if report.impacts.len() > 1 {
        line(format!(
            "  {} of {} vehicles involved",
            report.vehicles_involved,
            report.vehicles.len()
        ));
    }
    for change in &report.lane_changes {
        line(format!("  {}", describe_lane_changes(change, scenario)));
    }
    for UnnecessaryBrakingReport { vehicle, braking } in &report.unnecessary_braking {
        if let Some(BrakeInstant {
            time_s,
            brake_mps2,
            justified_mps2: caused_mps2,
        }) = braking.hardest
        {
            line(format!(
                "  vehicle {vehicle} brakes unnecessarily for {:.2} s, hardest at {time_s:.2} s: {brake_mps2:.1} m/s² \
                 where {caused_mps2:.1} was necessary",
                braking.time_s
            ));
        }
    }
    for vehicle in &report.fell_behind {
        line(format!("  vehicle {vehicle} is left behind by its leader"));
    }
    for SpecificationResult {
        specification,
        satisfied,
        robustness,
        parts,
    } in &report.specifications
    {
        let verdict = if *satisfied { "holds" } else { "VIOLATED" };
        line(format!(
            "  {verdict}, robustness {robustness:.3}: {specification}"
        ));
        parts
            .iter()
            .for_each(|part| line(part.describe(report.dt_s)));
    }
    for index in 0..report.vehicles.len() {
        if let Some(message) = shield_line(report.interventions, index) {
            line(message);
        }
    }
    line(format!(
        "  {:>3}  {:<6} {:<20} {:>11} {:>11} {:>15}  {}",
        "#", "class", "driver", "min gap m", "min TTC s", "max brake m/s²", "at the end"
    ));
    for (index, (summary, vehicle)) in report.vehicles.iter().zip(scenario.vehicles()).enumerate() {
        let number =
            |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
        let driver = match &vehicle.driver {
            Driver::UnderTest => (*controller).to_owned(),
            Driver::Controller(spec) => spec.to_arg(),
            Driver::Profile(profile) => profile.name().to_owned(),
            Driver::File(file) => Path::new(file.path())
                .file_name()
                .unwrap_or_default()
                .to_string_lossy()
                .into_owned(),
        };
        line(format!(
            "  {index:>3}  {:<6} {driver:<20} {:>11} {:>11} {:>15}  {}",
            vehicle.class.name(),
            number(summary.min_gap_m),
            number(summary.min_ttc_s),
            number(Some(summary.max_brake_mps2)),
            if summary.stopped {
                "standing"
            } else {
                "moving"
            }
        ));
    }
    text
}

/// Describes a run in one line: its end, and everything that is wrong.
pub(super) fn describe_briefly(report: &RunReport<'_>) -> String {
    let end = match (&report.outcome, report.impacts.first()) {
        (Outcome::ControllerFailed(failed), _) => format!("CONTROLLER FAILED: {failed}"),
        (_, Some(Impact { contact, .. })) => format!(
            "COLLISION at {:.2} s: vehicle {} hits vehicle {} at {:.1} m/s",
            contact.time_s, contact.rear_vehicle, contact.front_vehicle, contact.impact_speed_mps
        ),
        (_, None) => {
            let least_m = report
                .vehicles
                .iter()
                .filter_map(|vehicle| vehicle.min_gap_m)
                .reduce(f64::min);
            format!(
                "no collision{}",
                least_m.map_or(String::new(), |gap_m| format!(
                    ", smallest gap {gap_m:.2} m"
                ))
            )
        }
    };
    let mut parts = vec![format!("{}: {end}", report.scenario)];
    if report.impacts.len() > 1 {
        parts.push(format!(
            "{} of {} vehicles involved",
            report.vehicles_involved,
            report.vehicles.len()
        ));
    }
    let brakings = report
        .unnecessary_braking
        .iter()
        .filter(|one| !one.braking.is_empty());
    parts.extend(
        brakings.map(|UnnecessaryBrakingReport { vehicle, braking }| {
            format!(
                "vehicle {vehicle} brakes unnecessarily for {:.2} s",
                braking.time_s
            )
        }),
    );
    parts.extend(
        report
            .fell_behind
            .iter()
            .map(|vehicle| format!("vehicle {vehicle} is left behind by its leader")),
    );
    let violated = report
        .specifications
        .iter()
        .filter(|evaluated| !evaluated.satisfied);
    parts.extend(violated.map(
        |SpecificationResult {
             specification,
             robustness,
             ..
         }| { format!("VIOLATED, robustness {robustness:.3}: {specification}") },
    ));
    format!("{}\n", TerminalText(&parts.join("; ")))
}

pub(super) fn lane_changes(scenario: &Scenario, result: &SimulationResult) -> Vec<LaneChanges> {
    let Some(trace) = &result.trace else {
        return Vec::new();
    };
    let vehicles = scenario.vehicles().iter().zip(&trace.vehicles).enumerate();
    let changes = vehicles
        .filter(|(_, (vehicle, _))| !vehicle.keeps_lane())
        .map(|(vehicle, (_, track))| {
            let [entered_s, left_s] = track
                .in_lane_s
                .map(|time_s| Some(time_s).filter(|time_s| time_s.is_finite()));
            LaneChanges {
                vehicle,
                entered_s,
                left_s,
            }
        });
    changes.collect()
}

fn describe_lane_changes(change: &LaneChanges, scenario: &Scenario) -> String {
    let LaneChanges {
        vehicle,
        entered_s,
        left_s,
    } = change;
    let is_to = |change: fn(&VehicleSpec) -> Option<LaneChange>| {
        scenario.vehicles().get(*vehicle).and_then(change).is_some()
    };
    let entered = match (is_to(|vehicle| vehicle.enters), entered_s) {
        (true, Some(time_s)) => format!("enters the lane at {time_s:.2} s"),
        (true, None) => {
            "does not enter the lane: its trigger does not occur, or the lane has no room"
                .to_owned()
        }
        (false, _) => String::new(),
    };
    let lane = if entered.is_empty() { "the lane" } else { "it" };
    let left = match (is_to(|vehicle| vehicle.leaves), left_s) {
        (true, Some(time_s)) => format!("leaves {lane} at {time_s:.2} s"),
        (true, None) if entered_s.is_some() || entered.is_empty() => {
            format!("does not leave {lane}: its trigger does not occur, or it collides before")
        }
        _ => String::new(),
    };
    let both = if entered.is_empty() || left.is_empty() {
        ""
    } else {
        " and "
    };
    format!("vehicle {vehicle} {entered}{both}{left}")
}

/// Returns the unnecessary braking of the vehicles under test, front to rear.
pub(super) fn unnecessary_braking(
    scenario: &Scenario,
    result: &SimulationResult,
) -> Vec<UnnecessaryBrakingReport> {
    let Some(trace) = &result.trace else {
        return Vec::new();
    };
    let under_test = (0..trace.vehicles.len()).filter(|&vehicle| scenario.is_under_test(vehicle));
    let of = |vehicle| {
        let braking = UnnecessaryBraking::from_trace(trace, &result.impacts, vehicle)?;
        Some(UnnecessaryBrakingReport { vehicle, braking })
    };
    under_test.filter_map(of).collect()
}

pub(super) fn fell_behind(scenario: &Scenario, result: &SimulationResult) -> Vec<usize> {
    let Some(trace) = &result.trace else {
        return Vec::new();
    };
    let is_left = |vehicle: &usize| {
        let found = UsefulnessMeasures::from_trace(trace, &result.impacts, *vehicle)
            .and_then(|useful| useful.following);
        scenario.is_under_test(*vehicle) && found.is_some_and(|following| following.fell_behind)
    };
    (0..trace.vehicles.len()).filter(is_left).collect()
}

/// Summarises the interventions of a vehicle's shield in one line; `None` without interventions.
fn shield_line(interventions: &[Intervention], vehicle: usize) -> Option<String> {
    let own = || {
        interventions
            .iter()
            .filter(move |one| one.vehicle == vehicle)
    };
    let first_s = own().next()?.from_s;
    let braked_s: f64 = own().map(|one| one.to_s - one.from_s).sum();
    let times = match own().count() {
        1 => "once".to_owned(),
        n => format!("{n} times"),
    };
    let outside = if own().any(|one| one.outside_kernel) {
        "; the state was outside the safety kernel"
    } else {
        ""
    };
    let rear = match own().any(|one| one.rear_conflict) {
        true => "; while it braked, no command was safe for both the leader and the follower",
        false => "",
    };
    Some(format!(
        "  the shield of vehicle {vehicle} braked {times}, {braked_s:.2} s in all, first at {first_s:.2} \
         s{outside}{rear}"
    ))
}
