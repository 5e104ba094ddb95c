//! Effects of braking: collisions ahead avoided, collisions behind caused, and harm, for each kind of follower.
//!
//! Every controller drives the same random scenarios as in [`super::SpaceSamples`]; vehicles that collide drive on as
//! one body, and one that has hit its leader holds its brake or coasts, as the configuration states. The first
//! controller of the configuration is the reference, for example one that never brakes.

use std::collections::BTreeSet;
use std::fmt::Write as _;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use serde_json::json;

use super::sampling::{batches, draw_scenarios, simulate_each};
use super::share::PercentInterval;
use crate::assessment::claims::ContentId;
use crate::assessment::config::HarmConfig;
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::NamedSpace;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, Rounded};
use crumple_measure::harm;
use crumple_search::falsify::counterexample::Avoidability;
use crumple_sim::engine::{
    AfterCollision, NamedController, Outcome, RecordingLevel, RunOptions, SimulationResult,
};
use crumple_sim::scenario::{Scenario, VehicleSpec};

/// Deceleration above which a drive has an activation, in m/s²: comfort braking is below it, Autoware's brake above.
pub const ACTIVATION_MPS2: f64 = 2.5;

/// Smallest number of drives with harm for an interval of harm: with fewer, a normal interval is too short.
const MIN_HARMFUL_DRIVES: usize = 10;

/// Two-sided quantile of the normal distribution at 95 %.
const NORMAL_QUANTILE: f64 = 1.96;

/// Effects of braking in each scenario space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HarmReport {
    /// Emergencies per hour of driving, as the configuration states.
    pub emergencies_per_hour: f64,
    /// One entry per scenario space and kind of follower; the first of a space has all followers.
    pub groups: Vec<HarmGroup>,
    /// Runs as a table of comma-separated values.
    #[serde(skip)]
    pub(in crate::assessment) runs_csv: String,
}

/// Effects of braking with one kind of follower.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct HarmGroup {
    /// Scenario space.
    pub space: ContentId,
    /// Driver and class of the follower, or `all`.
    pub follower: String,
    /// Random scenarios with this follower.
    pub drives: u64,
    /// Scenarios in which some braking and acceleration avoids every collision, those proved to have none, and all that
    /// were examined.
    pub avoidable: [u64; 3],
    /// One entry per controller.
    pub controllers: Vec<ControllerHarm>,
}

/// Effects of one controller's braking.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerHarm {
    /// Name of the controller.
    pub controller: String,
    /// Drives in which this controller gave no answer. The other figures leave them out; those that compare also leave
    /// out the drives in which the reference gave none.
    pub unanswered: u64,
    /// Drives in which the vehicle under test brakes harder than [`ACTIVATION_MPS2`] before any collision.
    pub activations: u64,
    /// Drives in which the vehicle under test hits its leader, in percent.
    pub ahead_percent: PercentInterval,
    /// Drives in which the follower hits the vehicle under test, in percent.
    pub behind_percent: PercentInterval,
    /// Drives in which only the reference hits the leader.
    pub avoided: u64,
    /// Drives in which the follower hits only this controller's vehicle.
    pub caused: u64,
    /// Collisions behind caused per 100 activations.
    pub caused_per_100_activations: PercentInterval,
    /// Expected number of seriously injured drivers per 1000 drives, and half of its 95 % interval; `None` with harm in
    /// fewer than 10 drives.
    pub harm_per_1000: (Rounded<3>, Option<Rounded<3>>),
}

/// One run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct HarmRun {
    follower: String,
    speed_mps: f64,
    /// Initial gaps ahead and behind, divided by the initial speed.
    time_gaps_s: [Option<f64>; 2],
    friction: f64,
    activates: bool,
    /// Impact speed with the leader, and of the follower, in m/s.
    impacts_mps: [Option<f64>; 2],
    /// True if the follower hit the vehicle under test before that hit the leader.
    is_pushed: bool,
    harm: f64,
    /// True if the controller gave no answer, so that the run ended early.
    #[serde(default)]
    is_unanswered: bool,
}

