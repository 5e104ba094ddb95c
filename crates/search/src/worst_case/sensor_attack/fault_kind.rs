//! Kinds of sensor faults that the search for the mildest fault tries.

use serde::Serialize;

use crumple_sim::scenario::{GhostObject, Scenario, SensorFaults};

/// Parts into which the search divides the step to the smallest size that fails.
pub(super) const PARTS: u32 = 10;
/// Times at which ghosts appear, as fractions of the duration.
const GHOST_ONSETS: u32 = 8;
const GHOST_GAPS_M: [f64; 3] = [10.0, 30.0, 60.0];
const GHOST_SPEEDS: usize = 2;
pub(super) const GHOST: &str = "ghost";

/// A kind of fault, with one quantity whose sizes grow from none to a limit.
pub(super) struct FaultKind {
    pub(super) name: &'static str,
    pub(super) limit: &'static str,
    /// Quantity without a fault, and step between two sizes, both in units of 10^-`decimals`; divisible by [`PARTS`].
    none: i32,
    step: i32,
    /// Number of sizes.
    pub(super) count: u32,
    decimals: u32,
    pub(super) unit: &'static str,
    pub(super) set: fn(&mut SensorFaults, f64),
}

impl FaultKind {
    /// Returns a size as the number that its decimal text states, so that a printed size is the simulated one.
    pub(super) fn amount(&self, FaultSize { steps, part }: FaultSize) -> f64 {
        let parts = steps as i32 * PARTS as i32 + part as i32;
        let units = self.none + parts * (self.step / PARTS as i32);
        f64::from(units) / 10_f64.powi(self.decimals as i32)
    }

    pub(super) fn share(&self, FaultSize { steps, part }: FaultSize) -> f64 {
        f64::from(steps * PARTS + part) / f64::from(self.count * PARTS)
    }

    pub(super) fn searched_sizes(&self) -> SearchedSizes {
        let [smallest, largest] =
            [1, self.count].map(|steps| self.amount(FaultSize { steps, part: 0 }));
        SearchedSizes {
            count: self.count,
            smallest,
            largest,
            unit: self.unit,
        }
    }

    pub(super) fn ghost_count(&self) -> usize {
        if self.name == GHOST {
            GHOST_ONSETS as usize * GHOST_GAPS_M.len() * GHOST_SPEEDS
        } else {
            1
        }
    }

    pub(super) fn max_simulations(&self, ghosts: usize) -> u64 {
        (ghosts * (self.count as usize + 2 * (PARTS as usize - 1))) as u64
    }
}

pub(super) const KINDS: [FaultKind; 8] = [
    FaultKind {
        name: "latency",
        limit: "2 s",
        none: 0,
        step: 20,
        count: 1000,
        decimals: 4,
        unit: "s",
        set: |faults, time_s| faults.latency_s = time_s,
    },
    FaultKind {
        name: "gap too small",
        limit: "10 m",
        none: 0,
        step: 10,
        count: 1000,
        decimals: 3,
        unit: "m",
        set: |faults, bias_m| faults.gap_bias_m = -bias_m,
    },
    FaultKind {
        name: "gap too large",
        limit: "10 m",
        none: 0,
        step: 10,
        count: 1000,
        decimals: 3,
        unit: "m",
        set: |faults, bias_m| faults.gap_bias_m = bias_m,
    },
    FaultKind {
        name: "resolution",
        limit: "10 m",
        none: 0,
        step: 10,
        count: 1000,
        decimals: 3,
        unit: "m",
        set: |faults, step_m| faults.gap_resolution_m = step_m,
    },
    FaultKind {
        name: "outages",
        limit: "one per second, 10 s long",
        none: 0,
        step: 10,
        count: 1000,
        decimals: 3,
        unit: "s",
        set: |faults, length_s| {
            (faults.outage_rate_per_s, faults.outage_length_s) = (1.0, length_s)
        },
    },
    FaultKind {
        name: "range",
        limit: "1 m instead of 200 m",
        none: 20_000,
        step: -10,
        count: 1990,
        decimals: 2,
        unit: "m",
        set: |faults, range_m| faults.range_m = Some(range_m),
    },
    FaultKind {
        name: "late detection",
        limit: "10 s",
        none: 0,
        step: 10,
        count: 1000,
        decimals: 3,
        unit: "s",
        set: |faults, delay_s| faults.detection_delay_s = delay_s,
    },
    FaultKind {
        name: GHOST,
        limit: "2 s long",
        none: 0,
        step: 10,
        count: 200,
        decimals: 3,
        unit: "s",
        set: |_, _| {},
    },
];

/// A size of a fault: so many steps of its kind, and so many [parts](PARTS) of a step.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(super) struct FaultSize {
    pub(super) steps: u32,
    pub(super) part: u32,
}

/// Sizes of a kind of fault that the search simulates until one causes a failure.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct SearchedSizes {
    /// Number of sizes.
    pub count: u32,
    /// Size of the mildest fault.
    pub smallest: f64,
    /// Size at the limit.
    pub largest: f64,
    /// Unit of both.
    pub unit: &'static str,
}

/// Returns objects at some times and gaps, standing or at half the speed of the vehicle under test.
pub(super) fn ghosts(scenario: &Scenario) -> Vec<GhostObject> {
    let own_mps = (0..scenario.vehicles().len()).find(|&index| scenario.is_under_test(index));
    let own_mps = own_mps
        .and_then(|index| scenario.vehicles().get(index))
        .map_or(0.0, |own| own.speed_mps);
    let mut ghosts = Vec::new();
    for onset in 0..GHOST_ONSETS {
        let onset_s = scenario.spec().duration_s * f64::from(onset) / f64::from(GHOST_ONSETS);
        for gap_m in GHOST_GAPS_M {
            for speed_mps in [0.0, 0.5 * own_mps] as [f64; GHOST_SPEEDS] {
                ghosts.push(GhostObject {
                    onset_s,
                    duration_s: 0.0,
                    gap_m,
                    speed_mps,
                });
            }
        }
    }
    ghosts
}
