//! Random scenarios of scenario spaces: failure rates with exact bounds, and paired comparison.

use serde::{Deserialize, Serialize};
use serde_json::json;

use crate::assessment::case::{CaseVerdict, smallest};
use crate::assessment::claims::{AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, Strength};
use crate::assessment::document::ReportDocument;
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::NamedSpace;
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, ReportPart, Rounded};
use crate::draw::{
    Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, Marker, Panel, PixelRect, SMALL_TEXT_SIZE, Stroke, Svg, text_width,
};
use crumple_evidence::RateInterval;
use crumple_world::scenario::Scenario;
use crumple_world::sim::{
    FailedControllerRuns, NamedController, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate_batch,
};

const CONFIDENCE: f64 = 0.95;

/// Number of scenarios simulated at a time: enough to use all cores, and few enough for memory.
const BATCH_SIZE: u64 = 4096;

/// Every controller on the same random scenarios of each space.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceSamples {
    /// One entry per scenario space.
    pub spaces: Vec<SpaceSample>,
}

/// Every controller on the same random scenarios of a space.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SpaceSample {
    /// Scenario space.
    pub space: ContentId,
    /// Number of random scenarios for each controller.
    #[serde(rename = "draws")]
    pub random_scenarios: u64,
    /// Seed of the random scenarios.
    pub seed: u64,
    /// Confidence level of the intervals.
    pub confidence: f64,
    /// One entry per controller.
    pub controllers: Vec<ControllerSample>,
}

/// The results of one controller on all random scenarios.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct ControllerSample {
    /// Name of the controller.
    pub controller: String,
    /// Number of scenarios in which a vehicle under test collides.
    pub collisions: u64,
    /// Scenarios in which the controller gave no answer: failures, but no collisions.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unanswered: Option<FailedControllerRuns>,
    /// Number of scenarios that end with a collision of other vehicles: no evidence about the controller.
    #[serde(rename = "cut_short")]
    pub ended_by_others: u64,
    /// Number of scenarios in which a vehicle under test first hits its leader.
    pub hit: u64,
    /// Number of scenarios in which a vehicle under test is first hit from behind.
    pub was_hit: u64,
    /// Failure rate in percent, with exact bounds: collisions and scenarios without an answer.
    pub rate_percent: PercentInterval,
    /// Smallest gap ahead of a vehicle under test over all scenarios, in metres.
    pub min_gap_ahead_m: Option<Rounded<2>>,
    /// Smallest gap behind a vehicle under test over all scenarios, in metres.
    pub min_gap_behind_m: Option<Rounded<2>>,
    /// Mean impact speed of the collisions, in m/s.
    pub mean_impact_speed_mps: Option<Rounded<1>>,
    /// Comparison with the first controller on the same scenarios; absent for the first itself.
    pub paired: Option<PairedCounts>,
}

/// A share in percent with its bounds.
#[derive(Debug, Clone, Copy, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PercentInterval {
    /// Observed share.
    pub observed: Rounded<2>,
    /// Lower bound.
    pub lower: Rounded<2>,
    /// Upper bound.
    pub upper: Rounded<2>,
}

impl PercentInterval {
    pub(super) fn add_to(&self, panel: &mut Panel, y: f64, ink: Ink, marker: Marker) {
        panel.add_segment((self.lower.value(), y), (self.upper.value(), y), Stroke::solid(ink, 2.5));
        panel.add_markers(&[(self.observed.value(), y)], marker, ink);
    }

    pub(super) fn format_bounds(&self) -> String {
        format!("{} – {}", self.lower, self.upper)
    }

    /// Returns the share of `count` and its exact bounds, rounded outwards. Runs that ended early count in the upper
    /// bound only.
    pub(super) fn clopper_pearson([count, ended_by_others]: [u64; 2], total: u64, confidence: f64) -> Self {
        let bounds = |count| RateInterval::clopper_pearson(count, total, confidence);
        let observed = if total == 0 { 0.0 } else { count as f64 / total as f64 };
        Self {
            observed: Rounded::new(100.0 * observed),
            lower: Rounded::down(100.0 * bounds(count).lower),
            upper: Rounded::up(100.0 * bounds(count + ended_by_others).upper),
        }
    }
}

