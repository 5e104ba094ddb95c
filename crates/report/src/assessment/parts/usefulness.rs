//! Usefulness: the behaviour of a controller in everyday traffic, compared with its failures in dangerous scenarios.

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::sampling::{RunSummary, run_samples, share_panel, simulate_each};
use super::{PercentInterval, StringStabilityVerdict};
use crate::assessment::case::CaseVerdict;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength, UncomparedText,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::gate::SpaceTally;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::rounded::or_dash;
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, CacheError, ReportPart, Rounded};
use crate::draw::{Ink, Marker, Svg};
use crumple_evidence::exposure::IntervalEstimate;
use crumple_world::measure::{self, FollowingMeasures, HARD_BRAKE_MPS2, UNNECESSARY_MARGIN_MPS2};
use crumple_world::observation::EstimatorKind;
use crumple_world::scenario::space::{ScenarioSpace, built_in_space, built_in_space_summary, file as space_file};
use crumple_world::scenario::{GhostObject, Scenario, SensorFaults, speed_dip};
use crumple_world::sim::{FailedControllerRuns, NamedController, RecordingLevel, RunOptions, SimulationResult};

const ANCHOR: &str = "usefulness";

const CONFIDENCE: f64 = 0.95;

/// The built-in spaces of everyday traffic and of dangerous scenarios.
pub(in crate::assessment) const EVERYDAY_SPACES: [&str; 2] = ["traffic", "high-risk"];

const FOLLOWERS: usize = 5;

/// Initial time gap of the line, in seconds.
const TIME_GAP_S: f64 = 1.5;

/// Every controller in everyday traffic, in danger, and in a line.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct UsefulnessReport {
    /// Scenario spaces: everyday traffic, and dangerous scenarios.
    pub spaces: [ContentId; 2],
    /// Scenario of the line for string stability.
    #[serde(rename = "line")]
    pub platoon: ContentId,
    /// Number of random scenarios of each space for each controller.
    #[serde(rename = "draws")]
    pub random_scenarios: u64,
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Confidence level of the bounds.
    pub confidence: f64,
    /// One entry per controller.
    pub controllers: Vec<ControllerUsefulness>,
}

/// The usefulness of one controller. Means are over the drives that have the value; pairs are everyday traffic and
/// danger.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerUsefulness {
    /// Name of the controller.
    pub controller: String,
    /// Everyday drives in which a vehicle under test collided or its controller failed.
    pub failures: u64,
    /// Scenarios that ended with a collision of other vehicles: no evidence about the controller.
    #[serde(rename = "cut_short")]
    pub ended_by_others: [u64; 2],
    /// Dangerous scenarios that the controller failed.
    pub high_risk_failures: u64,
    /// Scenarios in which a vehicle under test first hit its leader.
    #[serde(default)]
    pub hit: [u64; 2],
    /// Scenarios in which a vehicle under test was first hit from behind.
    #[serde(default)]
    pub was_hit: [u64; 2],
    /// Scenarios without an answer of the controller: failures, but no evidence about its driving.
    #[serde(default, skip_serializing_if = "all_answered")]
    pub unanswered: [Option<FailedControllerRuns>; 2],
    /// Everyday drives with unnecessary braking.
    #[serde(rename = "needless")]
    pub unnecessary_braking: u64,
    /// Share of these drives in percent, with exact bounds.
    #[serde(rename = "needless_percent")]
    pub unnecessary_braking_percent: PercentInterval,
    /// Mean time of unnecessary braking in a drive, in seconds.
    #[serde(rename = "needless_s")]
    pub unnecessary_braking_s: Option<Rounded<2>>,
    /// Unnecessary braking per hour of everyday driving, without and with sensor faults.
    #[serde(rename = "needless_per_hour")]
    pub unnecessary_braking_rates: Vec<BrakingRate>,
    /// Everyday drives with hard braking where little braking was required.
    #[serde(rename = "hard")]
    pub hard_braking: u64,
    /// Everyday drives at whose end the vehicle had fallen behind.
    pub left_behind: u64,
    /// Mean distance driven, relative to that of the leader.
    pub progress: Option<Rounded<2>>,
    /// Mean time gap, in seconds.
    pub time_gap_s: Option<Rounded<2>>,
    /// Mean of the time gap's standard deviation over a drive, in seconds.
    pub time_gap_deviation_s: Option<Rounded<2>>,
    /// Mean of a drive's root mean square of acceleration, in m/s².
    pub rms_acceleration_mps2: Option<Rounded<2>>,
    /// Mean of a drive's root mean square of jerk, in m/s³.
    pub rms_jerk_mps3: Option<Rounded<2>>,
    /// Mean of the hardest deceleration of the follower, in m/s².
    #[serde(rename = "imposed_brake_mps2")]
    pub induced_brake_mps2: Option<Rounded<2>>,
    /// String stability of a line of these controllers.
    #[serde(rename = "line")]
    pub string_stability: StringStabilityVerdict,
    /// Share of failures in dangerous scenarios in percent, with exact bounds.
    pub high_risk_percent: PercentInterval,
}

