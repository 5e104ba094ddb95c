//! Step of a leader's braking profile inside its envelope, by a convex program.
//!
//! A profile has one acceleration per cell; a step changes it by a function that is linear between knots.

use super::attack::AttackObjective;
use super::profile_simulator::ProfileSimulator;
use crumple_quadratic::{QuadraticProgram, QuadraticSolution};

/// Numbers of knots until a simulation ends, and after that.
const KNOT_COUNTS: [usize; 2] = [24, 3];
/// Cost of squared changes if the margin is the objective.
const REGULARIZATION_WEIGHT: f64 = 1e-4;
/// Cost per metre by which the margin misses its goal.
const SHORTFALL_COST: f64 = 1e3;

/// Functions that are linear between knots, sampled at the middle of each cell.
pub(super) struct HatFunctions {
    /// Position of each cell between two knots.
    positions: Vec<KnotPosition>,
    knots: usize,
}

#[derive(Debug, Clone, Copy, Default)]
struct KnotPosition {
    /// Index of the knot to the left.
    left: usize,
    /// Weight of the knot to the right.
    right_weight: f64,
}

impl HatFunctions {
    /// Creates equidistant knots until `until_s`, shifted by `phase` of their distance, and a few after it.
    pub(super) fn new(simulator: &ProfileSimulator<'_>, until_s: f64, phase: f64) -> Self {
        let knots_s = knot_times_s(simulator, until_s, phase);
        let positions = (0..simulator.cell_count()).map(|cell| {
            let middle_s = (cell as f64 + 0.5) * simulator.cell_s();
            KnotPosition::new(&knots_s, middle_s)
        });
        Self {
            positions: positions.collect(),
            knots: knots_s.len(),
        }
    }

    fn terms(&self, cell: usize) -> [(usize, f64); 2] {
        let KnotPosition { left, right_weight } =
            self.positions.get(cell).copied().unwrap_or_default();
        [(left, 1.0 - right_weight), (left + 1, right_weight)]
    }

    /// Returns the profile with one knot changed, within the limits of the acceleration.
    pub(super) fn perturb(
        &self,
        cells_mps2: &[f64],
        knot: usize,
        by_mps2: f64,
        most_mps2: f64,
    ) -> Vec<f64> {
        let mut changed = cells_mps2.to_vec();
        for (cell, accel_mps2) in changed.iter_mut().enumerate() {
            let weight: f64 = self
                .terms(cell)
                .iter()
                .filter(|(index, _)| *index == knot)
                .map(|(_, weight)| weight)
                .sum();
            if weight != 0.0 {
                *accel_mps2 = (*accel_mps2 + weight * by_mps2).clamp(-most_mps2, 0.0);
            }
        }
        changed
    }

    /// Returns the weighted mean of the profile around each knot, in m/s².
    pub(super) fn means_mps2(&self, cells_mps2: &[f64]) -> impl Iterator<Item = f64> {
        let mut sums = vec![(0.0, 0.0); self.knots];
        for (cell, accel_mps2) in cells_mps2.iter().enumerate() {
            for (knot, weight) in self.terms(cell) {
                if let Some((sum, weights)) = sums.get_mut(knot) {
                    *sum += weight * accel_mps2;
                    *weights += weight;
                }
            }
        }
        sums.into_iter()
            .map(|(sum, weights)| if weights > 0.0 { sum / weights } else { 0.0 })
    }
}

fn knot_times_s(simulator: &ProfileSimulator<'_>, until_s: f64, phase: f64) -> Vec<f64> {
    let [early_count, late_count] = KNOT_COUNTS;
    let all_s = simulator.cell_count() as f64 * simulator.cell_s();
    let until_s = until_s.min(all_s);
    let apart_s = (until_s / early_count as f64).max(simulator.cell_s());
    let early_s = (0..=early_count).map(|knot| (knot as f64 + phase) * apart_s);
    let mut knots_s: Vec<f64> = std::iter::once(0.0)
        .chain(early_s)
        .filter(|knot_s| *knot_s < all_s)
        .collect();
    let last_s = knots_s.last().copied().unwrap_or(0.0);
    knots_s.extend(
        (1..=late_count).map(|knot| last_s + (all_s - last_s) * knot as f64 / late_count as f64),
    );
    knots_s.dedup();
    knots_s
}

