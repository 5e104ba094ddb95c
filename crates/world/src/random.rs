//! Seeded random streams: one seed decides everything.
//!
//! Every source of chance (the noise on one vehicle's acceleration, one sensor of one vehicle, one draw of a scenario
//! distribution) has a stream of its own, addressed by what it is for. No two consumers share a stream, so neither the
//! order of evaluation nor the number of threads can change a result.

use std::convert::Infallible;
use std::sync::LazyLock;

use rand::{Rng, SeedableRng, TryRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

/// The generator behind every stream: small state, fast, and with values fixed across releases and platforms.
pub type Stream = Xoshiro256PlusPlus;

/// What a stream of random numbers is for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Purpose {
    /// Noise on a vehicle's acceleration, one normal number a step.
    AccelerationNoise = 1,
    /// Noise and dropout of a vehicle's own position sensor.
    PositionSensor = 2,
    /// Noise and dropout of the sensor that looks ahead.
    GapAheadSensor = 3,
    /// Noise and dropout of the sensor that looks behind.
    GapBehindSensor = 4,
    /// Error of a filter's first estimate.
    InitialEstimate = 5,
    /// One draw from a distribution of scenarios.
    ScenarioSampling = 6,
    /// First weights of a network, one consumer a network.
    InitialWeights = 7,
    /// Actions tried out in training, one consumer an episode.
    Exploration = 8,
    /// Draws from replay memory, one consumer an episode.
    ReplaySampling = 9,
    /// Noise on target actions, one consumer an episode.
    TargetNoise = 10,
    /// Proposals of a search method; the index tells methods of one search apart.
    Search = 11,
    /// Digit permutations of a quasi-random sequence, one coordinate each.
    QuasiRandom = 12,
    /// Actions of a controller that acts at random, one consumer a vehicle.
    RandomActions = 13,
    /// Populations that climb towards a rare event, one consumer a repetition.
    RareEvents = 14,
    /// Resamples of what was observed, one consumer a resample.
    Resampling = 15,
    /// Which later runs of a process are asked twice, one consumer a run.
    DeterminismCheck = 16,
}

/// The stream for `purpose`, for the `index`-th consumer of its kind (a vehicle, a draw), under `seed`.
#[must_use]
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> Stream {
    let key = scramble(scramble(scramble(seed).wrapping_add(purpose as u64)).wrapping_add(index));
    Stream::seed_from_u64(key)
}

/// A seed derived from another, for the `index`-th of many runs.
#[must_use]
pub fn derived_seed(seed: u64, index: u64) -> u64 {
    // TOML integers are signed, and a scenario file must be able to hold its seed.
    scramble(scramble(seed).wrapping_add(index)) >> 1
}

/// Normal numbers for inner loops: those of [`StandardNormal`], to the last bit.
///
/// `rand_distr` draws by the ziggurat method (Marsaglia and Tsang, 2000; Doornik, 2005): 256 layers under the curve, of which
/// the number drawn chooses one and a place in it. Nearly always that place is under the curve for certain, and this is all
/// that is done here; the rest is left to the library, which starts again from where the stream was. That way the
/// stream's state stays in registers, since nothing takes its address.
#[derive(Debug, Clone, Copy)]
pub struct NormalSampler {
    /// The half width of each layer, widest first, and 0.
    half_widths: &'static [f64; 257],
}

impl Default for NormalSampler {
    fn default() -> Self {
        Self::new()
    }
}

impl NormalSampler {
    /// The table is made once a process.
    #[must_use]
    pub fn new() -> Self {
        /// The library keeps its table to itself, but half of a half width is under the curve for certain: who draws the
        /// middle of layer `i` is told it.
        static HALF_WIDTHS: LazyLock<[f64; 257]> = LazyLock::new(|| {
            std::array::from_fn(|layer| {
                let middle: f64 = StandardNormal.sample(&mut ScriptedRng { number: layer as u64 | 3 << 62 });
                if layer < 256 { 2.0 * middle } else { 0.0 }
            })
        });
        Self { half_widths: &HALF_WIDTHS }
    }

    /// The next number of `stream`.
    #[inline(always)]
    pub fn sample(self, stream: &mut Stream) -> f64 {
        let mut after = stream.clone();
        let bits = after.next_u64();
        let layer = bits as usize & 0xff;
        // The upper 52 bits as a number in [2, 4), and so in [-1, 1).
        let place = f64::from_bits(bits >> 12 | 1 << 62) - 3.0;
        let normal = place * self.half_widths[layer];
        if normal.abs() < self.half_widths[layer + 1] {
            *stream = after;
            return normal;
        }
        let (normal, after) = sample_from_library(stream.clone());
        *stream = after;
        normal
    }
}

/// A normal number, and the stream after it. Out of the way of the loops that draw most of theirs without it, so that those
/// keep what they work with in registers.
#[cold]
#[inline(never)]
fn sample_from_library(mut stream: Stream) -> (f64, Stream) {
    (StandardNormal.sample(&mut stream), stream)
}

/// A generator that says the same number first, and then the largest there is.
struct ScriptedRng {
    number: u64,
}

impl TryRng for ScriptedRng {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        self.try_next_u64().map(|number| number as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        Ok(std::mem::replace(&mut self.number, u64::MAX))
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        bytes.fill(u8::MAX);
        Ok(())
    }
}

/// The finaliser of SplitMix64 (Steele, Lea and Flood, 2014): a bijection in which every input bit reaches every
/// output bit, so that neighbouring seeds give unrelated streams.
fn scramble(value: u64) -> u64 {
    let mut z = value.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashSet;

    #[test]
    fn normals_are_those_of_the_library() {
        let (mut ours, mut theirs) =
            (stream(6, Purpose::AccelerationNoise, 0), stream(6, Purpose::AccelerationNoise, 0));
        let mut furthest = 0.0_f64;
        for _ in 0..2_000_000 {
            let expected: f64 = StandardNormal.sample(&mut theirs);
            assert_eq!(NormalSampler::new().sample(&mut ours).to_bits(), expected.to_bits());
            furthest = furthest.max(expected.abs());
        }
        assert_eq!(ours, theirs);
        assert!(furthest > 4.5, "the tail was drawn from: {furthest}");
    }

    #[test]
    fn streams_are_distinct_and_repeatable() {
        let mut seen = HashSet::new();
        for seed in 0..20 {
            for purpose in [Purpose::AccelerationNoise, Purpose::PositionSensor, Purpose::ScenarioSampling] {
                for index in 0..20 {
                    let first = stream(seed, purpose, index).next_u64();
                    assert_eq!(first, stream(seed, purpose, index).next_u64());
                    assert!(seen.insert(first), "stream {seed}/{purpose:?}/{index} repeats another");
                }
            }
        }
    }
}
