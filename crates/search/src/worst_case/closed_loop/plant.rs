//! Closed-loop simulation of profiles of the vehicles under test, with every other driver.

use std::ops::Range;

use super::super::avoidance_problem::delay_steps;
use super::super::escape::{script_pieces, scripted_run_options, set_script};
use super::super::profile_simulator::ProfileOutcome;
use crumple_sim::engine::{RecordingLevel, Run, SimulationResult, simulate_batch};
use crumple_sim::scenario::Scenario;

/// Acceleration of each vehicle under test in each cell, in m/s².
pub(super) type Profile = Vec<Vec<f64>>;

#[derive(Debug, Clone, PartialEq)]
pub(super) struct SimulatedProfile {
    pub(super) profile: Profile,
    /// Smallest gap in metres, or minus v²/10 of an impact at v m/s.
    pub(super) margin_m: f64,
}

/// Cells of one vehicle under test that change by the same amount.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CellBlock {
    pub(super) ego: usize,
    pub(super) cells: Range<usize>,
}

/// Bumper gaps of one simulation by pair, then sample, in metres; NaN if a pair or a sample is missing.
pub(super) struct SampledGaps {
    pub(super) gap_m: Vec<f64>,
    pub(super) samples: usize,
}

#[derive(Debug, Clone, Copy)]
struct EgoLimits {
    index: usize,
    /// Steps at the start before its first command has an effect.
    dead_steps: usize,
    low_mps2: f64,
    high_mps2: f64,
}

impl EgoLimits {
    /// Returns the limits of a vehicle; `None` if it has a lag or a jerk limit.
    fn new(scenario: &Scenario, index: usize) -> Option<Self> {
        let vehicle = scenario.vehicles().get(index)?;
        vehicle.response().is_full_at_once().then(|| Self {
            index,
            dead_steps: delay_steps(scenario, vehicle),
            low_mps2: -scenario.usable_brake_mps2(index),
            high_mps2: vehicle.max_accel_mps2(),
        })
    }

    /// Returns the acceleration at each step, in m/s², if each cell lasts `cell` steps.
    fn step_accelerations_mps2(&self, cells: &[f64], cell: usize, steps: usize) -> Vec<f64> {
        let mut accelerations_mps2: Vec<f64> = cells
            .iter()
            .flat_map(|&accel_mps2| std::iter::repeat_n(accel_mps2, cell))
            .take(steps)
            .map(|accel_mps2| accel_mps2.clamp(self.low_mps2, self.high_mps2))
            .collect();
        accelerations_mps2
            .iter_mut()
            .take(self.dead_steps)
            .for_each(|accel_mps2| *accel_mps2 = 0.0);
        accelerations_mps2
    }
}

pub(super) struct Plant<'s> {
    scenario: &'s Scenario,
    egos: Vec<EgoLimits>,
    /// Steps over which an acceleration is held.
    cell: usize,
    pub(super) simulations: usize,
}

/// Maximum time between two samples of a gap, in seconds. Between them the gap deviates from a straight line by about a
/// centimetre.
const MAX_SAMPLE_INTERVAL_S: f64 = 0.1;

impl<'s> Plant<'s> {
    /// Creates a plant; `None` if the vehicles under test are not neighbours, or one of them has a lag or a jerk limit.
    pub(super) fn new(scenario: &'s Scenario, cell: usize) -> Option<Self> {
        let indices: Vec<usize> = (0..scenario.vehicles().len())
            .filter(|&index| scenario.is_under_test(index))
            .collect();
        let follow_each_other = indices
            .windows(2)
            .all(|pair| pair.first().map(|ahead| ahead + 1) == pair.last().copied());
        let egos: Vec<EgoLimits> = indices
            .into_iter()
            .map(|index| EgoLimits::new(scenario, index))
            .collect::<Option<_>>()?;
        (follow_each_other && !egos.is_empty()).then_some(Self {
            scenario,
            egos,
            cell: cell.max(1),
            simulations: 0,
        })
    }

    pub(super) fn first_ego(&self) -> usize {
        self.egos.first().map_or(0, |ego| ego.index)
    }

    pub(super) fn ego_count(&self) -> usize {
        self.egos.len()
    }

    pub(super) fn cell_count(&self) -> usize {
        self.scenario.steps().div_ceil(self.cell)
    }

    pub(super) fn duration_s(&self) -> f64 {
        self.scenario.spec().duration_s
    }

    pub(super) fn cell_s(&self) -> f64 {
        self.cell as f64 * self.scenario.spec().step_s
    }

    pub(super) fn initial_speed_mps(&self, ego: usize) -> f64 {
        let vehicle = self
            .egos
            .get(ego)
            .and_then(|ego| self.scenario.vehicles().get(ego.index));
        vehicle.map_or(0.0, |vehicle| vehicle.speed_mps)
    }

