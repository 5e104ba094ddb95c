//! Avoidability of a scenario, and forward reachability of an actor.

use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;

use crumple_core::observer::Quiet;
use crumple_evidence::{BoxSpec, ReachPlan};
use crumple_search::worst_case::{AvoidOptions, avoid};
use crumple_sim::scenario::PAPER_STEP_S;

use crate::clock::{cpu_time_s, min_cpu_time_s};
use crate::table::Measurement;
use crate::work::networks::widened_reference;

pub fn measure(say: &mut dyn FnMut(Measurement)) {
    let scenario = crumple_sim::scenario::built_in_scenario("paper-1").expect("built in");
    for (grid_s, target_s) in [(0.1, 0.05), (0.01, 1.0)] {
        let options = AvoidOptions {
            grid_s: Some(grid_s),
            ..AvoidOptions::default()
        };
        let [seconds] = min_cpu_time_s(
            3,
            [&mut || _ = black_box(avoid(&scenario, options).expect("the grid fits"))],
        );
        say(Measurement::at_most(
            target_s,
            "s",
            format!("avoidability of paper-1, grid of {grid_s} s"),
            seconds,
        ));
    }
    // 0.1 s as in the policy's training, and a decision at every step as in the paper.
    [0.1, PAPER_STEP_S]
        .into_iter()
        .for_each(|interval_s| say(reach(interval_s)));
}

fn reach(interval_s: f64) -> Measurement {
    let spec = BoxSpec::from_toml(BOX, Path::new("box")).expect("a box");
    let plan = ReachPlan::new(Arc::new(widened_reference(interval_s)), &spec).expect("fits");
    let start_s = cpu_time_s();
    let verified = 100.0 * plan.partition(0, &Quiet).expect("fits").shares[0].verified;
    let name = format!(
        "reach of a 3 x 256 actor that decides every {interval_s} s, one box, 1500 steps ({verified:.0} % verified)"
    );
    Measurement::at_most(1.0, "s", name, cpu_time_s() - start_s)
}

/// Small enough to be verified without a bisection, so that all 1500 steps are computed.
const BOX: &str = "version = 1
about = \"\"
scenario = \"paper-1\"

[ranges]
gap_ahead_m = { low = 15.99, high = 16.01 }
gap_behind_m = { low = 15.99, high = 16.01 }
";