impl HarmRun {
    fn new(scenario: &Scenario, simulated: &SimulationResult) -> Self {
        let vehicles = scenario.vehicles();
        let ego = (0..vehicles.len())
            .find(|&index| scenario.is_under_test(index))
            .unwrap_or(0);
        let speed_mps = vehicles
            .get(ego)
            .map_or(f64::NAN, |vehicle| vehicle.speed_mps);
        let follower = vehicles.get(ego + 1);
        Self {
            follower: follower.map_or("none".to_owned(), |vehicle| {
                format!("{} {}", vehicle.driver.name(), vehicle.class.name())
            }),
            speed_mps,
            time_gaps_s: [ego.checked_sub(1), Some(ego)]
                .map(|front| initial_time_gap_s(vehicles, front?, speed_mps)),
            friction: scenario.spec().environment.friction,
            activates: simulated
                .vehicles
                .get(ego)
                .is_some_and(|vehicle| vehicle.max_brake_mps2 > ACTIVATION_MPS2),
            impacts_mps: [ego, ego + 1].map(|rear| hardest_impact_mps(simulated, rear)),
            is_pushed: is_pushed(simulated, ego),
            harm: harm(&simulated.impacts, vehicles.len()),
            is_unanswered: matches!(simulated.outcome, Outcome::ControllerFailed(_)),
        }
    }

    /// Returns the columns of the result in the table of runs; empty without an answer.
    fn result_columns(&self) -> String {
        if self.is_unanswered {
            return ",,,,".to_owned();
        }
        format!(
            "{},{},{},{},{}",
            u8::from(self.activates),
            number_or_empty(self.impacts_mps[0]),
            number_or_empty(self.impacts_mps[1]),
            u8::from(self.is_pushed),
            self.harm
        )
    }

    fn has_follower(&self, follower: Option<&str>) -> bool {
        follower.is_none_or(|follower| self.follower == follower)
    }

    fn hits_leader(&self) -> bool {
        self.impacts_mps[0].is_some()
    }

    fn is_hit_from_behind(&self) -> bool {
        self.impacts_mps[1].is_some()
    }

    fn causes_collision_behind(&self, reference: &Self) -> bool {
        self.is_hit_from_behind() && !reference.is_hit_from_behind()
    }

    /// Simulates scenarios until their first collision, and those with a collision again to their end.
    fn simulate_all(
        scenarios: &[Scenario],
        controller: &NamedController,
        after_collision: AfterCollision,
        work: &GatherContext<'_>,
    ) -> Result<Vec<Self>, AssessError> {
        let options =
            RunOptions::new(controller.source.clone()).with_estimator(work.plan.config.estimator);
        let mut runs = simulate_each(scenarios, &options, RecordingLevel::Summary, Self::new)?;
        let collided: Vec<usize> = (0..runs.len())
            .filter(|&index| runs[index].harm > 0.0)
            .collect();
        let scenarios: Vec<_> = collided
            .iter()
            .map(|&index| scenarios[index].clone())
            .collect();
        let options = options.with_after_collision(after_collision);
        let continued = simulate_each(&scenarios, &options, RecordingLevel::Summary, Self::new)?;
        for (index, run) in collided.into_iter().zip(continued) {
            // Braking of vehicles that stick together is no activation.
            runs[index] = Self {
                activates: runs[index].activates,
                ..run
            };
        }
        Ok(runs)
    }

    fn gather(
        named: &NamedSpace,
        controller: &NamedController,
        harm: &HarmConfig,
        work: &GatherContext<'_>,
    ) -> Result<Vec<Self>, AssessError> {
        let config = &work.plan.config;
        let inputs = json!([
            named.text,
            config.draws,
            config.seed,
            work.plan.identity(controller),
            harm.after_collision
        ]);
        work.get_or_gather(
            &format!("harm of {} in {}", controller.name, named.space.name()),
            &inputs,
            || {
                let mut runs = Vec::new();
                for draws in batches(config.draws) {
                    let scenarios = draw_scenarios(&named.space, config.seed, draws)?;
                    runs.extend(Self::simulate_all(
                        &scenarios,
                        controller,
                        harm.after_collision.into(),
                        work,
                    )?);
                    work.add_runs(scenarios.len() as u64)?;
                }
                Ok(runs)
            },
        )
    }
}

