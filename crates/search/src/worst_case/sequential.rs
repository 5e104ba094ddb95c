//! Search against any controller, networks included: pulses and ramps, then sequential convex programming.
//!
//! From the best few pulses and ramps ([`super::pulses`]) the search descends. Finite differences in one batch
//! linearise the margin (smallest gap, or depth of an impact) over changes that are linear between a few knots. A
//! convex program in a trust region proposes a step, and a simulation decides on it. The search goes down to a
//! collision, then along its boundary to a mild one, or further down to a severe one. A milder profile than the result
//! may exist.

use super::attack::{Attack, AttackError, AttackObjective};
use super::descent::{TRUST_REGION_FACTORS, finite_difference_gradient};
use super::envelope_step::{EnvelopeStep, HatFunctions, StepGoal};
use super::profile_simulator::{ProfileOutcome, ProfileSimulator};
use super::pulses::{self, Pulse};

const FINITE_DIFFERENCE_MPS2: f64 = 0.05;
const TRUST_REGION_MPS2: [f64; 2] = [1.0, 0.01];
/// Maximum number of starts of descents, and simulations per start.
const MAX_STARTS: usize = 8;
const SIMULATIONS_PER_START: usize = 250;
const BISECTIONS: usize = 6;
const BISECTED_PULSES: [usize; 2] = [8, 24];
const MIN_GAIN: f64 = 1e-4;
/// Time after a collision that is still covered by the knots before it, in seconds.
const CONTACT_TAIL_S: f64 = 0.3;

/// A profile, one acceleration per cell, and its simulation.
#[derive(Debug, Clone)]
pub(super) struct SimulatedBraking {
    pub(super) cells_mps2: Vec<f64>,
    margin_m: f64,
    collides: bool,
    until_s: f64,
}

/// Returns the best profile found with about `budget` simulations; `None` without a collision.
pub(super) fn attack(
    bench: &mut ProfileSimulator<'_>,
    aim: AttackObjective,
    budget: usize,
) -> Result<Option<Attack>, AttackError> {
    let mut search = AttackSearch {
        bench,
        objective: aim,
    };
    let mut best: Option<(SimulatedBraking, f64)> = None;
    let mut starts = search.find_starts(budget)?;
    starts
        .truncate((budget.saturating_sub(search.bench.evaluations) / SIMULATIONS_PER_START).max(1));
    let count = starts.len();
    for (index, start) in starts.into_iter().enumerate() {
        // Each descent gets an equal share of the remaining simulations.
        let spent = search.bench.evaluations;
        let until = spent + budget.saturating_sub(spent) / (count - index);
        let found = search.descend(start, until)?;
        let is_better = |best: &SimulatedBraking, found: &SimulatedBraking| match aim {
            AttackObjective::Severest => found.margin_m < best.margin_m,
            AttackObjective::Mildest | AttackObjective::LeastPeak => {
                search.cost(&found.cells_mps2) < search.cost(&best.cells_mps2)
            }
        };
        if found.0.collides
            && best
                .as_ref()
                .is_none_or(|(best, _)| is_better(best, &found.0))
        {
            best = Some(found);
        }
    }
    let Some((best, predicted_m)) = best else {
        return Ok(None);
    };
    Ok(Some(search.bench.report(&best.cells_mps2, predicted_m)?))
}

struct AttackSearch<'s, 'a> {
    bench: &'s mut ProfileSimulator<'a>,
    objective: AttackObjective,
}

impl AttackSearch<'_, '_> {
    fn simulate_profiles(
        &mut self,
        all: Vec<Vec<f64>>,
    ) -> Result<Vec<SimulatedBraking>, AttackError> {
        let trials = self.bench.simulate(&all)?;
        let duration_s = self.bench.scenario.spec().duration_s;
        let point = |(cells_mps2, trial): (Vec<f64>, ProfileOutcome)| SimulatedBraking {
            cells_mps2,
            margin_m: trial.margin_m,
            collides: trial.collides(),
            until_s: trial.end_time_s().unwrap_or(duration_s),
        };
        Ok(all.into_iter().zip(trials).map(point).collect())
    }

    /// Returns pulses and ramps as starts: the mildest that collide, or those with the smallest margins.
    fn find_starts(&mut self, budget: usize) -> Result<Vec<SimulatedBraking>, AttackError> {
        let pulses = pulses::scan(self.bench, budget);
        let profiles: Vec<_> = pulses
            .iter()
            .map(|pulse| pulse.cells_mps2(self.bench))
            .collect();
        let tried = self.simulate_profiles(profiles)?;
        let mut all: Vec<(Pulse, SimulatedBraking)> = pulses.into_iter().zip(tried).collect();
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
        all.retain(|(_, point)| point.collides);
        all.sort_by(|(_, a), (_, b)| {
            self.cost(&a.cells_mps2)
                .total_cmp(&self.cost(&b.cells_mps2))
        });
        // One depth of each form, length and onset.
        let mut mildest: Vec<(Pulse, SimulatedBraking)> = Vec::new();
        for (pulse, point) in all {
            if mildest.len() < most
                && mildest
                    .iter()
                    .all(|(other, _)| !other.differs_in_depth_only(&pulse))
            {
                mildest.push((pulse, point));
            }
        }
        self.bisect(&mut mildest)?;
        let mut points: Vec<SimulatedBraking> = mildest
            .into_iter()
            .map(|(_, point)| self.trim(point))
            .collect();
        points.sort_by(|a, b| {
            self.cost(&a.cells_mps2)
                .total_cmp(&self.cost(&b.cells_mps2))
        });
        points.truncate(MAX_STARTS);
        Ok(points)
    }

