//! Chasing Cars: monitors and simulation.

use std::hint::black_box;

use crumple_measure::stl::Formula;

use crate::clock::min_cpu_time_s;
use crate::table::Measurement;
use crate::work::chasing_cars::{ChasingCarsInputs, PIECES, SPECIFICATIONS, simulate};

fn switching_inputs() -> ChasingCarsInputs {
    ChasingCarsInputs {
        throttle: std::array::from_fn(|piece| [1.0, 0.2, 0.7][piece % 3]),
        brake: std::array::from_fn(|piece| if piece % 4 < PIECES / 10 { 0.1 } else { 0.9 }),
    }
}

pub fn measure(say: &mut dyn FnMut(Measurement)) {
    let motion = simulate(&switching_inputs());
    let signals = motion.signals().expect("signals");
    for (name, text) in SPECIFICATIONS {
        let formula: Formula = text.parse().expect("a formula");
        let [seconds] = min_cpu_time_s(200, [&mut || _ = black_box(formula.robustness(&signals))]);
        say(Measurement::at_most(
            0.1,
            "ms",
            format!("STL monitor, 10 001 samples, {name}"),
            1e3 * seconds,
        ));
    }
    let [seconds] = min_cpu_time_s(
        200,
        [&mut || _ = black_box(simulate(black_box(&switching_inputs())))],
    );
    say(Measurement::at_most(
        0.5,
        "ms",
        "Chasing Cars, one simulation of 10 000 steps",
        1e3 * seconds,
    ));
}
