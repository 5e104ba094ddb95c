//! Sequential convex programming on the simulated closed loop.
//!
//! The gaps of all pairs at all samples are linearised by finite differences, one block of cells at a time. A linear
//! program in a trust region proposes a change of all blocks; simulations of shares of it select the step.

use super::plant::{CellBlock, Plant, Profile, SampledGaps, SimulatedProfile};
use crumple_quadratic::{QuadraticProgram, QuadraticSolution};
use crumple_sim::random::Stream;
use rand::RngExt;

/// Numbers of blocks of all vehicles under test until the last small gap, and after it.
const BLOCK_COUNTS: [usize; 2] = [36, 3];
/// Initial, maximum and final trust region of an ascent, in m/s².
const TRUST_REGION_MPS2: [f64; 3] = [2.0, 6.0, 0.03];
const TRUST_REGION_FACTORS: [f64; 2] = [1.6, 0.45];
/// Shares of a step that are simulated.
const STEP_SHARES: [f64; 4] = [1.0, 0.6, 0.3, 0.1];
/// Gaps within this distance of the smallest one are small, in metres.
const NEAR_GAP_M: f64 = 1.0;
/// Time after the last small gap that still matters, in seconds.
const TAIL_S: f64 = 0.5;
/// Minimum gain of a successful step, in metres.
const MIN_GAIN_M: f64 = 1e-4;
/// Cost of squared changes, which suppresses changes without effect.
const REGULARIZATION_WEIGHT: f64 = 1e-4;

pub(super) struct Ascent {
    pub(super) current: SimulatedProfile,
    trust_region_mps2: f64,
}

impl Ascent {
    pub(super) fn new(at: SimulatedProfile) -> Self {
        Self {
            current: at,
            trust_region_mps2: TRUST_REGION_MPS2[0],
        }
    }

    pub(super) fn is_over(&self) -> bool {
        self.trust_region_mps2 < TRUST_REGION_MPS2[2]
    }

    pub(super) fn step(&mut self, plant: &mut Plant<'_>, stream: &mut Stream) -> bool {
        let gained = self
            .propose(plant, stream)
            .into_iter()
            .max_by(|a, b| a.margin_m.total_cmp(&b.margin_m));
        let [success, failure] = TRUST_REGION_FACTORS;
        match gained.filter(|best| best.margin_m > self.current.margin_m + MIN_GAIN_M) {
            Some(best) => {
                self.current = best;
                self.trust_region_mps2 =
                    (self.trust_region_mps2 * success).min(TRUST_REGION_MPS2[1]);
                true
            }
            None => {
                self.trust_region_mps2 *= failure;
                false
            }
        }
    }

    /// Returns simulated shares of the step that a linear program proposes.
    fn propose(&self, plant: &mut Plant<'_>, stream: &mut Stream) -> Vec<SimulatedProfile> {
        let Some(Some(current_gaps)) = plant
            .simulate_gaps(std::slice::from_ref(&self.current.profile))
            .pop()
        else {
            return Vec::new();
        };
        let blocks = self.blocks(plant, &current_gaps, stream);
        let nudge_mps2 = (0.5 * self.trust_region_mps2).clamp(0.05, 1.0);
        let by_mps2: Vec<f64> = blocks
            .iter()
            .map(|block| self.signed_nudge_mps2(plant, block, nudge_mps2))
            .collect();
        let nudged: Vec<Profile> = blocks
            .iter()
            .zip(&by_mps2)
            .map(|(block, &by)| plant.with_block_changed(&self.current.profile, block, by))
            .collect();
        let nudged = plant.simulate_gaps(&nudged);
        let Some(step) = self.best_step(plant, &blocks, &current_gaps, &nudged, &by_mps2) else {
            return Vec::new();
        };
        let shares = STEP_SHARES.map(|share| {
            blocks
                .iter()
                .zip(&step)
                .fold(self.current.profile.clone(), |profile, (block, by)| {
                    plant.with_block_changed(&profile, block, share * by)
                })
        });
        plant.simulate_profiles(shares.into())
    }

    /// Returns blocks of equal length until the last small gap, at a random phase, and few after it.
    fn blocks(
        &self,
        plant: &Plant<'_>,
        current_gaps: &SampledGaps,
        stream: &mut Stream,
    ) -> Vec<CellBlock> {
        let last = self.last_near_sample(current_gaps);
        let until_s = last as f64 * plant.sample_interval_s() + TAIL_S;
        let all = plant.cell_count();
        let until = ((until_s / plant.cell_s()).ceil() as usize).clamp(1, all);
        let [before, after] = BLOCK_COUNTS.map(|count| count.div_ceil(plant.ego_count()));
        let phase: f64 = stream.random();
        let length = until as f64 / before as f64;
        let early =
            (0..=before).map(|block| ((block as f64 - phase) * length).round().max(0.0) as usize);
        let late = (0..=after).map(|block| until + (all - until) * block / after);
        let mut borders: Vec<usize> = std::iter::once(0)
            .chain(early)
            .chain(late)
            .map(|cell| cell.min(all))
            .collect();
        borders.sort_unstable();
        borders.dedup();
        (0..plant.ego_count())
            .flat_map(|ego| {
                borders.windows(2).filter_map(move |pair| match pair {
                    &[from, to] => Some(CellBlock {
                        ego,
                        cells: from..to,
                    }),
                    _ => None,
                })
            })
            .collect()
    }

