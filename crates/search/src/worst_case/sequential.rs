//! Search against any controller, networks included: pulses and ramps, then sequential convex programming.
//!
//! From the best few pulses and ramps ([`super::pulses`]) the search descends. Finite differences in one batch
//! linearise the margin (smallest gap, or depth of an impact) over changes that are linear between a few knots. A
//! convex program in a trust region proposes a step, and a simulation decides on it. The search goes down to a
//! collision, then along its boundary to a mild one, or further down to a severe one. A milder profile than the result
//! may exist.

use std::cmp::Ordering;

use super::attack::{Attack, AttackError, AttackObjective};
use super::descent::{TRUST_REGION_FACTORS, finite_difference_gradient};
use super::envelope_step::{EnvelopeStep, HatFunctions, ProposedProfile, StepGoal};
use super::profile_simulator::ProfileSimulator;
use super::pulses::{self, Pulse};

const FINITE_DIFFERENCE_MPS2: f64 = 0.05;
const TRUST_REGION_MPS2: [f64; 2] = [1.0, 0.01];
/// Maximum number of starts of descents, and simulations per start.
const MAX_STARTS: usize = 8;
const SIMULATIONS_PER_START: usize = 250;
/// Bisections of the depth of every pulse that collides, and further ones of the mildest.
const FIRST_BISECTIONS: usize = 2;
const BISECTIONS: usize = 4;
const BISECTED_PULSES: [usize; 2] = [8, 24];
/// Bisections of the scale of a result, and of the time at which its braking is released.
const RESULT_BISECTIONS: usize = 8;
/// Largest number of simulations of each descent that are kept for its last round and for these bisections.
const RESERVED_SIMULATIONS: usize = 50;
const MIN_GAIN: f64 = 1e-4;
/// Margins that a step to a milder collision aims at, in metres.
const STEP_MARGINS_M: [f64; 4] = [-1e-3, -0.05, -0.3, -1.0];
/// Time after a collision that is still covered by the knots before it, in seconds.
const COLLISION_TAIL_S: f64 = 0.3;

/// A profile, one acceleration per cell, and its simulation.
#[derive(Debug, Clone)]
pub(super) struct SimulatedBraking {
    pub(super) cells_mps2: Vec<f64>,
    margin_m: f64,
    collides: bool,
    until_s: f64,
}

/// Result of a descent.
struct Descent {
    profile: SimulatedBraking,
    /// Margin of the profile that the last step predicted, in metres.
    predicted_margin_m: f64,
}

/// Bisection of the depth of a pulse between one that collides and one that does not.
struct DepthBisection {
    /// The pulse that collides, and its simulation.
    pulse: Pulse,
    point: SimulatedBraking,
    /// Depth with which it does not collide, in m/s².
    safe_depth_mps2: f64,
}

impl DepthBisection {
    fn new((pulse, point): (Pulse, SimulatedBraking)) -> Self {
        Self {
            safe_depth_mps2: pulse.shallower_depth_mps2(),
            pulse,
            point,
        }
    }

    /// Returns the pulse in the middle.
    fn half(&self) -> Pulse {
        self.pulse
            .with_depth(0.5 * (self.pulse.depth_mps2 + self.safe_depth_mps2))
    }

    /// Continues with the half of the range in which the collisions begin.
    fn narrow(&mut self, half: Pulse, point: SimulatedBraking) {
        if point.collides {
            self.pulse = half;
            self.point = point;
        } else {
            self.safe_depth_mps2 = half.depth_mps2;
        }
    }
}

/// Returns the best profile found with about `budget` simulations; `None` without a collision.
pub(super) fn attack(
    simulator: &mut ProfileSimulator<'_>,
    objective: AttackObjective,
    budget: usize,
) -> Result<Option<Attack>, AttackError> {
    let mut search = AttackSearch {
        simulator,
        objective,
    };
    let mut best: Option<Descent> = None;
    let mut starts = search.find_starts(budget)?;
    let left = budget.saturating_sub(search.simulator.evaluations);
    starts.truncate((left / SIMULATIONS_PER_START).max(1));
    let count = starts.len();
    for (index, start) in starts.into_iter().enumerate() {
        // Each descent gets an equal share of the remaining simulations.
        let spent = search.simulator.evaluations;
        let share = budget.saturating_sub(spent) / (count - index);
        let until = spent + share.saturating_sub(RESERVED_SIMULATIONS.min(share / 8));
        let descent = search.descend(start, until)?;
        let descent = search.reduce(descent)?;
        let is_best = best
            .as_ref()
            .is_none_or(|best| search.is_better(&descent.profile, &best.profile));
        if descent.profile.collides && is_best {
            best = Some(descent);
        }
    }
    let Some(best) = best else {
        return Ok(None);
    };
    let cells_mps2 = &best.profile.cells_mps2;
    let report = search
        .simulator
        .report(cells_mps2, best.predicted_margin_m)?;
    Ok(Some(report))
}

