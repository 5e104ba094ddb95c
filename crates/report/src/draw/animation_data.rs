//! The numbers of an animation: a run sampled at even steps, rounded for embedding.

use serde::Serialize;

use super::scale::extent;
use crumple_world::sim::{Impact, Trace, Track};

/// Time step of the samples, in seconds; the last one may be shorter.
pub(super) const STEP_S: f64 = 0.05;

/// Maximum number of samples; longer runs are truncated.
const MAX_SAMPLES: usize = 6_000;

/// Minimum and maximum length of the visible lane, in metres.
const WINDOW_RANGE_M: (f64, f64) = (40.0, 220.0);

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct AnimationData {
    step_s: f64,
    start_s: f64,
    pub(super) end_s: f64,
    /// Indices of the vehicles between whose outer bumpers the picture is centred.
    centred: (usize, usize),
    pub(super) vehicles: Vec<VehicleData>,
    pub(super) impacts: Vec<ImpactData>,
}

#[derive(Debug, Clone, PartialEq, Serialize)]
pub(super) struct VehicleData {
    pub(super) length_m: f64,
    position_m: Vec<f64>,
    speed_mps: Vec<f64>,
    acceleration_mps2: Vec<f64>,
    /// Times at which the vehicle enters and leaves the lane, in seconds; `None` if it is always there.
    #[serde(skip_serializing_if = "Option::is_none")]
    in_lane_s: Option<[f64; 2]>,
}

#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub(super) struct ImpactData {
    pub(super) time_s: f64,
    pub(super) front: usize,
    pub(super) rear: usize,
    pub(super) impact_speed_mps: f64,
}

impl AnimationData {
    pub(super) fn new(trace: &Trace, impacts: &[Impact]) -> Self {
        let (start_s, last_s) = match (trace.time_s.first(), trace.time_s.last()) {
            (Some(&first), Some(&last)) if first.is_finite() && last >= first => (first, last),
            _ => (0.0, 0.0),
        };
        let steps = ((last_s - start_s) / STEP_S - 1e-9).ceil().clamp(0.0, MAX_SAMPLES as f64) as usize;
        let end_s = last_s.min(start_s + steps as f64 * STEP_S);
        let times: Vec<f64> = (0..=steps).map(|step| (start_s + step as f64 * STEP_S).min(end_s)).collect();
        let vehicles: Vec<VehicleData> =
            trace.vehicles.iter().map(|track| VehicleData::new(&trace.time_s, track, &times)).collect();
        let drawn = impacts.iter().map(|impact| &impact.contact);
        let drawn =
            drawn.filter(|contact| contact.time_s.is_finite() && (1..vehicles.len()).contains(&contact.rear_vehicle));
        let impacts = drawn.map(|contact| ImpactData {
            time_s: round_to_digits(contact.time_s, 4),
            front: contact.front_vehicle,
            rear: contact.rear_vehicle,
            // Rounded as in the report, so that both agree.
            impact_speed_mps: round_to_digits(contact.impact_speed_mps, 1),
        });
        let impacts = impacts.collect();
        let mut data = Self {
            step_s: STEP_S,
            start_s: round_to_digits(start_s, 4),
            end_s: round_to_digits(end_s, 4),
            centred: (0, vehicles.len().saturating_sub(1)),
            vehicles,
            impacts,
        };
        // A line that is too long for the picture is centred on its first collision.
        if let (true, Some(first)) = (data.max_span_m() > WINDOW_RANGE_M.1, data.impacts.first()) {
            data.centred = (first.front, first.rear);
        }
        data
    }

    pub(super) fn sample_count(&self) -> usize {
        self.vehicles.first().map_or(0, |vehicle| vehicle.position_m.len())
    }

    /// Returns the visible length, in metres: all vehicles at all times, within the limits.
    pub(super) fn window_m(&self) -> f64 {
        (1.08 * self.max_span_m() + 2.0).clamp(WINDOW_RANGE_M.0, WINDOW_RANGE_M.1)
    }

    /// Returns the longest distance from the front of the first to the rear of the last vehicle.
    fn max_span_m(&self) -> f64 {
        let (Some(first), Some(last)) = (self.vehicles.first(), self.vehicles.last()) else { return 0.0 };
        let spans = first.position_m.iter().zip(&last.position_m).map(|(front, rear)| front - rear + last.length_m);
        extent(spans).1
    }

