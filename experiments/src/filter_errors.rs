//! Prints the `observation_error` of a box for `crumple verify reach --box`: six standard deviations of each Kalman
//! filter output in a built-in scenario, times a factor (1 by default):
//!
//! ```text
//! cargo run --release -p crumple-experiments -- filter_errors paper-1 0.03
//! ```
//!
//! Covers noise only, in steady state before a measurement, without the lag after another vehicle brakes. Speeds and
//! accelerations of neighbours combine the ego's estimates and those of the gap filter, whose noise is independent.

use crate::ExperimentError;
use crumple_sim::estimate::EgoTuning;
use crumple_sim::scenario::built_in_scenario;

/// Number of standard deviations, as for the shield.
const DEVIATIONS: f64 = 6.0;

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let mut arguments = arguments.iter();
    let name = arguments
        .next()
        .ok_or("name a built-in scenario, and perhaps a factor")?;
    let factor: f64 = arguments.next().map_or(Ok(1.0), |text| text.parse())?;
    let scenario =
        built_in_scenario(name).ok_or_else(|| format!("{name}: no built-in scenario"))?;
    let tuning = EgoTuning::new(scenario.spec().step_s, &scenario.spec().sensors);
    let [_, own_mps, own_mps2] = tuning.position().steady_deviations();
    let [gap_m, rate_mps, rate_mps2] = tuning.gap().steady_deviations();
    let other_mps = own_mps.hypot(rate_mps);
    let other_mps2 = own_mps2.hypot(rate_mps2);
    let deviations = [
        gap_m, gap_m, other_mps, own_mps, other_mps, other_mps2, own_mps2, other_mps2,
    ];
    let errors: Vec<String> = deviations
        .iter()
        .map(|deviation| format!("{:.4e}", factor * DEVIATIONS * deviation))
        .collect();
    println!("observation_error = [{}]", errors.join(", "));
    Ok(())
}
