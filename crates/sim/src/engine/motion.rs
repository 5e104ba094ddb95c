//! Exact motion under an acceleration that is constant over a step, and collisions inside a step.
//!
//! x += v dt + a dt²/2 and v += a dt, unless v would become negative. Then the vehicle stops for good after v²/(2|a|).

/// Motion of a vehicle at the start of a step.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Position of the front bumper, in metres.
    pub position_m: f64,
    /// Speed in m/s, not negative.
    pub speed_mps: f64,
    /// Acceleration over the step, in m/s².
    pub acceleration_mps2: f64,
}

impl Motion {
    /// Returns the motion after `dt_s` seconds.
    #[must_use]
    #[inline]
    pub fn after(self, dt_s: f64) -> Self {
        let (position_m, speed_mps) = advance(
            self.position_m,
            self.speed_mps,
            self.acceleration_mps2,
            dt_s,
        );
        Self {
            position_m,
            speed_mps,
            ..self
        }
    }

    /// Returns the motion at `from_s`, valid until the vehicle stops; without acceleration if it stands.
    ///
    /// The time decides whether the vehicle stands, not the speed: rounding can leave a positive speed at the instant
    /// of the stop.
    fn piece_from(self, from_s: f64) -> Self {
        let later = self.after(from_s);
        if from_s < self.stopping_time_s() {
            later
        } else {
            Self {
                speed_mps: 0.0,
                acceleration_mps2: 0.0,
                ..later
            }
        }
    }

    /// Returns the time until the vehicle stops, in seconds; infinite if it does not.
    pub(crate) fn stopping_time_s(self) -> f64 {
        if self.acceleration_mps2 < 0.0 {
            self.speed_mps / -self.acceleration_mps2
        } else {
            f64::INFINITY
        }
    }
}

#[inline]
pub(super) fn advance(x: f64, v: f64, a: f64, dt: f64) -> (f64, f64) {
    let v_end = v + a * dt;
    if v_end < 0.0 {
        (x + v * v / (-2.0 * a), 0.0)
    } else {
        (x + v * dt + 0.5 * a * dt * dt, v_end)
    }
}

/// True if a step needs [`first_collision`] and [`closest_gap_m`]: the vehicles could collide in it, or are closest
/// inside it.
///
/// The gap shrinks by at most the distance that the follower covers at its higher end speed.
#[inline]
pub(super) fn needs_collision_check(
    gap_m: f64,
    rear_mps: [f64; 2],
    closing_mps: [f64; 2],
    dt: f64,
) -> bool {
    may_collide(gap_m, rear_mps, dt) | ((closing_mps[0] > 0.0) & (closing_mps[1] <= 0.0))
}

/// True if a step needs [`first_collision`], given the speeds of the rear vehicle at both ends.
#[inline]
pub(super) fn may_collide(gap_m: f64, rear_mps: [f64; 2], dt: f64) -> bool {
    gap_m - rear_mps[0].max(rear_mps[1]) * dt <= 0.0
}

/// Returns the first instant in `[0, dt_s]` at which the gap between two vehicles is zero or less, if any.
///
/// Both motions are quadratic until a vehicle stops, so the gap is piecewise quadratic with at most three pieces.
pub(crate) fn first_collision(
    front: Motion,
    rear: Motion,
    front_length_m: f64,
    dt_s: f64,
) -> Option<f64> {
    first_zero(
        front,
        rear,
        |front, rear| gap_and_rates(front, rear, front_length_m),
        dt_s,
    )
}

/// Returns the gap between two vehicles in metres, its rate in m/s and its second derivative in m/s².
#[inline]
pub(super) fn gap_and_rates(front: Motion, rear: Motion, front_length_m: f64) -> [f64; 3] {
    let gap_m = front.position_m - front_length_m - rear.position_m;
    [
        gap_m,
        front.speed_mps - rear.speed_mps,
        front.acceleration_mps2 - rear.acceleration_mps2,
    ]
}

/// Returns the first instant in `[0, dt_s]` at which a quantity of two vehicles is zero or less, if any.
///
/// `size` returns value, rate and second derivative; it is quadratic until a vehicle stops.
#[inline]
pub(super) fn first_zero(
    front: Motion,
    rear: Motion,
    size: impl Fn(Motion, Motion) -> [f64; 3],
    dt_s: f64,
) -> Option<f64> {
    if size(front, rear)[0] <= 0.0 {
        return Some(0.0);
    }
    for [from_s, to_s] in split_at_stops(front, rear, dt_s) {
        let [value, rate, second] = size(front.piece_from(from_s), rear.piece_from(from_s));
        let root_s = first_root(value, rate, second);
        if let Some(root_s) = root_s.filter(|root_s| from_s + root_s <= to_s) {
            return Some((from_s + root_s).min(dt_s));
        }
        if size(front.after(to_s), rear.after(to_s))[0] <= 0.0 {
            return Some(to_s);
        }
    }
    None
}

