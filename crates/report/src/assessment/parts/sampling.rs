//! Random scenarios of scenario spaces: failure rates with exact bounds, and paired comparison.

use std::collections::BTreeSet;
use std::ops::Range;

use serde::{Deserialize, Serialize};
use serde_json::json;

use super::first_scenarios::FirstScenarios;
use super::proofs;
use super::share::{CONFIDENCE, PercentInterval, ShareFigure, ShareMark};
use crate::assessment::case::{CaseVerdict, smallest};
use crate::assessment::claim_draft::ClaimDraft;
use crate::assessment::claims::{
    AssuranceClaim, ContentId, Domain, Evidence, EvidenceSource, Property, RandomScenario,
    Strength, Subject,
};
use crate::assessment::document::ReportDocument;
use crate::assessment::followers::{describe_followers, follower_drivers};
use crate::assessment::gather_context::GatherContext;
use crate::assessment::plan::NamedSpace;
use crate::assessment::report_part::{Chapter, PartHeading, ReportPart};
use crate::assessment::run_ends::{RunEnds, note_unanswered};
use crate::assessment::table::{ReportCell, ReportColumn, ReportTable};
use crate::assessment::{AssessError, AssessmentPlan, Rounded};
use crate::draw::{Ink, Marker, Svg};
use crumple_sim::engine::{
    NamedController, RecordingLevel, Run, RunError, RunOptions, SimulationResult, simulate_batch,
};
use crumple_sim::scenario::{InvalidField, Scenario};
use crumple_spaces::ScenarioSpace;

const BATCH_SIZE: u64 = 4096;

/// Largest failure rate that counts as rare, in percent.
const RARE_PERCENT: f64 = 1.0;

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
    /// Names of the drivers of the vehicles directly behind a vehicle under test.
    pub followers: Vec<String>,
    /// Number of random scenarios for each controller.
    #[serde(alias = "draws")]
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
    /// Ends of the runs.
    #[serde(flatten)]
    pub ends: RunEnds,
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
    /// First scenarios that violate a claim.
    #[serde(default, skip_serializing_if = "FirstScenarios::is_empty")]
    pub first: FirstScenarios,
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
    /// Returns the strength of the claim to fail less often. Scenarios without an answer of the other controller are
    /// open.
    fn strength_against(&self, other: &Self, random_scenarios: u64) -> Strength {
        let other_counts = [
            other.ends.collisions,
            other
                .ends
                .ended_by_others
                .saturating_add(other.ends.unanswered_runs()),
        ];
        let own = [self.ends.failures(), self.ends.ended_by_others];
        match (
            Strength::from_paired_counts(
                own,
                other_counts,
                random_scenarios,
                self.ends.unanswered_runs(),
            ),
            &other.ends.unanswered,
        ) {
            (Strength::NotShown, Some(unanswered)) => Strength::OtherUnanswered {
                unanswered: unanswered.runs,
                runs: random_scenarios,
                reason: unanswered.reason.clone(),
            },
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
        let spaces = plan
            .rate_spaces
            .iter()
            .map(|named| SpaceSample::gather(named, work))
            .collect::<Result<_, _>>()?;
        Ok(Self { spaces })
    }

    fn simulated(&self) -> impl Iterator<Item = &SpaceSample> {
        self.spaces
            .iter()
            .filter(|sample| sample.random_scenarios > 0)
    }
}

impl SpaceSample {
    pub(in crate::assessment) fn draws_domain(&self) -> Domain {
        Domain::Draws {
            space: self.space.clone(),
            seed: self.seed,
            draws: self.random_scenarios,
        }
    }

