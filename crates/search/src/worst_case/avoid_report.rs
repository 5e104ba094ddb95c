//! Report of an analysis of avoidability, as text and as JSON.

use serde::{Deserialize, Serialize};

use super::avoid::AvoidError;
use super::avoidance::{Avoidance, AvoidanceClass, AvoidanceVerdict, Optimality};
use super::emergency_brake::EmergencyBrake;
use super::escape::{Escape, EscapeMethod, FoundBy};
use super::reason::UndecidedReason;
use crate::confirmation::escape_survives;
use crumple_core::digits::{format_fixed_down, format_fixed_up, format_number};
use crumple_core::quoting::TerminalText;
use crumple_sim::scenario::Scenario;

/// Optimality of an escape of the programs.
const LARGEST_GAP: &str = "no escape with a larger gap was found by the convex programs, which hold accelerations over \
    the steps of a time grid (--grid)";

/// Report of an analysis of avoidability. Reading its JSON returns the same report.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct AvoidReport {
    /// Name of the scenario.
    pub scenario: String,
    /// Duration of the scenario, in seconds. Nothing is shown about the time afterwards.
    pub duration_s: f64,
    /// Verdict of the analysis.
    pub verdict: AvoidanceClass,
    /// Largest smallest gap of all replayed escapes, in metres.
    pub best_min_gap_m: Option<f64>,
    /// Smallest gap of the escape, in metres.
    pub escape_min_gap_m: Option<f64>,
    /// Upper bound of the smallest gap over every driver, in metres.
    pub min_gap_bound_m: Option<f64>,
    /// True if a certificate proves the bound.
    pub min_gap_bound_is_certified: bool,
    /// Proof that no driver keeps a larger gap; `None` without an escape.
    pub optimality: Option<Optimality>,
    /// Time at which the follower's emergency brake fires in the replay, in seconds.
    pub trigger_time_s: Option<f64>,
    /// True if the follower's emergency brake fires in the replay; `None` if a driver behind is unknown.
    pub emergency_brake_fires: Option<bool>,
    /// ∫ a² of the escape, in m²/s³.
    pub effort_m2ps3: Option<f64>,
    /// Criterion by which the escape is the best one.
    pub escape_is_best_for: Option<String>,
    /// Method that found the escape.
    pub escape_found_by: Option<EscapeMethod>,
    /// Number of convex programs solved.
    pub programs: usize,
    /// Number of simulations in closed loop.
    pub simulations: usize,
    /// True if the escape has no collision with the multi-body plant either.
    pub escape_survives_multi_body: Option<bool>,
    /// Reason why the analysis decides nothing.
    pub reason: Option<UndecidedReason>,
}

impl AvoidReport {
    /// Creates the report of an analysis, and replays an escape with the multi-body plant.
    #[must_use]
    pub fn new(scenario: &Scenario, avoidance: &Avoidance) -> Self {
        let escape = avoidance.verdict.escape();
        let reason = match &avoidance.verdict {
            AvoidanceVerdict::Undecided(reason) => Some(reason.clone()),
            AvoidanceVerdict::Avoidable(_) | AvoidanceVerdict::Unavoidable(_) => None,
        };
        let survives =
            escape.and_then(|escape| escape_survives(scenario, &escape.acceleration_mps2));
        Self {
            scenario: scenario.spec().name.clone(),
            duration_s: scenario.spec().duration_s,
            verdict: avoidance.verdict.class(),
            best_min_gap_m: avoidance.best_min_gap_m,
            escape_min_gap_m: escape.map(|escape| escape.min_gap_m),
            min_gap_bound_m: avoidance.min_gap_bound_m,
            min_gap_bound_is_certified: avoidance.bound_certificate.is_some(),
            optimality: escape.map(|_| avoidance.optimality),
            trigger_time_s: escape.and_then(Escape::trigger_time_s),
            emergency_brake_fires: escape.and_then(emergency_brake_fires),
            effort_m2ps3: escape.map(Escape::effort_m2ps3),
            escape_is_best_for: escape.map(|escape| criterion(escape.found_by)),
            escape_found_by: escape.map(|escape| escape.found_by.method()),
            programs: avoidance.programs,
            simulations: escape.map_or(0, |escape| simulations(escape.found_by)),
            escape_survives_multi_body: survives,
            reason,
        }
    }

    /// Creates the report of a scenario that was not analysed, with the reason.
    #[must_use]
    pub fn not_analysed(scenario: &Scenario, error: &AvoidError) -> Self {
        let reason = UndecidedReason::NotAnalysed {
            why: error.to_string(),
        };
        Self::new(scenario, &Avoidance::undecided(reason))
    }

    /// Returns the report for a reader, as lines.
    #[must_use]
    pub fn to_text(&self) -> String {
        let heading = format!(
            "{}: {}, in the {} s of the scenario\n",
            TerminalText(&self.scenario),
            self.verdict.name(),
            format_number(self.duration_s)
        );
        let lines = [
            self.unavoidable_line(),
            self.gap_line(),
            self.bound_line(),
            self.emergency_brake_line(),
            self.effort_line(),
            self.escape_is_best_for.clone(),
            self.multi_body_line(),
            self.reason.as_ref().map(ToString::to_string),
            Some(format!("{} convex programs", self.programs)),
        ];
        let indented = lines
            .into_iter()
            .flatten()
            .map(|line| format!("  {line}\n"));
        heading + &indented.collect::<String>()
    }