/// A paired comparison of two controllers. Scenarios in which the first gave no answer are not in `only_first`.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PairedCounts {
    /// Number of scenarios in which both fail.
    pub both: u64,
    /// Number in which only the first controller collides.
    pub only_first: u64,
    /// Number in which only this controller fails.
    pub only_this: u64,
}

pub(super) struct RunSummary {
    pub(super) verdict: CaseVerdict,
    impact_speed_mps: Option<f64>,
    gaps_m: [Option<f64>; 2],
}

impl ControllerSample {
    #[must_use]
    pub(crate) fn unanswered_runs(&self) -> u64 {
        self.unanswered.as_ref().map_or(0, |unanswered| unanswered.runs)
    }

    /// Returns the number of failures: collisions and scenarios without an answer.
    #[must_use]
    pub fn failures(&self) -> u64 {
        self.collisions.saturating_add(self.unanswered_runs())
    }

    /// Returns the strength of the claim to fail less often. Scenarios without an answer of the other controller are
    /// open.
    fn strength_against(&self, other: &Self, random_scenarios: u64) -> Strength {
        let beside = [other.collisions, other.ended_by_others.saturating_add(other.unanswered_runs())];
        match (
            Strength::from_paired_counts([self.failures(), self.ended_by_others], beside, random_scenarios),
            &other.unanswered,
        ) {
            (Strength::Untried, Some(FailedControllerRuns { runs: unanswered, because: reason })) => {
                Strength::OtherUnanswered { unanswered: *unanswered, runs: random_scenarios, reason: reason.clone() }
            }
            (strength, _) => strength,
        }
    }

    fn rate_strength(&self, distribution: &SpaceSample) -> Strength {
        Strength::Between {
            lower_percent: self.rate_percent.lower,
            upper_percent: self.rate_percent.upper,
            // Each end of a two-sided interval is a one-sided bound at half the risk.
            confidence_percent: Rounded::down(50.0 + 50.0 * distribution.confidence),
            runs: distribution.random_scenarios,
        }
    }
}

impl SpaceSamples {
    pub(in crate::assessment) fn gather(work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let of = |named: &NamedSpace| SpaceSample::gather(named, work);
        Ok(Self { spaces: plan.rate_spaces.iter().map(of).collect::<Result<_, _>>()? })
    }

    pub(in crate::assessment) fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let mut all = Vec::new();
        for drawn in self.spaces.iter().filter(|drawn| drawn.random_scenarios > 0) {
            let space = || drawn.space.clone();
            let draws = || Domain::Draws { space: space(), seed: drawn.seed, draws: drawn.random_scenarios };
            let made = format!("{} random scenarios, seed {}", drawn.random_scenarios, drawn.seed);
            let first = plan.claim_subject(0, plan.config.estimator).zip(drawn.controllers.first());
            for (subject, sampled) in plan.claim_subjects().into_iter().zip(&drawn.controllers) {
                let mut add = |property, domain, strength| {
                    let claim = AssuranceClaim { subject: subject.clone(), property, domain };
                    all.push(Evidence { claim, strength, source: EvidenceSource::from_part(ANCHOR, made.as_str()) });
                };
                let telling = drawn.random_scenarios - sampled.ended_by_others;
                let unanswered = sampled.unanswered.as_ref();
                let touching = Strength::from_counts_with_unanswered(sampled.collisions, telling, unanswered, true);
                add(Property::NoContact, draws(), touching);
                let others = Strength::from_counts(sampled.ended_by_others, drawn.random_scenarios);
                add(Property::OthersKeepClear, draws(), others);
                add(Property::FailureRate, Domain::Space { space: space() }, sampled.rate_strength(drawn));
                if let Some((first, of_first)) = first.as_ref().filter(|(first, _)| *first != subject) {
                    let than = Property::FailsLessOften { than: first.controller.clone() };
                    add(than, draws(), sampled.strength_against(of_first, drawn.random_scenarios));
                }
            }
        }
        all
    }
}

