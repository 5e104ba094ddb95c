//! Adaptive cruise control benchmark of ARCH-COMP AINNCS: proof and random simulations of a network.
//! `crumple_verify::cruise` has the problem and the proof. The simulation here is independent of it: a classic
//! Runge-Kutta method with a tenth of the period, and the network in single precision.

use std::time::Instant;

use crumple_verify::cruise::{
    self, CLIP_LIMIT, CruiseBoundsError, CruiseClaim, INITIAL_SET, LEAD_ACCEL_MPS2, PERIOD_S, PERIODS, SAFE_DISTANCE,
    SET_SPEED_AND_TIME_GAP,
};
use crumple_verify::reach::{NeuralController, controller_file_name};
use crumple_verify::{Certificate, Statement};
use rand::RngExt;
use rayon::prelude::*;
use serde::Serialize;

use super::certificate_without_scenario;
use crumple_core::digest::sha256;
use crumple_world::control::{
    HistoryPadding, InputMapping, InvalidMapping, Mapping, NetworkController, ObservedQuantity, OutputMapping,
};
use crumple_world::network::{FeedForward, NetworkFile};
use crumple_world::policy::Workspace;
use crumple_world::random::{self, Purpose};

/// Runge-Kutta steps per period, and initial states per batch.
const STEPS_PER_PERIOD: usize = 10;
const BATCH_SIZE: usize = 500;

/// Reason why a network cannot be proved.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CruiseError {
    /// The network does not fit the benchmark.
    #[error("does not fit the benchmark: {0}")]
    Mapping(#[from] InvalidMapping),
    /// The checker cannot read the network.
    #[error("{0}")]
    Unreadable(String),
    /// The bounds do not suffice.
    #[error(transparent)]
    Unproved(#[from] CruiseBoundsError),
}

/// A network in the benchmark.
pub struct CruisePlan {
    network: NetworkController,
    bytes: Vec<u8>,
    actor: NeuralController,
}

/// Proof of a network.
#[derive(Debug, Clone, PartialEq)]
pub struct CruiseProof {
    /// Certificate, not yet checked.
    pub certificate: Certificate,
    /// Lower bound of D_rel - 10 - 1.4 v_ego over the box and all times, in metres.
    pub margin_m: f64,
    /// Bounds of x_ego at the end, in metres.
    pub x_ego_m: [f64; 2],
    /// Duration of the proof, in seconds.
    pub seconds: f64,
}

/// Results of the corners of the box and of random initial states.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CruiseSamples {
    /// Number of initial states.
    pub samples: usize,
    /// Smallest D_rel - 10 - 1.4 v_ego, in metres.
    pub margin_m: f64,
    /// Smallest and largest x_ego at the end, in metres.
    pub x_ego_m: [f64; 2],
}

impl CruisePlan {
    /// Creates a plan for a network with inputs (30, 1.4, v_ego, D_rel, v_rel).
    ///
    /// # Errors
    /// [`CruiseError`] if the network has other inputs, or more than one output.
    pub fn new(file: NetworkFile) -> Result<Self, CruiseError> {
        let answers = file.network.outputs();
        if answers != 1 {
            let problem = format!("has {answers} outputs, and the benchmark needs 1");
            return Err(InvalidMapping { field: "network".to_owned(), problem }.into());
        }
        let input = |quantity, constant| InputMapping {
            variable: None,
            quantity,
            constant,
            offset: 0.0,
            scale: 1.0,
            low: -CLIP_LIMIT,
            high: CLIP_LIMIT,
            absent: None,
        };
        let seen = [ObservedQuantity::SpeedMps, ObservedQuantity::GapAheadM, ObservedQuantity::RelativeSpeedAheadMps];
        let constants = SET_SPEED_AND_TIME_GAP.map(|constant| input(None, Some(constant)));
        let mapping = Mapping {
            decision_interval_s: Some(PERIOD_S),
            history: 1,
            history_padding: HistoryPadding::First,
            newest_first: false,
            inputs: constants.into_iter().chain(seen.map(|quantity| input(Some(quantity), None))).collect(),
            output: OutputMapping {
                variable: None,
                answer: None,
                squash: None,
                scale_mps2: 1.0,
                offset_mps2: 0.0,
                low_mps2: -CLIP_LIMIT,
                high_mps2: CLIP_LIMIT,
            },
        };
        let network = NetworkController::new(file, mapping)?;
        let bytes = network.checker_file()?;
        let actor = NeuralController::from_bytes(&bytes).map_err(CruiseError::Unreadable)?;
        Ok(Self { network, bytes, actor })
    }

    /// Returns the widths of the network's layers.
    #[must_use]
    pub fn shape(&self) -> String {
        self.network.network().shape()
    }

