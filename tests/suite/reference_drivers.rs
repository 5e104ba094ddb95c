//! The competent and careful human of UN R157 against the JRC's published implementation.
//!
//! The oracle below is written from the equations of repository ec-jrc/JRC-FSM, commit 01b05c2 (`utility/movement.py`,
//! `utility/models.py`, `utility/comparison_cut_in.py`), and shares nothing with crumple's driver. [`CUT_INS`] was
//! computed once with that code (Python 3, numpy 2.4.6), and the oracle must reproduce its numbers.

use crumple_sim::control::BuiltInController;
use crumple_sim::engine::{RecordingLevel, Run, RunOptions, simulate};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::{Driver, LaneChange, LeadProfile, Scenario, VehicleClass, VehicleSpec};

use crate::generate::scenario_spec;

/// Speeds of both vehicles in km/h, and the number of runs of `comparison_cut_in.py` in which `CC_human_driver`
/// collides with the side and with the rear of the vehicle that cuts in. Above 60 km/h there are 1080 runs, else 1062.
const CUT_INS: [(u32, u32, usize, usize); 28] = [
    (20, 10, 27, 109),
    (30, 10, 52, 179),
    (30, 20, 27, 109),
    (40, 10, 65, 245),
    (40, 20, 52, 179),
    (40, 30, 27, 109),
    (50, 10, 65, 313),
    (50, 20, 65, 245),
    (50, 30, 52, 179),
    (50, 40, 27, 109),
    (60, 10, 59, 379),
    (60, 20, 65, 313),
    (60, 30, 65, 245),
    (60, 40, 52, 179),
    (60, 50, 27, 109),
    (70, 10, 32, 278),
    (70, 40, 35, 132),
    (90, 10, 32, 334),
    (90, 40, 35, 226),
    (90, 70, 31, 95),
    (110, 10, 30, 376),
    (110, 40, 34, 311),
    (110, 70, 35, 177),
    (110, 100, 14, 59),
    (130, 10, 28, 391),
    (130, 40, 33, 357),
    (130, 70, 32, 278),
    (130, 100, 35, 132),
];

const RATE_HZ: f64 = 10.0;
const LENGTH_M: f64 = 4.3;
const WIDTH_M: f64 = 1.9;

#[derive(Debug, Clone, Copy, PartialEq, Default)]
struct CutIn {
    /// `None` without a collision; otherwise true if the driver hits the side of the other vehicle rather than its
    /// rear.
    collides_beside: Option<bool>,
    /// Bumper gap in metres when the driver first reacts.
    reacts_at_m: Option<f64>,
}

/// Simulates a cut-in with the JRC's equations: speeds in m/s, the initial gap in metres.
///
/// The driver reacts while the vehicles overlap laterally and the time to collision is at most 2 s. A longer one ends
/// the run.
fn simulate_cut_in(own_mps: f64, other_mps: f64, gap_m: f64, lateral_mps: f64) -> CutIn {
    let from_m = [gap_m + LENGTH_M, 1.6 + WIDTH_M];
    let steps_across = (RATE_HZ * from_m[1] / lateral_mps).floor() + 1.0;
    // The original driver approaches for the time in which the lateral speed builds up at 1.5 m/s²; only position
    // rounding remains.
    let steps_before = (lateral_mps / (1.5 / RATE_HZ)).ceil() as usize;
    let come_m = |from_m: f64, step_m: f64| (0..steps_before).fold(from_m, |at_m, _| at_m + step_m);
    let mut position_m = come_m(come_m(0.0, -own_mps / RATE_HZ), own_mps / RATE_HZ);
    let mut speed_mps = own_mps;
    let (mut reaction_s, mut braking_mps2) = (0.75, 0.0);
    // Speeds are summed before they are divided, as in the original: rounding decides ties at a boundary.
    let (mut along, mut across) = (0.0, 0.0);
    let mut cut_in = CutIn::default();
    for step in 0..350 {
        let other_m = along / RATE_HZ + from_m[0];
        let aside_m = (across / RATE_HZ + from_m[1]).abs() - WIDTH_M / 2.0 - WIDTH_M / 2.0;
        let apart_m = other_m - position_m - LENGTH_M / 2.0 - LENGTH_M / 2.0;
        let is_ahead = position_m > other_m;
        let overlaps = !is_ahead && aside_m <= 0.0;
        let is_far = overlaps && (apart_m / (speed_mps - other_mps)).abs() > 2.0;
        if aside_m < 0.0
            && (position_m - other_m).abs() - LENGTH_M < 0.0
            && cut_in.collides_beside.is_none()
        {
            cut_in.collides_beside = Some(is_ahead);
        }
        if is_far {
            break;
        }
        if overlaps {
            cut_in.reacts_at_m.get_or_insert(apart_m);
            braking_mps2 = match reaction_s > 0.0 {
                true => 0.4,
                false => (braking_mps2 + 12.65 / RATE_HZ).min(0.774 * 9.81),
            };
            reaction_s -= 1.0 / RATE_HZ;
            speed_mps = (speed_mps - braking_mps2 / RATE_HZ).max(0.0);
        }
        position_m += speed_mps / RATE_HZ;
        along += other_mps;
        if f64::from(step) < steps_across {
            across -= lateral_mps;
        }
    }
    cut_in
}

