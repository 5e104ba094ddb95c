//! Evaluations that a search method needs to falsify each specification of the automatic transmission.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- transmission 41000 100 [METHOD]        # first seed, seeds
//! ```
//! Inputs of instance 1 are arbitrary; here they have a piece for each second. Instance 2 has pieces of 5 s.

mod model;

use self::model::{DURATION_S, MAX_BRAKE, MAX_THROTTLE, STEP_S, simulate};
use crate::ExperimentError;
use crate::falsification::{Problem, print_table};
use crumple::search::falsify::UnitCube;
use crumple::world::measure::stl::Formula;

/// Duration of a piece of the inputs, in seconds, of each instance.
const PIECE_S: [usize; 2] = [1, 5];

/// Returns names and formulas of the ten specifications. A next sample of the published AT51 to AT54 is one within 0.1 s
/// here, as in the published formulas without next; comparisons of the gear with numbers are half a gear away.
fn specifications() -> Vec<(String, String)> {
    let low_rpm = "always[0,30] rpm < 3000";
    let slow = |until_s: u32, mph: u32| format!("({low_rpm} implies always[0,{until_s}] speed < {mph})");
    let [a, b, c] = [slow(4, 35), slow(8, 50), slow(20, 65)];
    let named = |name: &str, formula: String| (name.to_owned(), formula);
    let mut all = vec![
        named("AT1", "always[0,20] speed < 120".to_owned()),
        named("AT2", "always[0,10] rpm < 4750".to_owned()),
    ];
    for gear in 1..=4 {
        let here = format!("(gear > {} and gear < {})", f64::from(gear) - 0.5, f64::from(gear) + 0.5);
        let shifted = format!("not {here} and eventually[0.01,0.1] {here}");
        let stays = format!("eventually[0.01,0.1] always[0,2.5] {here}");
        all.push((format!("AT5{gear}"), format!("always[0,30] ({shifted} implies {stays})")));
    }
    let all_three = format!("{a} and {b} and {c}");
    all.extend([named("AT6a", a), named("AT6b", b), named("AT6c", c), named("AT6abc", all_three)]);
    all
}

/// Returns throttle and brake at a time, from a point of the unit cube with pieces of `piece_s`.
fn inputs(point: &[f64], piece_s: usize, t_s: f64) -> [f64; 2] {
    let pieces = DURATION_S / piece_s;
    // Half a step more, so that rounding does not move a border.
    let piece = (((t_s + 0.5 * STEP_S) / piece_s as f64) as usize).min(pieces - 1);
    let at = |index: usize| point.get(index).copied().unwrap_or(0.0);
    [MAX_THROTTLE * at(piece), MAX_BRAKE * at(pieces + piece)]
}

fn robustness(formula: &Formula, point: &[f64], piece_s: usize) -> Result<f64, ExperimentError> {
    Ok(formula.robustness(&simulate(|t_s| inputs(point, piece_s, t_s))?)?)
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut problems = Vec::new();
    for (instance, piece_s) in PIECE_S.into_iter().enumerate() {
        let pieces = DURATION_S / piece_s;
        for (name, text) in specifications() {
            let formula: Formula = text.parse()?;
            problems.push(Problem {
                name: format!("{name}, instance {}", instance + 1),
                cube: UnitCube::new([pieces, pieces])?,
                evaluate: Box::new(move |point| {
                    let value = robustness(&formula, point, piece_s)?;
                    Ok((value, value < 0.0))
                }),
            });
        }
    }
    print_table(&problems, arguments)
}
