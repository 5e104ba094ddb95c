//! Positions and speeds of vehicles, enclosed without loss.
//!
//! A vehicle at speed v ≥ 0 that holds the acceleration a has the speed max(0, v + a s) after s seconds: it does not
//! reverse, and once it stands with a < 0 it stays. So after t seconds it has covered
//!
//! ```text
//! d(v, a, t) = ∫ max(0, v + a s) ds from 0 to t  =  v t + a t²/2    if v + a t ≥ 0
//!                                                =  v² / (-2 a)     otherwise: it stopped on the way
//! ```
//!
//! The integrand grows with v and with a, hence so do d and the speed. Over a box of speeds and accelerations both are
//! least at the least v and a, and largest at the largest, even if only some members stop. This also holds for an
//! acceleration that changes within its bounds during the step, and implies that firing later never moves the follower
//! back.

use crate::claim::{ConstantPiece, Scene, SceneFollower};
use crate::interval::Interval;

/// Returns the distance in metres and the speed in m/s after `time_s` seconds at a held acceleration. Speeds and times
/// are not negative.
#[must_use]
pub fn distance_and_speed_after(
    speed_mps: Interval,
    acceleration_mps2: Interval,
    time_s: Interval,
) -> (Interval, Interval) {
    let (least_m, least_mps) =
        corner_distance_and_speed(speed_mps.low(), acceleration_mps2.low(), time_s);
    let (most_m, most_mps) =
        corner_distance_and_speed(speed_mps.high(), acceleration_mps2.high(), time_s);
    (least_m.hull(most_m), least_mps.hull(most_mps))
}

fn corner_distance_and_speed(v: f64, a: f64, t: Interval) -> (Interval, Interval) {
    let [v, a] = [v, a].map(Interval::point);
    let end = v + a * t;
    let surely_moves = a.low() >= 0.0 || end.low() >= 0.0;
    let surely_stops = end.high() < 0.0;
    let covered = if surely_moves {
        distance_moving(v, a, t)
    } else if surely_stops {
        stopping_distance(v, a)
    } else {
        // Rounding leaves open whether it stops: either formula may be the true one.
        distance_moving(v, a, t).hull(stopping_distance(v, a))
    };
    (covered, end.max(Interval::ZERO))
}

fn distance_moving(v: Interval, a: Interval, t: Interval) -> Interval {
    v * t + a * t.sqr() * Interval::point(0.5)
}

fn stopping_distance(v: Interval, a: Interval) -> Interval {
    v.sqr().over(-(a + a))
}

pub(crate) fn expand_pieces<T: Copy>(pieces: &[ConstantPiece<T>]) -> impl Iterator<Item = T> {
    pieces
        .iter()
        .flat_map(|&ConstantPiece(steps, value)| std::iter::repeat_n(value, steps as usize))
}

impl Scene {
    /// Returns instant `k`, in seconds.
    #[must_use]
    pub fn time_s(&self, k: u32) -> Interval {
        Interval::point(f64::from(k)) * Interval::point(self.step_s)
    }

    /// Returns the leader's rear bumper at the instants 0 to N, in metres.
    #[must_use]
    pub fn leader_rear_m(&self) -> Vec<Interval> {
        let rear_m = self.leader.position_m - Interval::point(self.leader.length_m);
        let step_s = Interval::point(self.step_s);
        let moves = expand_pieces(&self.leader.acceleration_mps2).scan(
            (rear_m, self.leader.speed_mps),
            |(x, v), a| {
                let (covered_m, speed_mps) = distance_and_speed_after(*v, a, step_s);
                (*x, *v) = (*x + covered_m, speed_mps);
                Some(*x)
            },
        );
        std::iter::once(rear_m).chain(moves).collect()
    }

    /// Returns the follower's front bumper in metres at instant `k`, at most N, if its brake fires at `fires`; N means
    /// never.
    #[must_use]
    pub fn follower_position_m(&self, follower: &SceneFollower, fires: u32, k: u32) -> Interval {
        let coasts = k.min(fires.saturating_add(follower.reaction_steps));
        let coasting_m = follower.position_m + follower.speed_mps * self.time_s(coasts);
        if coasts == k {
            return coasting_m;
        }
        coasting_m
            + distance_and_speed_after(
                follower.speed_mps,
                -follower.brake_mps2,
                self.time_s(k - coasts),
            )
            .0
    }

    pub(crate) fn follower_speed_mps(
        &self,
        follower: &SceneFollower,
        fires: u32,
        k: u32,
    ) -> Interval {
        let coasts = k.min(fires.saturating_add(follower.reaction_steps));
        distance_and_speed_after(
            follower.speed_mps,
            -follower.brake_mps2,
            self.time_s(k - coasts),
        )
        .1
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::claim::{SceneEgo, SceneLeader};

    #[test]
    fn a_follower_loses_speed_from_its_reaction_on() {
        let follower = SceneFollower {
            position_m: Interval::ZERO,
            speed_mps: Interval::point(12.0),
            brake_mps2: Interval::point(6.0),
            ttc_s: 1.0,
            reaction_steps: 2,
        };
        let scene = Scene {
            step_s: 0.25,
            steps: 20,
            leader: SceneLeader {
                position_m: Interval::ZERO,
                length_m: 0.0,
                speed_mps: Interval::ZERO,
                acceleration_mps2: vec![ConstantPiece(20, Interval::ZERO)],
            },
            egos: Vec::<SceneEgo>::new(),
            follower: None,
        };
        for (fires, k) in (0..=20_u32).flat_map(|fires| (0..=20_u32).map(move |k| (fires, k))) {
            let expected = (12.0 - 1.5 * f64::from(k.saturating_sub(fires + 2))).max(0.0);
            let actual = scene.follower_speed_mps(&follower, fires, k);
            assert!(
                (actual.low() - expected).abs() < 1e-12 && (actual.high() - expected).abs() < 1e-12,
                "{fires} {k}"
            );
        }
    }
}