/// Returns the initial gap behind a vehicle, divided by a speed.
fn initial_time_gap_s(vehicles: &[VehicleSpec], front: usize, speed_mps: f64) -> Option<f64> {
    let rear = vehicles.get(front + 1)?;
    let front = vehicles.get(front)?;
    Some((front.position_m - front.length_m() - rear.position_m) / speed_mps)
        .filter(|gap_s| gap_s.is_finite())
}

/// Returns the largest speed at which a vehicle hits the one ahead.
fn hardest_impact_mps(simulated: &SimulationResult, rear: usize) -> Option<f64> {
    let impacts = simulated
        .impacts
        .iter()
        .filter(|impact| impact.collision.rear_vehicle == rear);
    impacts
        .map(|impact| impact.collision.impact_speed_mps)
        .reduce(f64::max)
}

/// Returns true if the follower hits a vehicle before that hits its leader.
fn is_pushed(simulated: &SimulationResult, vehicle: usize) -> bool {
    let first_impact = |rear: usize| {
        let mut impacts = simulated.impacts.iter();
        impacts.position(|impact| impact.collision.rear_vehicle == rear)
    };
    match [vehicle, vehicle + 1].map(first_impact) {
        [Some(ahead), Some(behind)] => behind < ahead,
        _ => false,
    }
}

/// Returns the avoidability of the first scenarios of a space.
fn gather_avoidability(
    named: &NamedSpace,
    harm: &HarmConfig,
    work: &GatherContext<'_>,
) -> Result<Vec<Option<bool>>, AssessError> {
    let config = &work.plan.config;
    let count = harm.avoid_draws.min(config.draws);
    work.get_or_gather(
        &format!("avoidability in {}", named.space.name()),
        &json!([named.text, count, config.seed]),
        || {
            let scenarios = draw_scenarios(&named.space, config.seed, 0..count)?;
            Ok(scenarios
                .par_iter()
                .map(|scenario| Avoidability::classify_collision(scenario).is_avoidable())
                .collect())
        },
    )
}

impl HarmReport {
    pub(in crate::assessment) fn gather(
        work: &GatherContext<'_>,
    ) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let Some(config) = &plan.config.harm else {
            return Ok(None);
        };
        let mut groups = Vec::new();
        let mut runs_csv = CSV_HEADER.to_owned();
        for named in &plan.rate_spaces {
            let avoidability = gather_avoidability(named, config, work)?;
            let mut runs = Vec::new();
            for controller in &plan.controllers {
                let of_controller = HarmRun::gather(named, controller, config, work)?;
                write_csv(
                    &mut runs_csv,
                    named.space.name(),
                    &controller.name,
                    &of_controller,
                    &avoidability,
                );
                runs.push((controller.name.as_str(), of_controller));
            }
            let reference = runs.first().into_iter().flat_map(|(_, runs)| runs);
            let followers: BTreeSet<&str> = reference.map(|run| run.follower.as_str()).collect();
            let kinds = std::iter::once(None).chain(followers.into_iter().map(Some));
            groups.extend(
                kinds.map(|follower| {
                    HarmGroup::new(&named.content_id, follower, &runs, &avoidability)
                }),
            );
        }
        Ok(Some(Self {
            emergencies_per_hour: config.emergencies_per_hour,
            groups,
            runs_csv,
        }))
    }
}

const CSV_HEADER: &str = "space,controller,draw,follower,speed_mps,gap_ahead_s,gap_behind_s,friction,avoidable,\
                          activates,ahead_mps,behind_mps,pushed,harm\n";

fn write_csv(
    out: &mut String,
    space: &str,
    controller: &str,
    runs: &[HarmRun],
    avoidability: &[Option<bool>],
) {
    for (draw, run) in runs.iter().enumerate() {
        let avoidable = match avoidability.get(draw) {
            None => "",
            Some(None) => "undecided",
            Some(Some(true)) => "yes",
            Some(Some(false)) => "no",
        };
        let [ahead_s, behind_s] = run.time_gaps_s.map(number_or_empty);
        // A controller's name may have commas.
        let _ = write!(
            out,
            "{space},\"{}\",{draw},{},{},{ahead_s},{behind_s},{},{avoidable},",
            controller.replace('"', "\"\""),
            run.follower,
            run.speed_mps,
            run.friction,
        );
        *out += &run.result_columns();
        out.push('\n');
    }
}