impl KnotPosition {
    /// Returns the position of a time, by linear interpolation.
    fn new(knots_s: &[f64], time_s: f64) -> Self {
        let right = knots_s.partition_point(|knot_s| *knot_s <= time_s);
        let left = right.clamp(1, knots_s.len().max(2) - 1) - 1;
        let right_weight = match knots_s.get(left..left + 2) {
            Some(&[left_s, right_s]) => ((time_s - left_s) / (right_s - left_s)).clamp(0.0, 1.0),
            _ => 0.0,
        };
        Self { left, right_weight }
    }
}

/// Variables of the program of a step.
#[derive(Clone, Copy)]
struct Variables {
    /// Number of knots. The first variables are the changes at them, in m/s².
    knots: usize,
    /// Index of the hardest braking of the profile, in m/s².
    peak: usize,
    /// Index of the length by which the margin misses its goal, in metres.
    shortfall: usize,
}

impl Variables {
    fn new(knots: usize) -> Self {
        Self {
            knots,
            peak: knots,
            shortfall: knots + 1,
        }
    }

    fn count(self) -> usize {
        self.knots + 2
    }
}

/// A profile after a step.
pub(super) struct ProposedProfile {
    pub(super) cells_mps2: Vec<f64>,
    /// Margin by the linearisation, in metres.
    pub(super) predicted_margin_m: f64,
}

#[derive(Debug, Clone, Copy)]
pub(super) enum StepGoal {
    Margin,
    /// The least cost of a profile whose linearised margin is at most `margin_m`, in metres, or near it.
    Cost {
        /// Definition of the cost: ∫ a² or the peak.
        objective: AttackObjective,
        margin_m: f64,
    },
}

pub(super) struct EnvelopeStep<'a> {
    pub(super) profile_mps2: &'a [f64],
    pub(super) margin_m: f64,
    /// Gradient of the margin with respect to the knots, in s².
    pub(super) gradient: &'a [f64],
    pub(super) hats: &'a HatFunctions,
    pub(super) trust_region_mps2: f64,
}

