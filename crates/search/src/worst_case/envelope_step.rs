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
    /// Index of the knot left of each cell, and the weight of the right one.
    shares: Vec<(usize, f64)>,
    knots: usize,
}

impl HatFunctions {
    /// Creates equidistant knots until `until_s`, shifted by `phase` of their distance, and a few after it.
    pub(super) fn new(bench: &ProfileSimulator<'_>, until_s: f64, phase: f64) -> Self {
        let all_s = bench.cell_count() as f64 * bench.cell_s();
        let until_s = until_s.min(all_s);
        let apart_s = (until_s / KNOT_COUNTS[0] as f64).max(bench.cell_s());
        let early = (0..=KNOT_COUNTS[0]).map(|knot| (knot as f64 + phase) * apart_s);
        let mut at_s: Vec<f64> = std::iter::once(0.0)
            .chain(early)
            .filter(|at_s| *at_s < all_s)
            .collect();
        let last_s = at_s.last().copied().unwrap_or(0.0);
        at_s.extend(
            (1..=KNOT_COUNTS[1])
                .map(|knot| last_s + (all_s - last_s) * knot as f64 / KNOT_COUNTS[1] as f64),
        );
        at_s.dedup();
        let share = |cell: usize| {
            let middle_s = (cell as f64 + 0.5) * bench.cell_s();
            let left = at_s
                .partition_point(|at_s| *at_s <= middle_s)
                .clamp(1, at_s.len().max(2) - 1)
                - 1;
            match at_s.get(left..left + 2) {
                Some(&[left_s, right_s]) => (
                    left,
                    ((middle_s - left_s) / (right_s - left_s)).clamp(0.0, 1.0),
                ),
                _ => (left, 0.0),
            }
        };
        Self {
            shares: (0..bench.cell_count()).map(share).collect(),
            knots: at_s.len(),
        }
    }

    fn terms(&self, cell: usize) -> [(usize, f64); 2] {
        let (left, share) = self.shares.get(cell).copied().unwrap_or((0, 0.0));
        [(left, 1.0 - share), (left + 1, share)]
    }

    /// Returns the profile with one knot changed, within the limits of the acceleration.
    pub(super) fn perturb(
        &self,
        cells_mps2: &[f64],
        knot: usize,
        by_mps2: f64,
        most_mps2: f64,
    ) -> Vec<f64> {
        let held = |(cell, held): (usize, &f64)| {
            let weight: f64 = self
                .terms(cell)
                .iter()
                .filter(|(index, _)| *index == knot)
                .map(|(_, weight)| weight)
                .sum();
            if weight == 0.0 {
                *held
            } else {
                (held + weight * by_mps2).clamp(-most_mps2, 0.0)
            }
        };
        cells_mps2.iter().enumerate().map(held).collect()
    }

    /// Returns the weighted mean of the profile around each knot, in m/s².
    pub(super) fn means_mps2(&self, cells_mps2: &[f64]) -> impl Iterator<Item = f64> {
        let mut sums = vec![(0.0, 0.0); self.knots];
        for (cell, held) in cells_mps2.iter().enumerate() {
            for (knot, weight) in self.terms(cell) {
                if let Some((sum, weights)) = sums.get_mut(knot) {
                    (*sum, *weights) = (*sum + weight * held, *weights + weight);
                }
            }
        }
        sums.into_iter()
            .map(|(sum, weights)| if weights > 0.0 { sum / weights } else { 0.0 })
    }
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
    /// Returns the profile after the step, and its predicted margin in metres; `None` if the solver fails.
    pub(super) fn solve(
        &self,
        bench: &mut ProfileSimulator<'_>,
        goal: StepGoal,
    ) -> Option<(Vec<f64>, f64)> {
        bench.programs += 1;
        let knots = self.hats.knots;
        let (peak, short) = (knots, knots + 1);
        let mut program = QuadraticProgram::new(knots + 2);
        self.add_envelope_rows(bench, &mut program);
        program.add_inequality(&[(short, -1.0)], 0.0);
        program.add_inequality(&[(peak, -1.0)], 0.0);
        let predicted_m = match goal {
            StepGoal::Margin => {
                for (knot, &slope) in self.gradient.iter().enumerate() {
                    program.add_linear_cost(knot, slope);
                    program.add_squared_cost(&[(knot, 1.0)], REGULARIZATION_WEIGHT);
                }
                None
            }
            StepGoal::Cost {
                objective: aim,
                margin_m,
            } => {
                let mut falls: Vec<_> = self.gradient.iter().copied().enumerate().collect();
                falls.push((short, -1.0));
                program.add_inequality(&falls, margin_m - self.margin_m);
                program.add_linear_cost(short, SHORTFALL_COST);
                self.add_cost(bench, &mut program, aim, peak);
                Some(margin_m)
            }
        };
        let QuadraticSolution::Optimal { point: at, .. } = program.solve() else {
            return None;
        };
        if at.iter().any(|value| !value.is_finite()) {
            return None;
        }
        let linear_m: f64 = self
            .gradient
            .iter()
            .zip(&at)
            .map(|(slope, change)| slope * change)
            .sum();
        Some((
            self.apply_clamped(bench, &at),
            predicted_m.unwrap_or(self.margin_m + linear_m),
        ))
    }

