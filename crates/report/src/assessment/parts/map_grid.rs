//! The grid of a failure map: two parameters of a space, their values, and the scenario of every cell.

use serde::{Deserialize, Serialize};

use crate::assessment::{AssessError, Rounded};
use crumple_world::scenario::Scenario;
use crumple_world::scenario::space::{ScenarioSpace, SpaceParameter};

/// A parameter that varies over a map.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FailureMapAxis {
    /// Name of the parameter in the space.
    pub parameter: String,
    /// Description for readers.
    pub title: String,
    /// Unit of the parameter.
    pub unit: String,
    /// Lower end of the first cell.
    pub low: Rounded<2>,
    /// Upper end of the last cell.
    pub high: Rounded<2>,
    /// Value in each column from the left, or in each row from the bottom.
    pub values: Vec<Rounded<2>>,
    /// True if the values grow by a factor rather than by a step.
    #[serde(rename = "by_factor")]
    pub is_logarithmic: bool,
}

/// A parameter that does not vary.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct FixedParameter {
    /// Name of the parameter in the space.
    pub parameter: String,
    /// Formatted value with its unit.
    pub value: String,
}

impl FailureMapAxis {
    /// Creates an axis whose values are the rounded centres of the cells over the parameter's range.
    pub(super) fn new(space: &ScenarioSpace, parameter: &SpaceParameter, title: &str, cells: usize) -> Self {
        let [low, high] = parameter.range();
        let at = |share: f64| {
            let mut point = space.point(&space.nominal());
            set_parameter(&mut point, parameter, share);
            space.values(&point).get(parameter.coordinates().start).copied().unwrap_or(low)
        };
        let values = (0..cells).map(|cell| Rounded::new(at((cell as f64 + 0.5) / cells as f64))).collect();
        // On a linear scale the centre of the range is its arithmetic mean.
        let by_factor = (at(0.5) - 0.5 * (low + high)).abs() > 1e-6 * (high - low);
        Self {
            parameter: parameter.name().to_owned(),
            title: title.to_owned(),
            unit: parameter.unit().to_owned(),
            low: low.into(),
            high: high.into(),
            values,
            is_logarithmic: by_factor,
        }
    }

    pub(super) fn normalize(&self, value: f64) -> f64 {
        let (low, high) = (self.low.value(), self.high.value());
        if self.is_logarithmic { (value / low).ln() / (high / low).ln() } else { (value - low) / (high - low) }
    }
}

fn set_parameter(values: &mut [f64], parameter: &SpaceParameter, to: f64) {
    for value in values.get_mut(parameter.coordinates()).unwrap_or_default() {
        *value = to;
    }
}

/// Returns the scenario of every cell, row by row from the top, each row from the left.
pub(super) fn grid_scenarios(
    space: &ScenarioSpace,
    (across, up): (&SpaceParameter, &SpaceParameter),
    axes: &(FailureMapAxis, FailureMapAxis),
) -> Result<Vec<Scenario>, AssessError> {
    let at = |x: Rounded<2>, y: Rounded<2>| {
        let mut values = space.nominal();
        set_parameter(&mut values, across, x.value());
        set_parameter(&mut values, up, y.value());
        Ok(space.scenario(&values)?)
    };
    let cells = axes.1.values.iter().rev().flat_map(|&y| axes.0.values.iter().map(move |&x| (x, y)));
    cells.map(|(x, y)| at(x, y)).collect()
}

pub(super) fn fixed_parameters(
    space: &ScenarioSpace,
    varied: (&SpaceParameter, &SpaceParameter),
) -> Vec<FixedParameter> {
    let others = space.parameters().iter().filter(|p| p.name() != varied.0.name() && p.name() != varied.1.name());
    let one = |parameter: &SpaceParameter| {
        let mut shown: Vec<String> = parameter.nominal().iter().map(|&value| parameter.format_value(value)).collect();
        shown.dedup();
        let unit = if parameter.unit() == "1" { "" } else { parameter.unit() };
        let value = format!("{} {unit}", shown.join(", "));
        FixedParameter { parameter: parameter.name().to_owned(), value: value.trim_end().to_owned() }
    };
    others.map(one).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_world::scenario::space::built_in_space;

    #[test]
    fn an_axis_by_factors_is_even_in_the_logarithm() {
        let space = built_in_space("high-risk").unwrap();
        let axis = |name: &str| {
            let parameter = space.parameters().iter().find(|p| p.name() == name).unwrap();
            FailureMapAxis::new(&space, parameter, "", 8)
        };
        for (axis, by_factor) in [(axis("gap_behind_m"), true), (axis("speed_mps"), false)] {
            assert_eq!(axis.is_logarithmic, by_factor);
            for (cell, value) in axis.values.iter().enumerate() {
                assert!((axis.normalize(value.value()) - (cell as f64 + 0.5) / 8.0).abs() < 2e-3);
            }
        }
    }
}
