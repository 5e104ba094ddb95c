//! A failure that a search found, as a report shows it.

use std::iter;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::failure_searches::CounterexampleFiles;
use crate::assessment::{CrumpleCommand, Rounded};
use crate::export::openscenario::{OpenScenario, export_trajectories};
use crumple_core::digest::sha256;
use crumple_search::falsify::campaign::{CampaignSummary, MethodSummary};
use crumple_search::falsify::counterexample::{AvoidabilityClass, ChangedParameter, Counterexample};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::{Scenario, file};
use crumple_world::sim::{NamedController, RecordingLevel, Run, RunError, RunOptions, simulate};

/// The extension of roads.
const ROAD_EXTENSION: &str = "xodr";

/// What a method reached within its budget.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct MethodResult {
    /// The method.
    pub method: String,
    /// Runs it made.
    pub evaluations: u64,
    /// In which of them, from 1, it met its first failure of the controller.
    pub first_failure: Option<u64>,
    /// How many of them the controller failed in.
    pub failures: u64,
    /// In how many of those it gave no answer.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub unanswered: u64,
    /// How many ended when vehicles touched that are not under test: they say nothing of the controller.
    pub others: u64,
}

impl MethodResult {
    /// Of scenarios like `nominal`.
    pub(super) fn new(method: &MethodSummary, all: &CampaignSummary, nominal: &Scenario) -> Self {
        let own = all
            .failures
            .iter()
            .filter(|kind| involves_vehicle_under_test([kind.front_vehicle, kind.rear_vehicle], nominal));
        let silent = all.failures.iter().filter(|kind| kind.failed_vehicle.is_some());
        let silent = silent.flat_map(|kind| &kind.by_method).filter(|by| by.method == method.method);
        let own: Vec<_> = own.flat_map(|kind| &kind.by_method).filter(|by| by.method == method.method).collect();
        let failures = own.iter().map(|by| by.count).sum();
        Self {
            method: method.method.clone(),
            evaluations: method.evaluations,
            first_failure: own.iter().map(|by| by.first).min(),
            failures,
            unanswered: silent.map(|by| by.count).sum(),
            others: method.failures.saturating_sub(failures),
        }
    }
}

fn is_zero(count: &u64) -> bool {
    *count == 0
}

/// Whether a contact between these is one of a vehicle under test; what is no contact is its controller's.
pub(super) fn involves_vehicle_under_test(vehicles: [Option<u32>; 2], nominal: &Scenario) -> bool {
    let mut tested = vehicles.into_iter().flatten().map(|index| nominal.is_under_test(index as usize)).peekable();
    tested.peek().is_none() || tested.any(|is_tested| is_tested)
}

/// How a counterexample could have been avoided: its scenario with a script in place of every vehicle under test, in which nobody
/// touches.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct EscapeFile {
    /// The scenario file, from the folder of the report, beside that of the counterexample.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// How to see nothing happen.
    pub replay: CrumpleCommand,
    /// The file itself; of what was kept it is among the files that were kept with it.
    #[serde(skip)]
    pub(super) text: String,
}

impl EscapeFile {
    /// Beside the file of a counterexample.
    pub(super) fn for_counterexample(counterexample: &str, text: String) -> Self {
        let file = format!("{}-escape.toml", counterexample.trim_end_matches(".toml"));
        let replay = CrumpleCommand::new(["simulate", file.as_str(), "--expect", "safe"]);
        Self { sha256: sha256(&text), file, replay, text }
    }
}

/// A distinct failure, shrunk.
#[derive(Debug, Clone, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct DistinctFailure {
    /// The scenario file, from the folder of the report.
    pub file: String,
    /// SHA-256 of that file.
    pub sha256: String,
    /// How to see it happen; none of a controller from outside.
    pub replay: Option<CrumpleCommand>,
    /// What happens.
    pub kind: String,
    /// Of a controller that gave no answer: when and why.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub because: Option<String>,
    /// When vehicles first touch, in seconds.
    pub contact_time_s: Option<Rounded<2>>,
    /// Difference of their speeds, in m/s.
    pub impact_speed_mps: Option<Rounded<1>>,
    /// Largest change of speed of any vehicle when the crash is played to its end, in m/s.
    pub max_delta_v_mps: Option<Rounded<1>>,
    /// Vehicles involved then.
    pub vehicles: usize,
    /// Whether a driver could have avoided it.
    pub class: AvoidabilityClass,
    /// The smallest gap of the best escape, in metres, rounded down.
    pub best_gap_m: Option<Rounded<2>>,
    /// That escape.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub escape: Option<EscapeFile>,
    /// Place among all of its search by likelihood, from 1.
    pub likelihood_rank: usize,
    /// Whether it disappears at a tenth of the step.
    pub dt_fragile: bool,
    /// Which method found it.
    pub found_by: String,
    /// In which of its runs, from 1.
    pub found_at: u64,
    /// Parameters that are not nominal.
    pub changed: Vec<String>,
    /// The file itself.
    #[serde(skip)]
    pub(in crate::assessment) text: String,
    /// What happens in it, for other simulators.
    #[serde(skip)]
    pub(super) openscenario: Option<OpenScenario>,
}