fn number_or_empty(value: Option<f64>) -> String {
    value.map_or_else(String::new, |value| value.to_string())
}

impl HarmGroup {
    fn new(
        space: &ContentId,
        follower: Option<&str>,
        runs: &[(&str, Vec<HarmRun>)],
        avoidability: &[Option<bool>],
    ) -> Self {
        let reference: &[HarmRun] = runs.first().map_or(&[], |(_, runs)| runs);
        let examined: Vec<Option<bool>> = reference
            .iter()
            .zip(avoidability)
            .filter(|(run, _)| run.has_follower(follower))
            .map(|(_, avoidable)| *avoidable)
            .collect();
        let controllers = runs.iter().map(|(controller, runs)| {
            let pairs: Vec<_> = runs
                .iter()
                .zip(reference)
                .filter(|(run, _)| run.has_follower(follower))
                .collect();
            ControllerHarm::new(controller, &pairs)
        });
        Self {
            space: space.clone(),
            follower: follower.unwrap_or("all").to_owned(),
            drives: reference
                .iter()
                .filter(|run| run.has_follower(follower))
                .count() as u64,
            avoidable: [
                count_answers(&examined, true),
                count_answers(&examined, false),
                examined.len() as u64,
            ],
            controllers: controllers.collect(),
        }
    }

