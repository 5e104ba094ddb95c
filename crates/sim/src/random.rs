//! Seeded random streams: one seed determines all results.
//!
//! Every consumer of random numbers has its own stream (acceleration noise of a vehicle, one of its sensors, one sample
//! of a scenario space). Neither the order of evaluation nor the number of threads therefore changes a result.

use std::convert::Infallible;
use std::sync::LazyLock;

use rand::rngs::Xoshiro256PlusPlus;
use rand::{Rng, RngExt, SeedableRng, TryRng};
use rand_distr::{Distribution, StandardNormal};

/// Generator of every stream: small, fast, with values that are fixed across releases and platforms.
pub type Stream = Xoshiro256PlusPlus;

/// Purpose of a random stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u64)]
pub enum Purpose {
    /// Noise on a vehicle's acceleration, one normal number per step.
    AccelerationNoise = 1,
    /// Noise and dropout of a vehicle's own position sensor.
    PositionSensor = 2,
    /// Noise and dropout of the sensor of the gap ahead.
    GapAheadSensor = 3,
    /// Noise and dropout of the sensor of the gap behind.
    GapBehindSensor = 4,
    /// Error of the initial estimate of a filter.
    InitialEstimate = 5,
    /// One sample of a scenario space.
    ScenarioSampling = 6,
    /// Initial weights of a network, one consumer per network.
    InitialWeights = 7,
    /// Exploration actions in training, one consumer per episode.
    Exploration = 8,
    /// Samples of the replay buffer, one consumer per episode.
    ReplaySampling = 9,
    /// Noise on target actions, one consumer per episode.
    TargetNoise = 10,
    /// Proposals of a search method; the index distinguishes methods of one search.
    Search = 11,
    /// Digit permutations of a quasi-random sequence, one consumer per coordinate.
    QuasiRandom = 12,
    /// Actions of a random controller, one consumer per vehicle.
    RandomActions = 13,
    /// Populations of a splitting estimator, one consumer per repetition.
    RareEvents = 14,
    /// Bootstrap resamples, one consumer per resample.
    Resampling = 15,
    /// Choice of the later runs of a process that are checked for determinism, one consumer per run.
    DeterminismCheck = 16,
    /// Order of rows in a fit of a policy to an expert, one consumer per round.
    Imitation = 17,
    /// Outages of the sensor of the gap ahead.
    GapAheadOutage = 18,
    /// Outages of the sensor of the gap behind.
    GapBehindOutage = 19,
    /// Properties and glances of a human driver, one consumer per vehicle.
    HumanDriver = 20,
    /// Standing vehicles that an emergency brake misses, one consumer per vehicle.
    MissedDetection = 21,
}

/// Returns the stream for `purpose` and its `index`-th consumer (a vehicle, a sample), under `seed`.
#[must_use]
pub fn stream(seed: u64, purpose: Purpose, index: u64) -> Stream {
    let key = scramble(scramble(scramble(seed).wrapping_add(purpose as u64)).wrapping_add(index));
    Stream::seed_from_u64(key)
}

/// Derives the seed of the `index`-th of many runs.
#[must_use]
pub fn derived_seed(seed: u64, index: u64) -> u64 {
    // A TOML integer is signed, and a scenario file must be able to hold the seed.
    scramble(scramble(seed).wrapping_add(index)) >> 1
}

/// A share of the noise of a run: all normal numbers of a seed, times a weight.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NoiseShare {
    /// Seed of the normal numbers.
    pub seed: u64,
    /// Weight. The sum of the squares of all weights is 1.
    pub weight: f64,
}

/// Noise of one consumer: normal numbers of one seed, or weighted sums of those of several seeds.
#[derive(Debug, Clone)]
pub(crate) struct NoiseStream {
    stream: Stream,
    weight: f64,
    others: Vec<(Stream, f64)>,
    normals: NormalSampler,
}

impl NoiseStream {
    pub(crate) fn new(seed: u64, purpose: Purpose, index: u64) -> Self {
        Self {
            stream: stream(seed, purpose, index),
            weight: 1.0,
            others: Vec::new(),
            normals: NormalSampler::new(),
        }
    }

    /// Creates the noise of shares, the first of which has the seed `seed`; without shares, that of the seed.
    pub(crate) fn from_shares(
        seed: u64,
        shares: &[NoiseShare],
        purpose: Purpose,
        index: u64,
    ) -> Self {
        let mut noise = Self::new(seed, purpose, index);
        if let Some((own, others)) = shares.split_first() {
            noise.weight = own.weight;
            noise.others = others
                .iter()
                .map(|other| (stream(other.seed, purpose, index), other.weight))
                .collect();
        }
        noise
    }

    #[inline]
    pub(crate) fn normal(&mut self) -> f64 {
        let [one] = self.normals();
        one
    }

    /// Returns the next normal numbers.
    #[inline]
    pub(crate) fn normals<const N: usize>(&mut self) -> [f64; N] {
        // Local copies stay in registers.
        let mut stream = self.stream.clone();
        let sampler = self.normals;
        let mut numbers = [0.0; N];
        for number in &mut numbers {
            *number = sampler.sample(&mut stream);
        }
        self.stream = stream;
        if !self.others.is_empty() {
            self.add_others(&mut numbers);
        }
        numbers
    }