struct AttackSearch<'s, 'a> {
    simulator: &'s mut ProfileSimulator<'a>,
    objective: AttackObjective,
}

impl AttackSearch<'_, '_> {
    fn is_better(&self, profile: &SimulatedBraking, best: &SimulatedBraking) -> bool {
        match self.objective {
            AttackObjective::Severest => profile.margin_m < best.margin_m,
            AttackObjective::Mildest | AttackObjective::LeastPeak => {
                self.cost(&profile.cells_mps2) < self.cost(&best.cells_mps2)
            }
        }
    }

    fn simulate_profiles(
        &mut self,
        all: Vec<Vec<f64>>,
    ) -> Result<Vec<SimulatedBraking>, AttackError> {
        let trials = self.simulator.simulate(&all)?;
        let duration_s = self.simulator.scenario.spec().duration_s;
        let mut simulated = Vec::with_capacity(all.len());
        for (cells_mps2, trial) in all.into_iter().zip(trials) {
            simulated.push(SimulatedBraking {
                cells_mps2,
                margin_m: trial.margin_m,
                collides: trial.collides(),
                until_s: trial.end_time_s().unwrap_or(duration_s),
            });
        }
        Ok(simulated)
    }

    /// Returns pulses and ramps as starts: the mildest that collide, or those with the smallest margins.
    fn find_starts(&mut self, budget: usize) -> Result<Vec<SimulatedBraking>, AttackError> {
        let pulses = pulses::scan(self.simulator, budget);
        let profiles: Vec<_> = pulses
            .iter()
            .map(|pulse| pulse.cells_mps2(self.simulator))
            .collect();
        let simulated = self.simulate_profiles(profiles)?;
        let mut all: Vec<(Pulse, SimulatedBraking)> = pulses.into_iter().zip(simulated).collect();
        if self.objective == AttackObjective::Severest
            || !all.iter().any(|(_, point)| point.collides)
        {
            all.sort_by(|(_, a), (_, b)| a.margin_m.total_cmp(&b.margin_m));
            return Ok(all
                .into_iter()
                .map(|(_, point)| point)
                .take(MAX_STARTS)
                .collect());
        }
        let most = (all.len() / 5).clamp(BISECTED_PULSES[0], BISECTED_PULSES[1]);
        // A long and shallow braking is milder than its first depth that collides suggests.
        let mut bisections = self.select_shallowest(all);
        self.reduce_depths(&mut bisections, FIRST_BISECTIONS)?;
        bisections.sort_by(|a, b| self.compare_costs(&a.point, &b.point));
        bisections.truncate(most);
        self.reduce_depths(&mut bisections, BISECTIONS)?;
        let mut points: Vec<SimulatedBraking> = bisections
            .into_iter()
            .map(|bisection| self.trim(bisection.point))
            .collect();
        points.sort_by(|a, b| self.compare_costs(a, b));
        points.truncate(MAX_STARTS);
        Ok(points)
    }

    /// Returns the shallowest pulse that collides of each form, length and onset.
    fn select_shallowest(&self, mut all: Vec<(Pulse, SimulatedBraking)>) -> Vec<DepthBisection> {
        all.retain(|(_, point)| point.collides);
        all.sort_by(|(_, a), (_, b)| self.compare_costs(a, b));
        let mut shallowest: Vec<DepthBisection> = Vec::new();
        for pulse in all {
            let is_new = !shallowest
                .iter()
                .any(|milder| milder.pulse.differs_in_depth_only(&pulse.0));
            if is_new {
                shallowest.push(DepthBisection::new(pulse));
            }
        }
        shallowest
    }

