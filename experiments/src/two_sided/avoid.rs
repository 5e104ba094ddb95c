//! States outside the set of the two-sided shield, compared with the best escape that `avoid` finds.

use rayon::prelude::*;

use super::{SEED, parse_scenarios, start};
use crate::ExperimentError;
use crumple::search::worst_case::{AvoidOptions, AvoidanceVerdict, avoid};
use crumple::sim::control::TwoSidedSettings;
use crumple::sim::scenario::{Brake, Driver, LeadProfile, Scenario};
use crumple::spaces::ScenarioSpace;

/// Share of the limit at which a state near the boundary has a plan.
const NEAR_SHARE: f64 = 0.8;

/// Largest gap of an escape that does not contradict the set, in metres.
const MAX_GAP_M: f64 = 0.3;

/// Scenarios that are tried for each one that is wanted.
const MAX_TRIES: u64 = 200;

/// Prints how many states outside the set have an escape, and how large its gap is.
pub(super) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let (space, count, settings) = parse_scenarios(arguments)?;
    let scenarios = outside(&space, count, &settings)?;
    let gaps_m: Vec<Option<f64>> = scenarios.par_iter().map(escape_gap_m).collect();
    let undecided = gaps_m.iter().filter(|gap_m| gap_m.is_none()).count();
    let decided: Vec<f64> = gaps_m.iter().flatten().copied().collect();
    let large: Vec<f64> = decided
        .iter()
        .copied()
        .filter(|&gap_m| gap_m > MAX_GAP_M)
        .collect();
    println!(
        "{} scenarios outside the set (half of them near its boundary): {undecided} undecided, {} without a collision \
         by more than {MAX_GAP_M} m, {} with a smaller gap, {} unavoidable; largest gap {:.2} m",
        scenarios.len(),
        large.len(),
        decided
            .iter()
            .filter(|&&gap_m| gap_m > 0.0 && gap_m <= MAX_GAP_M)
            .count(),
        decided.iter().filter(|&&gap_m| gap_m <= 0.0).count(),
        decided.iter().copied().fold(0.0, f64::max)
    );
    for (scenario, gap_m) in scenarios.iter().zip(&gaps_m) {
        if gap_m.is_some_and(|gap_m| gap_m > MAX_GAP_M) {
            println!("{}: {gap_m:?}", scenario.spec().name);
        }
    }
    Ok(())
}

/// Returns random scenarios outside the set, whose leader brakes at its limit from the start. Every second one has a
/// plan at a slightly lower level.
fn outside(
    space: &ScenarioSpace,
    count: u64,
    settings: &TwoSidedSettings,
) -> Result<Vec<Scenario>, ExperimentError> {
    let mut near = Vec::new();
    let mut far = Vec::new();
    let half = (count / 2) as usize;
    for index in 0..count * MAX_TRIES {
        if near.len() == half && far.len() == half {
            break;
        }
        let scenario = space.draw(SEED, index)?;
        let (params, mut meter) = start(&scenario, settings)?;
        if meter.keeps(params.level_mps2) {
            continue;
        }
        let list = if meter.keeps(NEAR_SHARE * params.level_mps2) {
            &mut near
        } else {
            &mut far
        };
        if list.len() < half {
            list.push(with_braking_leader(&scenario, params.level_mps2)?);
        }
    }
    near.extend(far);
    Ok(near)
}

fn with_braking_leader(scenario: &Scenario, rate_mps2: f64) -> Result<Scenario, ExperimentError> {
    Ok(scenario.edited(|spec| {
        if let Some(leader) = spec.vehicles.first_mut() {
            leader.driver = Driver::Profile(LeadProfile::Brake(Brake {
                onset_s: 0.0,
                rate_mps2,
            }));
        }
    })?)
}

/// Returns the smallest gap of the best escape, 0 if the collision is unavoidable, or `None` if this is undecided.
fn escape_gap_m(scenario: &Scenario) -> Option<f64> {
    match avoid(scenario, AvoidOptions::default()).ok()?.verdict {
        AvoidanceVerdict::Avoidable(escape) => Some(escape.min_gap_m),
        AvoidanceVerdict::Unavoidable(_) => Some(0.0),
        AvoidanceVerdict::Undecided(_) => None,
    }
}
