//! A line of vehicles as bodies: how they move together through one step, and what happens when they touch.

use super::motion::{Motion, closest_gap_until, first_contact, needs_care};
use super::{AfterContact, Contact, Impact};

/// Lines of at most so many vehicles are moved at once.
const SHORT_LINE: usize = 8;

/// The bodies of one run.
///
/// After an impact vehicles stick together: perfectly inelastic, by mass. A group that sticks together moves as one body
/// under the sum of its members' forces, so its acceleration is the mean of theirs weighted by mass.
#[derive(Debug, Clone)]
pub(super) struct Platoon {
    pub(super) motion: Vec<Motion>,
    pub(super) length_m: Vec<f64>,
    pub(super) mass_kg: Vec<f64>,
    /// Whether each vehicle sticks to the one ahead of it.
    pub(super) sticks: Vec<bool>,
    /// Smallest gap ahead of each vehicle so far, in metres; infinite for the leader.
    pub(super) min_gap_m: Vec<f64>,
}

impl Platoon {
    pub(super) fn gap_m(&self, rear: usize) -> f64 {
        self.motion[rear - 1].position_m - self.length_m[rear - 1] - self.motion[rear].position_m
    }

    /// Whether a vehicle sticks to another one.
    pub(super) fn is_stuck(&self, index: usize) -> bool {
        [index, index + 1].into_iter().any(|rear| self.sticks.get(rear).is_some_and(|&sticks| sticks))
    }

    /// Moves everybody by `dt_s`, through whatever contacts happen on the way, which are added to `impacts`.
    ///
    /// Accelerations must have been shared among vehicles that stick together. Returns how much of the step was done: all
    /// of it, unless the run ends at a contact.
    pub(super) fn advance(
        &mut self,
        from_s: f64,
        dt_s: f64,
        after_contact: AfterContact,
        impacts: &mut Vec<Impact>,
    ) -> f64 {
        if self.glide(dt_s) {
            return dt_s;
        }
        let mut done_s = 0.0;
        while let Some((in_s, rear)) = self.next_contact(dt_s - done_s) {
            self.drift(in_s);
            done_s += in_s;
            let impact = self.impact(from_s + done_s, rear);
            self.min_gap_m[rear] = 0.0;
            let common_mps = impact.common_speed_mps;
            let involved = impact.first_involved..=impact.last_involved;
            impacts.push(impact);
            if after_contact == AfterContact::Stop {
                return done_s;
            }
            self.sticks[rear] = true;
            for vehicle in involved {
                self.motion[vehicle].speed_mps = common_mps;
            }
            self.share_acceleration();
        }
        self.drift(dt_s - done_s);
        dt_s
    }

    /// Moves everybody by `dt_s` where that needs no care, which is nearly always: nobody sticks to another one, can touch or is closest
    /// inside. To the bit what [`Self::drift`] does then, with each vehicle moved once. Does nothing elsewhere.
    #[inline]
    fn glide(&mut self, dt_s: f64) -> bool {
        let mut ends = [Motion { position_m: 0.0, speed_mps: 0.0, acceleration_mps2: 0.0 }; SHORT_LINE];
        let Some(ends) = ends.get_mut(..self.motion.len()) else { return false };
        for (end, motion) in ends.iter_mut().zip(&self.motion) {
            *end = motion.after(dt_s);
        }
        let mut gaps_m = [f64::INFINITY; SHORT_LINE];
        for (rear, gap_m) in gaps_m.iter_mut().enumerate().take(ends.len()).skip(1) {
            let ([front, behind], [front_end, behind_end]) =
                ([self.motion[rear - 1], self.motion[rear]], [ends[rear - 1], ends[rear]]);
            let closing_mps = [behind.speed_mps - front.speed_mps, behind_end.speed_mps - front_end.speed_mps];
            let behind_mps = [behind.speed_mps, behind_end.speed_mps];
            if self.sticks[rear] || needs_care(self.gap_m(rear), behind_mps, closing_mps, dt_s) {
                return false;
            }
            *gap_m = front_end.position_m - self.length_m[rear - 1] - behind_end.position_m;
        }
        for (least_m, gap_m) in self.min_gap_m.iter_mut().zip(gaps_m) {
            *least_m = least_m.min(gap_m);
        }
        self.motion.copy_from_slice(ends);
        true
    }

