//! Drivers of the followers in random scenarios, which results about collisions from behind must name.

use std::collections::BTreeSet;

use crumple_sim::scenario::Scenario;

/// Returns the names of the drivers directly behind vehicles under test, in alphabetical order.
pub(super) fn follower_drivers<'s>(
    scenarios: impl IntoIterator<Item = &'s Scenario>,
) -> BTreeSet<String> {
    scenarios.into_iter().flat_map(drivers_behind).collect()
}

fn drivers_behind(scenario: &Scenario) -> impl Iterator<Item = String> {
    let vehicles = scenario.vehicles();
    let behind = (1..vehicles.len())
        .filter(|index| scenario.is_under_test(index - 1) && !scenario.is_under_test(*index));
    behind.map(|index| vehicles[index].driver.name().to_owned())
}

/// Describes followers in a sentence: "`baseline` drives the follower".
pub(super) fn describe_followers(drivers: &[String]) -> String {
    let names: Vec<_> = drivers.iter().map(|name| format!("`{name}`")).collect();
    match names.as_slice() {
        [] => "no vehicle follows, so no collision from behind can happen".to_owned(),
        names => format!("{} drives the follower", names.join(" or ")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_spaces::built_in_space;

    #[test]
    fn followers_of_built_in_spaces_are_named() {
        let described = |space: &str| {
            let space = built_in_space(space).unwrap();
            let scenarios: Vec<_> = (0..100)
                .map(|index| space.draw(0, index).unwrap())
                .collect();
            let drivers: Vec<_> = follower_drivers(&scenarios).into_iter().collect();
            describe_followers(&drivers)
        };
        assert_eq!(described("high-risk"), "`baseline` drives the follower");
        assert_eq!(described("high-risk-human"), "`human` drives the follower");
        assert_eq!(
            described("traffic"),
            "`acc-aeb` or `idm` drives the follower"
        );
        assert_eq!(
            described("alone"),
            "no vehicle follows, so no collision from behind can happen"
        );
    }
}
