//! Cost of monitoring: each Chasing Cars specification on one trace of 10 001 samples, compared with the simulation.

#![allow(clippy::expect_used, reason = "a bench that cannot start must say so")]

use crumple_search::falsify::chasing_cars::{ChasingCarsInputs, PIECES, SPECIFICATIONS, simulate};
use crumple_world::measure::stl::Formula;
use divan::Bencher;

fn main() {
    divan::main();
}

fn switching_inputs() -> ChasingCarsInputs {
    ChasingCarsInputs {
        throttle: std::array::from_fn(|piece| [1.0, 0.2, 0.7][piece % 3]),
        brake: std::array::from_fn(|piece| if piece % 4 < PIECES / 10 { 0.1 } else { 0.9 }),
    }
}

#[divan::bench(args = SPECIFICATIONS.map(|(name, _)| name))]
fn monitor(bencher: Bencher, name: &str) {
    let (_, text) = SPECIFICATIONS.iter().find(|(known, _)| *known == name).expect("a specification of that name");
    let formula: Formula = text.parse().expect("a formula");
    let motion = simulate(&switching_inputs());
    let signals = motion.signals().expect("signals");
    bencher.bench(|| formula.robustness(&signals));
}

#[divan::bench]
fn simulation(bencher: Bencher) {
    bencher.bench(|| simulate(divan::black_box(&switching_inputs())));
}

#[divan::bench]
fn simulation_to_robustness(bencher: Bencher) {
    let formula: Formula = SPECIFICATIONS[3].1.parse().expect("a formula");
    bencher
        .bench(|| crumple_search::falsify::chasing_cars::robustness(&formula, divan::black_box(&switching_inputs())));
}
