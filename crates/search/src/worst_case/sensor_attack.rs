//! Mildest sensor fault that makes a controller collide or brake unnecessarily.
//!
//! Each kind of fault is scaled from none to a limit, and its share of the limit measures its size: the mildest fault
//! has the smallest share. Twenty shares of each kind are simulated. Bisection to a thousandth follows between the
//! first one that fails and the one before. Between two shares a controller may fail at a smaller fault, so that the
//! result is the mildest fault found.

use serde::Serialize;

use super::attack::{AttackError, check_size};
use crumple_core::observer::{Observer, RunProgress};
use crumple_world::measure::UnnecessaryBraking;
use crumple_world::scenario::{GhostObject, Scenario, SensorFaults};
use crumple_world::sim::{RecordingLevel, Run, RunOptions, SimulationResult, simulate_batch};

/// Thousandths of the limit between two simulated shares, before the bisection.
const COARSE_STEP: u32 = 50;
const LIMIT: u32 = 1000;
/// Times at which ghosts appear, as fractions of the duration.
const GHOST_ONSETS: u32 = 8;
const GHOST_GAPS_M: [f64; 3] = [10.0, 30.0, 60.0];
const GHOST_LIMIT_S: f64 = 2.0;
const GHOST: &str = "ghost";

/// A kind of fault, with one quantity that grows from none to a limit.
struct FaultKind {
    name: &'static str,
    limit: &'static str,
    /// Quantity without a fault and at the limit.
    range: [f64; 2],
    unit: &'static str,
    set: fn(&mut SensorFaults, f64),
}

impl FaultKind {
    const fn new(
        name: &'static str,
        limit: &'static str,
        range: [f64; 2],
        unit: &'static str,
        set: fn(&mut SensorFaults, f64),
    ) -> Self {
        Self { name, limit, range, unit, set }
    }

    fn amount(&self, share: f64) -> f64 {
        let [none, limit] = self.range;
        none + (limit - none) * share
    }
}

const KINDS: [FaultKind; 8] = [
    FaultKind::new("latency", "2 s", [0.0, 2.0], "s", |faults, time_s| faults.latency_s = time_s),
    FaultKind::new("gap too small", "10 m", [0.0, 10.0], "m", |faults, bias_m| faults.gap_bias_m = -bias_m),
    FaultKind::new("gap too large", "10 m", [0.0, 10.0], "m", |faults, bias_m| faults.gap_bias_m = bias_m),
    FaultKind::new("resolution", "10 m", [0.0, 10.0], "m", |faults, step_m| faults.gap_resolution_m = step_m),
    FaultKind::new("outages", "one per second, 10 s long", [0.0, 10.0], "s", |faults, length_s| {
        (faults.outage_rate_per_s, faults.outage_length_s) = (1.0, length_s);
    }),
    FaultKind::new("range", "1 m instead of 200 m", [200.0, 1.0], "m", |faults, range_m| {
        faults.range_m = Some(range_m)
    }),
    FaultKind::new("late detection", "10 s", [0.0, 10.0], "s", |faults, delay_s| faults.detection_delay_s = delay_s),
    FaultKind::new(GHOST, "2 s long", [0.0, GHOST_LIMIT_S], "s", |_, _| {}),
];

/// Failure that a fault causes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SensorFailure {
    /// A collision, or a controller that gives no answer.
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

/// Mildest faults of one kind; `None` if none was found up to the limit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct FaultKindResult {
    /// Name of the kind.
    pub kind: &'static str,
    /// Description of the limit.
    pub limit: &'static str,
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
        let found = self.kinds.iter().filter_map(|kind| kind.mildest(failure));
        found.min_by(|a, b| a.share.total_cmp(&b.share))
    }
}

/// A kind of fault, and for ghosts the object.
struct Candidate {
    kind: usize,
    ghost: Option<GhostObject>,
}

struct FaultSearch<'a> {
    scenario: &'a Scenario,
    options: &'a RunOptions,
    observer: &'a dyn Observer<RunProgress>,
    candidates: Vec<Candidate>,
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
    let candidates = list_candidates(scenario);
    check_size(scenario, candidates.len() * 2 * (LIMIT / COARSE_STEP) as usize)?;
    let mut search = FaultSearch { scenario, options, observer, candidates, evaluations: 0 };
    let [collides, brakes] = search.simulate(&[scenario.spec().sensors.faults.clone()])?[0];
    let bounds = search.find_bounds([collides, brakes])?;
    let kinds = KINDS.iter().enumerate().map(|(index, kind)| {
        let [collision, unnecessary_braking] = [0, 1].map(|failure| {
            let own = search.candidates.iter().zip(&bounds).filter(|(candidate, _)| candidate.kind == index);
            let found = own.filter_map(|(candidate, bounds)| Some((candidate, bounds[failure]?[1])));
            let (candidate, high) = found.min_by_key(|(_, high)| *high)?;
            let faults = candidate.scale(&scenario.spec().sensors.faults, high);
            let share = share_of_limit(high);
            Some(MildestFault { kind: kind.name, share, amount: kind.amount(share), unit: kind.unit, faults })
        });
        FaultKindResult { kind: kind.name, limit: kind.limit, collision, unnecessary_braking }
    });
    Ok(SensorAttackResult {
        collides_without_fault: collides,
        brakes_unnecessarily_without_fault: brakes,
        kinds: kinds.collect(),
        evaluations: search.evaluations,
    })
}

