//! Running a campaign, from its first evaluation to its summary.

use std::ops::ControlFlow;
use std::path::Path;

use super::coverage::Coverage;
use super::failures::{Failures, Kind};
use super::journal::Journal;
use super::regions::Sample;
use super::summary::{
    AvoidabilitySummary, ByMethod, CoverageSummary, KindSummary, MethodSummary, SUMMARY_VERSION, Summary,
};
use super::table::Table;
use super::{Campaign, CampaignError, Evaluated, FailureKind};
use crate::difference;
use crate::falsify::counterexample::Examiner;
use crate::falsify::{Cube, Method};
use crate::work::{Asked, Changes, Examined, Work, WorkError};
use crumple_world::digest::sha256;
use crumple_world::measure::RunVerdict;
use crumple_world::scenario::Scenario;
use crumple_world::scenario::space::Space;
use crumple_world::sim::{Run, simulate_batch};

/// Batches of a method that ignores values, asked for at once: enough to fill the engine on all cores.
const BLIND_BATCHES: usize = 16;
/// Kinds of failures that are looked at closely: the most frequent ones.
const MOST_KINDS: usize = 12;

/// How far a campaign is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Progress {
    /// The method at work; none once counterexamples are examined.
    pub method: Option<Method>,
    /// Evaluations done, of all methods together.
    pub evaluations: u64,
    /// Evaluations there will be.
    pub total: u64,
    /// Evaluations that failed.
    pub failures: u64,
    /// Smallest robustness so far.
    pub best_robustness: f64,
}

/// What one method has reached.
struct Reached {
    method: Method,
    evaluations: u64,
    first: Option<u64>,
    failures: u64,
    best: f64,
    coverage: Coverage,
}

/// Everything that is remembered of the evaluations.
struct Findings<'a> {
    work: &'a Work,
    reached: Vec<Reached>,
    failures: Failures,
    sample: Sample,
    table: Table<'a>,
}

impl Campaign {
    /// Runs the campaign in `folder`, or goes on with it where `resume` says so.
    ///
    /// # Errors
    /// [`CampaignError`] if the folder cannot be used, or a scenario cannot be run.
    pub fn run(
        &self,
        folder: &Path,
        resume: bool,
        progress: &mut dyn FnMut(&Progress),
    ) -> Result<Summary, CampaignError> {
        self.run_until(folder, resume, &mut |state| {
            progress(state);
            ControlFlow::Continue(())
        })
    }

