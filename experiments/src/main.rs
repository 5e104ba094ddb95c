//! Runs the experiments behind the reports and the corpora: `cargo run --release -p crumple-experiments -- NAME
//! [ARGUMENT...]`.
//!
//! Each module documents its output and arguments. Without a name the program lists the experiments.

mod both_sides;
mod chasing_cars;
mod falsification;
mod filter_errors;
mod learning_curve;
mod plants_and_sensors;
mod scenario_of_input;
mod search_comparison;
mod transmission;

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

use std::process::ExitCode;

type ExperimentError = Box<dyn std::error::Error + Send + Sync>;

struct Experiment {
    name: &'static str,
    arguments: &'static str,
    run: fn(&[String]) -> Result<(), ExperimentError>,
}

const EXPERIMENTS: [Experiment; 8] = [
    Experiment {
        name: "both_sides",
        arguments: "RUNS CONTROLLER... [FIGURE.svg] [MEASURED.csv] [space=SPACE]... [seed=N] [estimator=truth] \
                    [follower=CHANGE]",
        run: both_sides::run,
    },
    Experiment {
        name: "chasing_cars",
        arguments: "FIRST_SEED SEEDS [METHOD]",
        run: chasing_cars::run,
    },
    Experiment {
        name: "filter_errors",
        arguments: "SCENARIO [FACTOR]",
        run: filter_errors::run,
    },
    Experiment {
        name: "learning_curve",
        arguments: "TABLE.csv CONFIGURATION FIGURE.svg",
        run: learning_curve::run,
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
        name: "transmission",
        arguments: "FIRST_SEED SEEDS [METHOD]",
        run: transmission::run,
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
        } in &EXPERIMENTS
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