impl EnvelopeStep<'_> {
    /// Returns the profile after the step; `None` if the solver fails.
    pub(super) fn solve(
        &self,
        simulator: &mut ProfileSimulator<'_>,
        goal: StepGoal,
    ) -> Option<ProposedProfile> {
        simulator.programs += 1;
        let variables = Variables::new(self.hats.knots);
        let mut program = QuadraticProgram::new(variables.count());
        self.add_envelope_rows(simulator, &mut program);
        program.add_inequality(&[(variables.shortfall, -1.0)], 0.0);
        program.add_inequality(&[(variables.peak, -1.0)], 0.0);
        self.add_goal(simulator, &mut program, variables, goal);
        let QuadraticSolution::Optimal { point, .. } = program.solve() else {
            return None;
        };
        if point.iter().any(|value| !value.is_finite()) {
            return None;
        }
        Some(ProposedProfile {
            cells_mps2: self.apply_clamped(simulator, &point),
            predicted_margin_m: match goal {
                StepGoal::Margin => self.margin_m + self.linear_change_m(&point),
                StepGoal::Cost { margin_m, .. } => margin_m,
            },
        })
    }

    /// Returns the linearised change of the margin, in metres.
    fn linear_change_m(&self, changes: &[f64]) -> f64 {
        self.gradient
            .iter()
            .zip(changes)
            .map(|(slope, change)| slope * change)
            .sum()
    }

    fn add_goal(
        &self,
        simulator: &ProfileSimulator<'_>,
        program: &mut QuadraticProgram,
        variables: Variables,
        goal: StepGoal,
    ) {
        match goal {
            StepGoal::Margin => {
                for (knot, &slope) in self.gradient.iter().enumerate() {
                    program.add_linear_cost(knot, slope);
                    program.add_squared_cost(&[(knot, 1.0)], REGULARIZATION_WEIGHT);
                }
            }
            StepGoal::Cost {
                objective,
                margin_m,
            } => {
                let mut falls: Vec<_> = self.gradient.iter().copied().enumerate().collect();
                falls.push((variables.shortfall, -1.0));
                program.add_inequality(&falls, margin_m - self.margin_m);
                program.add_linear_cost(variables.shortfall, SHORTFALL_COST);
                self.add_cost(simulator, program, objective, variables.peak);
            }
        }
    }

    /// Adds the limits of acceleration and jerk, where the trust region reaches them.
    fn add_envelope_rows(&self, simulator: &ProfileSimulator<'_>, program: &mut QuadraticProgram) {
        let region_mps2 = self.trust_region_mps2;
        for knot in 0..self.hats.knots {
            program.add_inequality(&[(knot, 1.0)], region_mps2);
            program.add_inequality(&[(knot, -1.0)], region_mps2);
        }
        let max_brake_mps2 = simulator.envelope.max_brake_mps2;
        let mut last_mps2 = 0.0;
        let mut last_terms = [(0, 0.0); 2];
        for (cell, &accel_mps2) in self.profile_mps2.iter().enumerate() {
            let terms = self.hats.terms(cell);
            if accel_mps2 + region_mps2 > 0.0 {
                program.add_inequality(&terms, -accel_mps2);
            }
            if accel_mps2 - region_mps2 < -max_brake_mps2 {
                program.add_inequality(&negative(&terms), max_brake_mps2 + accel_mps2);
            }
            let change = difference(terms, last_terms);
            self.add_jerk_rows(simulator, program, &change, accel_mps2 - last_mps2);
            last_mps2 = accel_mps2;
            last_terms = terms;
        }
    }

    /// Limits the jerk between two cells, whose accelerations differ by `jump_mps2` now and by `change` in a step.
    fn add_jerk_rows(
        &self,
        simulator: &ProfileSimulator<'_>,
        program: &mut QuadraticProgram,
        change: &[(usize, f64)],
        jump_mps2: f64,
    ) {
        let max_jump_mps2 = simulator.envelope.jerk_mps3 * simulator.cell_s();
        let weights: f64 = change.iter().map(|(_, weight)| weight.abs()).sum();
        let reach_mps2 = self.trust_region_mps2 * weights;
        if jump_mps2 + reach_mps2 > max_jump_mps2 {
            program.add_inequality(change, max_jump_mps2 - jump_mps2);
        }
        if jump_mps2 - reach_mps2 < -max_jump_mps2 {
            program.add_inequality(&negative(change), max_jump_mps2 + jump_mps2);
        }
    }

    fn add_cost(
        &self,
        simulator: &ProfileSimulator<'_>,
        program: &mut QuadraticProgram,
        objective: AttackObjective,
        peak: usize,
    ) {
        let is_least_peak = objective == AttackObjective::LeastPeak;
        // Selects a mild one among profiles with the least peak.
        let weight_per_s = if is_least_peak { 1e-4 } else { 1.0 };
        let weight = weight_per_s * simulator.cell_s();
        for (cell, &accel_mps2) in self.profile_mps2.iter().enumerate() {
            let terms = self.hats.terms(cell);
            program.add_squared_cost(&terms, weight);
            for (knot, share) in terms {
                program.add_linear_cost(knot, 2.0 * weight * accel_mps2 * share);
            }
            if is_least_peak {
                let [(left, a), (right, b)] = terms;
                program.add_inequality(&[(left, -a), (right, -b), (peak, -1.0)], accel_mps2);
            }
        }
        if is_least_peak {
            program.add_linear_cost(peak, 1.0);
        }
    }

    /// Returns the changed profile, clamped to the envelope because of the solver's tolerance.
    fn apply_clamped(&self, simulator: &ProfileSimulator<'_>, change: &[f64]) -> Vec<f64> {
        let jump = simulator.envelope.jerk_mps3 * simulator.cell_s();
        let mut before = 0.0_f64;
        let mut changed = self.profile_mps2.to_vec();
        for (cell, accel_mps2) in changed.iter_mut().enumerate() {
            let by: f64 = self
                .hats
                .terms(cell)
                .iter()
                .filter_map(|&(knot, w)| Some(w * change.get(knot)?))
                .sum();
            let wanted = (*accel_mps2 + by).clamp(-simulator.envelope.max_brake_mps2, 0.0);
            // Removes the solver's residue of a zero.
            let wanted = if wanted > -1e-6 { 0.0 } else { wanted };
            before = wanted.clamp(before - jump, before + jump);
            *accel_mps2 = before;
        }
        changed
    }
}

fn negative(terms: &[(usize, f64)]) -> Vec<(usize, f64)> {
    terms
        .iter()
        .map(|&(knot, weight)| (knot, -weight))
        .collect()
}

/// Returns the terms of a difference of two cells.
fn difference(terms: [(usize, f64); 2], subtracted: [(usize, f64); 2]) -> Vec<(usize, f64)> {
    let mut difference = Vec::from(terms);
    for (knot, weight) in subtracted {
        match difference.iter_mut().find(|(index, _)| *index == knot) {
            Some((_, sum)) => *sum -= weight,
            None => difference.push((knot, -weight)),
        }
    }
    difference
}