impl SpaceSample {
    pub(in crate::assessment) fn gather(named: &NamedSpace, work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let inputs = json!([named.text, plan.config.draws, plan.config.seed, plan.identities()]);
        work.get_or_gather(&format!("draws of {}", named.space.name()), &inputs, || Self::run(named, work))
    }

    fn run(named: &NamedSpace, work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let config = &plan.config;
        let mut tallies: Vec<SampleTally> = plan.controllers.iter().map(|_| SampleTally::default()).collect();
        for from in (0..config.draws).step_by(BATCH_SIZE as usize) {
            let to = config.draws.min(from + BATCH_SIZE);
            let draw = |index| named.space.draw(config.seed, index);
            let scenarios = (from..to).map(draw).collect::<Result<Vec<_>, _>>()?;
            let mut first: Vec<SampleOutcome> = Vec::new();
            for (tally, controller) in tallies.iter_mut().zip(&plan.controllers) {
                let runs = run_samples(&scenarios, controller, plan)?;
                let fared: Vec<_> = runs.iter().map(|run| SampleOutcome::from_verdict(&run.verdict)).collect();
                if first.is_empty() {
                    first.clone_from(&fared);
                }
                tally.add(&runs, first.iter().copied().zip(fared));
            }
            work.add_runs((to - from) * plan.controllers.len() as u64)?;
        }
        let finish = |(index, (controller, tally)): (usize, (&NamedController, SampleTally))| {
            tally.finish(controller, index > 0)
        };
        let controllers = plan.controllers.iter().zip(tallies).enumerate().map(finish).collect();
        Ok(Self {
            space: named.content_id.clone(),
            random_scenarios: config.draws,
            seed: config.seed,
            confidence: CONFIDENCE,
            controllers,
        })
    }

    fn introduction(&self) -> String {
        format!(
            "All controllers run the same {} random scenarios of `{}` (seed {}). Bounds are exact (Clopper–Pearson, {} \
             %, each controller separately) and rounded outwards.",
            self.random_scenarios,
            self.space.name,
            self.seed,
            100.0 * self.confidence
        )
    }

    fn table(&self) -> ReportTable {
        let first = self.controllers.first().map_or("", |sampled| sampled.controller.as_str());
        let only_first = format!("only {first} collides");
        let columns: [ReportColumn<'_, &ControllerSample>; 13] = [
            ("controller", &|one| ReportCell::text(&one.controller)),
            ("collisions", &|one| ReportCell::with_verdict(one.collisions, one.collisions + one.ended_by_others == 0)),
            ("no answer", &|one| ReportCell::with_verdict(one.unanswered_runs(), one.unanswered_runs() == 0)),
            ("rate (%)", &|one| ReportCell::number(one.rate_percent.observed)),
            ("bounds (%)", &|one| ReportCell::number(one.rate_percent.format_bounds())),
            ("hits leader", &|one| ReportCell::number(one.hit)),
            ("hit from behind", &|one| ReportCell::number(one.was_hit)),
            ("ended by others", &|one| ReportCell::number(one.ended_by_others)),
            ("min gap ahead (m)", &|one| ReportCell::optional(one.min_gap_ahead_m)),
            ("min gap behind (m)", &|one| ReportCell::optional(one.min_gap_behind_m)),
            ("mean impact (m/s)", &|one| ReportCell::optional(one.mean_impact_speed_mps)),
            (&only_first, &|one| ReportCell::optional(one.paired.map(|paired| paired.only_first))),
            ("only this collides", &|one| ReportCell::optional(one.paired.map(|paired| paired.only_this))),
        ];
        let all_answered = self.controllers.iter().all(|sampled| sampled.unanswered.is_none());
        ReportTable::from_items_without(&self.controllers, &columns, all_answered.then_some(2))
    }