    fn space_domain(&self) -> Domain {
        Domain::Space {
            space: self.space.clone(),
        }
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        let subjects = plan.claim_subjects();
        let first = subjects.first().zip(self.controllers.first());
        let mut evidence = Vec::new();
        for (subject, sampled) in subjects.iter().zip(&self.controllers) {
            evidence.extend(self.evidence_about(subject, sampled));
            if let Some((first, first_sampled)) = first.filter(|(first, _)| *first != subject) {
                let than = Property::FailsLessOften {
                    than: first.controller.clone(),
                };
                let strength = sampled.strength_against(first_sampled, self.random_scenarios);
                let claim = AssuranceClaim {
                    subject: subject.clone(),
                    property: than,
                    domain: self.draws_domain(),
                };
                evidence.push(self.piece_of_evidence(claim, strength, &sampled.first));
            }
        }
        evidence
    }

    fn evidence_about(&self, subject: &Subject, sampled: &ControllerSample) -> [Evidence; 3] {
        let runs = self.random_scenarios;
        let no_collision = sampled.ends.strength(runs);
        let others_clear = Strength::from_counts(sampled.ends.ended_by_others, runs);
        let rate = sampled.rate_strength(self);
        [
            (Property::NoCollision, self.draws_domain(), no_collision),
            (Property::OthersKeepClear, self.draws_domain(), others_clear),
            (Property::FailureRate, self.space_domain(), rate),
        ]
        .map(|(property, domain, strength)| {
            let claim = AssuranceClaim {
                subject: subject.clone(),
                property,
                domain,
            };
            self.piece_of_evidence(claim, strength, &sampled.first)
        })
    }

    fn piece_of_evidence(
        &self,
        claim: AssuranceClaim,
        strength: Strength,
        first: &FirstScenarios,
    ) -> Evidence {
        let description = format!(
            "{} random scenarios, seed {}",
            self.random_scenarios, self.seed
        );
        Evidence {
            first_violation: RandomScenario::new(self.seed, first.violating(&claim.property)),
            claim,
            strength,
            source: EvidenceSource::from_part(ANCHOR, description).with_seed(Some(self.seed)),
        }
    }

    fn claims(&self, plan: &AssessmentPlan, named: &NamedSpace) -> Vec<ClaimDraft> {
        let mut claims = vec![ClaimDraft::about_all(
            plan,
            ANCHOR,
            Property::NoCollision,
            self.draws_domain(),
        )];
        if named.can_others_collide() {
            claims.push(ClaimDraft::about_all(
                plan,
                ANCHOR,
                Property::OthersKeepClear,
                self.draws_domain(),
            ));
        }
        for percent in claimed_percents(plan, named) {
            let at_most = Property::RateAtMost { percent };
            claims.push(ClaimDraft::about_all(
                plan,
                ANCHOR,
                at_most,
                self.space_domain(),
            ));
        }
        if let Some(first) = plan.claim_subject(0, plan.config.estimator) {
            let fewer = Property::FailsLessOften {
                than: first.controller,
            };
            // The first controller cannot fail less often than itself.
            claims.push(
                ClaimDraft::about_all(plan, ANCHOR, fewer.clone(), self.draws_domain())
                    .without_first(),
            );
            claims.push(
                ClaimDraft::about_all(plan, proofs::ANCHOR, fewer, self.space_domain())
                    .without_first(),
            );
        }
        claims
    }

    fn all_answered(&self) -> bool {
        self.controllers
            .iter()
            .all(|sampled| sampled.ends.unanswered.is_none())
    }

    fn unanswered_notes(&self) -> Vec<String> {
        self.controllers
            .iter()
            .filter_map(|sampled| {
                let unanswered = sampled.ends.unanswered.as_ref()?;
                let runs = self.random_scenarios;
                Some(note_unanswered(&sampled.controller, unanswered, runs))
            })
            .collect()
    }

    pub(in crate::assessment) fn find(&self, controller: &str) -> Option<&ControllerSample> {
        self.controllers
            .iter()
            .find(|sampled| sampled.controller == controller)
    }

    pub(in crate::assessment) fn gather(
        named: &NamedSpace,
        work: &GatherContext<'_>,
    ) -> Result<Self, AssessError> {
        let plan = work.plan;
        let inputs = json!([
            named.text,
            plan.config.draws,
            plan.config.seed,
            plan.identities()
        ]);
        work.get_or_gather(&format!("draws of {}", named.space.name()), &inputs, || {
            Self::run(named, work)
        })
    }

