//! Mildest sensor fault that makes a controller collide or brake unnecessarily.
//!
//! Each kind of fault has sizes from the smallest one to a limit, on a grid of decimal numbers. A larger fault may be
//! harmless where a smaller one is not, so the search does not bisect: it simulates the sizes in order until one causes
//! each failure, and then nine sizes between that one and the one before. The smallest size that causes a failure is
//! the result; a smaller one between the simulated sizes may exist. The share of the limit compares faults of different
//! kinds.

mod fault_kind;

use serde::Serialize;

use super::attack::{AttackError, check_size};
use crumple_core::observer::{Observer, RunProgress};
use crumple_measure::UnnecessaryBraking;
use crumple_sim::engine::{
    FailedControllerRuns, RecordingLevel, Run, RunOptions, SimulationResult, simulate_batch,
};
use crumple_sim::scenario::{GhostObject, Scenario, SensorFaults};
pub use fault_kind::SearchedSizes;
use fault_kind::{FaultKind, FaultSize, GHOST, KINDS, PARTS, ghosts};

/// Sizes of each kind that are simulated together.
const ROUND: u32 = 50;
/// Runs that are prepared together.
const MAX_BATCH: usize = 256;

/// Failure that a fault causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorFailure {
    /// A collision.
    Collision,
    /// Unnecessary braking of a vehicle under test, as measured by [`UnnecessaryBraking`].
    UnnecessaryBraking,
}

/// Mildest fault of a kind that was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MildestFault {
    /// Name of the kind.
    pub kind: &'static str,
    /// Share of the limit, above 0 and at most 1.
    pub share: f64,
    /// Size of the fault.
    pub amount: f64,
    /// Unit of the size.
    pub unit: &'static str,
    /// All faults of the sensors.
    pub faults: SensorFaults,
}

/// Mildest faults of one kind; `None` if no simulated size causes the failure, or it happens without a fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultKindResult {
    /// Name of the kind.
    pub kind: &'static str,
    /// Description of the limit.
    pub limit: &'static str,
    /// Sizes that were searched.
    pub sizes: SearchedSizes,
    /// Mildest fault with a collision.
    pub collision: Option<MildestFault>,
    /// Mildest fault with unnecessary braking.
    pub unnecessary_braking: Option<MildestFault>,
}

/// Result of a search for the mildest fault.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorAttackResult {
    /// True if the scenario ends in a collision without a further fault; no fault is then searched for collisions.
    pub collides_without_fault: bool,
    /// True if a vehicle under test brakes unnecessarily without a further fault.
    pub brakes_unnecessarily_without_fault: bool,
    /// True if a controller gives no answer without a further fault; no fault is then simulated.
    pub fails_without_fault: bool,
    /// Simulations that ended because a controller gave no answer, and the reason of the first. A collision that would
    /// have happened later is unknown.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub missing_answers: Option<FailedControllerRuns>,
    /// One entry per kind of fault.
    pub kinds: Vec<FaultKindResult>,
    /// Number of simulations.
    pub evaluations: usize,
}

impl FaultKindResult {
    /// Returns the mildest fault that causes a failure.
    #[must_use]
    pub fn mildest(&self, failure: SensorFailure) -> Option<&MildestFault> {
        match failure {
            SensorFailure::Collision => self.collision.as_ref(),
            SensorFailure::UnnecessaryBraking => self.unnecessary_braking.as_ref(),
        }
    }
}

impl SensorAttackResult {
    /// Returns the fault with the smallest share of its limit that causes a failure.
    #[must_use]
    pub fn mildest(&self, failure: SensorFailure) -> Option<&MildestFault> {
        let faults = self.kinds.iter().filter_map(|kind| kind.mildest(failure));
        faults.min_by(|a, b| a.share.total_cmp(&b.share))
    }
}

/// The search for the mildest faults of one kind.
struct KindSearch {
    kind: &'static FaultKind,
    /// Objects of a ghost; one `None` for every other kind.
    ghosts: Vec<Option<GhostObject>>,
    /// Smallest size, with its object, that causes each failure.
    smallest: [Option<(FaultSize, usize)>; 2],
    /// Number of sizes that were simulated.
    done: u32,
}

struct FaultSearch<'a> {
    scenario: &'a Scenario,
    options: &'a RunOptions,
    observer: &'a dyn Observer<RunProgress>,
    /// True for each failure that happens without a fault, and is not searched.
    skip: [bool; 2],
    missing_answers: Option<FailedControllerRuns>,
    evaluations: usize,
}