impl DistinctFailure {
    pub(super) fn from_counterexample(
        found: &Counterexample,
        place: &str,
        texts: CounterexampleFiles,
        replay: &dyn Fn(&str) -> Option<CrumpleCommand>,
    ) -> Self {
        let name = found.file.rsplit('/').next().unwrap_or(&found.file);
        let file = format!("{place}/{name}");
        let CounterexampleFiles { counterexample: text, escape } = texts;
        Self {
            escape: escape.map(|text| EscapeFile::for_counterexample(&file, text)),
            sha256: sha256(&text),
            replay: replay(&file),
            file,
            kind: found.kind.clone(),
            because: found.because.clone(),
            contact_time_s: found.contact_time_s.map(Rounded::new),
            impact_speed_mps: found.impact_speed_mps.map(Rounded::new),
            max_delta_v_mps: found.max_delta_v_mps.map(Rounded::new),
            vehicles: found.vehicles_involved,
            class: found.avoidability.class(),
            best_gap_m: found.avoidability.best_min_gap_m().map(Rounded::down),
            likelihood_rank: found.likelihood_rank,
            dt_fragile: found.dt_fragile,
            found_by: found.found_by.clone(),
            found_at: found.found_at,
            changed: found.changed.iter().map(format_change).collect(),
            text,
            openscenario: None,
        }
    }

    /// The files for other simulators beside that of a counterexample.
    fn simulator_file_names(file: &str) -> [String; 2] {
        let stem = file.trim_end_matches(".toml");
        ["xosc", ROAD_EXTENSION].map(|extension| format!("{stem}.{extension}"))
    }

    /// Simulates it anew for what stands beside its file: what happened, for other simulators.
    pub(super) fn with_simulator_files(
        mut self,
        controller: &NamedController,
        estimator: EstimatorKind,
    ) -> Result<Self, RunError> {
        // What a campaign wrote and read back can be read again.
        let Ok(scenario) = file::from_toml(&self.text, Path::new(&self.file)) else { return Ok(self) };
        let run = Run::new(&scenario, RunOptions::new(controller.kind.clone()).with_estimator(estimator))?;
        let trace = simulate(&run, RecordingLevel::Trace).trace;
        let road = format!("{}.{ROAD_EXTENSION}", self.short_name());
        // None of a run that is too long for such a file, or in which vehicles change lanes.
        self.openscenario =
            trace.and_then(|trace| export_trajectories(&scenario, &trace, Some(&controller.name), &road).ok());
        Ok(self)
    }

    /// How to see it happen, and what would have avoided it.
    pub(in crate::assessment) fn commands(&self) -> impl Iterator<Item = &CrumpleCommand> {
        self.replay.iter().chain(self.escape.iter().map(|escape| &escape.replay))
    }

    /// Its files: the scenario, and beside it the escape and the run for other simulators.
    pub(in crate::assessment) fn files(&self) -> impl Iterator<Item = (String, Vec<u8>)> {
        let [scenario, road] = Self::simulator_file_names(&self.file);
        let run = self.openscenario.as_ref().map(|run| [(scenario, run.scenario.clone()), (road, run.road.clone())]);
        let escape = self.escape.as_ref().map(|escape| (escape.file.clone(), escape.text.clone().into_bytes()));
        let own = iter::once((self.file.clone(), self.text.clone().into_bytes()));
        own.chain(escape).chain(run.into_iter().flatten())
    }

    /// Its file's name without folders.
    pub(super) fn short_name(&self) -> &str {
        self.file.rsplit('/').next().unwrap_or(&self.file).trim_end_matches(".toml")
    }

    pub(super) fn describe(&self) -> String {
        let fragile = if self.dt_fragile { ", only at the scenario's step" } else { "" };
        if let Some(because) = &self.because {
            return format!("{} {because}{fragile}", self.kind);
        }
        match (self.impact_speed_mps, self.contact_time_s) {
            (Some(speed), Some(time)) => format!("{}: impact at {speed} m/s, after {time} s{fragile}", self.kind),
            _ => format!("{}{fragile}", self.kind),
        }
    }

    pub(super) fn describe_class(&self) -> String {
        match (self.class, self.best_gap_m) {
            (AvoidabilityClass::Avoidable, Some(gap_m)) => format!("avoidable, by {gap_m} m"),
            (AvoidabilityClass::Avoidable, None) => "avoidable".to_owned(),
            (AvoidabilityClass::Unavoidable, _) => "unavoidable, proved".to_owned(),
            (AvoidabilityClass::Undecided, _) => "undecided".to_owned(),
            (AvoidabilityClass::NotAsked, _) => "not asked".to_owned(),
        }
    }
}

fn format_change(changed: &ChangedParameter) -> String {
    let unit = if changed.unit == "1" { String::new() } else { format!(" {}", changed.unit) };
    format!("{} {}{}", changed.parameter, changed.value, unit.trim_end())
}
