//! Features of a run for fuzzers: smallest gaps, impacts and emergency braking. Two runs through the same code can
//! differ: one nearly collides and one does not. With these features a fuzzer keeps the first as a step towards a
//! collision.

use std::path::Path;

use super::TestCase;
use crumple_measure::CollisionRole;
use crumple_sim::engine::{Collision, SimulationResult, Track};
use crumple_sim::scenario::{Driver, Scenario};

const GAP_BINS_M: [f64; 12] = [
    16.0, 8.0, 4.0, 2.0, 1.0, 0.5, 0.25, 0.12, 0.06, 0.03, 0.01, 0.0,
];
const TTC_BINS_S: [f64; 8] = [8.0, 4.0, 2.0, 1.4, 1.0, 0.7, 0.4, 0.2];
const IMPACT_BIN_MPS: f64 = 2.0;
const IMPACT_BINS: usize = 24;
const BRAKE_ONSET_BINS: usize = 8;
const VEHICLE_BINS: usize = 6;
const ROLE_COUNT: usize = 3;

/// Size of the hash table of kinds of approaches and of collisions.
const KIND_BINS: usize = 4096;

/// Number of features.
pub const FEATURE_COUNT: usize = VEHICLE_BINS
    * (GAP_BINS_M.len() + 1 + TTC_BINS_S.len() + 1 + BRAKE_ONSET_BINS)
    + ROLE_COUNT * (VEHICLE_BINS + IMPACT_BINS)
    + 2 * KIND_BINS;

#[must_use]
pub(crate) fn extract_features(test_case: &TestCase, result: &SimulationResult) -> Vec<usize> {
    let mut features = FeatureSet::default();
    for vehicle in 0..VEHICLE_BINS {
        features.push_vehicle(test_case, result, vehicle);
    }
    for role in [
        CollisionRole::Hits,
        CollisionRole::HitFromBehind,
        CollisionRole::Bystander,
    ] {
        let collision = result
            .outcome
            .collision()
            .filter(|collision| merged_role(collision, &test_case.scenario) == role);
        features.push(
            VEHICLE_BINS,
            collision.map(|collision| collision.rear_vehicle),
        );
        features.push(
            IMPACT_BINS,
            collision.map(|collision| (collision.impact_speed_mps / IMPACT_BIN_MPS) as usize),
        );
    }
    features.push(
        KIND_BINS,
        collision_kind(test_case, result).map(|kind| kind_bin(&kind)),
    );
    let approach_start = features.next;
    let approaches = approach_kinds(test_case, result);
    features
        .found
        .extend(approaches.map(|kind| approach_start + kind_bin(&kind)));
    features.found
}

/// Features of a run, as indices.
#[derive(Default)]
struct FeatureSet {
    found: Vec<usize>,
    /// First index of the next group.
    next: usize,
}

impl FeatureSet {
    /// Appends a group of `size` features, of which a run has at most one. The last one stands for larger values, too.
    fn push(&mut self, size: usize, value: Option<usize>) {
        self.found
            .extend(value.map(|value| self.next + value.min(size - 1)));
        self.next += size;
    }

    /// Appends smallest gap, smallest TTC and emergency braking of a vehicle.
    fn push_vehicle(&mut self, test_case: &TestCase, result: &SimulationResult, vehicle: usize) {
        let summary = result.vehicles.get(vehicle);
        let min_gap_m = summary.and_then(|summary| summary.min_gap_m);
        self.push(
            GAP_BINS_M.len() + 1,
            min_gap_m.map(|gap_m| count_reached(&GAP_BINS_M, gap_m)),
        );
        let min_ttc_s = summary.and_then(|summary| summary.min_ttc_s);
        self.push(
            TTC_BINS_S.len() + 1,
            min_ttc_s.map(|ttc_s| count_reached(&TTC_BINS_S, ttc_s)),
        );
        let track = result
            .trace
            .as_ref()
            .and_then(|trace| trace.vehicles.get(vehicle));
        let limit_mps2 = test_case.scenario.usable_brake_mps2(vehicle);
        let is_scripted = test_case
            .scenario
            .vehicles()
            .get(vehicle)
            .is_none_or(|v| matches!(v.driver, Driver::Profile(_)));
        self.push(
            BRAKE_ONSET_BINS,
            track
                .filter(|_| !is_scripted)
                .map(|track| full_braking_onsets(track, limit_mps2)),
        );
    }
}

/// Returns the number of thresholds that a value is at or below.
fn count_reached(thresholds: &[f64], value: f64) -> usize {
    thresholds
        .iter()
        .filter(|&&threshold| value <= threshold)
        .count()
}

/// Describes how near each pair of vehicles came, and its drivers.
fn approach_kinds<'a>(
    test_case: &'a TestCase,
    result: &'a SimulationResult,
) -> impl Iterator<Item = String> + 'a {
    let vehicles = test_case.scenario.vehicles();
    let pairs = vehicles
        .windows(2)
        .zip(result.vehicles.iter().skip(1))
        .enumerate();
    pairs.filter_map(move |(index, (pair, summary))| {
        let nearness = GAP_BINS_M
            .iter()
            .filter(|&&step| summary.min_gap_m.is_some_and(|gap_m| gap_m <= step))
            .count();
        let [front, rear] = pair else { return None };
        Some(format!(
            "{index} of {}, {} and {}, {nearness}",
            vehicles.len(),
            front.driver.name(),
            rear.driver.name()
        ))
    })
}

fn kind_bin(kind: &str) -> usize {
    let hash = kind.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    (hash % KIND_BINS as u64) as usize
}

fn full_braking_onsets(track: &Track, limit_mps2: f64) -> usize {
    let is_full: Vec<bool> = track
        .acceleration_mps2
        .iter()
        .map(|a| *a <= -0.95 * limit_mps2)
        .collect();
    is_full
        .windows(2)
        .filter(|pair| **pair == [false, true])
        .count()
}

/// Returns the role, with all collisions from behind as one.
fn merged_role(collision: &Collision, scenario: &Scenario) -> CollisionRole {
    match CollisionRole::new(collision, scenario) {
        CollisionRole::HitByRecording => CollisionRole::HitFromBehind,
        role => role,
    }
}

/// Returns a name for the kind of collision: vehicles under test, roles, number of vehicles and impact speed.
/// Equivalent collisions have the same name. `None` if no vehicle under test collided.
#[must_use]
pub(crate) fn collision_kind(test_case: &TestCase, result: &SimulationResult) -> Option<String> {
    let collision = result.outcome.collision()?;
    let vehicles = test_case.scenario.vehicles();
    let front = collision.front_vehicle;
    let rear = collision.rear_vehicle;
    let (verb, [own, partner]) = match CollisionRole::new(collision, &test_case.scenario) {
        CollisionRole::Hits => ("hits", [rear, front]),
        CollisionRole::HitFromBehind | CollisionRole::HitByRecording => ("hit-by", [front, rear]),
        CollisionRole::Bystander => return None,
    };
    let partner = vehicles
        .get(partner)
        .map_or("unknown", |vehicle| vehicle.driver.name());
    let speed_mps = (collision.impact_speed_mps / IMPACT_BIN_MPS).floor() * IMPACT_BIN_MPS;
    let controller = Path::new(test_case.setup.controller.name())
        .file_stem()
        .unwrap_or_default()
        .to_string_lossy();
    Some(format!(
        "{controller}-{own}-of-{}-{verb}-{partner}-at-{speed_mps:02}-mps",
        vehicles.len()
    ))
}
