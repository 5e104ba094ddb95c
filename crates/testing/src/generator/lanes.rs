//! Generation of scenarios with lane changes.

use arbitrary::Unstructured;

use super::choices::Choices;
use super::shape::MAX_VEHICLES;
use crumple_sim::scenario::{LaneChange, Scenario, VehicleSpec};

/// Bytes of one change: occurrence, trigger and value. Each vehicle has one for entering, then one for leaving.
const CHANGE_BYTES: usize = 4;

/// Bytes of the lane changes of a scenario.
pub const LANE_BYTES: usize = MAX_VEHICLES * 2 * CHANGE_BYTES;

/// Adds lane changes to scripted vehicles, if they are valid. No bytes add none.
#[must_use]
pub fn with_lane_changes(scenario: Scenario, from: &mut Unstructured<'_>) -> Scenario {
    let mut choices = Choices::read_block(from, LANE_BYTES);
    let fields: [fn(&mut VehicleSpec) -> &mut Option<LaneChange>; 2] =
        [|vehicle| &mut vehicle.enters, |vehicle| &mut vehicle.leaves];
    (0..MAX_VEHICLES * fields.len()).fold(scenario, |scenario, index| {
        let change = read_lane_change(
            &mut choices.read_sub_block(CHANGE_BYTES),
            scenario.spec().duration_s,
        );
        if change.is_none() {
            return scenario;
        }
        let changed = scenario.edited(|spec| {
            if let Some(vehicle) = spec.vehicles.get_mut(index / fields.len()) {
                *fields[index % fields.len()](vehicle) = change;
            }
        });
        changed.unwrap_or(scenario)
    })
}

fn read_lane_change(choices: &mut Choices<'_>, duration_s: f64) -> Option<LaneChange> {
    let happens = choices.chance(128);
    let kind = choices.byte() % 3;
    let change = match kind {
        0 => LaneChange::At(choices.up_to(duration_s)),
        1 => LaneChange::Gap(choices.around(10.0, [0.5, 40.0])),
        _ => LaneChange::TimeToCollision(choices.around(2.0, [0.1, 8.0])),
    };
    happens.then_some(change)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::built_in_scenario;
    use proptest::prelude::*;

    #[test]
    fn no_bytes_and_zero_bytes_keep_all_lanes() {
        let paper = built_in_scenario("paper-1").unwrap();
        for bytes in [vec![], vec![0; LANE_BYTES]] {
            assert_eq!(
                with_lane_changes(paper.clone(), &mut Unstructured::new(&bytes)),
                paper
            );
        }
    }

    proptest! {
        #![proptest_config(crumple_cases::with_cases(256))]

        #[test]
        fn many_bytes_make_changes_of_all_kinds(bytes in prop::collection::vec(128_u8..=255, LANE_BYTES)) {
            let paper = built_in_scenario("paper-1").unwrap();
            let changed = with_lane_changes(paper, &mut Unstructured::new(&bytes));
            prop_assert!(!changed.keeps_lanes());
            prop_assert!(changed.vehicles().iter().skip(1).all(VehicleSpec::keeps_lane));
        }
    }
}
