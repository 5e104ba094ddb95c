//! Height that the states of a simplex miss after one decision.

use super::{BoundarySearch, Point, Shortfall, advance, hull};
use crumple_verify::invariant::MotionModel;
use crumple_verify::invariant::table::{AXIS_COUNT, HeightTable};

impl BoundarySearch<'_> {
    /// Returns the simplex and the motion for which states at least `above_m` above the boundary miss most height.
    pub(super) fn worst(
        &self,
        table: &HeightTable,
        points: &[Point],
        command: [f64; 2],
        above_m: f64,
    ) -> Shortfall {
        let states: Vec<[f64; AXIS_COUNT]> = points.iter().map(|(state, _)| *state).collect();
        let (claim, axes) = (self.claim, table.axes());
        let time_s = claim.step_s * f64::from(claim.decision_steps);
        let is_relative = claim.motion == MotionModel::Relative;
        // Ranges of the change of each state, and the smallest growth of the gap.
        let motion = |&[own, leader]: &[f64; AXIS_COUNT]| {
            let ([low, high], [brakes, accelerates]) = (command, claim.leader_mps2);
            if is_relative {
                let of_closing = [low - accelerates, high - brakes];
                let growth_m = -own * time_s - 0.5 * of_closing[1] * time_s * time_s;
                return (
                    growth_m,
                    [of_closing.map(|change| change * time_s), [0.0; 2]],
                );
            }
            let [slow, fast] = command.map(|held| advance(own, held, time_s));
            let leads = [brakes, accelerates].map(|held| advance(leader, held, time_s));
            let growth_m = leads[0][0] - fast[0];
            (
                growth_m,
                [
                    [slow[1] - own, fast[1] - own],
                    leads.map(|end| end[1] - leader),
                ],
            )
        };
        let motions: Vec<_> = states.iter().map(motion).collect();
        let touched: [[usize; 2]; AXIS_COUNT] = std::array::from_fn(|axis| {
            let reached = states.iter().zip(&motions).map(|(state, (_, changes))| {
                let [low, high] = changes[axis];
                [state[axis] + low.min(0.0), state[axis] + high.max(0.0)]
            });
            let [low, high] = reached.fold([f64::INFINITY, f64::NEG_INFINITY], hull);
            let Some(last) = axes[axis].cells.checked_sub(1) else {
                return [0, 0];
            };
            let place = |value: f64| {
                (value - axes[axis].low) / (axes[axis].high - axes[axis].low)
                    * f64::from(axes[axis].cells)
            };
            // A cell that shares only its boundary with the motion adds nothing.
            let first = ((place(low) + 1e-9).max(0.0) as usize).min(last as usize);
            [
                first,
                ((place(high) - 1e-9).max(0.0) as usize).clamp(first, last as usize),
            ]
        });
        let extent: [[f64; 2]; AXIS_COUNT] = std::array::from_fn(|axis| {
            states
                .iter()
                .map(|state| [state[axis]; 2])
                .fold([f64::INFINITY, f64::NEG_INFINITY], hull)
        });
        let mut worst = Shortfall {
            missing_m: f64::NEG_INFINITY,
            cell: [0; 2],
            order: 0,
            change: [0.0; 2],
        };
        for i in touched[0][0]..=touched[0][1] {
            for j in touched[1][0]..=touched[1][1] {
                let cell = [i, j];
                for (order, of_order) in table.orders().iter().enumerate() {
                    let nodes = table.simplex(cell, of_order);
                    let mut slopes = [0.0; AXIS_COUNT];
                    for (place, &axis) in of_order.iter().enumerate() {
                        let width = axes[axis].node(cell[axis] + 1) - axes[axis].node(cell[axis]);
                        let rise =
                            table.node_height(nodes[place + 1]) - table.node_height(nodes[place]);
                        slopes[axis] = rise / width;
                    }
                    for (state, (growth_m, changes)) in states.iter().zip(&motions) {
                        let change: [f64; AXIS_COUNT] = std::array::from_fn(|axis| {
                            let [low, high] = changes[axis];
                            let to_edge =
                                [axes[axis].low - state[axis], axes[axis].high - state[axis]];
                            let [low, high] = [
                                low.clamp(to_edge[0], to_edge[1]),
                                high.clamp(to_edge[0], to_edge[1]),
                            ];
                            // A motion away from a cell does not reach it.
                            let low = if axes[axis].node(cell[axis]) >= extent[axis][1] {
                                low.max(0.0)
                            } else {
                                low
                            };
                            let is_below = axes[axis].node(cell[axis] + 1) <= extent[axis][0];
                            let high = if is_below && axes[axis].cells > 0 {
                                high.min(0.0)
                            } else {
                                high
                            };
                            match slopes[axis] {
                                0.0 => 0.0_f64.max(low).min(high),
                                slope if slope > 0.0 => high,
                                _ => low,
                            }
                        });
                        let rise: f64 = slopes
                            .iter()
                            .zip(change)
                            .map(|(slope, change)| slope * change)
                            .sum();
                        let still = rise == 0.0 && *growth_m >= 0.0;
                        let missing_m =
                            rise - growth_m - if still { above_m.max(0.0) } else { above_m };
                        if missing_m > worst.missing_m {
                            worst = Shortfall {
                                missing_m,
                                cell,
                                order,
                                change,
                            };
                        }
                    }
                }
            }
        }
        worst
    }
}