fn cut_in_grid(own_kmph: u32) -> impl Iterator<Item = (f64, f64)> {
    let (last_m, step_m) = if own_kmph > 60 { (120_u32, 2) } else { (60, 1) };
    let gaps_m = (1..last_m).step_by(step_m).map(f64::from);
    gaps_m.flat_map(|gap_m| (0_u32..18).map(move |tenths| (gap_m, f64::from(tenths) * 0.1)))
}

#[test]
fn the_oracle_collides_as_often_as_the_published_code() {
    for (own_kmph, other_kmph, beside, rear) in CUT_INS {
        let [own_mps, other_mps] = [own_kmph, other_kmph].map(|kmph| f64::from(kmph) / 3.6);
        let mut collisions = [0, 0];
        for (gap_m, lateral_mps) in cut_in_grid(own_kmph) {
            if let Some(is_beside) =
                simulate_cut_in(own_mps, other_mps, gap_m, lateral_mps).collides_beside
            {
                collisions[usize::from(!is_beside)] += 1;
            }
        }
        assert_eq!(
            collisions,
            [beside, rear],
            "{own_kmph} km/h behind {other_kmph} km/h"
        );
    }
}

fn collides(own_mps: f64, other_mps: f64, gap_m: f64) -> bool {
    let vehicle = |position_m, speed_mps, driver| {
        let mut vehicle = VehicleSpec::new(VehicleClass::Light, position_m, speed_mps, driver);
        // The class brakes at 7.5 m/s², a little less than 0.774 g.
        vehicle.max_brake_mps2 = Some(9.0);
        vehicle
    };
    let mut other = vehicle(
        gap_m + VehicleClass::Light.length_m(),
        other_mps,
        Driver::Profile(LeadProfile::ConstantSpeed),
    );
    other.enters = Some(LaneChange::At(0.0));
    let vehicles = vec![other, vehicle(0.0, own_mps, Driver::UnderTest)];
    let scenario = Scenario::new(scenario_spec("cut-in", 0.01, 8.0, vehicles)).unwrap();
    let driver = BuiltInController::from_name("competent-human").unwrap();
    let run = Run::new(
        &scenario,
        RunOptions::new(driver).with_estimator(EstimatorKind::Truth),
    )
    .unwrap();
    simulate(&run, RecordingLevel::Summary)
        .outcome
        .collision()
        .is_some()
}

/// For a vehicle ahead that the published driver reacts to, crumple's driver agrees with it up to the effect of the
/// published steps of 0.1 s: with a gap 0.4 m smaller it collides if the published one does, and with one 0.4 m larger
/// it does not if that one does not. At equal gaps 16 of 1161 runs differ.
#[test]
fn the_competent_human_collides_with_vehicles_that_cut_in_where_the_published_one_does() {
    const STEP_M: f64 = 0.4;
    let mut compared = [0, 0];
    for (own_kmph, other_kmph, ..) in CUT_INS {
        let [own_mps, other_mps] = [own_kmph, other_kmph].map(|kmph| f64::from(kmph) / 3.6);
        for (gap_m, lateral_mps) in cut_in_grid(own_kmph)
            .filter(|(_, lateral_mps)| (lateral_mps * 10.0).round() % 6.0 == 5.0)
        {
            let published = simulate_cut_in(own_mps, other_mps, gap_m, lateral_mps);
            let Some(at_m) = published.reacts_at_m.filter(|at_m| *at_m > STEP_M) else {
                continue;
            };
            let it_collides = published.collides_beside.is_some();
            let at_m = if it_collides {
                at_m - STEP_M
            } else {
                at_m + STEP_M
            };
            let situation = format!("{own_kmph} km/h behind {other_kmph} km/h at {at_m} m");
            assert_eq!(
                collides(own_mps, other_mps, at_m),
                it_collides,
                "{situation}"
            );
            compared[usize::from(it_collides)] += 1;
        }
    }
    assert!(compared.iter().all(|&runs| runs > 100), "{compared:?}");
}
