//! Cost of a campaign besides its simulations.

use crumple_controllers::Controllers;
use crumple_core::observer::Quiet;
use crumple_search::falsify::Method;
use crumple_search::falsify::campaign::{Campaign, CampaignReader};
use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, simulate_batch};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;
use crumple_spaces::built_in_space;
use crumple_store::study::Study;

use crate::clock::wall_time_s;
use crate::table::Measurement;
use crate::work::rollouts::{built_in, runs};

const BUDGET: u64 = 500_000;
/// Evaluations that are simulated again, as a random sample.
const RESIMULATED: usize = 50_000;
const BLOCK: usize = 256;

/// Measures the time share of simulation in a campaign of a million scenarios with a full log.
pub fn end_to_end(say: &mut dyn FnMut(Measurement)) {
    for (space, controller) in [("paper", "baseline"), ("traffic", "idm")] {
        let folder = tempfile::tempdir().expect("a folder");
        let at = folder.path().join("campaign");
        let campaign = Campaign {
            estimator: EstimatorKind::Truth,
            ..Campaign::new(
                BuiltInController::from_name(controller).expect("built in"),
                built_in_space(space).expect("built in"),
            )
            .with_method(Method::Uniform)
            .with_budget(BUDGET)
        };
        let start_s = wall_time_s();
        campaign.run(&at, false, &Quiet).expect("runs");
        let each_s = (wall_time_s() - start_s) / (2 * BUDGET) as f64;
        let look = CampaignReader::open(&at, Controllers::default()).expect("is there");
        let scenario = |values: &[f64]| look.scenario(values).expect("was run");
        let scenarios: Vec<Scenario> = look.evaluations()[..RESIMULATED]
            .iter()
            .map(|(_, evaluated)| scenario(&evaluated.values))
            .collect();
        let simulated_s: f64 = scenarios
            .chunks(BLOCK)
            .map(|block| simulation_time_s(block, controller))
            .sum();
        let name = format!(
            "{} scenarios of `{space}` under {controller} end to end, share of their simulation",
            2 * BUDGET
        );
        say(Measurement::at_least(
            70.0,
            "%",
            name,
            100.0 * simulated_s / RESIMULATED as f64 / each_s,
        ));
    }
}

fn simulation_time_s(scenarios: &[Scenario], controller: &str) -> f64 {
    let runs = runs(scenarios, built_in(controller), EstimatorKind::Truth);
    let start_s = wall_time_s();
    std::hint::black_box(simulate_batch(
        &runs,
        RecordingLevel::Summary,
        |_, result| result.outcome,
    ));
    wall_time_s() - start_s
}
