//! Harm: the expected number of seriously injured drivers, from changes of speed.
//!
//! Curves: logit p = intercept + slope · Δv, with Δv in mph, for injuries MAIS(05/08) 3 or more of occupants of light
//! vehicles in frontal and in rear-end crashes: Wang 2022, *MAIS(05/08) injury probability curves as functions of delta
//! V*, DOT HS 813 219, NHTSA, tables, fitted to NASS-CDS 2010 to 2015. The report itself could not be read:
//! the coefficients are those that three public transcriptions agree on.
//!
//! Range: towed light vehicles up to ten years old, front-seat and rear-seat occupants of any age and belt use, from
//! crashes that were severe enough to be investigated. Near Δv = 0 the curves give 0.1 % (frontal) and 0.03 %
//! (rear-end), which overstates the harm of touching at walking speed. No curve for lorries could be read, so that they
//! use the same curves. The mass of a lorry makes its Δv against a car small.

use crumple_sim::engine::Impact;

const MPH_PER_MPS: f64 = 3600.0 / 1609.344;

/// Intercept and slope per mph of a logistic curve.
struct InjuryCurve([f64; 2]);

/// Table A-6.
const FRONTAL: InjuryCurve = InjuryCurve([-6.9774, 0.1620]);
/// Table A-9.
const REAR_END: InjuryCurve = InjuryCurve([-8.0329, 0.1793]);

impl InjuryCurve {
    fn probability(&self, delta_v_mps: f64) -> f64 {
        let Self([intercept, slope]) = self;
        1.0 / (1.0 + libm::exp(-(intercept + slope * MPH_PER_MPS * delta_v_mps)))
    }
}

/// Returns the probability that the driver of vehicle `index` is seriously injured, the largest over all impacts; 0
/// without an impact. A vehicle behind the impact is struck at its front, one ahead of it at its rear.
#[must_use]
pub fn injury_probability(impacts: &[Impact], index: usize) -> f64 {
    let involving = impacts.iter().filter(|impact| impact.involves(index));
    involving
        .map(|impact| {
            let curve = if index <= impact.collision.front_vehicle {
                REAR_END
            } else {
                FRONTAL
            };
            curve.probability(impact.delta_v_mps(index))
        })
        .fold(0.0, f64::max)
}

/// Returns the harm of a run: the expected number of seriously injured drivers among its `vehicles`, front to rear.
#[must_use]
pub fn harm(impacts: &[Impact], vehicles: usize) -> f64 {
    (0..vehicles)
        .map(|index| injury_probability(impacts, index))
        .sum()
}

/// Returns the harm of one inelastic impact of two vehicles with these masses, front and rear.
#[must_use]
pub fn harm_of_pair(impact_speed_mps: f64, [front_kg, rear_kg]: [f64; 2]) -> f64 {
    let share_mps = impact_speed_mps / (front_kg + rear_kg);
    REAR_END.probability(share_mps * rear_kg) + FRONTAL.probability(share_mps * front_kg)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::impact;

    #[test]
    fn a_car_behind_a_car_by_hand() {
        // 20 m/s into equal mass: 10 m/s = 22.369 mph each. Logits -6.9774 + 3.6238 and -8.0329 + 4.0108.
        let by_hand = 1.0 / (1.0 + 3.3536_f64.exp()) + 1.0 / (1.0 + 4.0221_f64.exp());
        let impacts = [impact(1.0, 0, 5.0, 25.0)];
        assert!(
            (harm(&impacts, 3) - by_hand).abs() < 1e-4,
            "{}",
            harm(&impacts, 3)
        );
        assert!((harm_of_pair(20.0, [1500.0, 1500.0]) - harm(&impacts, 2)).abs() < 1e-12);
        assert_eq!(
            (harm(&impacts, 1), injury_probability(&impacts, 2)),
            (injury_probability(&impacts, 0), 0.0)
        );
        assert_eq!(harm(&[], 3), 0.0);
    }

    /// Above walking speed, a lorry that hits a car does more harm than a car that does, and speed adds harm.
    #[test]
    fn harm_follows_the_masses() {
        for speed_mps in [8.0, 14.0, 20.0] {
            let (lorry, car) = ([1500.0, 15_000.0], [1500.0, 1500.0]);
            assert!(harm_of_pair(speed_mps, lorry) > harm_of_pair(speed_mps, car));
            assert!(harm_of_pair(speed_mps + 1.0, lorry) > harm_of_pair(speed_mps, lorry));
        }
    }
}