    fn table(&self, emergencies_per_hour: f64) -> ReportTable {
        // A controller that never answered has no figures.
        let drives = self.drives;
        let shown = |harm: &ControllerHarm, cell: String| {
            ReportCell::optional((harm.unanswered < drives).then_some(cell))
        };
        let columns: [ReportColumn<'_, &ControllerHarm>; 9] = [
            ("controller", &|harm| ReportCell::text(&harm.controller)),
            ("activations", &|harm| {
                shown(harm, harm.activations.to_string())
            }),
            ("hits leader (%)", &|harm| {
                shown(harm, describe_percent(harm.ahead_percent))
            }),
            ("avoided", &|harm| shown(harm, harm.avoided.to_string())),
            ("hit from behind (%)", &|harm| {
                shown(harm, describe_percent(harm.behind_percent))
            }),
            ("caused", &|harm| shown(harm, harm.caused.to_string())),
            ("caused per 100 activations", &|harm| {
                shown(harm, describe_percent(harm.caused_per_100_activations))
            }),
            ("harm per 1000 drives", &|harm| {
                let (mean, margin) = harm.harm_per_1000;
                let margin = margin.map_or_else(String::new, |margin| format!(" ± {margin}"));
                shown(harm, format!("{mean}{margin}"))
            }),
            ("harm per hour", &|harm| {
                let per_drive = harm.harm_per_1000.0.value() / 1000.0;
                shown(harm, format!("{:.2e}", per_drive * emergencies_per_hour))
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }
}

fn count_answers(answers: &[Option<bool>], wanted: bool) -> u64 {
    let matching = answers.iter().filter(|answer| **answer == Some(wanted));
    matching.count() as u64
}

/// Describes a share with its bounds.
fn describe_percent(share: PercentInterval) -> String {
    format!("{} ({})", share.observed, share.format_bounds())
}

impl ControllerHarm {
    /// Summarizes the runs of a controller, each with the run of the reference in the same drive.
    fn new(controller: &str, pairs: &[(&HarmRun, &HarmRun)]) -> Self {
        let answered: Vec<&HarmRun> = pairs
            .iter()
            .map(|(run, _)| *run)
            .filter(|run| !run.is_unanswered)
            .collect();
        let compared: Vec<(&HarmRun, &HarmRun)> = pairs
            .iter()
            .copied()
            .filter(|(run, reference)| !run.is_unanswered && !reference.is_unanswered)
            .collect();
        let total = answered.len() as u64;
        let causes = count_pairs(&compared, |run, reference| {
            run.activates && run.causes_collision_behind(reference)
        });
        let compared_activations = count_pairs(&compared, |run, _| run.activates);
        Self {
            controller: controller.to_owned(),
            unanswered: pairs.len() as u64 - total,
            activations: count_runs(&answered, |run| run.activates),
            ahead_percent: PercentInterval::clopper_pearson(
                [count_runs(&answered, HarmRun::hits_leader), 0],
                total,
            ),
            behind_percent: PercentInterval::clopper_pearson(
                [count_runs(&answered, HarmRun::is_hit_from_behind), 0],
                total,
            ),
            avoided: count_pairs(&compared, |run, reference| {
                !run.hits_leader() && reference.hits_leader()
            }),
            caused: count_pairs(&compared, HarmRun::causes_collision_behind),
            caused_per_100_activations: PercentInterval::clopper_pearson(
                [causes, 0],
                compared_activations,
            ),
            harm_per_1000: harm_per_1000(&answered),
        }
    }
}

fn count_runs(runs: &[&HarmRun], condition: impl Fn(&HarmRun) -> bool) -> u64 {
    runs.iter().filter(|run| condition(run)).count() as u64
}

fn count_pairs(
    pairs: &[(&HarmRun, &HarmRun)],
    condition: impl Fn(&HarmRun, &HarmRun) -> bool,
) -> u64 {
    pairs
        .iter()
        .filter(|(run, reference)| condition(run, reference))
        .count() as u64
}

/// Returns the mean harm of 1000 drives, and half of its interval.
fn harm_per_1000(runs: &[&HarmRun]) -> (Rounded<3>, Option<Rounded<3>>) {
    let drives = runs.len().max(1) as f64;
    let mean = runs.iter().map(|run| run.harm).sum::<f64>() / drives;
    let squares = runs.iter().map(|run| (run.harm - mean).powi(2));
    let margin = NORMAL_QUANTILE * (squares.sum::<f64>() / drives / drives).sqrt();
    let harmful = runs.iter().filter(|run| run.harm > 0.0).count();
    (
        Rounded::new(1000.0 * mean),
        (harmful >= MIN_HARMFUL_DRIVES).then(|| Rounded::new(1000.0 * margin)),
    )
}

/// File with a line for each run.
pub(in crate::assessment) const HARM_RUNS_FILE: &str = "runs.csv";

impl ReportPart for HarmReport {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::RandomScenarios,
            anchor: "harm",
            title: "Collisions ahead avoided, collisions behind caused, and harm",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        if plan.config.harm.is_none() {
            return 0;
        }
        plan.runs_of_all(plan.rate_spaces.len() as u64 * plan.config.draws)
    }

    fn files(&self) -> Vec<(String, Vec<u8>)> {
        vec![(
            HARM_RUNS_FILE.to_owned(),
            self.runs_csv.clone().into_bytes(),
        )]
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(self.introduction());
        for group in &self.groups {
            out.heading(format!(
                "{}, follower: {}",
                group.space.name, group.follower
            ));
            out.paragraph(group.describe());
            out.table(group.table(self.emergencies_per_hour));
        }
    }
}

impl HarmReport {
    fn introduction(&self) -> String {
        format!(
            "Harm is the expected number of seriously injured drivers (MAIS3+ of Wang 2022, DOT HS 813 219, for light \
             vehicles; also used for lorries). An activation is braking above {ACTIVATION_MPS2} m/s² before any \
             collision. Avoided and caused are relative to the first controller in the same drive. Intervals are at 95 \
             %: exact for shares, normal for harm (none if fewer than {MIN_HARMFUL_DRIVES} drives have harm). Rates \
             per hour assume {} emergencies per hour. `runs.csv` has every run.",
            self.emergencies_per_hour
        )
    }
}

impl HarmGroup {
    fn describe(&self) -> String {
        let [avoidable, unavoidable, examined] = self.avoidable;
        let mut text = describe_drives(self.drives) + ".";
        if examined > 0 {
            let _ = write!(
                text,
                " Of the first {examined}, {avoidable} have an escape from every collision, and {unavoidable} are \
                 proved to have none (`crumple avoid`)."
            );
        }
        for harm in self.controllers.iter().filter(|harm| harm.unanswered > 0) {
            let _ = write!(
                text,
                " `{}` gave no answer in {}, which its row leaves out.",
                harm.controller,
                describe_drives(harm.unanswered)
            );
        }
        let reference = self.controllers.first();
        if reference.is_some_and(|harm| harm.unanswered > 0) {
            text += " Comparisons with it leave out these drives.";
        }
        text
    }
}

fn describe_drives(count: u64) -> String {
    format!("{count} drive{}", if count == 1 { "" } else { "s" })
}