    fn unanswered_notes(&self) -> Vec<String> {
        let unanswered = self.controllers.iter().filter_map(|sampled| Some((sampled, sampled.unanswered.as_ref()?)));
        let words = unanswered.map(|(sampled, unanswered)| {
            format!(
                "{} {}. These are failures of the controller, but no collisions.",
                sampled.controller,
                unanswered.describe(self.random_scenarios)
            )
        });
        words.collect()
    }

    fn figure(&self) -> Svg {
        let names: Vec<_> = self.controllers.iter().map(|sampled| sampled.controller.as_str()).collect();
        let (mut panel, size) =
            share_panel("Collision rate and its exact bounds", "Collisions (% of random scenarios)", &names, 30.0);
        for (index, sampled) in self.controllers.iter().enumerate() {
            let y = (names.len() - 1 - index) as f64;
            let (ink, marker) =
                if sampled.failures() == 0 { (Ink::Series(0), Marker::Ring) } else { (Ink::Alert, Marker::Cross) };
            sampled.rate_percent.add_to(&mut panel, y, ink, marker);
        }
        let description = self.controllers.iter().map(|s| format!("{} {} %", s.controller, s.rate_percent.observed));
        let description = description.collect::<Vec<_>>().join(", ");
        let id = format!("rates-{}", self.space.name);
        Svg::new(&id, size, "Collision rates", &description, panel.draw(&Svg::id(&id, "panel")))
    }
}

/// Returns a panel of shares in percent with one row for each name, from the top, and the size of its figure.
pub(super) fn share_panel(title: &str, axis: &str, names: &[&str], row_height: f64) -> (Panel, (f64, f64)) {
    let left = names.iter().map(|name| text_width(name, SMALL_TEXT_SIZE)).fold(0.0, f64::max) + 16.0;
    let (width, height) = (480.0, row_height * names.len() as f64);
    let frame = PixelRect { left, top: HEADING_HEIGHT, width: width - left - 24.0, height };
    let axis = Axis::numeric(axis, (0.0, 100.0), 5);
    let panel = Panel::new(frame, title, axis, Axis::categorical("", names).reversed());
    (panel, (width, frame.bottom() + BOTTOM_MARGIN))
}

/// Simulates each scenario without recording its trace.
pub(super) fn run_samples(
    scenarios: &[Scenario],
    controller: &NamedController,
    plan: &AssessmentPlan,
) -> Result<Vec<RunSummary>, RunError> {
    let options = RunOptions::new(controller.kind.clone()).with_estimator(plan.config.estimator);
    simulate_each(scenarios, &options, RecordingLevel::Summary, RunSummary::new)
}

/// Simulates each scenario, in order.
pub(super) fn simulate_each<T: Send>(
    scenarios: &[Scenario],
    options: &RunOptions,
    keep: RecordingLevel,
    read: fn(&Scenario, &SimulationResult) -> T,
) -> Result<Vec<T>, RunError> {
    let runs = scenarios.iter().map(|scenario| Run::new(scenario, options.clone())).collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(&runs, keep, |index, simulated| read(runs[index].scenario(), &simulated)))
}