    fn compare_costs(&self, a: &SimulatedBraking, b: &SimulatedBraking) -> Ordering {
        self.cost(&a.cells_mps2)
            .total_cmp(&self.cost(&b.cells_mps2))
    }

    /// Reduces the depths of colliding pulses by bisection.
    fn reduce_depths(
        &mut self,
        bisections: &mut [DepthBisection],
        count: usize,
    ) -> Result<(), AttackError> {
        for _ in 0..count {
            let halves: Vec<Pulse> = bisections.iter().map(DepthBisection::half).collect();
            let profiles = halves.iter().map(|half| half.cells_mps2(self.simulator));
            let simulated = self.simulate_profiles(profiles.collect())?;
            let trials = halves.into_iter().zip(simulated);
            for (bisection, (half, point)) in bisections.iter_mut().zip(trials) {
                bisection.narrow(half, point);
            }
        }
        Ok(())
    }

    /// Releases the braking of a result earlier and scales it down, as far as it still collides. Once a latched brake
    /// has fired, the margin no longer depends on the profile, and a descent finds no gradient.
    fn reduce(&mut self, descent: Descent) -> Result<Descent, AttackError> {
        if !self.reduces_cost(&descent.profile) {
            return Ok(descent);
        }
        let cost = self.cost(&descent.profile.cells_mps2);
        let most = self.simulator.envelope.jerk_mps3 * self.simulator.cell_s();
        let cells = descent.profile.until_s / self.simulator.cell_s();
        let released = |cells_mps2: &[f64], share: f64| {
            let mut released = cells_mps2.to_vec();
            release_from((share * cells).ceil() as usize, &mut released, most);
            released
        };
        let scaled = |cells_mps2: &[f64], share: f64| {
            let scaled = cells_mps2.iter().map(|cell_mps2| share * cell_mps2);
            scaled.collect()
        };
        let profile = self.bisect_share(descent.profile, &released)?;
        let profile = self.bisect_share(profile, &scaled)?;
        Ok(if self.cost(&profile.cells_mps2) < cost {
            Descent {
                predicted_margin_m: profile.margin_m,
                profile,
            }
        } else {
            Descent { profile, ..descent }
        })
    }

    /// Returns the change of a colliding profile by the smallest share that collides, of those that a bisection tries.
    fn bisect_share(
        &mut self,
        mut best: SimulatedBraking,
        change: &dyn Fn(&[f64], f64) -> Vec<f64>,
    ) -> Result<SimulatedBraking, AttackError> {
        let whole_mps2 = best.cells_mps2.clone();
        let [mut safe, mut collides] = [0.0, 1.0];
        for _ in 0..RESULT_BISECTIONS {
            let share = 0.5 * (safe + collides);
            let simulated = self.simulate_profiles(vec![change(&whole_mps2, share)])?;
            match simulated.into_iter().next().filter(|point| point.collides) {
                Some(point) => {
                    collides = share;
                    best = point;
                }
                None => safe = share,
            }
        }
        Ok(best)
    }

    /// Steps from one profile until `until` simulations or no improvement.
    fn descend(&mut self, mut at: SimulatedBraking, until: usize) -> Result<Descent, AttackError> {
        let [success, failure] = TRUST_REGION_FACTORS;
        let [largest_mps2, smallest_mps2] = TRUST_REGION_MPS2;
        let mut trust_region_mps2 = largest_mps2;
        let mut predicted_margin_m = at.margin_m;
        let mut phase = 0.0;
        while trust_region_mps2 > smallest_mps2 && self.simulator.evaluations < until {
            match self.step(&at, trust_region_mps2, phase)? {
                Some(next) => {
                    at = next.profile;
                    predicted_margin_m = next.predicted_margin_m;
                    trust_region_mps2 = (trust_region_mps2 * success).min(largest_mps2);
                }
                None => trust_region_mps2 *= failure,
            }
            // The knots of the next round lie between those of this one.
            phase = 0.5 - phase;
        }
        Ok(Descent {
            profile: at,
            predicted_margin_m,
        })
    }