/// Unnecessary braking per hour, with the exact interval of independent brakings at 95 %.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrakingRate {
    /// Sensor faults.
    pub sensors: String,
    /// Number of brakings.
    pub count: u64,
    /// Hours of driving.
    pub hours: Rounded<2>,
    /// Brakings per hour.
    pub per_hour: Rounded<1>,
    /// Lower and upper end of the interval, per hour.
    pub interval: [Rounded<1>; 2],
}

/// Returns names and faults of the sensors in everyday drives. The first has none.
fn sensor_conditions() -> [(&'static str, SensorFaults); 3] {
    let degraded = SensorFaults {
        latency_s: 0.2,
        gap_resolution_m: 0.5,
        outage_rate_per_s: 0.5,
        outage_length_s: 0.5,
        ..SensorFaults::default()
    };
    let object = GhostObject { onset_s: 5.0, duration_s: 0.5, gap_m: 20.0, speed_mps: 0.0 };
    let ghost = SensorFaults { ghost: Some(object), ..SensorFaults::default() };
    [("no fault", SensorFaults::default()), ("degraded", degraded), ("ghost", ghost)]
}

fn all_answered(unanswered: &[Option<FailedControllerRuns>; 2]) -> bool {
    unanswered.iter().all(Option::is_none)
}

struct EverydayDrive {
    verdict: CaseVerdict,
    usefulness: Option<measure::UsefulnessMeasures>,
    /// Duration until the end or a collision, in seconds.
    duration_s: f64,
}

impl UsefulnessReport {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        if plan.config.everyday_draws == 0 {
            return Ok(None);
        }
        let inputs =
            json!([plan.config.everyday_draws, plan.config.seed, plan.config.estimator.name(), plan.identities()]);
        work.get_or_gather("usefulness", &inputs, || Self::run(work))
    }

    fn run(work: &GatherContext<'_>) -> Result<Option<Self>, AssessError> {
        let plan = work.plan;
        let (seed, count) = (plan.config.seed, plan.config.everyday_draws);
        let [Some(traffic), Some(high_risk)] = EVERYDAY_SPACES.map(built_in_space) else { return Ok(None) };
        let content_id = |space: &ScenarioSpace| {
            let text = space_file::to_toml(space).map_err(CacheError::encoding)?;
            Ok::<_, CacheError>(ContentId::new(space.name(), text))
        };
        let spaces = [content_id(&traffic)?, content_id(&high_risk)?];
        let random_scenarios =
            |space: ScenarioSpace| (0..count).map(|index| space.draw(seed, index)).collect::<Result<Vec<_>, _>>();
        let (traffic, high_risk, line) =
            (random_scenarios(traffic)?, random_scenarios(high_risk)?, speed_dip(FOLLOWERS, TIME_GAP_S)?);
        let platoon = ContentId::from_scenario("a platoon of five vehicles whose leader slows down", &line);
        let useful = |controller: &NamedController| -> Result<ControllerUsefulness, AssessError> {
            let options = RunOptions::new(controller.kind.clone()).with_estimator(plan.config.estimator);
            let drives = simulate_each(&traffic, &options, RecordingLevel::Trace, EverydayDrive::new)?;
            let danger = run_samples(&high_risk, controller, plan)?;
            let line = StringStabilityVerdict::simulate(&line, &options)?;
            let mut useful = ControllerUsefulness::new(controller, &drives, &danger, line);
            useful.unnecessary_braking_rates = braking_rates(&traffic, &drives, &options)?;
            work.add_runs(2 * count + 1)?;
            Ok(useful)
        };
        let controllers = plan.controllers.iter().map(useful).collect::<Result<_, _>>()?;
        Ok(Some(Self { spaces, platoon, random_scenarios: count, seed, confidence: CONFIDENCE, controllers }))
    }

    pub(in crate::assessment) fn domains(&self) -> [Domain; 2] {
        let (seed, draws) = (self.seed, self.random_scenarios);
        self.spaces.clone().map(|space| Domain::Draws { space, seed, draws })
    }

    pub(super) fn space_summaries(&self) -> Vec<(String, String)> {
        let of = |name: &str| Some((name.to_owned(), built_in_space_summary(&built_in_space(name)?)?.to_owned()));
        EVERYDAY_SPACES.iter().filter_map(|name| of(name)).collect()
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&ControllerUsefulness> {
        self.controllers.iter().find(|useful| useful.controller == controller)
    }

    /// Returns the counts of a controller in a space, if it is one of the two.
    pub(in crate::assessment) fn space_tally(&self, controller: &str, space: &str) -> Option<SpaceTally> {
        let (place, useful) = (EVERYDAY_SPACES.iter().position(|known| *known == space)?, self.find(controller)?);
        let failures = [useful.failures, useful.high_risk_failures];
        let unanswered = useful.unanswered_runs()[place];
        Some(SpaceTally {
            scenarios: self.random_scenarios,
            collisions: failures[place].saturating_sub(unanswered),
            unanswered,
            ended_by_others: useful.ended_by_others[place],
        })
    }

    pub(in crate::assessment) fn platoon_domain(&self) -> Domain {
        Domain::Scenarios { about: UncomparedText(self.platoon.name.clone()), all: vec![self.platoon.clone()] }
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let [traffic, danger] = self.domains();
        let made = format!("{} drives, seed {}", self.random_scenarios, self.seed);
        let mut all = Vec::new();
        for (subject, useful) in plan.claim_subjects().into_iter().zip(&self.controllers) {
            let touching = |place: usize, failures: u64| failures.saturating_sub(useful.unanswered_runs()[place]);
            let [in_traffic, in_danger] = &useful.unanswered;
            let counts = [
                (Property::NoContact, &traffic, touching(0, useful.failures), useful.ended_by_others[0], in_traffic),
                (Property::NoUnnecessaryBraking, &traffic, useful.unnecessary_braking, 0, in_traffic),
                (Property::KeepsUp, &traffic, useful.left_behind, 0, in_traffic),
                (
                    Property::NoContact,
                    &danger,
                    touching(1, useful.high_risk_failures),
                    useful.ended_by_others[1],
                    in_danger,
                ),
            ];
            let (property, domain) = (Property::StringStable, self.platoon_domain());
            let line = AssuranceClaim { subject: subject.clone(), property, domain };
            let source = EvidenceSource::from_part(ANCHOR, "one run of a platoon");
            all.push(Evidence { claim: line, strength: useful.string_stability.strength(), source });
            for (property, domain, failures, ended_by_others, unanswered) in counts {
                let (telling, refutes) = (self.random_scenarios - ended_by_others, property == Property::NoContact);
                let strength = Strength::from_counts_with_unanswered(failures, telling, unanswered.as_ref(), refutes);
                let claim = AssuranceClaim { subject: subject.clone(), property, domain: domain.clone() };
                all.push(Evidence { claim, strength, source: EvidenceSource::from_part(ANCHOR, made.as_str()) });
            }
        }
        all
    }

    fn introduction(&self) -> String {
        format!(
            "A controller that stands still never collides, so the report also measures usefulness. Every controller \
             drives the same {} random scenarios of `traffic` (seed {}), ordinary driving without hard braking, and as \
             many of `high-risk`. Columns without a space are about `traffic`. Braking is unnecessary if it is more \
             than {UNNECESSARY_MARGIN_MPS2} m/s² harder, for 0.2 s, than the Intelligent Driver Model would brake at \
             the true state, than the collision avoidance required, and than the leader braked. Gain: {FOLLOWERS} \
             vehicles with the controller follow a leader that slows down by 4 m/s and recovers; the change of speed \
             of the last one, relative to the leader's. Bounds are exact (Clopper–Pearson, {} %).",
            self.random_scenarios,
            self.seed,
            100.0 * self.confidence
        )
    }

    fn table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 14] = [
            ("controller", &|one| ReportCell::text(&one.controller)),
            ("failures", &|one| ReportCell::with_verdict(one.failures, one.failures == 0)),
            ("unnecessary braking (%)", &|one| match (one.unnecessary_braking, one.unanswered_runs()) {
                // A drive without an answer is no evidence for the absence of unnecessary braking.
                (0, [unanswered, _]) if unanswered > 0 => ReportCell::number(one.unnecessary_braking_percent.observed),
                (needless, _) => ReportCell::with_verdict(one.unnecessary_braking_percent.observed, needless == 0),
            }),
            ("bounds (%)", &|one| ReportCell::number(one.unnecessary_braking_percent.format_bounds())),
            ("per drive (s)", &|one| ReportCell::optional(one.unnecessary_braking_s)),
            ("hard braking", &|one| ReportCell::number(one.hard_braking)),
            ("falls behind", &|one| ReportCell::number(one.left_behind)),
            ("progress", &|one| ReportCell::optional(one.progress)),
            ("time gap (s)", &|one| {
                ReportCell::number(format!("{} ± {}", or_dash(one.time_gap_s), or_dash(one.time_gap_deviation_s)))
            }),
            ("rms acceleration (m/s²)", &|one| ReportCell::optional(one.rms_acceleration_mps2)),
            ("rms jerk (m/s³)", &|one| ReportCell::optional(one.rms_jerk_mps3)),
            ("induced braking (m/s²)", &|one| ReportCell::optional(one.induced_brake_mps2)),
            ("gain", &|one| one.string_stability.table_cell()),
            ("failures in high-risk (%)", &|one| ReportCell::number(one.high_risk_percent.observed)),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    /// The main results of both sides, for the first page.
    pub(super) fn both_sides_table(&self) -> ReportTable {
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 8] = [
            ("controller", &|one| ReportCell::text(&one.controller)),
            ("failures in high-risk (%)", &|one| ReportCell::number(one.high_risk_percent.observed)),
            ("in traffic", &|one| ReportCell::with_verdict(one.failures, one.failures == 0)),
            ("unnecessary braking (%)", &|one| ReportCell::number(one.unnecessary_braking_percent.observed)),
            ("hard", &|one| ReportCell::number(one.hard_braking)),
            ("falls behind", &|one| ReportCell::number(one.left_behind)),
            ("rms jerk (m/s³)", &|one| ReportCell::optional(one.rms_jerk_mps3)),
            ("time gap (s)", &|one| ReportCell::optional(one.time_gap_s)),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    /// Explains the table of the first page.
    pub(super) fn both_sides_note(&self) -> String {
        format!(
            "Both sides: {} random scenarios of each space (seed {}). Columns without a space are about `traffic`. \
             Hard: unnecessary braking harder than {HARD_BRAKE_MPS2} m/s².",
            self.random_scenarios, self.seed
        )
    }

    /// The failures of both spaces by their kind.
    fn failure_table(&self) -> ReportTable {
        let pair = |[traffic, danger]: [u64; 2]| format!("{traffic}, {danger}");
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 4] = [
            ("controller", &|one| ReportCell::text(&one.controller)),
            ("no answer (traffic, high-risk)", &|one| {
                ReportCell::with_verdict(pair(one.unanswered_runs()), one.unanswered_runs() == [0, 0])
            }),
            ("hits leader (traffic, high-risk)", &|one| ReportCell::number(pair(one.hit))),
            ("hit from behind (traffic, high-risk)", &|one| ReportCell::number(pair(one.was_hit))),
        ];
        let all_answered = self.controllers.iter().all(|one| all_answered(&one.unanswered));
        ReportTable::from_items_without(&self.controllers, &columns, all_answered.then_some(1))
    }

    /// Unnecessary braking per hour, without and with sensor faults.
    fn braking_rate_table(&self) -> ReportTable {
        let cell = |one: &ControllerUsefulness, sensors: &str| {
            let rate = one.unnecessary_braking_rates.iter().find(|rate| rate.sensors == sensors);
            ReportCell::optional(
                rate.map(|BrakingRate { per_hour, interval: [low, high], .. }| format!("{per_hour} ({low} to {high})")),
            )
        };
        let columns: [ReportColumn<'_, &ControllerUsefulness>; 4] = [
            ("unnecessary braking per hour", &|one| ReportCell::text(&one.controller)),
            ("no fault", &|one| cell(one, "no fault")),
            ("degraded", &|one| cell(one, "degraded")),
            ("ghost", &|one| cell(one, "ghost")),
        ];
        ReportTable::from_items(&self.controllers, &columns)
    }

    fn unanswered_notes(&self) -> Vec<String> {
        let of = |useful: &ControllerUsefulness| {
            let places = EVERYDAY_SPACES.into_iter().zip(&useful.unanswered);
            let words = places.filter_map(|(place, unanswered)| {
                let words = unanswered.as_ref()?.describe(self.random_scenarios);
                Some(format!("{} in `{place}`: {words}", useful.controller))
            });
            let line = match &useful.string_stability {
                StringStabilityVerdict::Unanswered { reason } => {
                    Some(format!("{} in the platoon gave no answer: {reason}", useful.controller))
                }
                _ => None,
            };
            words.chain(line).collect::<Vec<_>>()
        };
        self.controllers.iter().flat_map(of).collect()
    }

    /// Draws both shares: one row per controller, 0 at the left, lower is better.
    pub(super) fn figure(&self, id: &str) -> Svg {
        let names: Vec<_> = self.controllers.iter().map(|useful| useful.controller.as_str()).collect();
        let title = "Failures in high-risk (×), unnecessary braking (○)";
        let (mut panel, size) = share_panel(title, "Share of random scenarios (%)", &names, 36.0);
        for (index, useful) in self.controllers.iter().enumerate() {
            let row = (names.len() - 1 - index) as f64;
            let sides = [
                (useful.high_risk_percent, row + 0.15, Ink::Alert, Marker::Cross),
                (useful.unnecessary_braking_percent, row - 0.15, Ink::Series(0), Marker::Ring),
            ];
            for (share, y, ink, marker) in sides {
                share.add_to(&mut panel, y, ink, marker);
            }
        }
        let of = |useful: &ControllerUsefulness| {
            let (fails, brakes) = (useful.high_risk_percent.observed, useful.unnecessary_braking_percent.observed);
            let name = &useful.controller;
            format!("{name} fails in {fails} % of high-risk, brakes unnecessarily in {brakes} % of traffic")
        };
        let description = self.controllers.iter().map(of).collect::<Vec<_>>().join("; ");
        Svg::new(id, size, "Safety and usefulness", &description, panel.draw(&Svg::id(id, "panel")))
    }
}

/// Measures unnecessary braking per hour under each condition of the sensors. Leaves out conditions that a controller
/// refuses, as a shield does, and all faults if the controller observes the true state.
fn braking_rates(
    traffic: &[Scenario],
    drives: &[EverydayDrive],
    options: &RunOptions,
) -> Result<Vec<BrakingRate>, AssessError> {
    let mut rates = Vec::new();
    for (sensors, faults) in sensor_conditions() {
        if !faults.is_any() {
            rates.push(BrakingRate::new(sensors, drives));
        } else if options.estimator == EstimatorKind::Kalman {
            let faulty = |one: &Scenario| one.edited(|spec| spec.sensors.faults = faults.clone());
            let faulty = traffic.iter().map(faulty).collect::<Result<Vec<_>, _>>()?;
            let drives = simulate_each(&faulty, options, RecordingLevel::Trace, EverydayDrive::new);
            rates.extend(drives.ok().map(|drives| BrakingRate::new(sensors, &drives)));
        }
    }
    Ok(rates)
}

impl BrakingRate {
    fn new(sensors: &str, drives: &[EverydayDrive]) -> Self {
        let count = drives.iter().filter_map(|drive| drive.usefulness).map(|useful| useful.unnecessary.count as u64);
        let (count, hours) = (count.sum(), drives.iter().map(|drive| drive.duration_s).sum::<f64>() / 3600.0);
        let IntervalEstimate { estimate, lower, upper } = IntervalEstimate::poisson_rate(count, hours);
        Self {
            sensors: sensors.to_owned(),
            count,
            hours: hours.into(),
            per_hour: estimate.into(),
            interval: [Rounded::down(lower), Rounded::up(upper)],
        }
    }
}

impl EverydayDrive {
    fn new(scenario: &Scenario, simulated: &SimulationResult) -> Self {
        let ego = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index));
        let usefulness = simulated
            .trace
            .as_ref()
            .zip(ego)
            .and_then(|(trace, ego)| measure::UsefulnessMeasures::from_trace(trace, &simulated.impacts, ego));
        let end_s = simulated.outcome.contact().map(|contact| contact.time_s);
        let duration_s = end_s.unwrap_or(scenario.spec().duration_s);
        Self { verdict: CaseVerdict::new(simulated, scenario), usefulness, duration_s }
    }
}

