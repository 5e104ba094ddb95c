//! Text of the report of a run.

use std::path::Path;

use super::{RunReport, SpecificationResult, UnnecessaryBrakingReport};
use crate::collision_role::CollisionRole;
use crate::usefulness::BrakeInstant;
use crumple_core::digits::format_or_hyphen;
use crumple_core::quoting::TerminalText;
use crumple_sim::engine::{Collision, Impact, Intervention, Outcome, VehicleSummary};
use crumple_sim::scenario::{Driver, VehicleSpec};

const NONDETERMINISTIC: &str = "  the controller declares that it is not deterministic: another run may give another \
                                result";

impl RunReport<'_> {
    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let mut lines = vec![self.heading()];
        if self.nondeterministic {
            lines.push(NONDETERMINISTIC.to_owned());
        }
        lines.extend(self.outcome_line());
        lines.extend(self.impact_lines());
        lines.extend(self.lane_change_lines());
        lines.extend(self.braking_lines());
        lines.extend(self.describe_fell_behind().map(|line| format!("  {line}")));
        for level in &self.levels {
            lines.push(format!("  {}", level.describe()));
            let followers = level.describe_followers();
            lines.extend(followers.iter().map(|line| format!("  {line}")));
        }
        lines.extend(self.missing_levels.iter().map(|missing| {
            format!(
                "  vehicle {}: no level: {}",
                missing.vehicle, missing.reason
            )
        }));
        lines.extend(self.specification_lines());
        lines.extend(self.shield_lines());
        lines.extend(self.vehicle_lines());
        lines
            .iter()
            .map(|line| format!("{}\n", TerminalText(line.trim_end())))
            .collect()
    }

    /// Returns one line for a reader: the end of the run, and everything that is wrong.
    #[must_use]
    pub fn to_line(&self) -> String {
        let mut parts = vec![format!("{}: {}", self.scenario, self.describe_end())];
        if self.impacts.len() > 1 {
            parts.push(self.describe_involved());
        }
        let brakings = self
            .unnecessary_braking
            .iter()
            .filter(|vehicle| !vehicle.braking.is_empty());
        parts.extend(brakings.map(|vehicle| {
            let time_s = vehicle.braking.time_s;
            let cause = self.describe_cause_of_braking();
            format!(
                "vehicle {} brakes unnecessarily for {time_s:.2} s{cause}",
                vehicle.vehicle
            )
        }));
        parts.extend(self.describe_fell_behind());
        let violated = self
            .specifications
            .iter()
            .filter(|result| !result.satisfied);
        parts.extend(violated.map(SpecificationResult::describe));
        format!("{}\n", TerminalText(&parts.join("; ")))
    }

    fn heading(&self) -> String {
        let plant = self
            .plant
            .map_or_else(String::new, |plant| format!(", plant {plant}"));
        format!(
            "{}: {}, estimator {}, dt {} s, seed {}{plant}",
            self.scenario, self.controller, self.estimator, self.dt_s, self.seed
        )
    }

    fn outcome_line(&self) -> Option<String> {
        match &self.outcome {
            Outcome::ControllerFailed(failed) => Some(format!("  CONTROLLER FAILED: {failed}")),
            _ if self.impacts.is_empty() => Some("  no collision".to_owned()),
            _ => None,
        }
    }

    fn impact_lines(&self) -> Vec<String> {
        let words = std::iter::once("COLLISION").chain(std::iter::repeat("then     "));
        let mut lines: Vec<_> = words
            .zip(self.impacts)
            .map(|(word, impact)| {
                let note = self.note_recording(&impact.collision);
                format!("  {word} {}{note}", describe_impact(impact))
            })
            .collect();
        if self.impacts.len() > 1 {
            lines.push(format!("  {}", self.describe_involved()));
        }
        lines
    }

    /// Returns the reason why a collision does not count against the controller, as an addition; empty if it may count.
    fn note_recording(&self, collision: &Collision) -> &'static str {
        match CollisionRole::new(collision, self.simulated_scenario) {
            CollisionRole::HitByRecording => {
                "; does not count against the controller: the vehicle behind repeats recorded speeds"
            }
            _ => "",
        }
    }

    fn describe_involved(&self) -> String {
        let involved = self.vehicles_involved;
        format!("{involved} of {} vehicles involved", self.vehicles.len())
    }

    fn lane_change_lines(&self) -> impl Iterator<Item = String> {
        self.lane_changes
            .iter()
            .map(|change| format!("  {}", change.describe(self.simulated_scenario)))
    }

    fn braking_lines(&self) -> impl Iterator<Item = String> {
        self.unnecessary_braking
            .iter()
            .filter_map(UnnecessaryBrakingReport::describe)
            .map(|line| format!("  {line}{}", self.describe_cause_of_braking()))
    }

    /// Returns the cause after a description of unnecessary braking; empty if it counts against the controller.
    fn describe_cause_of_braking(&self) -> &'static str {
        match self.brakes_only_with_vehicle_behind {
            true => "; only with the vehicle behind: does not count against the controller",
            false => "",
        }
    }

    fn describe_fell_behind(&self) -> impl Iterator<Item = String> {
        self.fell_behind
            .iter()
            .map(|vehicle| format!("vehicle {vehicle} falls behind its leader"))
    }

    fn specification_lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        for result in &self.specifications {
            lines.push(format!("  {}", result.describe()));
            lines.extend(result.parts.iter().map(|part| part.describe(self.dt_s)));
        }
        lines
    }

    fn shield_lines(&self) -> impl Iterator<Item = String> {
        let words = if self.has_two_sided_shield {
            ShieldWords {
                intervened: "replaced commands",
                outside: "at least once it had no plan for the level to keep (setting `level`)",
            }
        } else {
            ShieldWords {
                intervened: "braked",
                outside: "the state was outside the safety kernel",
            }
        };
        (0..self.vehicles.len())
            .filter_map(move |index| shield_line(self.interventions, index, words))
    }

    fn vehicle_lines(&self) -> Vec<String> {
        let heading = format!(
            "  {:>3}  {:<6} {:<20} {:>11} {:>11} {:>15}  {:<10}  {}",
            "#",
            "class",
            "driver",
            "min gap m",
            "min TTC s",
            "max brake m/s²",
            "at the end",
            "role"
        );
        let mut lines = vec![heading];
        for (index, summary) in self.vehicles.iter().enumerate() {
            if let Some(vehicle) = self.simulated_scenario.vehicles().get(index) {
                lines.push(self.vehicle_line(index, summary, vehicle));
            }
        }
        lines
    }

    fn vehicle_line(
        &self,
        index: usize,
        summary: &VehicleSummary,
        vehicle: &VehicleSpec,
    ) -> String {
        let class = vehicle.class.name();
        let driver = describe_driver(&vehicle.driver, self.controller);
        let min_gap_m = format_or_hyphen(summary.min_gap_m, 2);
        let min_ttc_s = format_or_hyphen(summary.min_ttc_s, 2);
        let max_brake_mps2 = summary.max_brake_mps2;
        let end = if summary.stopped {
            "standing"
        } else {
            "moving"
        };
        let role = match vehicle.driver {
            Driver::UnderTest => "ego vehicle",
            _ => "",
        };
        format!(
            "  {index:>3}  {class:<6} {driver:<20} {min_gap_m:>11} {min_ttc_s:>11} {max_brake_mps2:>15.2}  \
             {end:<10}  {role}"
        )
    }

    fn describe_end(&self) -> String {
        if let Outcome::ControllerFailed(failed) = &self.outcome {
            return format!("CONTROLLER FAILED: {failed}");
        }
        if let Some(impact) = self.impacts.first() {
            let note = self.note_recording(&impact.collision);
            return format!("COLLISION {}{note}", impact.collision);
        }
        let gaps_m = self.vehicles.iter().filter_map(|vehicle| vehicle.min_gap_m);
        match gaps_m.reduce(f64::min) {
            Some(gap_m) => format!("no collision, smallest gap {gap_m:.2} m"),
            None => "no collision".to_owned(),
        }
    }
}