    /// Returns the best profile after one step; `None` if no step improves the profile.
    fn step(
        &mut self,
        at: &SimulatedBraking,
        trust_region_mps2: f64,
        phase: f64,
    ) -> Result<Option<Descent>, AttackError> {
        let hats = HatFunctions::new(self.simulator, at.until_s + COLLISION_TAIL_S, phase);
        let gradient = self.gradient(at, &hats)?;
        let step = EnvelopeStep {
            profile_mps2: &at.cells_mps2,
            margin_m: at.margin_m,
            gradient: &gradient,
            hats: &hats,
            trust_region_mps2,
        };
        let goals = self.goals(at);
        let proposed: Vec<ProposedProfile> = goals
            .into_iter()
            .filter_map(|goal| step.solve(self.simulator, goal))
            .collect();
        let profiles = proposed.iter().map(|profile| profile.cells_mps2.clone());
        let simulated = self.simulate_profiles(profiles.collect())?;
        let best = simulated
            .into_iter()
            .zip(proposed)
            .max_by(|(a, _), (b, _)| self.gain(at, a).total_cmp(&self.gain(at, b)));
        let best = best.filter(|(profile, _)| self.gain(at, profile) > MIN_GAIN);
        Ok(best.map(|(profile, proposed)| Descent {
            profile: self.trim(profile),
            predicted_margin_m: proposed.predicted_margin_m,
        }))
    }

    /// Returns whether milder profiles than this one are wanted, and not smaller margins.
    fn reduces_cost(&self, at: &SimulatedBraking) -> bool {
        at.collides && self.objective != AttackObjective::Severest
    }

    /// Returns the goals of a step. Several depths are tried, because the linear prediction is not exact.
    fn goals(&self, at: &SimulatedBraking) -> Vec<StepGoal> {
        if !self.reduces_cost(at) {
            return vec![StepGoal::Margin];
        }
        STEP_MARGINS_M
            .map(|margin_m| StepGoal::Cost {
                objective: self.objective,
                margin_m,
            })
            .into()
    }

    fn gain(&self, at: &SimulatedBraking, profile: &SimulatedBraking) -> f64 {
        if !self.reduces_cost(at) {
            at.margin_m - profile.margin_m
        } else if profile.collides {
            1.0 - self.cost(&profile.cells_mps2) / self.cost(&at.cells_mps2)
        } else {
            f64::NEG_INFINITY
        }
    }

    /// Returns the profile with a release as fast as the jerk allows after the end of the simulation.
    fn trim(&self, mut point: SimulatedBraking) -> SimulatedBraking {
        let cell_s = self.simulator.cell_s();
        let most = self.simulator.envelope.jerk_mps3 * cell_s;
        let over = (point.until_s / cell_s).ceil() as usize;
        release_from(over, &mut point.cells_mps2, most);
        point
    }

    fn cost(&self, cells_mps2: &[f64]) -> f64 {
        self.objective.cost(cells_mps2, self.simulator.cell_s())
    }

    /// Returns the gradient of the margin with respect to the knots, in s².
    fn gradient(
        &mut self,
        at: &SimulatedBraking,
        hats: &HatFunctions,
    ) -> Result<Vec<f64>, AttackError> {
        let most = self.simulator.envelope.max_brake_mps2;
        let by: Vec<f64> = hats
            .means_mps2(&at.cells_mps2)
            .map(|mean| {
                if mean > -0.5 * most {
                    -FINITE_DIFFERENCE_MPS2
                } else {
                    FINITE_DIFFERENCE_MPS2
                }
            })
            .collect();
        let nudged = by
            .iter()
            .enumerate()
            .map(|(knot, &by)| hats.perturb(&at.cells_mps2, knot, by, most))
            .collect();
        let margins_m: Vec<f64> = self
            .simulate_profiles(nudged)?
            .iter()
            .map(|point| point.margin_m)
            .collect();
        Ok(finite_difference_gradient(at.margin_m, &margins_m, &by))
    }
}

/// Releases the braking from a cell on, by at most `most` from cell to cell.
fn release_from(cell: usize, cells_mps2: &mut [f64], most: f64) {
    let mut before = cell
        .checked_sub(1)
        .and_then(|last| cells_mps2.get(last))
        .copied()
        .unwrap_or(0.0);
    for cell_mps2 in cells_mps2.iter_mut().skip(cell) {
        *cell_mps2 = (before + most).min(0.0);
        before = *cell_mps2;
    }
}