    fn run(named: &NamedSpace, work: &GatherContext<'_>) -> Result<Self, AssessError> {
        let plan = work.plan;
        let config = &plan.config;
        let mut tallies: Vec<SampleTally> = plan
            .controllers
            .iter()
            .map(|_| SampleTally::default())
            .collect();
        let mut followers = BTreeSet::new();
        for draws in batches(config.draws) {
            let scenarios = draw_scenarios(&named.space, config.seed, draws)?;
            followers.append(&mut follower_drivers(&scenarios));
            let mut first: Vec<RunSummary> = Vec::new();
            for (tally, controller) in tallies.iter_mut().zip(&plan.controllers) {
                let runs = run_samples(&scenarios, controller, plan)?;
                tally.add(&runs, if first.is_empty() { &runs } else { &first });
                if first.is_empty() {
                    first = runs;
                }
            }
            work.add_runs((scenarios.len() * plan.controllers.len()) as u64)?;
        }
        let finished = plan.controllers.iter().zip(tallies).enumerate();
        let controllers = finished
            .map(|(index, (controller, tally))| tally.finish(controller, index > 0))
            .collect();
        Ok(Self {
            space: named.content_id.clone(),
            followers: followers.into_iter().collect(),
            random_scenarios: config.draws,
            seed: config.seed,
            confidence: CONFIDENCE,
            controllers,
        })
    }

    fn introduction(&self) -> String {
        format!(
            "All controllers run the same {} random scenarios of `{}` (seed {}), in which {}. Bounds are exact \
             (Clopper–Pearson, {} %, each controller separately) and rounded outwards. One side alone has half the \
             probability of error: 97.5 % instead of 95 %.",
            self.random_scenarios,
            self.space.name,
            self.seed,
            describe_followers(&self.followers),
            100.0 * self.confidence
        )
    }

    fn table(&self) -> ReportTable {
        let first = self
            .controllers
            .first()
            .map_or("", |sampled| sampled.controller.as_str());
        let all_answered = self.all_answered();
        // A run without an answer counts as a failure, and has no collision.
        let fails = if all_answered { "collides" } else { "fails" };
        let only_first = format!("only {first} {fails}");
        let only_this = format!("only this {fails}");
        let columns: [ReportColumn<'_, &ControllerSample>; 13] = [
            ("controller", &|sampled| {
                ReportCell::text(&sampled.controller)
            }),
            ("collisions", &|sampled| {
                ReportCell::with_verdict(
                    sampled.ends.collisions,
                    sampled.ends.collisions + sampled.ends.ended_by_others == 0,
                )
            }),
            ("no answer", &|sampled| {
                ReportCell::with_verdict(
                    sampled.ends.unanswered_runs(),
                    sampled.ends.unanswered_runs() == 0,
                )
            }),
            ("rate (%)", &|sampled| {
                ReportCell::number(sampled.rate_percent.observed)
            }),
            ("bounds (%)", &|sampled| {
                ReportCell::number(sampled.rate_percent.format_bounds())
            }),
            ("hits leader", &|sampled| {
                ReportCell::number(sampled.ends.hit)
            }),
            ("hit from behind", &|sampled| {
                ReportCell::number(sampled.ends.was_hit)
            }),
            ("ended by others", &|sampled| {
                ReportCell::number(sampled.ends.ended_by_others)
            }),
            ("min gap ahead (m)", &|sampled| {
                ReportCell::optional(sampled.min_gap_ahead_m)
            }),
            ("min gap behind (m)", &|sampled| {
                ReportCell::optional(sampled.min_gap_behind_m)
            }),
            ("mean impact (m/s)", &|sampled| {
                ReportCell::optional(sampled.mean_impact_speed_mps)
            }),
            (&only_first, &|sampled| {
                ReportCell::optional(sampled.paired.map(|paired| paired.only_first))
            }),
            (&only_this, &|sampled| {
                ReportCell::optional(sampled.paired.map(|paired| paired.only_this))
            }),
        ];
        ReportTable::from_items(&self.controllers, &columns)
            .without_column(all_answered.then_some(2))
    }

