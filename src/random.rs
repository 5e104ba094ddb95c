//! Seeded random streams: one seed decides everything.
//!
//! Every source of chance (the noise on one vehicle's acceleration, one sensor of one vehicle, one draw of a scenario
//! distribution) has a stream of its own, addressed by what it is for. No two consumers share a stream, so neither the
//! order of evaluation nor the number of threads can change a result.

use rand::SeedableRng;
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
    FirstEstimate = 5,
    /// One draw from a distribution of scenarios.
    ScenarioDraw = 6,
    /// First weights of a network, one consumer a network.
    FirstWeights = 7,
    /// Actions tried out in training, one consumer an episode.
    Exploration = 8,
    /// Draws from replay memory, one consumer an episode.
    ReplayDraw = 9,
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
    use rand::Rng;
    use std::collections::HashSet;

    #[test]
    fn streams_are_distinct_and_repeatable() {
        let mut seen = HashSet::new();
        for seed in 0..20 {
            for purpose in [Purpose::AccelerationNoise, Purpose::PositionSensor, Purpose::ScenarioDraw] {
                for index in 0..20 {
                    let first = stream(seed, purpose, index).next_u64();
                    assert_eq!(first, stream(seed, purpose, index).next_u64());
                    assert!(seen.insert(first), "stream {seed}/{purpose:?}/{index} repeats another");
                }
            }
        }
    }
}
