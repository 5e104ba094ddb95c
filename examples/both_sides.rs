//! What controllers do in draws of the built-in spaces, on both sides: contacts, and braking without cause.
//!
//! ```sh
//! cargo run --release --example both_sides -- 1000 policy idm acc-aeb runs/seed-0/policy.safetensors
//! ```
//! The first argument is how many draws of each space; the draws are those of a seed that neither trainings nor selections have.

use std::error::Error;
use std::path::Path;

use crumple::world::measure::Usefulness;
use crumple::world::observation::EstimatorKind;
use crumple::world::scenario::space::{BUILT_IN_SPACES, built_in_space};
use crumple::world::sim::{NamedController, RecordingLevel, Run, RunOptions, simulate_batch};

const SEED: u64 = 0x626f_7468;
/// Draws that are simulated at once: each keeps its motion.
const BLOCK: u64 = 100;

#[derive(Default)]
struct Sums {
    contacts: u64,
    into_the_leader: u64,
    hard: u64,
    needless: u64,
    left_behind: u64,
    squares: [f64; 2],
    progress: Vec<f64>,
    time_gap_s: Vec<f64>,
    imposed_mps2: Vec<f64>,
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let draws: u64 = arguments.next().ok_or("how many draws?")?.parse()?;
    let names: Vec<String> = arguments.collect();
    println!(
        "| space | controller | contacts | into the leader | hard | needless | left behind | rms a | rms jerk | progress | time gap s | imposed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    for (space, ..) in BUILT_IN_SPACES {
        for name in &names {
            let sums = driven(space, name, draws)?;
            let n = draws as f64;
            let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
            println!(
                "| {space} | {name} | {} | {} | {} | {} | {} | {:.2} | {:.2} | {:.3} | {:.2} | {:.2} |",
                sums.contacts,
                sums.into_the_leader,
                sums.hard,
                sums.needless,
                sums.left_behind,
                (sums.squares[0] / n).sqrt(),
                (sums.squares[1] / n).sqrt(),
                mean(&sums.progress),
                mean(&sums.time_gap_s),
                mean(&sums.imposed_mps2),
            );
        }
    }
    Ok(())
}

fn driven(space: &str, name: &str, draws: u64) -> Result<Sums, Box<dyn Error>> {
    let space = built_in_space(space).ok_or("no such space")?;
    let controller = NamedController::find(name, Path::new(""))?;
    let options = RunOptions::new(controller.kind).with_estimator(EstimatorKind::Kalman);
    let mut sums = Sums::default();
    for from in (0..draws).step_by(BLOCK as usize) {
        let scenarios =
            (from..draws.min(from + BLOCK)).map(|index| space.draw(SEED, index)).collect::<Result<Vec<_>, _>>()?;
        let runs = scenarios.iter().map(|one| Run::new(one, options.clone())).collect::<Result<Vec<_>, _>>()?;
        let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            let useful = result.trace.as_ref().and_then(|trace| Usefulness::of(trace, &result.impacts, 1));
            (result.outcome.contact().copied(), useful)
        });
        for (contact, useful) in results {
            sums.contacts += u64::from(contact.is_some());
            sums.into_the_leader += u64::from(contact.is_some_and(|contact| contact.front_vehicle == 0));
            let Some(useful) = useful else { continue };
            sums.hard += u64::from(!useful.hard.is_none());
            sums.needless += u64::from(!useful.needless.is_none());
            sums.squares[0] += useful.rms_acceleration_mps2.unwrap_or(0.0).powi(2);
            sums.squares[1] += useful.rms_jerk_mps3.unwrap_or(0.0).powi(2);
            sums.imposed_mps2.extend(useful.imposed.and_then(|imposed| imposed.peak_brake_mps2));
            let Some(following) = useful.following else { continue };
            sums.left_behind += u64::from(following.left_behind);
            sums.progress.extend(following.progress);
            sums.time_gap_s.extend(following.mean_time_gap_s);
        }
    }
    Ok(sums)
}