    pub(super) fn camera_m(&self, sample: usize) -> f64 {
        let front = self.vehicles.get(self.centred.0).and_then(|vehicle| vehicle.position_m(sample));
        let rear = self.vehicles.get(self.centred.1).and_then(|v| Some(v.position_m(sample)? - v.length_m));
        (front.unwrap_or(0.0) + rear.unwrap_or(0.0)) / 2.0
    }

    pub(super) fn has_lane_changes(&self) -> bool {
        self.vehicles.iter().any(|vehicle| vehicle.in_lane_s.is_some())
    }

    pub(super) fn is_in_lane(&self, vehicle: usize, sample: usize) -> bool {
        let time_s = (self.start_s + sample as f64 * self.step_s).min(self.end_s);
        let in_lane_s = self.vehicles.get(vehicle).and_then(|vehicle| vehicle.in_lane_s);
        in_lane_s.is_none_or(|[from_s, to_s]| from_s <= time_s && time_s < to_s)
    }

    /// Returns the gap of a vehicle; `None` without a leader in the lane.
    pub(super) fn gap_m(&self, rear: usize, sample: usize) -> Option<f64> {
        let is_there = |vehicle: &usize| self.is_in_lane(*vehicle, sample);
        let ahead = (0..rear).rev().find(is_there).filter(|_| is_there(&rear))?;
        let front = self.vehicles.get(ahead)?;
        Some(front.position_m(sample)? - front.length_m - self.vehicles.get(rear)?.position_m(sample)?)
    }

    pub(super) fn impact_position_m(&self, impact: &ImpactData, sample: usize) -> f64 {
        self.vehicles.get(impact.rear).and_then(|vehicle| vehicle.position_m(sample)).unwrap_or(0.0)
    }

    /// Returns the text of the last impact until `time_s`; the script produces the same text.
    pub(super) fn event_text(&self, time_s: f64) -> String {
        let so_far: Vec<_> = self.impacts.iter().filter(|impact| impact.time_s <= time_s).collect();
        match so_far.last() {
            None => "no contact".to_owned(),
            Some(ImpactData { time_s, front, rear, impact_speed_mps }) => {
                format!("✗ {rear} hits {front} at {time_s:.2} s, {impact_speed_mps:.1} m/s")
            }
        }
    }

    pub(super) fn to_json(&self) -> String {
        // Finite numbers and fixed names always serialize.
        serde_json::to_string(self).unwrap_or_default()
    }
}

impl VehicleData {
    fn new(time_s: &[f64], track: &Track, at_s: &[f64]) -> Self {
        let sampled = |values: &[f64], digits| -> Vec<f64> {
            at_s.iter().map(|&at| round_to_digits(interpolate(time_s, values, at), digits)).collect()
        };
        // Clamp to just outside the run, because JSON has no infinity.
        let [first_s, last_s] = [at_s.first(), at_s.last()].map(|at_s| at_s.copied().unwrap_or(0.0));
        let within = |time_s: f64| round_to_digits(time_s.clamp(first_s - 1.0, last_s + 1.0), 4);
        Self {
            in_lane_s: (track.in_lane_s != Track::THROUGHOUT_S).then(|| track.in_lane_s.map(within)),
            length_m: round_to_digits(track.length_m, 2),
            position_m: sampled(&track.position_m, 2),
            speed_mps: sampled(&track.speed_mps, 2),
            acceleration_mps2: at_s
                .iter()
                .map(|&at| round_to_digits(hold_previous(time_s, &track.acceleration_mps2, at), 1))
                .collect(),
        }
    }

    pub(super) fn position_m(&self, sample: usize) -> Option<f64> {
        self.position_m.get(sample).copied()
    }

    pub(super) fn speed_mps(&self, sample: usize) -> Option<f64> {
        self.speed_mps.get(sample).copied()
    }

    pub(super) fn acceleration_mps2(&self, sample: usize) -> Option<f64> {
        self.acceleration_mps2.get(sample).copied()
    }
}

fn interpolate(time_s: &[f64], values: &[f64], at_s: f64) -> f64 {
    let after = time_s.partition_point(|time| *time < at_s);
    let last = values.last().copied().unwrap_or(0.0);
    let (t1, v1) = (time_s.get(after).copied().unwrap_or(at_s), values.get(after).copied().unwrap_or(last));
    let before = after.checked_sub(1).and_then(|before| Some((*time_s.get(before)?, *values.get(before)?)));
    match before {
        Some((t0, v0)) if t1 > t0 => v0 + (v1 - v0) * ((at_s - t0) / (t1 - t0)).clamp(0.0, 1.0),
        _ => v1,
    }
}