    /// Returns the verdict and what supports it, without the effort of the escape and of the search.
    #[must_use]
    pub fn main_statements(&self) -> Vec<String> {
        let statements = [
            Some(self.verdict.name().to_owned()),
            self.unavoidable_line(),
            self.gap_line(),
            self.bound_line(),
            self.emergency_brake_line(),
            self.multi_body_line(),
            self.reason.as_ref().map(ToString::to_string),
        ];
        statements.into_iter().flatten().collect()
    }

    fn unavoidable_line(&self) -> Option<String> {
        let is_unavoidable = self.verdict == AvoidanceClass::Unavoidable;
        is_unavoidable
            .then(|| "every driver collides; the checker has accepted the proof".to_owned())
    }

    fn gap_line(&self) -> Option<String> {
        let gap = format_fixed_down(self.escape_min_gap_m?, 2);
        let optimality = match self.optimality? {
            Optimality::BestFound => "best found",
            Optimality::InitialGap => "optimal: equals the initial gap",
            Optimality::Bound => "optimal to a centimetre: at most 0.01 m below the bound",
        };
        Some(format!("smallest gap of the escape {gap} m, {optimality}"))
    }

    fn bound_line(&self) -> Option<String> {
        let bound = format_fixed_up(self.min_gap_bound_m?, 2);
        let proof = match self.min_gap_bound_is_certified {
            true => "proved",
            false => "computed, without a certificate",
        };
        Some(format!("no driver keeps more than {bound} m, {proof}"))
    }

    fn emergency_brake_line(&self) -> Option<String> {
        match (self.trigger_time_s, self.emergency_brake_fires) {
            (Some(time_s), _) => Some(format!(
                "the follower's emergency brake fires at {time_s:.2} s"
            )),
            (None, Some(false)) => Some("no emergency brake behind fires".to_owned()),
            (None, _) => None,
        }
    }

    fn effort_line(&self) -> Option<String> {
        let effort = self.effort_m2ps3?;
        Some(format!("effort of the escape: ∫a² {effort:.1} m²/s³"))
    }

    fn multi_body_line(&self) -> Option<String> {
        let result = if self.escape_survives_multi_body? {
            "this escape has no collision either"
        } else {
            "the accelerations of this escape cause a COLLISION: `avoidable` is shown for point masses only"
        };
        Some(format!("with the multi-body plant, {result}"))
    }
}

fn emergency_brake_fires(escape: &Escape) -> Option<bool> {
    match escape.emergency_brake {
        EmergencyBrake::Fires { .. } => Some(true),
        EmergencyBrake::NeverFires => Some(false),
        EmergencyBrake::Unknown => None,
    }
}

/// Describes the criterion by which a search found the best escape.
fn criterion(found_by: FoundBy) -> String {
    match found_by {
        FoundBy::Programs => LARGEST_GAP.to_owned(),
        FoundBy::ClosedLoop { simulations } => format!(
            "no escape with a larger gap was found in {simulations} simulated profiles, with the drivers of all other \
             vehicles in the loop"
        ),
    }
}

fn simulations(found_by: FoundBy) -> usize {
    match found_by {
        FoundBy::Programs => 0,
        FoundBy::ClosedLoop { simulations } => simulations,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::worst_case::{AvoidOptions, avoid};
    use crumple_sim::scenario::{Driver, VehicleClass, VehicleSpec, built_in_scenario};

    /// Asserts that a report is read back from its JSON, with the same text and JSON.
    fn assert_read_back(report: &AvoidReport) {
        let json = serde_json::to_string(report).unwrap();
        let read: AvoidReport = serde_json::from_str(&json).expect(&json);
        assert_eq!(&read, report);
        assert_eq!(read.to_text(), report.to_text());
        assert_eq!(serde_json::to_string(&read).unwrap(), json);
    }

    #[test]
    fn reports_are_read_back_from_their_json() {
        let options = AvoidOptions {
            certify_bound: true,
            ..AvoidOptions::default()
        };
        let avoidable = built_in_scenario("paper-1").unwrap();
        let avoidance = avoid(&avoidable, options).unwrap();
        assert_read_back(&AvoidReport::new(&avoidable, &avoidance));

        // The leader brakes hard, close ahead of a vehicle that is much faster.
        let unavoidable = avoidable
            .edited(|spec| {
                spec.vehicles = vec![
                    VehicleSpec::new(
                        VehicleClass::Light,
                        10.0,
                        0.0,
                        spec.vehicles[0].driver.clone(),
                    ),
                    VehicleSpec::new(VehicleClass::Light, 0.0, 30.0, Driver::UnderTest),
                ];
            })
            .unwrap();
        let avoidance = avoid(&unavoidable, options).unwrap();
        let report = AvoidReport::new(&unavoidable, &avoidance);
        assert_eq!(
            report.main_statements(),
            [
                "unavoidable",
                "every driver collides; the checker has accepted the proof"
            ]
        );
        assert_read_back(&report);
    }

    #[test]
    fn undecided_reports_are_read_back_with_their_reasons() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let too_close = |low_m| UndecidedReason::TooClose {
            low_m,
            high_m: 0.1 + 0.2,
        };
        let follower = UndecidedReason::Follower {
            vehicle: 2,
            driver: "idm".into(),
        };
        for reason in [too_close(None), too_close(Some(-1.0 / 3.0)), follower] {
            let avoidance = Avoidance::undecided(reason.clone());
            let report = AvoidReport::new(&scenario, &avoidance);
            assert!(report.to_text().contains(&reason.to_string()));
            assert_read_back(&report);
        }
        let error = AvoidError::TooLarge {
            egos: 21,
            steps: 10,
        };
        let report = AvoidReport::not_analysed(&scenario, &error);
        assert!(report.to_text().contains(&error.to_string()));
        assert_read_back(&report);
    }
}
