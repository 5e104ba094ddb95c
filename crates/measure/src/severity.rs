//! Severity: impact speeds, changes of speed, and involved vehicles.

use crumple_sim::engine::Impact;

/// Returns the impacts that involve vehicle `index`: those in which it is among the vehicles that stick together.
pub fn impacts_of(impacts: &[Impact], index: usize) -> impl Iterator<Item = &Impact> {
    impacts.iter().filter(move |impact| impact.involves(index))
}

/// Returns the largest impact speed of vehicle `index` with its leader, in m/s; `None` without a collision.
#[must_use]
pub fn impact_speed_mps(impacts: &[Impact], index: usize) -> Option<f64> {
    let hits = impacts
        .iter()
        .filter(|impact| impact.collision.rear_vehicle == index);
    hits.map(|impact| impact.collision.impact_speed_mps)
        .reduce(f64::max)
}

/// Returns the largest change of speed of vehicle `index` in one impact, in m/s; `None` without impacts.
///
/// Impacts are not summed, because injury follows from a single one. An impact shares momentum in inverse proportion to
/// mass, so that the lighter vehicle changes its speed more; see [`Impact::delta_v_mps`].
///
/// Source: delta-v as the measure of severity, and its ratio inverse to that of the masses: Evans 1994, "Driver injury
/// and fatality risk in two-car crashes versus mass ratio inferred using Newtonian mechanics", Accident Analysis and
/// Prevention 26, 609-616.
#[must_use]
pub fn max_delta_v_mps(impacts: &[Impact], index: usize) -> Option<f64> {
    impacts_of(impacts, index)
        .map(|impact| impact.delta_v_mps(index))
        .reduce(f64::max)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::testing::impact;
    use crumple_sim::engine::Collision;

    #[test]
    fn a_truck_into_a_car_by_hand() {
        // 15 t at 18 m/s into 1.5 t at 7 m/s: 11 m/s, of which the car takes 15 / 16.5 and the truck 1.5 / 16.5.
        let impacts = [Impact {
            common_speed_mps: (15.0 * 18.0 + 1.5 * 7.0) / 16.5,
            ..impact(1.0, 0, 7.0, 18.0)
        }];
        assert!((max_delta_v_mps(&impacts, 0).unwrap() - 10.0).abs() < 1e-12);
        assert!((max_delta_v_mps(&impacts, 1).unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(max_delta_v_mps(&impacts, 2), None);
    }

    #[test]
    fn a_pile_up_by_hand() {
        // Equal masses. Vehicle 2 hits 1: 4 against 10 m/s, both leave at 7. Vehicle 1, with 2 stuck to it, hits 0:
        // 1 against 7 m/s, all leave at (1 + 7 + 7) / 3 = 5.
        let second = Impact {
            collision: Collision {
                time_s: 2.0,
                front_vehicle: 0,
                rear_vehicle: 1,
                ..impact(2.0, 0, 1.0, 7.0).collision
            },
            common_speed_mps: 5.0,
            beside: Vec::new(),
            first_involved: 0,
            last_involved: 2,
        };
        let impacts = [impact(1.0, 1, 4.0, 10.0), second];
        assert_eq!(
            [0, 1, 2, 3].map(|i| impact_speed_mps(&impacts, i)),
            [None, Some(6.0), Some(6.0), None]
        );
        // 0: 5 - 1. 1: max(7 - 4, 7 - 5). 2: max(10 - 7, 7 - 5).
        assert_eq!(
            [0, 1, 2, 3].map(|i| max_delta_v_mps(&impacts, i)),
            [Some(4.0), Some(3.0), Some(3.0), None]
        );
        assert_eq!(
            [0, 1, 2, 3].map(|i| impacts_of(&impacts, i).count()),
            [1, 2, 2, 0]
        );
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        /// Closed form for two vehicles that stick together: `Δv = impact speed * m_other / (m_own + m_other)`.
        #[test]
        fn an_impact_shares_its_speed_by_mass(
            front in 0.0..30.0f64,
            closing in 0.1..30.0f64,
            masses in prop::array::uniform2(1e3..4e4f64),
        ) {
            let common_speed_mps = (masses[0] * front + masses[1] * (front + closing)) / (masses[0] + masses[1]);
            let impact = Impact { common_speed_mps, ..impact(1.0, 0, front, front + closing) };
            for (own, other) in [(0, 1), (1, 0)] {
                let by_mass_mps = closing * masses[other] / (masses[own] + masses[other]);
                let found_mps = max_delta_v_mps(std::slice::from_ref(&impact), own).unwrap();
                prop_assert!((found_mps - by_mass_mps).abs() < 1e-9);
            }
        }
    }
}