    /// Returns the number of cells before the first command of a vehicle under test has an effect.
    pub(super) fn dead_cells(&self, ego: usize) -> usize {
        self.egos
            .get(ego)
            .map_or(0, |ego| ego.dead_steps.div_ceil(self.cell))
    }

    pub(super) fn limits_mps2(&self, ego: usize) -> [f64; 2] {
        self.egos
            .get(ego)
            .map_or([0.0; 2], |ego| [ego.low_mps2, ego.high_mps2])
    }

    /// Returns the profile of accelerations per step: the mean of each cell.
    pub(super) fn cell_profile(&self, each_step_mps2: &[Vec<f64>]) -> Profile {
        each_step_mps2
            .iter()
            .map(|steps_mps2| {
                steps_mps2
                    .chunks(self.cell)
                    .map(|cell| cell.iter().sum::<f64>() / cell.len() as f64)
                    .collect()
            })
            .collect()
    }

    pub(super) fn step_accelerations_mps2(&self, profile: &Profile) -> Vec<Vec<f64>> {
        let steps = self.scenario.steps();
        self.egos
            .iter()
            .zip(profile)
            .map(|(ego, cells)| ego.step_accelerations_mps2(cells, self.cell, steps))
            .collect()
    }

    pub(super) fn with_block_changed(
        &self,
        profile: &Profile,
        block: &CellBlock,
        by_mps2: f64,
    ) -> Profile {
        let [low, high] = self.limits_mps2(block.ego);
        let mut changed = profile.clone();
        let cells = changed
            .get_mut(block.ego)
            .and_then(|cells| cells.get_mut(block.cells.clone()));
        cells
            .into_iter()
            .flatten()
            .for_each(|cell| *cell = (*cell + by_mps2).clamp(low, high));
        changed
    }

    /// Simulates profiles; an invalid scenario has a margin of minus infinity.
    pub(super) fn simulate_profiles(&mut self, profiles: Vec<Profile>) -> Vec<SimulatedProfile> {
        let margins_m = self.simulate(&profiles, RecordingLevel::Summary, |simulated| {
            ProfileOutcome::from_simulated(&simulated).margin_m
        });
        profiles
            .into_iter()
            .zip(margins_m)
            .map(|(profile, margin_m)| SimulatedProfile {
                profile,
                margin_m: margin_m.unwrap_or(f64::NEG_INFINITY),
            })
            .collect()
    }

    pub(super) fn simulate_gaps(&mut self, profiles: &[Profile]) -> Vec<Option<SampledGaps>> {
        let stride = self.sample_steps();
        let samples = self.scenario.steps() / stride + 1;
        let vehicles = self.scenario.vehicles().len();
        let gaps = self.simulate(profiles, RecordingLevel::Trace, |simulated| {
            let trace = simulated.trace.as_ref()?;
            let pairs_m = (1..vehicles).flat_map(|rear| {
                let gaps_m = trace
                    .gaps_m(rear)
                    .into_iter()
                    .step_by(stride)
                    .map(|gap_m| gap_m.unwrap_or(f64::NAN));
                gaps_m.chain(std::iter::repeat(f64::NAN)).take(samples)
            });
            Some(SampledGaps {
                gap_m: pairs_m.collect(),
                samples,
            })
        });
        gaps.into_iter().map(Option::flatten).collect()
    }

    pub(super) fn sample_interval_s(&self) -> f64 {
        self.sample_steps() as f64 * self.scenario.spec().step_s
    }

    fn sample_steps(&self) -> usize {
        ((MAX_SAMPLE_INTERVAL_S / self.scenario.spec().step_s) as usize).max(1)
    }

    fn simulate<R: Send>(
        &mut self,
        profiles: &[Profile],
        level: RecordingLevel,
        reduce: impl Fn(SimulationResult) -> R + Sync,
    ) -> Vec<Option<R>> {
        let scripted: Vec<Option<Scenario>> = profiles
            .iter()
            .map(|profile| self.with_scripts(profile))
            .collect();
        let runs: Vec<Option<Run>> = scripted
            .iter()
            .map(|scenario| Run::new(scenario.as_ref()?, scripted_run_options()).ok())
            .collect();
        let is_valid: Vec<bool> = runs.iter().map(Option::is_some).collect();
        let runs: Vec<Run> = runs.into_iter().flatten().collect();
        self.simulations += runs.len();
        let mut results =
            simulate_batch(&runs, level, |_, simulated| reduce(simulated)).into_iter();
        is_valid
            .into_iter()
            .map(|is_valid| if is_valid { results.next() } else { None })
            .collect()
    }

    fn with_scripts(&self, profile: &Profile) -> Option<Scenario> {
        let step_s = self.scenario.spec().step_s;
        let scripts = self.step_accelerations_mps2(profile);
        let scripted = self.scenario.edited(|spec| {
            let egos = spec.vehicles.iter_mut().skip(self.first_ego());
            for (vehicle, script_mps2) in egos.zip(&scripts) {
                set_script(vehicle, script_pieces(script_mps2, step_s));
            }
        });
        scripted.ok()
    }
}