/// Searches for the mildest fault of each kind, in addition to the faults of the scenario.
///
/// # Errors
/// [`AttackError`] if the scenario is too large or cannot be simulated, or if `observer` stops the search.
pub fn attack_sensors(
    scenario: &Scenario,
    options: &RunOptions,
    observer: &dyn Observer<RunProgress>,
) -> Result<SensorAttackResult, AttackError> {
    let mut kinds: Vec<_> = KINDS
        .iter()
        .map(|kind| KindSearch::new(kind, scenario))
        .collect();
    check_size(scenario, count_simulations(&kinds))?;
    let mut search = FaultSearch {
        scenario,
        options,
        observer,
        skip: [false; 2],
        missing_answers: None,
        evaluations: 0,
    };
    let [collides, brakes] = search.simulate(&[scenario.spec().sensors.faults.clone()])?[0];
    let fails = search.missing_answers.is_some();
    search.skip = [collides || fails, brakes || fails];
    while search.advance(&mut kinds)? {}
    search.refine(&mut kinds)?;
    Ok(SensorAttackResult {
        collides_without_fault: collides,
        brakes_unnecessarily_without_fault: brakes,
        fails_without_fault: fails,
        missing_answers: search.missing_answers,
        kinds: kinds
            .iter()
            .map(|kind| kind.result(&scenario.spec().sensors.faults))
            .collect(),
        evaluations: search.evaluations,
    })
}

/// Returns the largest number of simulations of a [search](attack_sensors): all sizes of each kind, and all parts.
#[must_use]
pub fn max_sensor_simulations() -> u64 {
    KINDS
        .iter()
        .map(|kind| kind.max_simulations(kind.ghost_count()))
        .sum::<u64>()
        + 1
}

fn count_simulations(kinds: &[KindSearch]) -> usize {
    kinds
        .iter()
        .map(|search| search.kind.max_simulations(search.ghosts.len()))
        .sum::<u64>() as usize
        + 1
}

impl KindSearch {
    fn new(kind: &'static FaultKind, scenario: &Scenario) -> Self {
        let ghosts = if kind.name == GHOST {
            ghosts(scenario).into_iter().map(Some).collect()
        } else {
            vec![None]
        };
        Self {
            kind,
            ghosts,
            smallest: [None; 2],
            done: 0,
        }
    }

    /// Returns the faults of the sensors with a size of this kind.
    fn scale(&self, base: &SensorFaults, size: FaultSize, ghost: usize) -> SensorFaults {
        let mut faults = base.clone();
        let amount = self.kind.amount(size);
        match self.ghosts[ghost] {
            Some(ghost) => {
                faults.ghost = Some(GhostObject {
                    duration_s: amount,
                    ..ghost
                })
            }
            None => (self.kind.set)(&mut faults, amount),
        }
        faults
    }

    /// Returns the next sizes to simulate, each with every object; none once each failure is found or all are done.
    fn next_round(&self, skip: [bool; 2]) -> Vec<(FaultSize, usize)> {
        let is_open = (0..2).any(|failure| !skip[failure] && self.smallest[failure].is_none());
        let last = if is_open {
            (self.done + ROUND).min(self.kind.count)
        } else {
            self.done
        };
        let whole_steps = self.done + 1..=last;
        whole_steps
            .flat_map(|steps| self.with_ghosts(FaultSize { steps, part: 0 }))
            .collect()
    }

    /// Returns the sizes between each smallest size that fails and the one before.
    fn parts(&self) -> Vec<(FaultSize, usize)> {
        let mut whole_steps: Vec<u32> = self
            .smallest
            .iter()
            .flatten()
            .map(|(size, _)| size.steps - 1)
            .collect();
        whole_steps.dedup();
        let parts = whole_steps
            .into_iter()
            .flat_map(|steps| (1..PARTS).map(move |part| FaultSize { steps, part }));
        parts.flat_map(|size| self.with_ghosts(size)).collect()
    }

    fn with_ghosts(&self, size: FaultSize) -> impl Iterator<Item = (FaultSize, usize)> + use<> {
        (0..self.ghosts.len()).map(move |ghost| (size, ghost))
    }

    /// Records the failures of a simulated size.
    fn record(&mut self, size: FaultSize, ghost: usize, failed: [bool; 2], skip: [bool; 2]) {
        for failure in (0..2).filter(|&failure| failed[failure] && !skip[failure]) {
            let smallest = &mut self.smallest[failure];
            if smallest.is_none_or(|(smallest_size, _)| size < smallest_size) {
                *smallest = Some((size, ghost));
            }
        }
    }

