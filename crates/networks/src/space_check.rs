//! Consistency of a controller file with the spaces in which a model was trained.

use super::{InputMapping, InvalidMapping, Mapping, OutputMapping, Squash};
use crate::network::SavedModel;

/// Tolerance of comparisons with bounds, which are in single precision.
const BOUND_TOLERANCE: f64 = 1e-3;

const MAX_NAMED_INPUTS: usize = 3;

/// Returns the range of the model's actions and the corresponding accelerations in m/s²; `None` for unbounded actions.
fn action_range_mps2(output: &OutputMapping, saved: &SavedModel) -> Option<((f64, f64), [f64; 2])> {
    let actions = saved
        .action_space
        .bounds(output.answer.unwrap_or_default())?;
    if !(actions.0.is_finite() && actions.1.is_finite()) {
        return None;
    }
    let meant_mps2 = [actions.0, actions.1].map(|action| {
        let action = if output.squash == Some(Squash::Tanh) {
            action.tanh()
        } else {
            action
        };
        output.offset_mps2 + output.scale_mps2 * action
    });
    Some((
        actions,
        [
            meant_mps2[0].min(meant_mps2[1]),
            meant_mps2[0].max(meant_mps2[1]),
        ],
    ))
}

/// Rejects a mapping in which every action of the model gives the same command.
pub(super) fn check(mapping: &Mapping, saved: &SavedModel) -> Result<(), InvalidMapping> {
    let OutputMapping {
        low_mps2,
        high_mps2,
        ..
    } = mapping.output;
    match action_range_mps2(&mapping.output, saved) {
        Some(((low, high), [least_mps2, most_mps2]))
            if least_mps2 >= high_mps2 || most_mps2 <= low_mps2 =>
        {
            let problem = format!(
                "excludes every action of the model: actions of {low} to {high} mean {} to {} m/s² here, outside \
                    {low_mps2} to {high_mps2}",
                format_rounded(least_mps2),
                format_rounded(most_mps2)
            );
            Err(InvalidMapping::new("output", problem))
        }
        _ => Ok(()),
    }
}

/// Returns warnings, one line each. The observation space does not bound inputs behind `VecNormalize`.
pub(super) fn warnings(mapping: &Mapping, saved: &SavedModel, is_normalised: bool) -> Vec<String> {
    let seen = if is_normalised {
        None
    } else {
        input_warning(mapping, saved)
    };
    seen.into_iter()
        .chain(output_warning(&mapping.output, saved))
        .collect()
}

fn input_warning(mapping: &Mapping, saved: &SavedModel) -> Option<String> {
    let outside = |(index, input): (usize, &InputMapping)| {
        let ends = match (input.constant, input.quantity) {
            (Some(constant), _) => [constant; 2],
            (None, quantity) => quantity?.typical_range(),
        };
        let [a, b] = ends.map(|end| input.scaled(end));
        let (least, most) = (a.min(b), a.max(b));
        let (low, high) = saved.observation_space.bounds(index)?;
        let close = BOUND_TOLERANCE * (1.0 + low.abs().min(high.abs()));
        (least < low - close || most > high + close).then(|| {
            let seen = if least == most {
                format_rounded(least)
            } else {
                format!("{} to {}", format_rounded(least), format_rounded(most))
            };
            format!(
                "inputs[{index}] ({}) is {seen}, of {low} to {high}",
                input.name()
            )
        })
    };
    let all: Vec<String> = mapping
        .inputs
        .iter()
        .enumerate()
        .filter_map(outside)
        .collect();
    let named = all
        .get(..all.len().min(MAX_NAMED_INPUTS))
        .unwrap_or_default()
        .join("; ");
    let others = all.len().saturating_sub(MAX_NAMED_INPUTS);
    let others = if others > 0 {
        format!("; and {others} more")
    } else {
        String::new()
    };
    (!all.is_empty()).then(|| {
        format!(
            "in ordinary driving, inputs of the model leave its observation space: {named}{others}"
        )
    })
}

fn output_warning(output: &OutputMapping, saved: &SavedModel) -> Option<String> {
    let ((low, high), [least_mps2, most_mps2]) = action_range_mps2(output, saved)?;
    let OutputMapping {
        low_mps2,
        high_mps2,
        ..
    } = *output;
    let is_less =
        least_mps2 > low_mps2 + BOUND_TOLERANCE || most_mps2 < high_mps2 - BOUND_TOLERANCE;
    let is_more =
        least_mps2 < low_mps2 - BOUND_TOLERANCE || most_mps2 > high_mps2 + BOUND_TOLERANCE;
    let (least, most) = (format_rounded(least_mps2), format_rounded(most_mps2));
    let meant = format!("the model's actions of {low} to {high} mean {least} to {most} m/s² here");
    match (is_less, is_more) {
        (false, false) => None,
        (true, _) => Some(format!(
            "{meant}, of low_mps2 = {low_mps2} to high_mps2 = {high_mps2}"
        )),
        (false, true) => Some(format!(
            "{meant}, cut to low_mps2 = {low_mps2} to high_mps2 = {high_mps2}"
        )),
    }
}

fn format_rounded(value: f64) -> String {
    // Adding 0 removes the sign of -0.
    ((value * 1e3).round() / 1e3 + 0.0).to_string()
}
