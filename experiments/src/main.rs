//! Runs the experiments behind the reports and the corpora: `cargo run --release -p crumple-experiments -- NAME
//! [ARGUMENT...]`.
//!
//! Each module documents its output and arguments. Without a name the program lists the experiments.

mod both_sides;
mod car_brakes;
mod chasing_cars;
mod controllers;
mod falsification;
mod filter_errors;
mod follower_kinds;
mod learning_curve;
mod openacc;
mod plants_and_sensors;
mod scenario_of_input;
mod search_comparison;
mod steady_drives;
mod transmission;
mod two_sided;

/// Problems that the benches measure, too.
#[allow(
    dead_code,
    unreachable_pub,
    reason = "a problem has functions that only a bench uses"
)]
#[path = "../../benches/work"]
mod work {
    pub(crate) mod chasing_cars;
}

/// Closed loops that the tests of the simulator simulate, too.
#[allow(dead_code, reason = "the tests also measure times")]
#[path = "../../crates/sim/tests/two_sided/closed_loop.rs"]
mod closed_loop;

use std::process::ExitCode;

type ExperimentError = Box<dyn std::error::Error + Send + Sync>;

struct Experiment {
    name: &'static str,
    arguments: &'static str,
    run: fn(&[String]) -> Result<(), ExperimentError>,
}

const EXPERIMENTS: &[Experiment] = &[
    Experiment {
        name: "both_sides",
        arguments: "RUNS CONTROLLER... [FIGURE.svg] [MEASURED.csv] [space=SPACE]... [seed=N] [estimator=truth] \
                    [follower=CHANGE]",
        run: both_sides::run,
    },
    Experiment {
        name: "car_brakes",
        arguments: "predict ATTEMPT TESTS.csv FOLDER | validate ATTEMPT TESTS.csv FOLDER | sensitivity ATTEMPT \
                    TESTS.csv",
        run: car_brakes::run,
    },
    Experiment {
        name: "chasing_cars",
        arguments: "FIRST_SEED SEEDS [METHOD]",
        run: chasing_cars::run,
    },
    Experiment {
        name: "controllers",
        arguments: "ROWS [draws=N] [recordings=FOLDER] [controller=NAME]...",
        run: controllers::run,
    },
    Experiment {
        name: "filter_errors",
        arguments: "SCENARIO [FACTOR]",
        run: filter_errors::run,
    },
    Experiment {
        name: "follower_kinds",
        arguments: "RUNS SPACE REFERENCE CONTROLLER... [seed=N] [estimator=truth]",
        run: follower_kinds::run,
    },
    Experiment {
        name: "learning_curve",
        arguments: "TABLE.csv CONFIGURATION FIGURE.svg",
        run: learning_curve::run,
    },
    Experiment {
        name: "openacc",
        arguments: "RECORDINGS FILES.sha256 OUT",
        run: openacc::run,
    },
    Experiment {
        name: "plants_and_sensors",
        arguments: "RUNS CONTROLLER...",
        run: plants_and_sensors::run,
    },
    Experiment {
        name: "scenario_of_input",
        arguments: "INPUT",
        run: scenario_of_input::run,
    },
    Experiment {
        name: "search_comparison",
        arguments: "EVALUATIONS SEEDS",
        run: search_comparison::run,
    },
    Experiment {
        name: "steady_drives",
        arguments: "RUNS REFERENCE CONTROLLER... [seed=N]",
        run: steady_drives::run,
    },
    Experiment {
        name: "transmission",
        arguments: "FIRST_SEED SEEDS [METHOD]",
        run: transmission::run,
    },
    Experiment {
        name: "two_sided",
        arguments: "loops RUNS [FIRST] | shares SPACE RUNS [SETTING=NUMBER]... | runs SPACE RUNS CONTROLLER... | \
                    avoid SPACE RUNS [SETTING=NUMBER]...",
        run: two_sided::run,
    },
];

fn main() -> ExitCode {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let named = arguments.split_first();
    let selected = named.and_then(|(name, rest)| {
        Some((
            EXPERIMENTS
                .iter()
                .find(|experiment| experiment.name == name)?,
            rest,
        ))
    });
    let Some((experiment, rest)) = selected else {
        eprintln!("error: name an experiment:");
        for Experiment {
            name, arguments, ..
        } in EXPERIMENTS
        {
            eprintln!("  {name} {arguments}");
        }
        return ExitCode::from(2);
    };
    match (experiment.run)(rest) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!(
                "error: {error}; usage: {} {}",
                experiment.name, experiment.arguments
            );
            ExitCode::from(2)
        }
    }
}
