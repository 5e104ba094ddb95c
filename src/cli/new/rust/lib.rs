//! A controller: the Intelligent Driver Model. Replace `decide`.

use crumple_sim::observation::Observation;

/// Returns the commanded acceleration, in m/s².
pub fn decide(seen: &Observation) -> f64 {
    let free_road_mps2 = 1.5 * (1.0 - (seen.speed_mps / 33.0).powi(4));
    let Some(ahead) = seen.ahead else {
        return free_road_mps2;
    };
    let closing_mps = seen.speed_mps - ahead.speed_mps;
    let desired_gap_m = 2.0 + (1.2 * seen.speed_mps + seen.speed_mps * closing_mps / 3.0).max(0.0);
    (free_road_mps2 - 1.5 * (desired_gap_m / ahead.gap_m.max(0.1)).powi(2)).clamp(-9.0, 1.5)
}