fn list_candidates(scenario: &Scenario) -> Vec<Candidate> {
    let own_mps = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index));
    let own_mps = own_mps.and_then(|index| scenario.vehicles().get(index)).map_or(0.0, |own| own.speed_mps);
    let plain = (0..KINDS.len()).filter(|&kind| KINDS[kind].name != GHOST);
    let mut candidates: Vec<_> = plain.map(|kind| Candidate { kind, ghost: None }).collect();
    for onset in 0..GHOST_ONSETS {
        let onset_s = scenario.spec().duration_s * f64::from(onset) / f64::from(GHOST_ONSETS);
        for gap_m in GHOST_GAPS_M {
            for speed_mps in [0.0, 0.5 * own_mps] {
                let ghost = GhostObject { onset_s, duration_s: 0.0, gap_m, speed_mps };
                candidates.push(Candidate { kind: KINDS.len() - 1, ghost: Some(ghost) });
            }
        }
    }
    candidates
}

fn share_of_limit(thousandths: u32) -> f64 {
    f64::from(thousandths) / f64::from(LIMIT)
}

impl Candidate {
    fn scale(&self, base: &SensorFaults, thousandths: u32) -> SensorFaults {
        let kind = &KINDS[self.kind];
        let (mut faults, amount) = (base.clone(), kind.amount(share_of_limit(thousandths)));
        match self.ghost {
            Some(ghost) => faults.ghost = Some(GhostObject { duration_s: amount, ..ghost }),
            None => (kind.set)(&mut faults, amount),
        }
        faults
    }
}

/// Largest share that passes and smallest that fails, in thousandths, for each failure; `None` if none fails.
type FailureBounds = [Option<[u32; 2]>; 2];

impl FaultSearch<'_> {
    /// Finds the bounds of each candidate for the failures that do not happen without a fault.
    fn find_bounds(&mut self, skip: [bool; 2]) -> Result<Vec<FailureBounds>, AttackError> {
        let shares: Vec<u32> = (1..=LIMIT / COARSE_STEP).map(|step| step * COARSE_STEP).collect();
        let base = &self.scenario.spec().sensors.faults;
        let scaled = self.candidates.iter().flat_map(|one| shares.iter().map(|&share| one.scale(base, share)));
        let failed = self.simulate(&scaled.collect::<Vec<_>>())?;
        let first = |failed: &[[bool; 2]]| {
            [0, 1].map(|failure| {
                let place = failed.iter().position(|failed| failed[failure] && !skip[failure])?;
                Some([shares[place] - COARSE_STEP, shares[place]])
            })
        };
        let mut bounds: Vec<FailureBounds> = failed.chunks(shares.len()).map(first).collect();
        loop {
            let mut open: Vec<(usize, usize, u32)> = Vec::new();
            for (candidate, bounds) in bounds.iter().enumerate() {
                for (failure, bounds) in bounds.iter().enumerate() {
                    if let Some([low, high]) = bounds.filter(|[low, high]| high - low > 1) {
                        open.push((candidate, failure, low.midpoint(high)));
                    }
                }
            }
            if open.is_empty() {
                return Ok(bounds);
            }
            let scaled = open.iter().map(|&(candidate, _, share)| self.candidates[candidate].scale(base, share));
            let failed = self.simulate(&scaled.collect::<Vec<_>>())?;
            for ((candidate, failure, share), failed) in open.into_iter().zip(failed) {
                if let Some(bounds) = &mut bounds[candidate][failure] {
                    bounds[usize::from(failed[failure])] = share;
                }
            }
        }
    }

    /// Simulates the scenario with each set of faults. Returns which failures happen.
    fn simulate(&mut self, faults: &[SensorFaults]) -> Result<Vec<[bool; 2]>, AttackError> {
        let prepare = |faults: &SensorFaults| -> Result<Run, AttackError> {
            let faulty = self.scenario.edited(|spec| spec.sensors.faults = faults.clone())?;
            Ok(Run::new(&faulty, self.options.clone())?)
        };
        let runs = faults.iter().map(prepare).collect::<Result<Vec<_>, _>>()?;
        let failed = simulate_batch(&runs, RecordingLevel::Trace, |_, result| self.failures(&result));
        self.evaluations += runs.len();
        self.observer.notify(&RunProgress { done: self.evaluations as u64, total: None })?;
        Ok(failed)
    }

    fn failures(&self, result: &SimulationResult) -> [bool; 2] {
        let brakes = |vehicle: usize| {
            let trace = result.trace.as_ref()?;
            UnnecessaryBraking::from_trace(trace, &result.impacts, vehicle)
        };
        let tested = (0..self.scenario.vehicles().len()).filter(|&vehicle| self.scenario.is_under_test(vehicle));
        [!result.outcome.is_safe(), tested.filter_map(brakes).any(|braking| !braking.is_empty())]
    }
}
