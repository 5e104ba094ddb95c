//! Consistency of a controller file with the spaces in which a model was trained.

use super::{InputMapping, InvalidMapping, Mapping, OutputMapping, Squash};
use crate::network::SavedModel;
use crumple_core::digits::format_number;

/// Tolerance of comparisons with bounds, which are in single precision.
const BOUND_TOLERANCE: f64 = 1e-3;

const MAX_NAMED_INPUTS: usize = 3;

/// Actions of a model, and the accelerations that they mean.
struct ActionRange {
    /// Minimum and maximum of the model's action.
    actions: [f64; 2],
    min_mps2: f64,
    max_mps2: f64,
}

impl ActionRange {
    /// Returns the range of a model's actions; `None` if they are unbounded.
    fn new(output: &OutputMapping, saved: &SavedModel) -> Option<Self> {
        let actions = saved
            .action_space
            .bounds(output.answer.unwrap_or_default())?;
        let actions = [actions.0, actions.1];
        if !actions.iter().all(|action| action.is_finite()) {
            return None;
        }
        let [a_mps2, b_mps2] = actions.map(|action| {
            let action = if output.squash == Some(Squash::Tanh) {
                action.tanh()
            } else {
                action
            };
            output.offset_mps2 + output.scale_mps2 * action
        });
        Some(Self {
            actions,
            min_mps2: a_mps2.min(b_mps2),
            max_mps2: a_mps2.max(b_mps2),
        })
    }
}

/// Rejects a mapping in which every action of the model gives the same command.
pub(super) fn check(mapping: &Mapping, saved: &SavedModel) -> Result<(), InvalidMapping> {
    let OutputMapping {
        low_mps2,
        high_mps2,
        ..
    } = mapping.output;
    match ActionRange::new(&mapping.output, saved) {
        Some(range) if range.min_mps2 >= high_mps2 || range.max_mps2 <= low_mps2 => {
            let [low, high] = range.actions;
            let problem = format!(
                "excludes every action of the model: actions of {low} to {high} mean {} to {} m/s² here, outside \
                    {low_mps2} to {high_mps2}",
                format_rounded(range.min_mps2),
                format_rounded(range.max_mps2)
            );
            Err(InvalidMapping::new("output", problem))
        }
        _ => Ok(()),
    }
}

/// Returns warnings, one line each. The observation space does not bound inputs behind `VecNormalize`.
pub(super) fn warnings(mapping: &Mapping, saved: &SavedModel, is_normalised: bool) -> Vec<String> {
    let input = if is_normalised {
        None
    } else {
        input_warning(mapping, saved)
    };
    input
        .into_iter()
        .chain(output_warning(&mapping.output, saved))
        .collect()
}

fn input_warning(mapping: &Mapping, saved: &SavedModel) -> Option<String> {
    let outside: Vec<String> = mapping
        .inputs
        .iter()
        .enumerate()
        .filter_map(|(index, input)| {
            let bounds = saved.observation_space.bounds(index)?;
            describe_input_outside(index, input, [bounds.0, bounds.1])
        })
        .collect();
    let named = outside
        .get(..outside.len().min(MAX_NAMED_INPUTS))
        .unwrap_or_default()
        .join("; ");
    let further = outside.len().saturating_sub(MAX_NAMED_INPUTS);
    let more = if further > 0 {
        format!("; and {further} more")
    } else {
        String::new()
    };
    (!outside.is_empty()).then(|| {
        format!(
            "in ordinary driving, inputs of the model leave its observation space: {named}{more}"
        )
    })
}

/// Returns the description of an input whose typical range leaves its bounds; `None` if it does not.
fn describe_input_outside(
    index: usize,
    input: &InputMapping,
    [low, high]: [f64; 2],
) -> Option<String> {
    let ends = match (input.constant, input.quantity) {
        (Some(constant), _) => [constant; 2],
        (None, quantity) => quantity?.typical_range(),
    };
    let [a, b] = ends.map(|end| input.scaled(end));
    let min = a.min(b);
    let max = a.max(b);
    let tolerance = BOUND_TOLERANCE * (1.0 + low.abs().min(high.abs()));
    (min < low - tolerance || max > high + tolerance).then(|| {
        let range = if min == max {
            format_rounded(min)
        } else {
            format!("{} to {}", format_rounded(min), format_rounded(max))
        };
        format!(
            "inputs[{index}] ({}) is {range}, of {low} to {high}",
            input.name()
        )
    })
}

fn output_warning(output: &OutputMapping, saved: &SavedModel) -> Option<String> {
    let range = ActionRange::new(output, saved)?;
    let OutputMapping {
        low_mps2,
        high_mps2,
        ..
    } = *output;
    let is_less =
        range.min_mps2 > low_mps2 + BOUND_TOLERANCE || range.max_mps2 < high_mps2 - BOUND_TOLERANCE;
    let is_more =
        range.min_mps2 < low_mps2 - BOUND_TOLERANCE || range.max_mps2 > high_mps2 + BOUND_TOLERANCE;
    let [low, high] = range.actions;
    let [min, max] = [range.min_mps2, range.max_mps2].map(format_rounded);
    let meaning = format!("the model's actions of {low} to {high} mean {min} to {max} m/s² here");
    match (is_less, is_more) {
        (false, false) => None,
        (true, _) => Some(format!(
            "{meaning}, of low_mps2 = {low_mps2} to high_mps2 = {high_mps2}"
        )),
        (false, true) => Some(format!(
            "{meaning}, cut to low_mps2 = {low_mps2} to high_mps2 = {high_mps2}"
        )),
    }
}

/// Formats a number with at most three decimals.
fn format_rounded(value: f64) -> String {
    format_number((value * 1e3).round() / 1e3)
}
