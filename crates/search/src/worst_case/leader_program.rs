//! The convex program of a braking leader.
//!
//! Variables are the peak and, for each cell, the change of speed w and the displacement d from coasting, as in
//! [`super::program`]: -b H <= w⁺ - w <= 0, w >= -v₀, and accelerations of successive cells differ by at most the jerk
//! times H. Each constraint at a step is a bound on d + θ w.

use super::attack::AttackObjective;
use super::profile_simulator::ProfileSimulator;
use crumple_quadratic::{QuadraticProgram, QuadraticSolution};

const PEAK_VARIABLE: usize = 0;

/// A bound on d + θ w of the leader at a step.
#[derive(Debug, Clone, Copy)]
pub(super) struct LeaderConstraint {
    pub(super) step: usize,
    pub(super) theta_s: f64,
    pub(super) bound_m: f64,
    pub(super) is_upper_bound: bool,
}

/// Returns cost and accelerations per cell of the cheapest profile that satisfies the constraints, if there is one.
pub(super) fn cheapest_profile(
    bench: &mut ProfileSimulator<'_>,
    aim: AttackObjective,
    asked: &[LeaderConstraint],
) -> Option<(f64, Vec<f64>)> {
    bench.programs += 1;
    let (all, cell_s, cell) = (bench.cell_count(), bench.cell_s(), bench.cell);
    // After the last constraint the braking only eases off, within the jerk.
    let last = asked.iter().map(|ask| ask.step.div_ceil(cell)).max()?;
    let easing = bench.envelope.max_brake_mps2 / (bench.envelope.jerk_mps3 * cell_s);
    let cells = all.min(last.max(1) + easing.ceil() as usize);
    let step_s = bench.scenario.spec().step_s;
    let speed_mps = bench.scenario.vehicles().first().map_or(0.0, |leader| leader.speed_mps);
    let envelope = bench.envelope;
    let mut program = QuadraticProgram::new(1 + 2 * cells);
    // Index of the change of speed after cell j, counted from 1; its displacement is the next variable.
    let w = |j: usize| 2 * j - 1;
    let change = |j: usize| if j > 1 { vec![(w(j), 1.0), (w(j - 1), -1.0)] } else { vec![(w(j), 1.0)] };
    let negative = |terms: &[(usize, f64)]| terms.iter().map(|&(i, c)| (i, -c)).collect::<Vec<_>>();
    for j in 1..=cells {
        let mut travel = vec![(w(j) + 1, 1.0), (w(j), -0.5 * cell_s)];
        if j > 1 {
            travel.extend([(w(j - 1) + 1, -1.0), (w(j - 1), -0.5 * cell_s)]);
        }
        program.add_equality(&travel, 0.0);
        program.add_inequality(&change(j), 0.0);
        let mut brake = negative(&change(j));
        program.add_inequality(&brake, envelope.max_brake_mps2 * cell_s);
        program.add_inequality(&[(w(j), -1.0)], speed_mps);
        let mut jump = change(j);
        if j > 1 {
            jump.extend(negative(&change(j - 1)));
        }
        let most = envelope.jerk_mps3 * cell_s * cell_s;
        program.add_inequality(&jump, most);
        program.add_inequality(&negative(&jump), most);
        if aim == AttackObjective::LeastPeak {
            brake.push((PEAK_VARIABLE, -cell_s));
            program.add_inequality(&brake, 0.0);
            // Selects a mild one among profiles with the least peak.
            program.add_squared_cost(&change(j), 1e-3 / cell_s);
        } else {
            program.add_squared_cost(&change(j), 1.0 / cell_s);
        }
    }
    if aim == AttackObjective::LeastPeak {
        program.add_linear_cost(PEAK_VARIABLE, 1.0);
    }
    for ask in asked.iter().filter(|ask| ask.step > 0) {
        let j = ask.step.div_ceil(cell);
        let into_s = (ask.step - (j - 1) * cell) as f64 * step_s;
        let share = into_s / cell_s;
        let of_after = ask.theta_s * share + 0.5 * into_s * share;
        let mut terms = vec![(w(j), of_after)];
        if j > 1 {
            terms.extend([(w(j - 1) + 1, 1.0), (w(j - 1), ask.theta_s + into_s - of_after)]);
        }
        if ask.is_upper_bound {
            program.add_inequality(&terms, ask.bound_m)
        } else {
            program.add_inequality(&negative(&terms), -ask.bound_m)
        }
    }
    if asked.iter().any(|ask| ask.step == 0 && if ask.is_upper_bound { ask.bound_m < 0.0 } else { ask.bound_m > 0.0 }) {
        return None;
    }
    if cells < all {
        let last = change(cells);
        program.add_inequality(&negative(&last), envelope.jerk_mps3 * cell_s * cell_s);
    }
    let QuadraticSolution::Optimal { point: at, .. } = program.solve() else { return None };
    let mut before = 0.0;
    let mut profile: Vec<f64> = (1..=cells)
        .map(|j| {
            let after = at.get(w(j)).copied().unwrap_or(before).max(-speed_mps);
            let held = ((after - before) / cell_s).clamp(-envelope.max_brake_mps2, 0.0);
            before += held * cell_s;
            // Removes the solver's residue of a zero.
            if held > -1e-6 { 0.0 } else { held }
        })
        .collect();
    profile.resize(all, 0.0);
    Some((aim.cost(&profile, cell_s), profile))
}