    fn figure(&self) -> Svg {
        let rows = self.controllers.iter().map(|sampled| {
            let is_safe = sampled.ends.failures() == 0;
            let mark = ShareMark {
                share: sampled.rate_percent,
                offset: 0.0,
                ink: if is_safe { Ink::Series(0) } else { Ink::Alert },
                marker: if is_safe { Marker::Ring } else { Marker::Cross },
            };
            (sampled.controller.as_str(), vec![mark])
        });
        let description = self
            .controllers
            .iter()
            .map(|sampled| format!("{} {} %", sampled.controller, sampled.rate_percent.observed));
        let [heading, axis, title] = if self.all_answered() {
            [
                "Collision rate and its exact bounds",
                "Collisions (% of random scenarios)",
                "Collision rates",
            ]
        } else {
            [
                "Failure rate and its exact bounds",
                "Collisions and missing answers (% of random scenarios)",
                "Failure rates",
            ]
        };
        let figure = ShareFigure {
            heading,
            axis,
            title,
            description: &description.collect::<Vec<_>>().join(", "),
            row_height: 30.0,
        };
        figure.draw(
            &format!("rates-{}", self.space.name),
            &rows.collect::<Vec<_>>(),
        )
    }
}

/// Returns the limits of the failure rate in a space that the report claims: the rare one, and those of gates.
fn claimed_percents(plan: &AssessmentPlan, named: &NamedSpace) -> Vec<Rounded<2>> {
    let mut percents = vec![Rounded::new(RARE_PERCENT)];
    for config in &plan.config.gates {
        if let Some((space, percent)) = config.gate.rate_limit(&plan.config)
            && space == named.name
            && !percents.contains(&percent)
        {
            percents.push(percent);
        }
    }
    percents
}

/// Divides random scenarios into batches: enough to use all cores, and few enough for memory.
pub(super) fn batches(draws: u64) -> impl Iterator<Item = Range<u64>> {
    (0..draws)
        .step_by(BATCH_SIZE as usize)
        .map(move |from| from..draws.min(from + BATCH_SIZE))
}

pub(super) fn draw_scenarios(
    space: &ScenarioSpace,
    seed: u64,
    draws: Range<u64>,
) -> Result<Vec<Scenario>, InvalidField> {
    draws.map(|index| space.draw(seed, index)).collect()
}

/// Simulates each scenario without recording its trace.
pub(super) fn run_samples(
    scenarios: &[Scenario],
    controller: &NamedController,
    plan: &AssessmentPlan,
) -> Result<Vec<RunSummary>, RunError> {
    let options = RunOptions::new(controller.source.clone()).with_estimator(plan.config.estimator);
    simulate_each(
        scenarios,
        &options,
        RecordingLevel::Summary,
        RunSummary::new,
    )
}

