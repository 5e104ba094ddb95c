//! Signals of a simulated run.

use std::borrow::Cow;

use super::{SampledSignals, SignalsError};
use crate::approach::PairState;
use crate::{drac_mps2, time_gap_s, time_headway_s, ttc_s};
use crumple_sim::engine::{Trace, Track};

const OWN_SIGNALS: [&str; 4] = ["position_m", "speed_mps", "accel_mps2", "jerk_mps3"];
/// Signals of every vehicle but the first, towards its leader.
const LEAD_SIGNALS: [&str; 6] = [
    "gap_m",
    "closing_mps",
    "ttc_s",
    "headway_s",
    "time_gap_s",
    "drac_mps2",
];

/// Returns the names of all signals of a run of `vehicles` vehicles: `v0.speed_mps`, `v1.gap_m` and so on.
///
/// | signal of vehicle i | meaning |
/// |---|---|
/// | `vi.position_m`, `vi.speed_mps`, `vi.accel_mps2` | front bumper, speed, acceleration held from the sample on |
/// | `vi.jerk_mps3` | change of that acceleration since the previous sample, divided by the step |
/// | `vi.gap_m`, `vi.closing_mps` | bumper gap to the leader, own speed minus leader speed |
/// | `vi.ttc_s` | time to collision; +∞ where the gap does not close |
/// | `vi.headway_s`, `vi.time_gap_s` | time headway, time gap; +∞ at standstill |
/// | `vi.drac_mps2` | deceleration rate to avoid a crash; 0 where the gap does not close, +∞ in collision |
///
/// Without a leader in the lane, gap and times are +∞, closing speed and deceleration 0.
#[must_use]
pub fn motion_signal_names(vehicles: usize) -> Vec<String> {
    (0..vehicles).flat_map(vehicle_signal_names).collect()
}

fn vehicle_signal_names(vehicle: usize) -> impl Iterator<Item = String> {
    let ahead = if vehicle > 0 { &LEAD_SIGNALS[..] } else { &[] };
    OWN_SIGNALS
        .iter()
        .chain(ahead)
        .map(move |name| format!("v{vehicle}.{name}"))
}

/// Collects the signals in `names` that a run has, including samples after a collision, one every `step_s`.
///
/// # Errors
/// [`SignalsError`] if the trace is empty.
pub fn motion_signals<'a>(
    trace: &'a Trace,
    step_s: f64,
    names: &[&str],
) -> Result<SampledSignals<'a>, SignalsError> {
    let mut signals = SampledSignals::new(step_s, trace.len())?;
    for &name in names {
        if let Some(samples) = motion_signal(trace, step_s, name) {
            signals.insert(name.to_owned(), samples)?;
        }
    }
    Ok(signals)
}

/// Returns the index of the vehicle and the quantity in the name of a signal.
pub(super) fn split_signal_name(name: &str) -> Option<(usize, &str)> {
    let (vehicle, quantity) = name.strip_prefix('v')?.split_once('.')?;
    Some((vehicle.parse().ok()?, quantity))
}

/// Returns the samples of a signal; `None` if the run has no such signal.
fn motion_signal<'a>(trace: &'a Trace, step_s: f64, name: &str) -> Option<Cow<'a, [f64]>> {
    let (vehicle, quantity) = split_signal_name(name)?;
    let track = trace.vehicles.get(vehicle)?;
    Some(match quantity {
        "position_m" => Cow::Borrowed(&*track.position_m),
        "speed_mps" => Cow::Borrowed(&*track.speed_mps),
        "accel_mps2" => Cow::Borrowed(&*track.acceleration_mps2),
        "jerk_mps3" => {
            let changes = track.acceleration_mps2.windows(2).map(|pair| match pair {
                [before, now] => (now - before) / step_s,
                _ => 0.0,
            });
            Cow::Owned(std::iter::once(0.0).chain(changes).collect())
        }
        _ if vehicle == 0 => return None,
        _ => Cow::Owned(lead_signal(trace, vehicle, track, lead_quantity(quantity)?)),
    })
}