    /// Returns the file of the network, for the checker.
    #[must_use]
    pub fn network_bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Computes bounds with D_rel divided into `cells` intervals at the start.
    ///
    /// # Errors
    /// [`CruiseError`] if the bounds become too wide.
    pub fn prove(&self, cells: u32) -> Result<CruiseProof, CruiseError> {
        let begin = Instant::now();
        let found = cruise::compute_bounds(&self.actor, cells)?;
        let seconds = begin.elapsed().as_secs_f64();
        let source = self.actor.source.clone();
        let source = source.ok_or_else(|| CruiseError::Unreadable("does not name its source file".to_owned()))?;
        let policy_sha256 = sha256(&self.bytes);
        let claim = CruiseClaim {
            policy_file: controller_file_name(&policy_sha256, true),
            policy_sha256,
            source,
            cells,
            // Rounded to micrometres, so that other rounding in another version keeps the proof.
            margin_m_at_least: (found.margin_m * 1e6).floor() / 1e6,
            x_ego_width_m_at_most: (found.x_ego_width_m() * 1e6).ceil() / 1e6,
        };
        let certificate = certificate_without_scenario(Statement::AdaptiveCruise(claim));
        Ok(CruiseProof { certificate, margin_m: found.margin_m, x_ego_m: found.x_ego_m, seconds })
    }

    /// Simulates from the corners of the box and from random initial states, deterministically by seed.
    #[must_use]
    pub fn sample(&self, samples: usize, seed: u64) -> CruiseSamples {
        let nothing =
            || CruiseSamples { samples: 0, margin_m: f64::INFINITY, x_ego_m: [f64::INFINITY, f64::NEG_INFINITY] };
        let blocks = (0..samples.div_ceil(BATCH_SIZE)).into_par_iter();
        let driven = blocks.map(|block| {
            let mut stream = random::stream(seed, Purpose::ScenarioSampling, block as u64);
            let count = BATCH_SIZE.min(samples - block * BATCH_SIZE);
            let starts: Vec<[f64; 4]> = (0..count)
                .map(|_| INITIAL_SET.map(|[low, high]| low + (high - low) * stream.random::<f64>()))
                .collect();
            simulate(self.network.network(), &starts)
        });
        let corners: Vec<[f64; 4]> =
            (0..16_usize).map(|corner| std::array::from_fn(|i| INITIAL_SET[i][corner >> i & 1])).collect();
        let both = |a: CruiseSamples, b: CruiseSamples| CruiseSamples {
            samples: a.samples + b.samples,
            margin_m: a.margin_m.min(b.margin_m),
            x_ego_m: [a.x_ego_m[0].min(b.x_ego_m[0]), a.x_ego_m[1].max(b.x_ego_m[1])],
        };
        both(driven.reduce(nothing, both), simulate(self.network.network(), &corners))
    }
}

/// Simulates from initial states (x_lead, v_lead, x_ego, v_ego).
fn simulate(network: &FeedForward, starts: &[[f64; 4]]) -> CruiseSamples {
    let mut cars: Vec<[[f64; 3]; 2]> =
        starts.iter().map(|[x_lead, v_lead, x_ego, v_ego]| [[*x_lead, *v_lead, 0.0], [*x_ego, *v_ego, 0.0]]).collect();
    let margin = |[lead, ego]: &[[f64; 3]; 2]| lead[0] - ego[0] - SAFE_DISTANCE[0] - SAFE_DISTANCE[1] * ego[1];
    let mut least = cars.iter().map(margin).fold(f64::INFINITY, f64::min);
    let mut space = Workspace::default();
    for _ in 0..PERIODS {
        let see = |[lead, ego]: &[[f64; 3]; 2]| {
            [SET_SPEED_AND_TIME_GAP[0], SET_SPEED_AND_TIME_GAP[1], ego[1], lead[0] - ego[0], lead[1] - ego[1]]
        };
        let rows: Vec<f32> = cars.iter().flat_map(see).map(|number| number as f32).collect();
        let answers = network.forward(&rows, cars.len(), &mut space);
        for (cars, &answer) in cars.iter_mut().zip(answers) {
            for _ in 0..STEPS_PER_PERIOD {
                let [lead, ego] = cars;
                *lead = runge_kutta_step(*lead, LEAD_ACCEL_MPS2);
                *ego = runge_kutta_step(*ego, f64::from(answer));
                least = least.min(margin(cars));
            }
        }
    }
    let ends = cars.iter().map(|[_, ego]| ego[0]);
    let x_ego_m = ends.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)]);
    CruiseSamples { samples: starts.len(), margin_m: least, x_ego_m }
}

fn runge_kutta_step(from: [f64; 3], a: f64) -> [f64; 3] {
    let h = PERIOD_S / STEPS_PER_PERIOD as f64;
    let rate = |[_, v, gamma]: [f64; 3]| [v, gamma, -2.0 * gamma + 2.0 * a - cruise::DRAG * v * v];
    let moved = |by: [f64; 3], h: f64| std::array::from_fn(|i| from[i] + h * by[i]);
    let first = rate(from);
    let second = rate(moved(first, 0.5 * h));
    let third = rate(moved(second, 0.5 * h));
    let fourth = rate(moved(third, h));
    std::array::from_fn(|i| from[i] + h / 6.0 * (first[i] + 2.0 * second[i] + 2.0 * third[i] + fourth[i]))
}
