//! `crumple benchmark`: public problems for proofs.

use clap::{Args, Subcommand};

use super::CliError;
use super::acc_benchmark::AccBenchmark;

/// Run a public benchmark of neural-network verification
#[derive(Args)]
pub(super) struct BenchmarkCommand {
    #[command(subcommand)]
    problem: BenchmarkSubcommand,
}

#[derive(Subcommand)]
enum BenchmarkSubcommand {
    Acc(AccBenchmark),
}

impl BenchmarkCommand {
    pub(super) fn run(self) -> Result<(), CliError> {
        let BenchmarkSubcommand::Acc(cruise) = self.problem;
        cruise.run()
    }
}