/// Returns the value of the last sample until `at_s`.
fn hold_previous(time_s: &[f64], values: &[f64], at_s: f64) -> f64 {
    let next = time_s.partition_point(|time| *time <= at_s + 1e-9);
    let index = next.saturating_sub(1).min(values.len().saturating_sub(1));
    values.get(index).copied().unwrap_or(0.0)
}

/// Rounds to a number of digits; 0 for non-finite values, which JSON cannot hold.
fn round_to_digits(value: f64, digits: i32) -> f64 {
    let scale = 10f64.powi(digits);
    let rounded = (value * scale).round() / scale;
    if rounded.is_finite() { rounded + 0.0 } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::control::ControllerSpec;
    use crumple_world::scenario::built_in_scenario;
    use crumple_world::sim::{AfterContact, RecordingLevel, Run, RunOptions, simulate};
    use proptest::num::f64::ANY as ANY_NUMBER;
    use proptest::prelude::*;

    fn simulate_built_in(name: &str, after_contact: AfterContact) -> (Trace, Vec<Impact>) {
        let scenario = built_in_scenario(name).unwrap();
        let options = RunOptions::new(ControllerSpec::from_name("baseline").unwrap()).with_after_contact(after_contact);
        let simulated = simulate(&Run::new(&scenario, options).unwrap(), RecordingLevel::Trace);
        (simulated.trace.unwrap(), simulated.impacts)
    }

    #[test]
    fn samples_are_the_trace_at_even_steps_and_end_with_it() {
        for after_contact in [AfterContact::Stop, AfterContact::Continue] {
            let (trace, impacts) = simulate_built_in("paper-2", after_contact);
            let data = AnimationData::new(&trace, &impacts);
            let json: serde_json::Value = serde_json::from_str(&data.to_json()).unwrap();
            let mut compared = 0;
            for (index, track) in trace.vehicles.iter().enumerate() {
                let read = |name: &str| json["vehicles"][index][name].as_array().unwrap().clone();
                let (positions, speeds) = (read("position_m"), read("speed_mps"));
                assert_eq!(positions.len(), data.sample_count());
                for (sample, (x, v)) in positions.iter().zip(&speeds).enumerate() {
                    let time_s = (sample as f64 * STEP_S).min(*trace.time_s.last().unwrap());
                    // The simulator's steps divide those of the animation, so most samples are samples of the trace.
                    let Some(at) = trace.time_s.iter().position(|t| (t - time_s).abs() < 1e-9) else { continue };
                    assert!((x.as_f64().unwrap() - track.position_m[at]).abs() <= 0.005 + 1e-9, "{time_s} s");
                    assert!((v.as_f64().unwrap() - track.speed_mps[at]).abs() <= 0.005 + 1e-9, "{time_s} s");
                    compared += 1;
                }
                let last = positions.last().unwrap().as_f64().unwrap();
                assert!((last - track.position_m.last().unwrap()).abs() <= 0.005 + 1e-9);
            }
            assert!(compared > 3 * (data.sample_count() - 2), "{compared} of {}", 3 * data.sample_count());
            assert!(data.event_text(data.end_s).contains(" hits ") && data.event_text(0.0) == "no contact");
        }
    }

    #[test]
    fn vehicles_touch_where_the_run_ends_in_contact() {
        let (trace, impacts) = simulate_built_in("paper-2", AfterContact::Stop);
        let data = AnimationData::new(&trace, &impacts);
        let (last, impact) = (data.sample_count() - 1, data.impacts[0]);
        assert!(data.gap_m(impact.rear, last).unwrap().abs() <= 0.021);
        assert!((0..last).all(|sample| data.gap_m(impact.rear, sample).unwrap() > 0.0));
        assert!(impact.time_s <= data.end_s + 1e-9);
    }

    proptest! {
        #[test]
        fn any_trace_gives_data_that_json_can_hold(
            times in proptest::collection::vec(ANY_NUMBER, 0..8),
            values in proptest::collection::vec(proptest::collection::vec(ANY_NUMBER, 0..8), 0..4),
            length_m in ANY_NUMBER,
        ) {
            let track = |values: &Vec<f64>| Track {
                length_m,
                mass_kg: 1.0,
                position_m: values.clone(),
                speed_mps: values.clone(),
                acceleration_mps2: values.clone(),
                in_lane_s: Track::THROUGHOUT_S,
            };
            let trace = Trace { time_s: times, vehicles: values.iter().map(track).collect() };
            let data = AnimationData::new(&trace, &[]);
            prop_assert!(data.window_m().is_finite() && !data.to_json().is_empty());
            prop_assert!(!data.to_json().contains("null") && !data.to_json().contains('<'));
        }
    }
}