    /// The earliest contact within `within_s`: when, and the rear vehicle. The foremost of simultaneous ones.
    fn next_contact(&self, within_s: f64) -> Option<(f64, usize)> {
        let mut first: Option<(f64, usize)> = None;
        let mut front = *self.motion.first()?;
        let mut front_end = front.after(within_s);
        for rear in 1..self.motion.len() {
            let behind = self.motion[rear];
            let behind_end = behind.after(within_s);
            let behind_mps = [behind.speed_mps, behind_end.speed_mps];
            let closing_mps = [behind_mps[0] - front.speed_mps, behind_mps[1] - front_end.speed_mps];
            if !self.sticks[rear]
                && needs_care(self.gap_m(rear), behind_mps, closing_mps, within_s)
                && let Some(in_s) = first_contact(front, behind, self.length_m[rear - 1], within_s)
                && first.is_none_or(|(earliest_s, _)| in_s < earliest_s)
            {
                first = Some((in_s, rear));
            }
            (front, front_end) = (behind, behind_end);
        }
        first
    }

    /// Moves everybody by `dt_s` in which nobody touches, and notes how close they came.
    fn drift(&mut self, dt_s: f64) {
        let Some(mut front) = self.motion.first().copied() else { return };
        let mut front_end = front.after(dt_s);
        self.motion[0] = front_end;
        for rear in 1..self.motion.len() {
            let behind = self.motion[rear];
            let behind_end = behind.after(dt_s);
            if !self.sticks[rear] {
                let closest_m =
                    closest_gap_until([front, behind], [front_end, behind_end], self.length_m[rear - 1], dt_s);
                self.min_gap_m[rear] = self.min_gap_m[rear].min(closest_m);
            }
            self.motion[rear] = behind_end;
            (front, front_end) = (behind, behind_end);
        }
        // The gap inside a group is exactly zero: an emergency brake that looks at its sign must not see rounding.
        for rear in 1..self.motion.len() {
            if self.sticks[rear] {
                self.motion[rear].position_m = self.motion[rear - 1].position_m - self.length_m[rear - 1];
            }
        }
    }

    /// What the contact between `rear` and the vehicle ahead of it does.
    fn impact(&self, time_s: f64, rear: usize) -> Impact {
        let front = rear - 1;
        let first_involved = (0..=front).rev().find(|&i| !self.sticks[i]).unwrap_or(0);
        let last_involved = (rear + 1..self.sticks.len()).find(|&i| !self.sticks[i]).unwrap_or(self.sticks.len()) - 1;
        let involved = first_involved..=last_involved;
        let mass_kg: f64 = self.mass_kg[involved.clone()].iter().sum();
        let momentum: f64 = involved.map(|i| self.mass_kg[i] * self.motion[i].speed_mps).sum();
        let (front_speed_mps, rear_speed_mps) = (self.motion[front].speed_mps, self.motion[rear].speed_mps);
        let contact = Contact {
            time_s,
            front_vehicle: front,
            rear_vehicle: rear,
            front_speed_mps,
            rear_speed_mps,
            impact_speed_mps: rear_speed_mps - front_speed_mps,
        };
        Impact { contact, common_speed_mps: momentum / mass_kg, first_involved, last_involved }
    }

