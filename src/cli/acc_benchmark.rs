//! `crumple benchmark acc`: proof of a network for adaptive cruise control.

use std::path::{Path, PathBuf};
use std::time::Instant;

use clap::{Args, value_parser};
use crumple_evidence::{CruisePlan, CruiseProof, CruiseSamples};
use crumple_verify::{ProvedClaim, WorkLimit, check_with};
use crumple_world::network::NetworkFile;

use super::simulate::OutputFormat;
use super::{CliError, output, reach};

/// Prove that a network keeps its distance: ARCH-COMP AINNCS, adaptive cruise control
#[derive(Args)]
#[command(after_long_help = "\
The benchmark has two cars with x' = v, v' = γ, γ' = -2 γ + 2 a - 0.0001 v². The leader has a = -2. The network \
computes the a of the ego vehicle every 0.1 s from (30, 1.4, v_ego, D_rel, v_rel). Initially x_lead is in [90, 110], \
v_lead in [32, 32.2], x_ego in [10, 11], v_ego in [30, 30.2] and γ = 0. The specification is D_rel >= 10 + 1.4 v_ego \
for 5 s (docs/acc-benchmark.md). Exit code 1 if the proved margin is negative.

crumple does not contain the benchmark's networks; their repository states the licence. The official .onnx file \
subtracts 1 from every input, and the .mat file with the same weights does not: they are two networks.

Example:
  crumple benchmark acc --network corpora/controllers/acc-5x20.onnx --certificate acc.json")]
pub(super) struct AccBenchmark {
    /// Network: F.onnx, or a model of Stable-Baselines3, F.zip
    #[arg(long, value_name = "F")]
    network: PathBuf,
    /// Number of parts into which the initial D_rel is divided: 1 to 10 000
    #[arg(long, value_name = "N", default_value_t = DEFAULT_CELLS, value_parser = value_parser!(u32).range(1..=10_000))]
    cells: u32,
    /// Random initial states to simulate in addition to the corners of the box: 1 to 10 000 000
    #[arg(long, value_name = "N", default_value_t = 20_000, value_parser = value_parser!(u32).range(1..=10_000_000))]
    samples: u32,
    /// Seed of the random initial states
    #[arg(long, value_name = "N", default_value_t = 0)]
    seed: u64,
    /// File for the certificate; the file of the network goes next to it
    #[arg(long, value_name = "FILE")]
    certificate: Option<PathBuf>,
    /// Output format
    #[arg(long, value_enum, default_value = "text")]
    format: OutputFormat,
}

/// More cells cost more time than they gain in margin.
const DEFAULT_CELLS: u32 = 16;

/// Loads the network of the benchmark.
pub(super) fn load_network(path: &Path) -> Result<CruisePlan, CliError> {
    let file = NetworkFile::load(path).map_err(CliError::input)?;
    CruisePlan::new(file).map_err(|error| CliError::at(path, error))
}

impl AccBenchmark {
    pub(super) fn run(self) -> Result<(), CliError> {
        let place = self.network.display();
        let failed = |error| CliError::Input(format!("{place}: {error}"));
        let plan = load_network(&self.network)?;
        let shape = plan.shape();
        let proved = plan.prove(self.cells).map_err(failed)?;
        let begin = Instant::now();
        let accepted = check_with(&proved.certificate, Some(plan.network_bytes()), WorkLimit::UNLIMITED)
            .map_err(|rejection| CliError::Gate(format!("not shown: {rejection}")))?;
        let checked_s = begin.elapsed().as_secs_f64();
        let sampled = plan.sample(self.samples as usize, self.seed);
        if let Some(path) = &self.certificate {
            reach::write_certificate(path, &proved.certificate, plan.network_bytes())?;
        }
        let result = serde_json::json!({
            "network": place.to_string(), "shape": shape, "cells": self.cells,
            "proved": { "margin_m": proved.margin_m, "x_ego_m": proved.x_ego_m, "seconds": proved.seconds },
            "checked_in_s": checked_s, "sampled": sampled,
        });
        let words = || self.text(&shape, &proved, (&accepted, checked_s), &sampled);
        let printed = output::print_result(self.format, &result, words);
        let gate = if proved.margin_m >= 0.0 {
            Ok(())
        } else {
            Err(CliError::Gate("the proof does not show that the network keeps the distance".to_owned()))
        };
        CliError::gate_first(gate, printed)
    }

    fn text(
        &self,
        shape: &str,
        proved: &CruiseProof,
        (accepted, checked_s): (&ProvedClaim, f64),
        sampled: &CruiseSamples,
    ) -> String {
        let width = |[low, high]: [f64; 2]| high - low;
        // Round each bound to the side on which it holds.
        let down = |value: f64| (100.0 * value).floor() / 100.0;
        let up = |value: f64| (100.0 * value).ceil() / 100.0;
        format!(
            "adaptive cruise control (ARCH-COMP AINNCS), a network {shape}, D_rel divided into {cells} parts\n\x20 \
             D_rel - 10 - 1.4 v_ego    at least {:.2} m proved, {:.2} m the smallest in {} simulations\n\x20 width of \
             x_ego at 5 s     at most {:.2} m proved, {:.2} m in the simulations\n\x20 time                      {:.3} \
             s to prove, {checked_s:.3} s to check\naccepted: {accepted}\n",
            down(proved.margin_m),
            sampled.margin_m,
            sampled.samples,
            up(width(proved.x_ego_m)),
            width(sampled.x_ego_m),
            proved.seconds,
            cells = self.cells,
        )
    }
}
