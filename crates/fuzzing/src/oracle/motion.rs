//! Oracle: vehicles move forwards and continuously, and braking adds no energy.

use super::{OracleContext, OracleOutcome, OracleResult, ROUNDING_M, ensure};
use crate::Invariant;
use crumple_sim::engine::SimulationResult;

/// Checks that no vehicle reverses, that positions follow from speeds, and that braking never adds energy.
///
/// # Errors
/// [`Invariant::ForwardMotion`], [`Invariant::Continuity`] or [`Invariant::Energy`].
pub fn motion_is_physical(question: &OracleContext<'_>) -> OracleResult {
    let trace = question.trace()?;
    for (vehicle, track) in trace.vehicles.iter().enumerate() {
        let next = |values: &[f64]| values.iter().skip(1).copied().collect::<Vec<_>>();
        let (next_s, next_m, next_mps) = (
            next(&trace.time_s),
            next(&track.position_m),
            next(&track.speed_mps),
        );
        let now = trace
            .time_s
            .iter()
            .zip(&track.position_m)
            .zip(&track.speed_mps)
            .zip(&track.acceleration_mps2);
        let then = next_s.iter().zip(&next_m).zip(&next_mps);
        for (((((&t, &x), &v), &a), ((&t_next, &x_next), &v_next)), k) in now.zip(then).zip(0..) {
            let at = |what: &str| {
                format!(
                    "vehicle {vehicle} {what} at sample {k}, {t} s: {x} to {x_next} m, {v} to {v_next} m/s"
                )
            };
            ensure(v >= 0.0 && v_next >= 0.0, Invariant::ForwardMotion, || {
                at("reverses")
            })?;
            ensure(x_next >= x, Invariant::ForwardMotion, || at("moves back"))?;
            if is_hit_between(&question.result, vehicle, t, t_next) {
                continue;
            }
            let [slower, faster] = [v.min(v_next), v.max(v_next)].map(|mps| mps * (t_next - t));
            let stopped = v_next == 0.0;
            ensure(
                x_next - x <= faster + ROUNDING_M,
                Invariant::Continuity,
                || at("leaps"),
            )?;
            ensure(
                stopped || x_next - x >= slower - ROUNDING_M,
                Invariant::Continuity,
                || at("lags behind its speed"),
            )?;
            ensure(a > 0.0 || v_next <= v, Invariant::Energy, || {
                at("gains energy from its brakes")
            })?;
            let gained_mps = a * (t_next - t);
            ensure(
                stopped || (v_next - v - gained_mps).abs() <= 1e-9,
                Invariant::Continuity,
                || at("jumps in speed"),
            )?;
        }
    }
    Ok(OracleOutcome::Holds)
}

fn is_hit_between(result: &SimulationResult, vehicle: usize, from_s: f64, to_s: f64) -> bool {
    result.impacts.iter().any(|impact| {
        impact.involves(vehicle) && (from_s - 1e-9..=to_s + 1e-9).contains(&impact.contact.time_s)
    })
}