    /// Gives every group that sticks together the acceleration of its summed forces.
    pub(super) fn share_acceleration(&mut self) {
        let mut first = 0;
        while first < self.motion.len() {
            let end = (first + 1..self.sticks.len()).find(|&i| !self.sticks[i]).unwrap_or(self.sticks.len());
            if end > first + 1 {
                let mass_kg: f64 = self.mass_kg[first..end].iter().sum();
                let force: f64 = (first..end).map(|i| self.mass_kg[i] * self.motion[i].acceleration_mps2).sum();
                let shared = force / mass_kg;
                let at_rest = self.motion[first].speed_mps == 0.0 && shared <= 0.0;
                for motion in &mut self.motion[first..end] {
                    motion.acceleration_mps2 = if at_rest { 0.0 } else { shared };
                }
            }
            first = end;
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn platoon(vehicles: &[(f64, f64, f64, f64)]) -> Platoon {
        Platoon {
            motion: vehicles
                .iter()
                .map(|&(position_m, speed_mps, acceleration_mps2, _)| Motion {
                    position_m,
                    speed_mps,
                    acceleration_mps2,
                })
                .collect(),
            length_m: vec![2.0; vehicles.len()],
            mass_kg: vehicles.iter().map(|v| v.3).collect(),
            sticks: vec![false; vehicles.len()],
            min_gap_m: vec![f64::INFINITY; vehicles.len()],
        }
    }

    #[test]
    fn a_chain_of_impacts_in_one_step_keeps_momentum_and_order() {
        // The rear one hits the middle one (gap 1 m at 10 m/s), and both then hit the front one (gap 0.5 m).
        let mut platoon = platoon(&[(10.0, 0.0, 0.0, 1000.0), (7.5, 0.0, 0.0, 1000.0), (4.5, 10.0, 0.0, 2000.0)]);
        let mut impacts = Vec::new();
        let done_s = platoon.advance(0.0, 0.5, AfterContact::Continue, &mut impacts);
        assert_eq!(done_s, 0.5);
        assert_eq!(impacts.len(), 2);
        assert!((impacts[0].contact.time_s - 0.1).abs() < 1e-12);
        assert!((impacts[0].common_speed_mps - 20.0 / 3.0).abs() < 1e-12);
        assert!((impacts[1].contact.time_s - (0.1 + 0.5 / (20.0 / 3.0))).abs() < 1e-12);
        assert_eq!((impacts[1].first_involved, impacts[1].last_involved), (0, 2));
        for motion in &platoon.motion {
            assert!((motion.speed_mps - 5.0).abs() < 1e-12, "20 000 kg m/s over 4000 kg");
        }
        assert!((impacts[1].delta_v_mps(0) - 5.0).abs() < 1e-12);
        assert!((impacts[1].delta_v_mps(2) - (20.0 / 3.0 - 5.0)).abs() < 1e-12);
    }

    proptest! {
        /// Where the short way is taken it leads to the same bits as the long one.
        #[test]
        fn gliding_is_drifting(
            line in prop::collection::vec((0.0..4.0_f64, 0.0..40.0_f64, -9.0..4.0_f64), 1..10),
            dt_s in 1e-3..0.2_f64,
        ) {
            let mut front_m = 0.0;
            let vehicles = line.into_iter().map(|(gap_m, speed_mps, acceleration_mps2)| {
                front_m -= 2.0 + gap_m;
                (front_m, speed_mps, acceleration_mps2, 1000.0)
            });
            let mut long = platoon(&vehicles.collect::<Vec<_>>());
            let mut short = long.clone();
            if short.glide(dt_s) {
                prop_assert_eq!(long.next_contact(dt_s), None);
                long.drift(dt_s);
            }
            prop_assert_eq!(&short.motion, &long.motion);
            prop_assert_eq!(&short.min_gap_m, &long.min_gap_m);
        }
    }

    #[test]
    fn stuck_vehicles_brake_with_their_summed_force() {
        let mut platoon = platoon(&[(2.0, 10.0, 0.0, 1000.0), (0.0, 10.0, -4.0, 3000.0)]);
        platoon.sticks[1] = true;
        platoon.share_acceleration();
        platoon.advance(0.0, 1.0, AfterContact::Continue, &mut Vec::new());
        assert!((platoon.motion[0].speed_mps - 7.0).abs() < 1e-12);
        assert!(platoon.gap_m(1).abs() < 1e-12);
    }
}