    /// Returns the last sample with a gap near the smallest one.
    fn last_near_sample(&self, gaps: &SampledGaps) -> usize {
        let near_m = self.current.margin_m.max(0.0) + NEAR_GAP_M;
        (0..gaps.samples)
            .rev()
            .find(|&sample| gaps.gaps_at_sample(sample).any(|gap_m| gap_m < near_m))
            .unwrap_or(0)
    }

    /// Returns a nudge whose sign keeps every cell within the limits, if possible.
    fn signed_nudge_mps2(&self, plant: &Plant<'_>, block: &CellBlock, nudge_mps2: f64) -> f64 {
        let [low, high] = plant.limits_mps2(block.ego);
        let [least, most] = self.range_mps2(block);
        if high - most >= least - low {
            nudge_mps2.min((high - low) / 2.0)
        } else {
            -nudge_mps2.min((high - low) / 2.0)
        }
    }

    fn range_mps2(&self, block: &CellBlock) -> [f64; 2] {
        let cells = self
            .current
            .profile
            .get(block.ego)
            .and_then(|cells| cells.get(block.cells.clone()));
        let cells = cells.into_iter().flatten();
        cells.fold(
            [f64::INFINITY, f64::NEG_INFINITY],
            |[least, most], &cell| [least.min(cell), most.max(cell)],
        )
    }

    /// Returns the change of each block that maximises the smallest linearised gap.
    fn best_step(
        &self,
        plant: &Plant<'_>,
        blocks: &[CellBlock],
        current_gaps: &SampledGaps,
        nudged: &[Option<SampledGaps>],
        by_mps2: &[f64],
    ) -> Option<Vec<f64>> {
        let region_mps2 = self.trust_region_mps2;
        let smallest = blocks.len();
        let mut program = QuadraticProgram::new(blocks.len() + 1);
        program.add_linear_cost(smallest, -1.0);
        self.add_change_limits(&mut program, plant, blocks);
        let gaps = linearise(current_gaps, nudged, by_mps2);
        // Drop gaps that stay above the maximum of another one.
        let ceiling_m = gaps
            .iter()
            .map(|gap| gap.gap_m + gap.max_change_m(region_mps2))
            .fold(f64::INFINITY, f64::min);
        program.add_inequality(&[(smallest, 1.0)], ceiling_m);
        for gap in gaps
            .iter()
            .filter(|gap| gap.gap_m - gap.max_change_m(region_mps2) <= ceiling_m)
        {
            let falls = gap
                .slopes
                .iter()
                .enumerate()
                .filter(|(_, slope)| **slope != 0.0)
                .map(|(i, slope)| (i, -slope));
            let row: Vec<_> = falls.chain([(smallest, 1.0)]).collect();
            program.add_inequality(&row, gap.gap_m);
        }
        let QuadraticSolution::Optimal { point, .. } = program.solve() else {
            return None;
        };
        // Rounded, because the last digits of the solver differ between machines.
        let step: Vec<f64> = point
            .iter()
            .take(blocks.len())
            .map(|change| (change.clamp(-region_mps2, region_mps2) * 1e4).round() / 1e4)
            .collect();
        step.iter().all(|change| change.is_finite()).then_some(step)
    }

    /// Limits the change of each block to the trust region and to the limits of its vehicle.
    fn add_change_limits(
        &self,
        program: &mut QuadraticProgram,
        plant: &Plant<'_>,
        blocks: &[CellBlock],
    ) {
        let region_mps2 = self.trust_region_mps2;
        for (index, block) in blocks.iter().enumerate() {
            let [low, high] = plant.limits_mps2(block.ego);
            let [least, most] = self.range_mps2(block);
            program.add_inequality(&[(index, 1.0)], region_mps2.min(high - least));
            program.add_inequality(&[(index, -1.0)], region_mps2.min(most - low));
            program.add_squared_cost(&[(index, 1.0)], REGULARIZATION_WEIGHT);
        }
    }
}

/// A gap of one pair at one sample, as a linear function of the changes of all blocks.
struct LinearisedGap {
    gap_m: f64,
    /// Change of the gap in metres for a change of each block by 1 m/s².
    slopes: Vec<f64>,
}

impl LinearisedGap {
    /// Returns the maximum change of the gap in metres if no block changes by more than the trust region.
    fn max_change_m(&self, region_mps2: f64) -> f64 {
        region_mps2 * self.slopes.iter().map(|slope| slope.abs()).sum::<f64>()
    }
}

/// Linearises all gaps by finite differences. A slope that was not simulated is 0.
fn linearise(
    current_gaps: &SampledGaps,
    nudged: &[Option<SampledGaps>],
    by_mps2: &[f64],
) -> Vec<LinearisedGap> {
    let finite_gaps_m = current_gaps
        .gap_m
        .iter()
        .copied()
        .enumerate()
        .filter(|(_, gap_m)| gap_m.is_finite());
    finite_gaps_m
        .map(|(sample, gap_m)| LinearisedGap {
            gap_m,
            slopes: nudged
                .iter()
                .zip(by_mps2)
                .map(|(nudged, by_mps2)| {
                    let nudged_m = nudged.as_ref()?.gap_m.get(sample)?;
                    Some((nudged_m - gap_m) / by_mps2).filter(|slope| slope.is_finite())
                })
                .map(|slope| slope.unwrap_or(0.0))
                .collect(),
        })
        .collect()
}

impl SampledGaps {
    fn gaps_at_sample(&self, sample: usize) -> impl Iterator<Item = f64> {
        self.gap_m
            .iter()
            .skip(sample)
            .step_by(self.samples.max(1))
            .copied()
    }
}