impl ControllerUsefulness {
    /// Returns the number of everyday drives and of dangerous scenarios in which the controller gave no answer.
    #[must_use]
    pub fn unanswered_runs(&self) -> [u64; 2] {
        self.unanswered.each_ref().map(|unanswered| unanswered.as_ref().map_or(0, |unanswered| unanswered.runs))
    }

    fn new(
        controller: &NamedController,
        drives: &[EverydayDrive],
        danger: &[RunSummary],
        line: StringStabilityVerdict,
    ) -> Self {
        // A drive without an answer is no evidence about driving or keeping up.
        let answered = |drive: &&EverydayDrive| !matches!(drive.verdict, CaseVerdict::ControllerFailed { .. });
        let all: Vec<_> = drives.iter().filter(answered).filter_map(|drive| drive.usefulness).collect();
        let mut unanswered = [None, None];
        drives.iter().for_each(|drive| FailedControllerRuns::merge(&mut unanswered[0], drive.verdict.unanswered()));
        danger.iter().for_each(|run| FailedControllerRuns::merge(&mut unanswered[1], run.verdict.unanswered()));
        let count = |is: &dyn Fn(&measure::UsefulnessMeasures) -> bool| all.iter().filter(|one| is(one)).count() as u64;
        let mean = |of: &dyn Fn(&measure::UsefulnessMeasures) -> Option<f64>| {
            let (sum, n) = all.iter().filter_map(of).fold((0.0, 0_u32), |(sum, n), value| (sum + value, n + 1));
            (n > 0).then(|| Rounded::new(sum / f64::from(n)))
        };
        let following = |of: fn(FollowingMeasures) -> Option<f64>| mean(&|one| one.following.and_then(of));
        let needless = count(&|one| !one.unnecessary.is_empty());
        // The results of these drives are unknown.
        let unanswered_drives = unanswered[0].as_ref().map_or(0, |runs: &FailedControllerRuns| runs.runs);
        let in_traffic = EndCounts::from_verdicts(drives.iter().map(|drive| &drive.verdict));
        let in_danger = EndCounts::from_verdicts(danger.iter().map(|run| &run.verdict));
        let percent = |counts, runs: usize| PercentInterval::clopper_pearson(counts, runs as u64, CONFIDENCE);
        Self {
            controller: controller.name.clone(),
            failures: in_traffic.failures,
            unanswered,
            ended_by_others: [in_traffic.ended_by_others, in_danger.ended_by_others],
            high_risk_failures: in_danger.failures,
            hit: [in_traffic.hit, in_danger.hit],
            was_hit: [in_traffic.was_hit, in_danger.was_hit],
            unnecessary_braking: needless,
            unnecessary_braking_percent: percent([needless, unanswered_drives], drives.len()),
            unnecessary_braking_rates: Vec::new(),
            unnecessary_braking_s: mean(&|one| Some(one.unnecessary.time_s)),
            hard_braking: count(&|one| !one.hard.is_empty()),
            left_behind: count(&|one| one.following.is_some_and(|following| following.fell_behind)),
            progress: following(|following| following.progress),
            time_gap_s: following(|following| following.mean_time_gap_s),
            time_gap_deviation_s: following(|following| following.time_gap_deviation_s),
            rms_acceleration_mps2: mean(&|one| one.rms_acceleration_mps2),
            rms_jerk_mps3: mean(&|one| one.rms_jerk_mps3),
            induced_brake_mps2: mean(&|one| one.induced.and_then(|imposed| imposed.peak_brake_mps2)),
            string_stability: line,
            high_risk_percent: percent([in_danger.failures, in_danger.ended_by_others], danger.len()),
        }
    }
}