/// Simulates each scenario, in order.
pub(super) fn simulate_each<T: Send>(
    scenarios: &[Scenario],
    options: &RunOptions,
    keep: RecordingLevel,
    read: fn(&Scenario, &SimulationResult) -> T,
) -> Result<Vec<T>, RunError> {
    let runs = scenarios
        .iter()
        .map(|scenario| Run::new(scenario, options.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(&runs, keep, |index, simulated| {
        read(runs[index].scenario(), &simulated)
    }))
}

impl RunSummary {
    fn new(scenario: &Scenario, simulated: &SimulationResult) -> Self {
        let under_test: Vec<usize> = (0..simulated.vehicles.len())
            .filter(|&index| scenario.is_under_test(index))
            .collect();
        Self {
            verdict: CaseVerdict::new(simulated, scenario),
            impact_speed_mps: simulated
                .outcome
                .collision()
                .map(|collision| collision.impact_speed_mps),
            gaps_m: [
                smallest_gap_m(simulated, under_test.iter().copied()),
                smallest_gap_m(simulated, under_test.iter().map(|index| index + 1)),
            ],
        }
    }
}

/// Returns the smallest gap of these vehicles to their leaders.
fn smallest_gap_m(
    simulated: &SimulationResult,
    indices: impl Iterator<Item = usize>,
) -> Option<f64> {
    smallest(indices.map(|index| simulated.vehicles.get(index)?.min_gap_m))
}

#[derive(Default)]
struct SampleTally {
    random_scenarios: u64,
    ends: RunEnds,
    impact_speed_sum_mps: f64,
    impacts: u64,
    min_gaps_m: [Option<f64>; 2],
    paired: PairedCounts,
    first: FirstScenarios,
}

impl SampleTally {
    /// Adds runs; `first` are those of the first controller in the same scenarios.
    fn add(&mut self, runs: &[RunSummary], first: &[RunSummary]) {
        for (run, first) in runs.iter().zip(first) {
            let index = self.random_scenarios;
            self.random_scenarios += 1;
            self.ends.add(&run.verdict);
            self.first.add_verdict(index, &run.verdict);
            if let Some(impact_speed_mps) =
                run.impact_speed_mps.filter(|_| run.verdict.is_failure())
            {
                self.impact_speed_sum_mps += impact_speed_mps;
                self.impacts += 1;
            }
            for (smallest, gap_m) in self.min_gaps_m.iter_mut().zip(run.gaps_m) {
                *smallest = [*smallest, gap_m]
                    .into_iter()
                    .flatten()
                    .min_by(f64::total_cmp);
            }
            match (first.verdict.is_failure(), run.verdict.is_failure()) {
                (true, true) => self.paired.both += 1,
                (false, true) => {
                    self.paired.only_this += 1;
                    self.first.add_only_this(index);
                }
                // A scenario without an answer of the first controller does not count in favour of this sampled.
                (true, false) if first.verdict.unanswered().is_none() => {
                    self.paired.only_first += 1
                }
                (_, false) => {}
            }
        }
    }

    fn finish(self, controller: &NamedController, is_paired: bool) -> ControllerSample {
        let counts = [self.ends.failures(), self.ends.ended_by_others];
        let mean_impact_mps = self.impact_speed_sum_mps / self.impacts as f64;
        ControllerSample {
            controller: controller.name.clone(),
            rate_percent: PercentInterval::clopper_pearson(counts, self.random_scenarios),
            ends: self.ends,
            min_gap_ahead_m: self.min_gaps_m[0].map(Rounded::new),
            min_gap_behind_m: self.min_gaps_m[1].map(Rounded::new),
            mean_impact_speed_mps: (self.impacts > 0).then(|| mean_impact_mps.into()),
            paired: is_paired.then_some(self.paired),
            first: self.first,
        }
    }
}

const ANCHOR: &str = "distribution";

impl ReportPart for SpaceSamples {
    fn heading(&self) -> PartHeading {
        PartHeading {
            chapter: Chapter::RandomScenarios,
            anchor: ANCHOR,
            title: "Collision rates",
        }
    }

    fn runs(plan: &AssessmentPlan) -> u64 {
        plan.runs_of_all(plan.rate_spaces.len() as u64 * plan.config.draws)
    }

    fn write(&self, out: &mut ReportDocument) {
        for sample in self.simulated() {
            out.paragraph(sample.introduction());
            out.table(sample.table());
            for note in sample.unanswered_notes() {
                out.paragraph(note);
            }
            out.figure(sample.figure());
        }
    }

    fn is_shown(&self) -> bool {
        self.simulated().next().is_some()
    }

    fn evidence(&self, plan: &AssessmentPlan) -> Vec<Evidence> {
        self.simulated()
            .flat_map(|sample| sample.evidence(plan))
            .collect()
    }

    fn claims(&self, plan: &AssessmentPlan) -> Vec<ClaimDraft> {
        let spaces = self.spaces.iter().zip(&plan.rate_spaces);
        spaces
            .filter(|(sample, _)| sample.random_scenarios > 0)
            .flat_map(|(sample, named)| sample.claims(plan, named))
            .collect()
    }
}