    /// The same until `progress` breaks it off: what was evaluated by then stays in the folder, for `resume`.
    ///
    /// # Errors
    /// As [`Self::run`], and [`CampaignError::BrokenOff`].
    pub fn run_until(
        &self,
        folder: &Path,
        resume: bool,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Summary, CampaignError> {
        if resume && self.controller.kind.identity().is_none() {
            return Err(CampaignError::NoIdentity(self.controller.name.clone()));
        }
        let space = self.space.clone().with_noise_seed(self.seed);
        let nominal = space.scenario(&space.nominal())?;
        self.check(&nominal)?;
        let work = self.work(folder, resume)?;
        if work.is_complete() {
            return Summary::from_json(&String::from_utf8_lossy(&work.read_present(SUMMARY)?));
        }
        work.changes().write(CONFIGURATION, self.to_toml()?).grow(JOURNAL).commit()?;
        let (path, identity) = (work.path(JOURNAL), work.identity());
        let mut journal = if resume { Journal::resume(&path, &identity)? } else { Journal::create(&path, &identity)? };
        let mut findings = Findings {
            work: &work,
            reached: Vec::new(),
            failures: Failures::new(self.specification.clone()),
            sample: Sample::default(),
            table: Table::new(&space, &work),
        };
        for method in self.methods() {
            let reached = self.search(method, &space, &mut journal, &mut findings, progress)?;
            findings.reached.push(reached);
        }
        let Findings { reached, failures, sample, table, .. } = findings;
        // Until all of this is there, the journal is.
        let mut results = work.changes();
        table.finish(&mut results)?;
        go_on(progress(&state(None, &reached, self.total())))?;
        let summary = self.summarise(&space, &nominal, &reached, &failures, &sample, &mut results)?;
        go_on(progress(&state(None, &reached, self.total())))?;
        results.write(TEXT, summary.to_text()).write(SUMMARY, summary.to_json()?).remove(JOURNAL).commit()?;
        work.finish()?;
        Ok(summary)
    }

    fn total(&self) -> u64 {
        self.budget.saturating_mul(self.methods().len() as u64)
    }

    /// What would fail at every point fails before anything is written.
    fn check(&self, nominal: &Scenario) -> Result<(), CampaignError> {
        if !nominal.has_vehicle_under_test() {
            return Err(CampaignError::NobodyUnderTest(self.space.name().to_owned()));
        }
        let run = Run::new(nominal, self.options())?;
        let result = crumple_world::sim::simulate(&run, self.specification.keep());
        self.specification.judge(&run, &result)?;
        Ok(())
    }

    /// The folder, if it is this campaign's or nobody's; where it is another's, the error says in what they differ.
    fn work(&self, folder: &Path, resume: bool) -> Result<Work, CampaignError> {
        let configuration = self.to_toml()?;
        let asked = Asked {
            kind: "campaign",
            configuration: &configuration,
            configuration_file: CONFIGURATION,
            resume,
            outputs: &[
                CONFIGURATION,
                JOURNAL,
                SUMMARY,
                TEXT,
                "counterexamples/",
                "counterexamples/originals/",
                "evaluations/",
            ],
        };
        match Work::open(folder, asked) {
            Err(WorkError::OtherConfiguration { path, found, .. }) => {
                Err(CampaignError::Folder(difference::in_toml(&path, "campaign", &found, &configuration)))
            }
            work => Ok(work?),
        }
    }

    /// One method with its whole budget.
    fn search(
        &self,
        method: Method,
        space: &Space,
        journal: &mut Journal,
        findings: &mut Findings<'_>,
        progress: &mut dyn FnMut(&Progress) -> ControlFlow<()>,
    ) -> Result<Reached, CampaignError> {
        let cube = Cube::of(space).map_err(CampaignError::encoding)?;
        let mut search = method.start(&cube, self.seed);
        let nominal = space.point(&space.nominal());
        let departure = |point: &[f64]| cube.distance(point, &nominal) / cube.blocks().len() as f64;
        let coverage = Coverage::new(space.dimension());
        let mut reached = Reached { method, evaluations: 0, first: None, failures: 0, best: f64::INFINITY, coverage };
        let is_reference = matches!(method, Method::Uniform | Method::Halton);
        while reached.evaluations < self.budget {
            let mut points = search.ask();
            if is_reference {
                // Neither looks at values: many batches may be asked for at once.
                for _ in 1..BLIND_BATCHES {
                    points.extend(search.ask());
                }
            }
            points.truncate(usize::try_from(self.budget - reached.evaluations).unwrap_or(usize::MAX));
            let mut verdicts = Vec::with_capacity(points.len());
            while verdicts.len() < points.len()
                && let Some(verdict) = journal.next()?
            {
                verdicts.push(verdict);
            }
            let known = verdicts.len();
            verdicts.extend(self.evaluate(space, points.get(known..).unwrap_or_default())?);
            // Who breaks it off may have ended runs halfway: what came of these is not kept.
            go_on(progress(&state(Some(&reached), &findings.reached, self.total())))?;
            if let Some(durable) = journal.append(verdicts.get(known..).unwrap_or_default())? {
                findings.work.grew(JOURNAL, durable)?;
            }
            let mut told = Vec::with_capacity(points.len());
            for (point, verdict) in points.into_iter().zip(verdicts) {
                reached.evaluations += 1;
                let evaluated = Evaluated {
                    number: reached.evaluations,
                    values: space.values(&point),
                    ln_likelihood: space.ln_likelihood(&point),
                    departure: departure(&point),
                    point,
                    verdict,
                };
                let fails = FailureKind::of(&evaluated.verdict, &self.specification).is_some();
                told.push(self.aim.value(&evaluated));
                if fails {
                    reached.failures += 1;
                    reached.first = reached.first.or(Some(evaluated.number));
                }
                reached.best = reached.best.min(evaluated.verdict.robustness);
                reached.coverage.add(&evaluated.point);
                if is_reference {
                    findings.sample.add(&evaluated.values, fails);
                }
                findings.failures.add(method, &evaluated);
                findings.table.add(method, &evaluated)?;
            }
            search.tell(&told);
            go_on(progress(&state(Some(&reached), &findings.reached, self.total())))?;
        }
        Ok(reached)
    }

    /// Verdicts at points, in their order.
    fn evaluate(&self, space: &Space, points: &[Vec<f64>]) -> Result<Vec<RunVerdict>, CampaignError> {
        let scenarios = points.iter().map(|point| space.at(point)).collect::<Result<Vec<_>, _>>()?;
        let options = self.options();
        let runs =
            scenarios.iter().map(|scenario| Run::new(scenario, options.clone())).collect::<Result<Vec<_>, _>>()?;
        let judged = simulate_batch(&runs, self.specification.keep(), |index, result| {
            runs.get(index).map(|run| self.specification.judge(run, &result))
        });
        Ok(judged.into_iter().flatten().collect::<Result<_, _>>()?)
    }

    fn summarise(
        &self,
        space: &Space,
        nominal: &Scenario,
        reached: &[Reached],
        failures: &Failures,
        sample: &Sample,
        results: &mut Changes<'_>,
    ) -> Result<Summary, CampaignError> {
        let mut kinds: Vec<_> = failures.kinds.iter().collect();
        kinds.sort_by_key(|kind| std::cmp::Reverse(kind.count()));
        let picks: Vec<_> = kinds.iter().take(MOST_KINDS).flat_map(|kind| kind.picks()).collect();
        let counterexamples = Examiner::new(self, space)?.examine_all(&picks, results)?;
        let mut all = Coverage::new(space.dimension());
        reached.iter().for_each(|reached| all.join(&reached.coverage));
        let finite = |value: f64| Some(value).filter(|value| value.is_finite());
        let main = reached.first();
        let kind_summary = |kind: &&Kind| KindSummary {
            kind: kind.kind.describe(nominal),
            front_vehicle: kind.kind.vehicles().map(|[front, _]| front),
            rear_vehicle: kind.kind.vehicles().map(|[_, rear]| rear),
            count: kind.count(),
            by_method: kind
                .by_method
                .iter()
                .map(|&(method, count, first)| ByMethod { method: method.name().to_owned(), count, first })
                .collect(),
        };
        Ok(Summary {
            version: SUMMARY_VERSION,
            crumple: env!("CARGO_PKG_VERSION").to_owned(),
            configuration_sha256: sha256(&self.to_toml()?),
            controller: self.controller.name.clone(),
            policy_sha256: self.policy_sha256(),
            nondeterministic: !self.controller.kind.is_deterministic(),
            estimator: self.estimator,
            space: self.space.name().to_owned(),
            specification: self.specification.to_string(),
            method: self.method.name().to_owned(),
            aim: self.aim.name().to_owned(),
            budget: self.budget,
            seed: self.seed,
            evaluations: main.map_or(0, |reached| reached.evaluations),
            falsified: reached.iter().any(|reached| reached.failures > 0),
            first_falsification: main.and_then(|reached| reached.first),
            best_robustness: main.and_then(|reached| finite(reached.best)),
            coverage: CoverageSummary {
                method: main.map(|reached| reached.coverage.covered()),
                with_reference_searches: all.covered(),
            },
            methods: reached
                .iter()
                .map(|reached| MethodSummary {
                    method: reached.method.name().to_owned(),
                    evaluations: reached.evaluations,
                    first_falsification: reached.first,
                    failures: reached.failures,
                    best_robustness: finite(reached.best),
                })
                .collect(),
            failures: kinds.iter().map(kind_summary).collect(),
            front: failures.front.points(&self.specification, nominal),
            regions: sample.regions(space),
            avoidability: AvoidabilitySummary::of(&counterexamples),
            counterexamples,
        })
    }
}

/// Looks at the journal of a campaign that is half done, of which its folder's manifest knows the beginning only.
///
/// # Errors
/// [`WorkError::Disk`] if it cannot be read. What is damaged is in what was found, as for every other file.
pub fn with_journal(folder: &Path, mut found: Examined) -> Result<Examined, WorkError> {
    let Some(identity) = &found.identity else { return Ok(found) };
    if let Some((_, state @ Ok(()))) = found.files.iter_mut().find(|(name, _)| name == JOURNAL) {
        match Journal::look(&folder.join(JOURNAL), identity) {
            Err(WorkError::Damaged { problem, .. }) => *state = Err(problem),
            looked => looked?,
        }
    }
    Ok(found)
}

const CONFIGURATION: &str = "campaign.toml";
const JOURNAL: &str = "evaluations.journal";
const SUMMARY: &str = "summary.json";
const TEXT: &str = "summary.txt";

/// Nothing more, once the caller has broken it off.
fn go_on(flow: ControlFlow<()>) -> Result<(), CampaignError> {
    if flow.is_break() { Err(CampaignError::BrokenOff) } else { Ok(()) }
}

fn state(current: Option<&Reached>, done: &[Reached], total: u64) -> Progress {
    let all = || done.iter().chain(current);
    Progress {
        method: current.map(|reached| reached.method),
        evaluations: all().map(|reached| reached.evaluations).sum(),
        total,
        failures: all().map(|reached| reached.failures).sum(),
        best_robustness: all().map(|reached| reached.best).fold(f64::INFINITY, f64::min),
    }
}