impl RunSummary {
    fn new(scenario: &Scenario, simulated: &SimulationResult) -> Self {
        let gap_m = |behind: usize| {
            let of = |index: usize| simulated.vehicles.get(index + behind).and_then(|vehicle| vehicle.min_gap_m);
            smallest((0..simulated.vehicles.len()).filter(|&index| scenario.is_under_test(index)).map(of))
        };
        Self {
            verdict: CaseVerdict::new(simulated, scenario),
            impact_speed_mps: simulated.outcome.contact().map(|contact| contact.impact_speed_mps),
            gaps_m: [gap_m(0), gap_m(1)],
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum SampleOutcome {
    Passes,
    Fails,
    Unanswered,
}

impl SampleOutcome {
    fn from_verdict(verdict: &CaseVerdict) -> Self {
        match verdict {
            CaseVerdict::ControllerFailed { .. } => Self::Unanswered,
            verdict if verdict.is_failure() => Self::Fails,
            _ => Self::Passes,
        }
    }
}

#[derive(Default)]
struct SampleTally {
    random_scenarios: u64,
    collisions: u64,
    unanswered: Option<FailedControllerRuns>,
    ended_by_others: u64,
    hit: u64,
    was_hit: u64,
    impact_speed_sum_mps: f64,
    impacts: u64,
    min_gaps_m: [Option<f64>; 2],
    paired: PairedCounts,
}

impl SampleTally {
    fn add(&mut self, runs: &[RunSummary], with_first: impl Iterator<Item = (SampleOutcome, SampleOutcome)>) {
        for run in runs {
            self.random_scenarios += 1;
            self.collisions += u64::from(matches!(run.verdict, CaseVerdict::Hit(_) | CaseVerdict::WasHit(_)));
            FailedControllerRuns::merge(&mut self.unanswered, run.verdict.unanswered());
            self.ended_by_others += u64::from(!run.verdict.is_conclusive());
            self.hit += u64::from(matches!(run.verdict, CaseVerdict::Hit(_)));
            self.was_hit += u64::from(matches!(run.verdict, CaseVerdict::WasHit(_)));
            if let Some(impact_speed_mps) = run.impact_speed_mps.filter(|_| run.verdict.is_failure()) {
                self.impact_speed_sum_mps += impact_speed_mps;
                self.impacts += 1;
            }
            for (smallest, gap_m) in self.min_gaps_m.iter_mut().zip(run.gaps_m) {
                *smallest = [*smallest, gap_m].into_iter().flatten().min_by(f64::total_cmp);
            }
        }
        for (first, this) in with_first {
            match (first, this) {
                (SampleOutcome::Fails, SampleOutcome::Passes) => self.paired.only_first += 1,
                (SampleOutcome::Passes, SampleOutcome::Fails | SampleOutcome::Unanswered) => self.paired.only_this += 1,
                (_, SampleOutcome::Fails | SampleOutcome::Unanswered) => self.paired.both += 1,
                // A scenario without an answer of the first controller does not count in favour of this one.
                (SampleOutcome::Unanswered | SampleOutcome::Passes, SampleOutcome::Passes) => {}
            }
        }
    }

    fn failures(&self) -> u64 {
        self.collisions.saturating_add(self.unanswered.as_ref().map_or(0, |unanswered| unanswered.runs))
    }

    fn finish(self, controller: &NamedController, is_paired: bool) -> ControllerSample {
        let counts = [self.failures(), self.ended_by_others];
        let rate_percent = PercentInterval::clopper_pearson(counts, self.random_scenarios, CONFIDENCE);
        let mean_impact_mps = self.impact_speed_sum_mps / self.impacts as f64;
        ControllerSample {
            controller: controller.name.clone(),
            rate_percent,
            collisions: self.collisions,
            unanswered: self.unanswered,
            ended_by_others: self.ended_by_others,
            hit: self.hit,
            was_hit: self.was_hit,
            min_gap_ahead_m: self.min_gaps_m[0].map(Rounded::new),
            min_gap_behind_m: self.min_gaps_m[1].map(Rounded::new),
            mean_impact_speed_mps: (self.impacts > 0).then(|| mean_impact_mps.into()),
            paired: is_paired.then_some(self.paired),
        }
    }
}

const ANCHOR: &str = "distribution";

impl ReportPart for SpaceSamples {
    fn anchor_and_title(&self) -> (&'static str, String) {
        (ANCHOR, "Collision rates".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        for drawn in &self.spaces {
            out.paragraph(&drawn.introduction());
            out.table(&drawn.table());
            drawn.unanswered_notes().iter().for_each(|line| out.paragraph(line));
            out.figure(drawn.figure());
        }
    }
}