impl UnnecessaryBrakingReport {
    /// Describes the hardest unnecessary braking; `None` if there is none.
    fn describe(&self) -> Option<String> {
        let BrakeInstant {
            time_s,
            brake_mps2,
            justified_mps2,
        } = self.braking.hardest?;
        Some(format!(
            "vehicle {} brakes unnecessarily for {:.2} s, hardest at {time_s:.2} s: {brake_mps2:.1} m/s² where \
             {justified_mps2:.1} was justified",
            self.vehicle, self.braking.time_s
        ))
    }
}

impl SpecificationResult {
    fn describe(&self) -> String {
        let verdict = if self.satisfied { "holds" } else { "VIOLATED" };
        format!(
            "{verdict}, robustness {:.3}: {}",
            self.robustness, self.specification
        )
    }
}

fn describe_impact(impact: &Impact) -> String {
    let collision = &impact.collision;
    format!(
        "{collision} ({:.1} against {:.1} m/s)",
        collision.rear_speed_mps, collision.front_speed_mps
    )
}

fn describe_driver(driver: &Driver, controller: &str) -> String {
    match driver {
        Driver::UnderTest => controller.to_owned(),
        Driver::Controller(spec) => spec.to_arg(),
        Driver::Profile(profile) => profile.name().to_owned(),
        Driver::File(file) => Path::new(file.path())
            .file_name()
            .unwrap_or_default()
            .to_string_lossy()
            .into_owned(),
    }
}

/// Words for a kind of shield.
#[derive(Clone, Copy)]
struct ShieldWords {
    intervened: &'static str,
    /// Description of a state outside the set that the shield keeps.
    outside: &'static str,
}

/// Summarises the interventions of a vehicle's shield in one line; `None` without interventions.
fn shield_line(
    interventions: &[Intervention],
    vehicle: usize,
    words: ShieldWords,
) -> Option<String> {
    let own: Vec<_> = interventions
        .iter()
        .filter(|intervention| intervention.vehicle == vehicle)
        .collect();
    let first_s = own.first()?.from_s;
    let intervened_s: f64 = own
        .iter()
        .map(|intervention| intervention.to_s - intervention.from_s)
        .sum();
    let periods = match own.len() {
        1 => "1 period".to_owned(),
        count => format!("{count} periods"),
    };
    let outside = if own.iter().any(|intervention| intervention.outside_kernel) {
        format!("; {}", words.outside)
    } else {
        String::new()
    };
    let conflicts = own
        .iter()
        .filter(|intervention| intervention.rear_conflict)
        .count();
    let no_safe_command = "no command was safe for both the leader and the follower";
    let rear = match conflicts {
        0 => String::new(),
        all if all == own.len() => format!("; while it braked, {no_safe_command}"),
        some => format!("; in {some} of these, {no_safe_command}"),
    };
    let intervened = words.intervened;
    Some(format!(
        "  the shield of vehicle {vehicle} {intervened} in {periods}, {intervened_s:.2} s in all, first at \
         {first_s:.2} s{outside}{rear}"
    ))
}