#[derive(Default)]
struct EndCounts {
    failures: u64,
    /// Runs that a collision of other vehicles ended.
    ended_by_others: u64,
    hit: u64,
    was_hit: u64,
}

impl EndCounts {
    fn from_verdicts<'a>(verdicts: impl Iterator<Item = &'a CaseVerdict>) -> Self {
        let mut ends = Self::default();
        for verdict in verdicts {
            ends.failures += u64::from(verdict.is_failure());
            ends.ended_by_others += u64::from(!verdict.is_conclusive());
            ends.hit += u64::from(matches!(verdict, CaseVerdict::Hit(_)));
            ends.was_hit += u64::from(matches!(verdict, CaseVerdict::WasHit(_)));
        }
        ends
    }
}

const SENSOR_CONDITIONS: &str = "Unnecessary braking per hour of `traffic`, with the exact interval of independent \
    brakings at 95 %. Degraded sensors: latency 0.2 s, resolution 0.5 m, outages of 0.5 s, one per 2 s. Ghost: one \
    standing object per drive, reported 20 m ahead for 0.5 s. A dash: the controller refuses sensor faults.";

impl ReportPart for UsefulnessReport {
    fn anchor_and_title(&self) -> (&'static str, String) {
        (ANCHOR, "Comfort and unnecessary braking".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.paragraph(&self.introduction());
        out.table(&self.table());
        out.paragraph(SENSOR_CONDITIONS);
        out.table(&self.braking_rate_table());
        out.table(&self.failure_table());
        self.unanswered_notes().iter().for_each(|line| out.paragraph(line));
        out.figure(self.figure(ANCHOR));
    }
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::*;
    use crate::assessment::{AssessConfig, EvidenceCache};
    use crumple_core::observer::{ProgressCounter, Quiet};

    #[test]
    fn both_measures_are_reported_for_every_controller() {
        let controllers = ["idm", "retrained"].map(str::to_owned).into();
        let config = AssessConfig { controllers, gates: Vec::new(), ..AssessConfig::default() };
        let plan = AssessmentPlan::new(config, [], Path::new("")).unwrap();
        let cache = EvidenceCache::disabled();
        let work = GatherContext::new(&plan, &cache, ProgressCounter::new(&Quiet, None));
        let found = UsefulnessReport::gather(&work).unwrap().unwrap();
        let [idm, retrained] = &found.controllers[..] else { panic!("one entry per controller") };
        assert_eq!((idm.failures, idm.unnecessary_braking, idm.hard_braking, retrained.failures), (0, 0, 0, 0));
        assert!(retrained.unnecessary_braking > found.random_scenarios / 2 && retrained.progress < idm.progress);
        assert!(retrained.high_risk_percent.observed < idm.high_risk_percent.observed, "the other side");
        for useful in [idm, retrained] {
            assert_eq!(useful.hit[1] + useful.was_hit[1], useful.high_risk_failures, "a failure is a collision");
        }
        assert!(idm.was_hit[1] > 0 || idm.hit[1] > 0);
        assert!(
            matches!(idm.string_stability, StringStabilityVerdict::Damps { gain } if gain.value() < 1.0),
            "{:?}",
            idm.string_stability
        );
        assert_eq!(retrained.string_stability, StringStabilityVerdict::DoesNotSettle);
        let json = serde_json::to_string(&found).unwrap();
        assert_eq!(serde_json::to_string(&serde_json::from_str::<UsefulnessReport>(&json).unwrap()).unwrap(), json);
        assert!(
            found.to_markdown().into_string().contains("| idm |") && found.to_html().into_string().contains("<svg")
        );
    }
}
