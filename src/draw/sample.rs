//! Runs to draw in tests: the paper's scenarios in a few lines, with Euler steps and a controller that sees everything.

use crate::sim::{Contact, Impact, Trace, Track};

const DT_S: f64 = 0.01;

/// A line of vehicles 16 m apart at 25 m/s whose leader brakes at 3 m/s² after 1 s.
///
/// The others brake fully below a time to collision of `ttc_s`, or, without one, as the leader does and 0.1 s later.
pub(super) fn line(heavy: &[bool], ttc_s: Option<f64>, go_on: bool) -> (Trace, Vec<Impact>) {
    let length = |heavy: bool| if heavy { 15.0 } else { 2.0 };
    let mut x = Vec::new();
    for (index, _) in heavy.iter().enumerate() {
        let ahead = index.checked_sub(1).map_or(36.0, |ahead| x[ahead] - length(heavy[ahead]) - 16.0);
        x.push(ahead);
    }
    let mut v = vec![25.0; x.len()];
    let mut latched = vec![false; x.len()];
    let mut stuck = vec![false; x.len()];
    let track = |&heavy: &bool| Track {
        length_m: length(heavy),
        mass_kg: if heavy { 15_000.0 } else { 1_500.0 },
        position_m: vec![],
        speed_mps: vec![],
        acceleration_mps2: vec![],
    };
    let mut trace = Trace { time_s: vec![], vehicles: heavy.iter().map(track).collect() };
    let mut impacts: Vec<Impact> = Vec::new();
    for step in 0..=1500 {
        let time_s = f64::from(step) * DT_S;
        let mut a = vec![0.0; x.len()];
        for i in 0..x.len() {
            let limit = if heavy[i] { 6.0 } else { 7.5 };
            a[i] = match (i, ttc_s) {
                (0, _) => {
                    if time_s >= 1.0 {
                        -3.0
                    } else {
                        0.0
                    }
                }
                (_, None) => {
                    if time_s >= 1.0 + 0.1 * i as f64 {
                        -3.0
                    } else {
                        0.0
                    }
                }
                (_, Some(ttc_s)) => {
                    let gap = x[i - 1] - length(heavy[i - 1]) - x[i];
                    latched[i] |= v[i] > v[i - 1] && gap / (v[i] - v[i - 1]) < ttc_s;
                    if latched[i] { -limit } else { 0.0 }
                }
            };
        }
        trace.time_s.push(time_s);
        for (i, track) in trace.vehicles.iter_mut().enumerate() {
            track.position_m.push(x[i]);
            track.speed_mps.push(v[i]);
            track.acceleration_mps2.push(a[i]);
        }
        if !impacts.is_empty() && !go_on {
            break;
        }
        for i in 0..x.len() {
            x[i] += v[i] * DT_S;
            v[i] = (v[i] + a[i] * DT_S).max(0.0);
        }
        for i in 1..x.len() {
            let rear_bumper = x[i - 1] - length(heavy[i - 1]);
            if x[i] >= rear_bumper {
                if !stuck[i] {
                    let contact = Contact {
                        time_s: time_s + DT_S,
                        front_vehicle: i - 1,
                        rear_vehicle: i,
                        front_speed_mps: v[i - 1],
                        rear_speed_mps: v[i],
                        impact_speed_mps: v[i] - v[i - 1],
                    };
                    let common_speed_mps = (v[i] + v[i - 1]) / 2.0;
                    impacts.push(Impact { contact, common_speed_mps, first_involved: i - 1, last_involved: i });
                    stuck[i] = true;
                }
                x[i] = rear_bumper;
                let common = if i > 1 && stuck[i - 1] { v[i - 1] } else { (v[i] + v[i - 1]) / 2.0 };
                (v[i - 1], v[i]) = (common, common);
            }
        }
    }
    (trace, impacts)
}