/// Returns the minimum gap between two vehicles at any instant after now and up to `dt_s`, in metres.
#[must_use]
pub fn closest_gap_m(front: Motion, rear: Motion, front_length_m: f64, dt_s: f64) -> f64 {
    closest_gap_given_ends_m(
        [front, rear],
        [front.after(dt_s), rear.after(dt_s)],
        front_length_m,
        dt_s,
    )
}

/// Returns the minimum gap as [`closest_gap_m`] does, given the motions of front and rear vehicle at the end.
#[inline]
pub(super) fn closest_gap_given_ends_m(
    [front, rear]: [Motion; 2],
    end: [Motion; 2],
    front_length_m: f64,
    dt_s: f64,
) -> f64 {
    let at_end = end[0].position_m - front_length_m - end[1].position_m;
    // If both stand at the end and the rear one stopped first, the gap was smallest before.
    if rear.speed_mps - front.speed_mps > 0.0 && end[1].speed_mps - end[0].speed_mps <= 0.0 {
        at_end.min(gap_at_equal_speed_m(front, rear, front_length_m, dt_s).unwrap_or(at_end))
    } else {
        at_end
    }
}

/// Returns the gap at which two vehicles stop closing in, in metres.
#[inline(never)]
fn gap_at_equal_speed_m(
    front: Motion,
    rear: Motion,
    front_length_m: f64,
    dt_s: f64,
) -> Option<f64> {
    // The closing speed is piecewise linear and continuous: the gap is smallest where it changes sign.
    for span_s in split_at_stops(front, rear, dt_s) {
        let [before, after] =
            span_s.map(|at_s| rear.after(at_s).speed_mps - front.after(at_s).speed_mps);
        if before > 0.0 && after <= 0.0 {
            let [from_s, to_s] = span_s;
            let turn_s = from_s + (to_s - from_s) * before / (before - after);
            let front_m = front.after(turn_s).position_m;
            return Some(front_m - front_length_m - rear.after(turn_s).position_m);
        }
    }
    None
}

fn split_at_stops(front: Motion, rear: Motion, dt: f64) -> [[f64; 2]; 3] {
    let front_s = front.stopping_time_s().min(dt);
    let rear_s = rear.stopping_time_s().min(dt);
    let first = front_s.min(rear_s);
    let second = front_s.max(rear_s);
    [[0.0, first], [first, second], [second, dt]]
}

