//! Drivers of the followers in random scenarios, which results about collisions from behind must name.

use std::collections::BTreeSet;

use crumple_core::markdown::prose_name;
use crumple_sim::scenario::Scenario;
use crumple_spaces::{ChoiceSpec, DistributionSpec, ParameterSpec, ScenarioSpace};

/// End of the field of a parameter that chooses the kind of a follower.
const FOLLOWER_FIELD: &str = ".follower";
/// Kind of follower for which no vehicle follows.
const NO_FOLLOWER: &str = "none";

/// Returns the names of the drivers directly behind vehicles under test, in alphabetical order.
pub(super) fn follower_drivers<'s>(
    scenarios: impl IntoIterator<Item = &'s Scenario>,
) -> BTreeSet<String> {
    scenarios
        .into_iter()
        .flat_map(drivers_directly_behind)
        .collect()
}

fn drivers_directly_behind(scenario: &Scenario) -> impl Iterator<Item = String> {
    let vehicles = scenario.vehicles();
    let behind = (1..vehicles.len())
        .filter(|index| scenario.is_under_test(index - 1) && !scenario.is_under_test(*index));
    behind.map(|index| vehicles[index].driver.name().to_owned())
}

/// Returns the kinds of follower among which a space chooses, in its order; empty without such a parameter.
pub(super) fn follower_kinds(space: &ScenarioSpace) -> Vec<String> {
    let kinds = follower_parameter(space).and_then(|parameter| match &parameter.distribution {
        DistributionSpec::Choice(ChoiceSpec { values, .. }) => {
            Some(values.iter().map(ToString::to_string).collect())
        }
        _ => None,
    });
    kinds.unwrap_or_default()
}

fn follower_parameter(space: &ScenarioSpace) -> Option<&ParameterSpec> {
    let mut parameters = space.spec().parameters.iter();
    parameters.find(|parameter| parameter.field.ends_with(FOLLOWER_FIELD))
}

/// Returns the kind of follower of a random scenario; empty if the space has no such parameter.
pub(super) fn follower_kind(space: &ScenarioSpace, seed: u64, index: u64) -> String {
    let name = follower_parameter(space).map(|parameter| parameter.name.as_str());
    let values = space.values(&space.draw_point(seed, index));
    let mut parameters = space.coordinate_parameters().zip(values);
    let kind = parameters.find(|(parameter, _)| Some(parameter.name()) == name);
    kind.map_or_else(String::new, |(parameter, value)| {
        parameter.format_value(value)
    })
}

/// Describes followers in a sentence: "`baseline` drives the follower".
pub(super) fn describe_followers(drivers: &[String]) -> String {
    let is_named = |name: &&String| *name != NO_FOLLOWER;
    let names: Vec<_> = drivers
        .iter()
        .filter(is_named)
        .map(|name| format!("`{}`", prose_name(name)))
        .collect();
    match (names.as_slice(), names.len() < drivers.len()) {
        ([], _) => "no vehicle follows, so no collision from behind can happen".to_owned(),
        (names, has_none) => {
            let or_none = if has_none { ", or there is none" } else { "" };
            format!(
                "{} drives the follower{or_none}",
                enumerate_alternatives(names)
            )
        }
    }
}

/// Joins words as in "a, b or c".
fn enumerate_alternatives(words: &[String]) -> String {
    match words.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, others)) => format!("{} or {last}", others.join(", ")),
        None => String::new(),
    }
}

/// Explains the names of followers that are no controllers; `None` for other names.
pub(super) fn explain_follower(name: &str) -> Option<&'static str> {
    match name {
        "late" => Some("`baseline` that reacts 0.5 s later"),
        "weak" => Some("`baseline` with 0.7 times its largest deceleration"),
        _ => None,
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
            describe_followers(&follower_kinds(&built_in_space("everyday").unwrap())),
            "`baseline`, `human`, `idm`, `acc-aeb`, `late` or `weak` drives the follower, or there is none"
        );
        assert_eq!(
            described("alone"),
            "no vehicle follows, so no collision from behind can happen"
        );
    }
}