/// Returns a quantity of a vehicle and its leader at each sample.
fn lead_signal(trace: &Trace, vehicle: usize, track: &Track, quantity: LeadQuantity) -> Vec<f64> {
    trace
        .leaders(vehicle)
        .enumerate()
        .map(|(sample, front)| {
            let state = front
                .and_then(|front| PairState::from_sample(&trace.time_s, [front, track], sample));
            let Some((front, state)) = front.zip(state) else {
                return quantity(f64::INFINITY, 0.0, 0.0, 0.0);
            };
            // Vehicles that stay together after an impact have a gap of zero; remove its rounding error.
            let gap_m = if state.gap_m.abs() < 1e-9 {
                0.0
            } else {
                state.gap_m
            };
            quantity(
                gap_m,
                state.front_speed_mps,
                state.rear_speed_mps,
                front.length_m,
            )
        })
        .collect()
}

/// Computes a quantity from gap, leader speed, own speed and leader length.
type LeadQuantity = fn(f64, f64, f64, f64) -> f64;

fn lead_quantity(quantity: &str) -> Option<LeadQuantity> {
    Some(match quantity {
        "gap_m" => |gap_m, _, _, _| gap_m,
        "closing_mps" => |_, front, rear, _| rear - front,
        "ttc_s" => |gap_m, front, rear, _| ttc_s(gap_m, rear - front).unwrap_or(f64::INFINITY),
        "headway_s" => |gap_m, _, rear, length_m| {
            time_headway_s(gap_m, length_m, rear).unwrap_or(f64::INFINITY)
        },
        "time_gap_s" => |gap_m, _, rear, _| time_gap_s(gap_m, rear).unwrap_or(f64::INFINITY),
        "drac_mps2" => |gap_m, front, rear, _| {
            if rear <= front {
                0.0
            } else {
                drac_mps2(gap_m, rear - front).unwrap_or(f64::INFINITY)
            }
        },
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::LeadMeasures;
    use crate::stl::Formula;
    use crumple_sim::control::BuiltInController;
    use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
    use crumple_sim::scenario::built_in_scenario;

    #[test]
    fn formulas_over_a_run_agree_with_its_measures() {
        let scenario = built_in_scenario("paper-1").unwrap();
        let run = Run::new(
            &scenario,
            RunOptions::new(BuiltInController::from_name("match-leader").unwrap()),
        )
        .unwrap();
        let result = simulate(&run, RecordingLevel::Trace);
        let trace = result.trace.unwrap();
        let names = motion_signal_names(3);
        assert_eq!(names.len(), 3 * 4 + 2 * 6);
        let names: Vec<&str> = names.iter().map(String::as_str).collect();
        let signals = motion_signals(&trace, 0.01, &names).unwrap();
        assert_eq!(signals.names().collect::<Vec<_>>(), names);
        let least = |text: &str| {
            text.parse::<Formula>()
                .unwrap()
                .robustness(&signals)
                .unwrap()
        };
        let ahead = LeadMeasures::from_trace(&trace, &result.impacts, 1).unwrap();
        assert!((least("always v1.gap_m > 0") - ahead.min_gap_m.unwrap()).abs() < 1e-3);
        assert_eq!(least("always v1.ttc_s > 1"), ahead.min_ttc_s.unwrap() - 1.0);
        assert_eq!(
            least("always v1.headway_s > 0"),
            ahead.min_time_headway_s.unwrap()
        );
        assert_eq!(
            least("always v1.time_gap_s > 0"),
            ahead.min_time_gap_s.unwrap()
        );
        assert!(
            (least("always v1.drac_mps2 < 5") - (5.0 - ahead.max_drac_mps2.unwrap())).abs() < 1e-12
        );
        assert!((least("always v0.accel_mps2 >= -3") - 0.0).abs() < 1e-9);
        assert!((least("always v0.jerk_mps3 > -300") - 0.0).abs() < 1e-6);
        let [front, rear] = [1, 2].map(|vehicle| &trace.vehicles[vehicle].speed_mps);
        let closing_mps = rear
            .iter()
            .zip(front)
            .map(|(rear, front)| rear - front)
            .fold(f64::NEG_INFINITY, f64::max);
        assert_eq!(least("always v2.closing_mps < 100"), 100.0 - closing_mps);
    }
}