    /// Returns a uniform number from 0 to 1, which depends on the first seed only.
    #[inline]
    pub(crate) fn uniform(&mut self) -> f64 {
        self.stream.random()
    }

    #[cold]
    fn add_others(&mut self, numbers: &mut [f64]) {
        for number in numbers {
            let others = self
                .others
                .iter_mut()
                .map(|(stream, weight)| *weight * self.normals.sample(stream));
            *number = self.weight * *number + others.sum::<f64>();
        }
    }
}

/// Sampler of normal numbers for inner loops; bit-identical to [`StandardNormal`].
///
/// `rand_distr` uses the ziggurat method (Marsaglia and Tsang, 2000; Doornik, 2005) with 256 layers. A random number
/// chooses a layer and a place in it. This sampler handles places that are certainly under the curve, nearly all; for
/// others it calls the library. The stream stays in registers, because nothing takes its address.
#[derive(Debug, Clone, Copy)]
pub struct NormalSampler {
    /// Half width of each layer, widest first, and 0.
    half_widths: &'static [f64; 257],
}

impl Default for NormalSampler {
    fn default() -> Self {
        Self::new()
    }
}

impl NormalSampler {
    /// Creates a sampler; the table is computed once per process.
    #[must_use]
    pub fn new() -> Self {
        /// The library's table is private. Sampling the middle of layer `i` returns half of its half width.
        static HALF_WIDTHS: LazyLock<[f64; 257]> = LazyLock::new(|| {
            std::array::from_fn(|layer| {
                let middle: f64 = StandardNormal.sample(&mut ScriptedRng {
                    number: layer as u64 | 3 << 62,
                });
                if layer < 256 { 2.0 * middle } else { 0.0 }
            })
        });
        Self {
            half_widths: &HALF_WIDTHS,
        }
    }

    /// Returns the next normal number of `stream`.
    #[inline(always)]
    pub fn sample(self, stream: &mut Stream) -> f64 {
        let mut after = stream.clone();
        let bits = after.next_u64();
        let layer = bits as usize & 0xff;
        // The upper 52 bits as a number in [2, 4), and so in [-1, 1).
        let uniform = f64::from_bits(bits >> 12 | 1 << 62) - 3.0;
        let normal = uniform * self.half_widths[layer];
        if normal.abs() < self.half_widths[layer + 1] {
            *stream = after;
            return normal;
        }
        let (normal, after) = sample_from_library(stream.clone());
        *stream = after;
        normal
    }
}

/// Returns a normal number and the stream after it. Not inlined, so that calling loops keep values in registers.
#[cold]
#[inline(never)]
fn sample_from_library(mut stream: Stream) -> (f64, Stream) {
    (StandardNormal.sample(&mut stream), stream)
}

/// A generator that returns `number` first and `u64::MAX` afterwards.
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

/// Finaliser of SplitMix64 (Steele, Lea and Flood, 2014); neighbouring seeds give unrelated streams.
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
        let (mut ours, mut theirs) = (
            stream(6, Purpose::AccelerationNoise, 0),
            stream(6, Purpose::AccelerationNoise, 0),
        );
        let mut furthest = 0.0_f64;
        for _ in 0..2_000_000 {
            let expected: f64 = StandardNormal.sample(&mut theirs);
            assert_eq!(
                NormalSampler::new().sample(&mut ours).to_bits(),
                expected.to_bits()
            );
            furthest = furthest.max(expected.abs());
        }
        assert_eq!(ours, theirs);
        assert!(furthest > 4.5, "the tail was drawn from: {furthest}");
    }

    #[test]
    fn noise_is_the_weighted_sum_of_its_shares() {
        let shares = [(3, 0.8), (4, 0.6)].map(|(seed, weight)| NoiseShare { seed, weight });
        let noise = |shares: &[NoiseShare]| {
            NoiseStream::from_shares(3, shares, Purpose::AccelerationNoise, 1)
        };
        let (mut one, many) = (noise(&shares), noise(&shares).normals::<32>());
        let mut plain = [3, 4].map(|seed| NoiseStream::new(seed, Purpose::AccelerationNoise, 1));
        for stream in many {
            let [own, other] = plain.each_mut().map(NoiseStream::normal);
            assert_eq!([stream, stream], [0.8 * own + 0.6 * other, one.normal()]);
        }
        assert_eq!(
            noise(&[]).normals::<4>(),
            NoiseStream::new(3, Purpose::AccelerationNoise, 1).normals()
        );
    }

    #[test]
    fn streams_are_distinct_and_repeatable() {
        let mut first_numbers = HashSet::new();
        for seed in 0..20 {
            for purpose in [
                Purpose::AccelerationNoise,
                Purpose::PositionSensor,
                Purpose::ScenarioSampling,
            ] {
                for index in 0..20 {
                    let first = stream(seed, purpose, index).next_u64();
                    assert_eq!(first, stream(seed, purpose, index).next_u64());
                    assert!(
                        first_numbers.insert(first),
                        "stream {seed}/{purpose:?}/{index} repeats another"
                    );
                }
            }
        }
    }
}