/// Returns the smallest t >= 0 with g + r t + a t²/2 = 0, for g > 0.
fn first_root(g: f64, r: f64, a: f64) -> Option<f64> {
    let discriminant = r * r - 2.0 * a * g;
    if discriminant < 0.0 {
        return None;
    }
    let root = discriminant.sqrt();
    // Each form adds numbers of one sign, so that no cancellation occurs.
    if r < 0.0 {
        Some(2.0 * g / (root - r))
    } else if a < 0.0 {
        Some((r + root) / -a)
    } else {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn motion(position_m: f64, speed_mps: f64, acceleration_mps2: f64) -> Motion {
        Motion {
            position_m,
            speed_mps,
            acceleration_mps2,
        }
    }

    #[test]
    fn a_vehicle_stops_inside_the_step_and_stays() {
        let stopped = motion(10.0, 2.0, -4.0).after(1.0);
        assert_eq!((stopped.position_m, stopped.speed_mps), (10.5, 0.0));
        assert_eq!(stopped.after(1.0).position_m, 10.5);
    }

    #[test]
    fn collision_with_a_vehicle_that_stops_first() {
        // The front vehicle stops after 0.5 s and 0.5 m; the rear one covers 1.5 m of gap plus that at 4 m/s in 0.5 s.
        let time = first_collision(motion(3.5, 2.0, -4.0), motion(0.0, 4.0, 0.0), 2.0, 1.0);
        assert!((time.unwrap() - 0.5).abs() < 1e-12, "{time:?}");
    }

    #[test]
    fn the_smallest_gap_inside_a_step_is_found() {
        // The gap 1 - 2t + 2t² has its minimum 0.5 at t = 0.5.
        let (front, rear) = (motion(3.0, 10.0, 0.0), motion(0.0, 12.0, -4.0));
        assert!((closest_gap_m(front, rear, 2.0, 1.0) - 0.5).abs() < 1e-12);
        assert_eq!(first_collision(front, rear, 2.0, 1.0), None);
    }

    prop_compose! {
        fn any_pair()(gap in 1e-6..3.0_f64, vf in 0.0..40.0_f64, vr in 0.0..40.0_f64, af in -9.0..4.0_f64,
                      ar in -9.0..4.0_f64, dt in 1e-3..1.0_f64) -> (Motion, Motion, f64) {
            (motion(gap + 2.0, vf, af), motion(0.0, vr, ar), dt)
        }
    }

    #[test]
    fn a_vehicle_that_stops_within_a_step_has_speed_zero() {
        // The computed v - b (v / b) is a rounding error above zero.
        let (v, b) = (0.109_350_472_814_391, 9.586_679_427_354_404);
        let speed_mps = (1..1000)
            .map(|k| v * f64::from(k))
            .find(|&v| v - b * (v / b) > 0.0)
            .expect("common");
        let front = motion(2.5, speed_mps, -b);
        let stands_m = front.after(10.0).position_m - 2.0;
        let time_s = first_collision(front, motion(-40.0, 10.0, 0.0), 2.0, 10.0).unwrap();
        assert!(
            (time_s - (stands_m + 40.0) / 10.0).abs() < 1e-12,
            "{time_s}"
        );
    }

    #[test]
    fn vehicles_that_stop_in_one_step_are_closest_at_equal_speed() {
        // Rear: 3 m/s braking at 8; front: 2 m/s braking at 4. Equal speeds after 0.25 s: 1 + 0.5 * (2 - 3) * 0.25.
        let (front, rear) = (motion(3.0, 2.0, -4.0), motion(0.0, 3.0, -8.0));
        let closest_m = closest_gap_m(front, rear, 2.0, 1.0);
        assert!((closest_m - 0.875).abs() < 1e-12, "{closest_m}");
    }

    #[test]
    fn steps_without_a_possible_collision_need_no_collision_check() {
        let (far_m, dt_s) = (50.0, 0.01);
        assert!(
            !needs_collision_check(far_m, [20.0, 20.0], [1.0, 1.0], dt_s),
            "closing throughout"
        );
        assert!(
            !needs_collision_check(far_m, [20.0, 20.0], [-1.0, -1.0], dt_s),
            "opening throughout"
        );
        assert!(
            !needs_collision_check(far_m, [20.0, 20.0], [-1.0, 1.0], dt_s),
            "farthest inside"
        );
        assert!(
            needs_collision_check(far_m, [20.0, 20.0], [1.0, -1.0], dt_s),
            "closest inside"
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn collision_and_closest_gap_agree_with_brute_force((front, rear, dt) in any_pair()) {
            let gap_at = |t: f64| front.after(t).position_m - 2.0 - rear.after(t).position_m;
            let grid: Vec<f64> = (0..=2000).map(|k| dt * f64::from(k) / 2000.0).collect();
            let crossing = grid.iter().position(|&t| gap_at(t) <= 0.0);
            let collision = first_collision(front, rear, 2.0, dt);
            match (collision, crossing) {
                (Some(time), crossing) => {
                    prop_assert!(gap_at(time).abs() < 1e-9, "gap {} at the collision", gap_at(time));
                    if let Some(crossing) = crossing {
                        prop_assert!(time <= grid[crossing] + 1e-12);
                        prop_assert!(crossing == 0 || time >= grid[crossing - 1] - 1e-9);
                    }
                }
                (None, Some(_)) => prop_assert!(false, "missed a collision"),
                (None, None) => {}
            }
            let brute = grid[1..].iter().map(|&t| gap_at(t)).fold(f64::INFINITY, f64::min);
            let closest = closest_gap_m(front, rear, 2.0, dt);
            prop_assert!(closest.min(gap_at(0.0)) <= brute + 1e-12, "{closest} {brute}");
            prop_assert!(closest >= brute - 20.0 * (dt / 2000.0).powi(2) - 1e-12, "{closest} {brute}");
        }

        #[test]
        fn screening_never_misses_a_collision((front, rear, dt) in any_pair()) {
            let gap = front.position_m - 2.0 - rear.position_m;
            let (f, r) = (front.after(dt), rear.after(dt));
            let closing = [rear.speed_mps - front.speed_mps, r.speed_mps - f.speed_mps];
            if !needs_collision_check(gap, [rear.speed_mps, r.speed_mps], closing, dt) {
                prop_assert_eq!(first_collision(front, rear, 2.0, dt), None);
                prop_assert_eq!(closest_gap_m(front, rear, 2.0, dt), f.position_m - 2.0 - r.position_m);
            }
        }
    }
}