    /// Reduces the depth of colliding pulses while they collide.
    fn bisect(&mut self, pulses: &mut [(Pulse, SimulatedBraking)]) -> Result<(), AttackError> {
        let mut misses_mps2: Vec<f64> = pulses
            .iter()
            .map(|(pulse, _)| pulse.shallower_depth_mps2())
            .collect();
        for _ in 0..BISECTIONS {
            let halfway = |((pulse, _), misses): (&(Pulse, SimulatedBraking), &f64)| {
                pulse.with_depth(0.5 * (pulse.depth_mps2 + misses))
            };
            let halves: Vec<Pulse> = pulses.iter().zip(&misses_mps2).map(halfway).collect();
            let tried = self.simulate_profiles(
                halves
                    .iter()
                    .map(|half| half.cells_mps2(self.bench))
                    .collect(),
            )?;
            for (((pulse, misses_mps2), half), point) in pulses
                .iter_mut()
                .zip(&mut misses_mps2)
                .zip(halves)
                .zip(tried)
            {
                if point.collides {
                    *pulse = (half, point)
                } else {
                    *misses_mps2 = half.depth_mps2
                }
            }
        }
        Ok(())
    }

    /// Steps from one profile until `until` simulations or no improvement. Returns it with the last predicted margin.
    fn descend(
        &mut self,
        mut at: SimulatedBraking,
        until: usize,
    ) -> Result<(SimulatedBraking, f64), AttackError> {
        let [success, failure] = TRUST_REGION_FACTORS;
        let (mut region, mut predicted_m, mut phase) = (TRUST_REGION_MPS2[0], at.margin_m, 0.0);
        while region > TRUST_REGION_MPS2[1] && self.bench.evaluations < until {
            let wants_cost = at.collides && self.objective != AttackObjective::Severest;
            let hats = HatFunctions::new(self.bench, at.until_s + CONTACT_TAIL_S, phase);
            let slope = self.gradient(&at, &hats)?;
            // Try several depths, because the linear prediction is not exact.
            let goals: Vec<StepGoal> = match wants_cost {
                true => [-1e-3, -0.05, -0.3, -1.0]
                    .map(|margin_m| StepGoal::Cost {
                        objective: self.objective,
                        margin_m,
                    })
                    .into(),
                false => vec![StepGoal::Margin],
            };
            let step = EnvelopeStep {
                profile_mps2: &at.cells_mps2,
                margin_m: at.margin_m,
                gradient: &slope,
                hats: &hats,
                trust_region_mps2: region,
            };
            let steps: Vec<_> = goals
                .into_iter()
                .filter_map(|goal| step.solve(self.bench, goal))
                .collect();
            let tried =
                self.simulate_profiles(steps.iter().map(|(cells, _)| cells.clone()).collect())?;
            let gain = |point: &SimulatedBraking| match wants_cost {
                true if !point.collides => f64::NEG_INFINITY,
                true => 1.0 - self.cost(&point.cells_mps2) / self.cost(&at.cells_mps2),
                false => at.margin_m - point.margin_m,
            };
            let best = tried
                .into_iter()
                .zip(steps)
                .max_by(|(a, _), (b, _)| gain(a).total_cmp(&gain(b)));
            match best.filter(|(point, _)| gain(point) > MIN_GAIN) {
                Some((point, (_, predicted))) => {
                    (at, predicted_m) = (self.trim(point), predicted);
                    region = (region * success).min(TRUST_REGION_MPS2[0]);
                }
                None => region *= failure,
            }
            // The knots of the next round lie between those of this one.
            phase = 0.5 - phase;
        }
        Ok((at, predicted_m))
    }

    /// Returns the profile with a release as fast as the jerk allows after the end of the simulation.
    fn trim(&self, mut point: SimulatedBraking) -> SimulatedBraking {
        let (cell_s, most) = (
            self.bench.cell_s(),
            self.bench.envelope.jerk_mps3 * self.bench.cell_s(),
        );
        let over = (point.until_s / cell_s).ceil() as usize;
        let mut before = over
            .checked_sub(1)
            .and_then(|last| point.cells_mps2.get(last))
            .copied()
            .unwrap_or(0.0);
        for held in point.cells_mps2.iter_mut().skip(over) {
            *held = (before + most).min(0.0);
            before = *held;
        }
        point
    }

    fn cost(&self, cells_mps2: &[f64]) -> f64 {
        self.objective.cost(cells_mps2, self.bench.cell_s())
    }

    /// Returns the gradient of the margin with respect to the knots, in s².
    fn gradient(
        &mut self,
        at: &SimulatedBraking,
        hats: &HatFunctions,
    ) -> Result<Vec<f64>, AttackError> {
        let most = self.bench.envelope.max_brake_mps2;
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
