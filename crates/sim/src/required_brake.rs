//! The deceleration that avoids a braking leader: a measure, and a prediction of a controller.

/// Returns the required deceleration in m/s²: the smallest constant deceleration of the follower that avoids collision
/// with a leader that brakes at `front_brake_mps2` to standstill. 0 if no braking is needed; `None` without a gap.
///
/// DRAC misses a leader that has just begun to brake hard, because speeds are still equal. With gap `d`, speeds `v_f`
/// and `v_r`, and deceleration `b` of the leader,
/// - speeds become equal after `2 d / (v_r - v_f)` if the leader still moves then: `b + (v_r - v_f)² / (2 d)`;
/// - otherwise the follower must stop behind the final position of the leader: `v_r² / (2 (d + v_f² / (2 b)))`.
///
/// A leader that speeds up (`b < 0`) is taken to keep its speed, which yields DRAC.
///
/// Source: the first case is the required longitudinal acceleration under constant accelerations of Jansson 2005 in
/// Westhofen et al. 2023, "Criticality metrics for automated driving", Archives of Computational Methods in Engineering
/// 30, 1-35, which ignores the stop of the leader. The second case follows from the stopping distances.
#[must_use]
pub fn required_brake_mps2(
    gap_m: f64,
    front_speed_mps: f64,
    front_brake_mps2: f64,
    rear_speed_mps: f64,
) -> Option<f64> {
    let front_brake_mps2 = front_brake_mps2.max(0.0);
    let closing_mps = rear_speed_mps - front_speed_mps;
    let meet_while_moving =
        closing_mps > 0.0 && 2.0 * gap_m * front_brake_mps2 <= front_speed_mps * closing_mps;
    let required_mps2 = if meet_while_moving {
        front_brake_mps2 + 0.5 * closing_mps * closing_mps / gap_m
    } else if front_brake_mps2 > 0.0 {
        let room_m = gap_m + 0.5 * front_speed_mps * front_speed_mps / front_brake_mps2;
        0.5 * rear_speed_mps * rear_speed_mps / room_m
    } else {
        0.0
    };
    (gap_m > 0.0 && required_mps2.is_finite()).then_some(required_mps2)
}