    fn add_envelope_rows(&self, bench: &ProfileSimulator<'_>, program: &mut QuadraticProgram) {
        let (region, most) = (self.trust_region_mps2, bench.envelope.max_brake_mps2);
        let jump = bench.envelope.jerk_mps3 * bench.cell_s();
        for knot in 0..self.hats.knots {
            program.add_inequality(&[(knot, 1.0)], region);
            program.add_inequality(&[(knot, -1.0)], region);
        }
        let negative =
            |terms: &[(usize, f64)]| terms.iter().map(|&(i, c)| (i, -c)).collect::<Vec<_>>();
        let mut before: Option<(f64, [(usize, f64); 2])> = None;
        for (cell, &held) in self.profile_mps2.iter().enumerate() {
            let terms = self.hats.terms(cell);
            if held + region > 0.0 {
                program.add_inequality(&terms, -held);
            }
            if held - region < -most {
                program.add_inequality(&negative(&terms), most + held);
            }
            let (last, last_terms) = before.unwrap_or((0.0, [(0, 0.0); 2]));
            let mut change: Vec<(usize, f64)> = Vec::from(terms);
            for (knot, weight) in last_terms {
                match change.iter_mut().find(|(other, _)| *other == knot) {
                    Some((_, sum)) => *sum -= weight,
                    None => change.push((knot, -weight)),
                }
            }
            let reach = region * change.iter().map(|(_, weight)| weight.abs()).sum::<f64>();
            if held - last + reach > jump {
                program.add_inequality(&change, jump - (held - last));
            }
            if held - last - reach < -jump {
                program.add_inequality(&negative(&change), jump + (held - last));
            }
            before = Some((held, terms));
        }
    }

    fn add_cost(
        &self,
        bench: &ProfileSimulator<'_>,
        program: &mut QuadraticProgram,
        aim: AttackObjective,
        peak: usize,
    ) {
        // Selects a mild one among profiles with the least peak.
        let weight = if aim == AttackObjective::LeastPeak {
            1e-4
        } else {
            1.0
        } * bench.cell_s();
        for (cell, &held) in self.profile_mps2.iter().enumerate() {
            let terms = self.hats.terms(cell);
            program.add_squared_cost(&terms, weight);
            for (knot, share) in terms {
                program.add_linear_cost(knot, 2.0 * weight * held * share);
            }
            if aim == AttackObjective::LeastPeak {
                let [(left, a), (right, b)] = terms;
                program.add_inequality(&[(left, -a), (right, -b), (peak, -1.0)], held);
            }
        }
        if aim == AttackObjective::LeastPeak {
            program.add_linear_cost(peak, 1.0);
        }
    }

    /// Returns the changed profile, clamped to the envelope because of the solver's tolerance.
    fn apply_clamped(&self, bench: &ProfileSimulator<'_>, change: &[f64]) -> Vec<f64> {
        let jump = bench.envelope.jerk_mps3 * bench.cell_s();
        let mut before = 0.0_f64;
        let held = |(cell, held): (usize, &f64)| {
            let by: f64 = self
                .hats
                .terms(cell)
                .iter()
                .filter_map(|&(knot, w)| Some(w * change.get(knot)?))
                .sum();
            let wanted = (held + by).clamp(-bench.envelope.max_brake_mps2, 0.0);
            // Removes the solver's residue of a zero.
            let wanted = if wanted > -1e-6 { 0.0 } else { wanted };
            before = wanted.clamp(before - jump, before + jump);
            before
        };
        self.profile_mps2.iter().enumerate().map(held).collect()
    }
}