    fn result(&self, base: &SensorFaults) -> FaultKindResult {
        let kind = self.kind;
        let [collision, unnecessary_braking] = self.smallest.map(|smallest| {
            smallest.map(|(size, ghost)| MildestFault {
                kind: kind.name,
                share: kind.share(size),
                amount: kind.amount(size),
                unit: kind.unit,
                faults: self.scale(base, size, ghost),
            })
        });
        FaultKindResult {
            kind: kind.name,
            limit: kind.limit,
            sizes: kind.searched_sizes(),
            collision,
            unnecessary_braking,
        }
    }
}

impl FaultSearch<'_> {
    /// Simulates the next sizes of all kinds. Returns false if there are none.
    fn advance(&mut self, kinds: &mut [KindSearch]) -> Result<bool, AttackError> {
        let rounds: Vec<_> = kinds
            .iter()
            .map(|kind| kind.next_round(self.skip))
            .collect();
        self.simulate_all(kinds, &rounds)?;
        for (kind, round) in kinds.iter_mut().zip(&rounds) {
            kind.done = round.last().map_or(kind.done, |(size, _)| size.steps);
        }
        Ok(rounds.iter().any(|round| !round.is_empty()))
    }

    /// Simulates the parts of the step to each smallest size that fails.
    fn refine(&mut self, kinds: &mut [KindSearch]) -> Result<(), AttackError> {
        let rounds: Vec<_> = kinds.iter().map(KindSearch::parts).collect();
        self.simulate_all(kinds, &rounds)
    }

    /// Simulates sizes of each kind, and records which failures happen.
    fn simulate_all(
        &mut self,
        kinds: &mut [KindSearch],
        rounds: &[Vec<(FaultSize, usize)>],
    ) -> Result<(), AttackError> {
        let base = &self.scenario.spec().sensors.faults;
        let pairs = kinds.iter().zip(rounds);
        let scaled = pairs.flat_map(|(kind, round)| {
            round
                .iter()
                .map(|&(size, ghost)| kind.scale(base, size, ghost))
        });
        let scaled: Vec<_> = scaled.collect();
        let mut failed = Vec::with_capacity(scaled.len());
        // The runs of a batch are in memory together.
        for batch in scaled.chunks(MAX_BATCH) {
            failed.extend(self.simulate(batch)?);
        }
        let mut failed = failed.into_iter();
        for (kind, round) in kinds.iter_mut().zip(rounds) {
            for (&(size, ghost), failed) in round.iter().zip(failed.by_ref()) {
                kind.record(size, ghost, failed, self.skip);
            }
        }
        Ok(())
    }

    /// Simulates the scenario with each set of faults. Returns which failures happen.
    fn simulate(&mut self, faults: &[SensorFaults]) -> Result<Vec<[bool; 2]>, AttackError> {
        let runs = faults
            .iter()
            .map(|faults| self.run_with(faults))
            .collect::<Result<Vec<_>, _>>()?;
        let simulated = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            let unanswered = result.outcome.failed_controller().cloned();
            (self.failures(&result), unanswered)
        });
        self.evaluations += runs.len();
        let mut failed = Vec::with_capacity(simulated.len());
        for (failures, unanswered) in simulated {
            failed.push(failures);
            if let Some(unanswered) = unanswered {
                FailedControllerRuns::add(&mut self.missing_answers, &unanswered);
            }
        }
        self.observer.notify(&RunProgress {
            done: self.evaluations as u64,
            total: None,
        })?;
        Ok(failed)
    }

    fn run_with(&self, faults: &SensorFaults) -> Result<Run, AttackError> {
        let faulty = self
            .scenario
            .edited(|spec| spec.sensors.faults = faults.clone())?;
        Ok(Run::new(&faulty, self.options.clone())?)
    }

    /// Returns whether there is a collision, and whether a vehicle under test brakes unnecessarily.
    fn failures(&self, result: &SimulationResult) -> [bool; 2] {
        let mut brakings = (0..self.scenario.vehicles().len())
            .filter(|&vehicle| self.scenario.is_under_test(vehicle))
            .filter_map(|vehicle| {
                let trace = result.trace.as_ref()?;
                UnnecessaryBraking::from_trace(trace, &result.impacts, vehicle)
            });
        [
            result.outcome.collision().is_some(),
            brakings.any(|braking| !braking.is_empty()),
        ]
    }
}
