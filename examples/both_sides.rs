//! What controllers do in draws of the built-in spaces, on both sides: contacts, and braking without cause.
//!
//! ```sh
//! cargo run --release --example both_sides -- 1000 policy idm acc-aeb runs/seed-0/policy.safetensors
//! ```
//! An argument that ends in `.svg` is a figure to draw: contacts in `high-risk` against jerk in `traffic`.
//! The first argument is how many draws of each space; the draws are those of a seed that neither trainings nor selections have.

use std::error::Error;
use std::path::Path;

use crumple::report::draw::{Anchor, Axis, BELOW, Frame, HEADING, Ink, LEFT, Marker, Panel, Svg};
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

/// Contacts in the one space against jerk in the other make the front.
const EMERGENCIES: &str = "high-risk";
const TRAFFIC: &str = "traffic";

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let draws: u64 = arguments.next().ok_or("how many draws?")?.parse()?;
    let (figures, names): (Vec<String>, Vec<String>) = arguments.partition(|argument| argument.ends_with(".svg"));
    println!(
        "| space | controller | contacts | into the leader | hard | needless | left behind | rms a | rms jerk | progress | time gap s | imposed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut front: Vec<(f64, f64)> = vec![(0.0, 0.0); names.len()];
    for (space, ..) in BUILT_IN_SPACES {
        for (name, (jerk_mps3, contacts_percent)) in names.iter().zip(&mut front) {
            let sums = driven(space, name, draws)?;
            let n = draws as f64;
            let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
            let rms_jerk_mps3 = (sums.squares[1] / n).sqrt();
            println!(
                "| {space} | {name} | {} | {} | {} | {} | {} | {:.2} | {rms_jerk_mps3:.2} | {:.3} | {:.2} | {:.2} |",
                sums.contacts,
                sums.into_the_leader,
                sums.hard,
                sums.needless,
                sums.left_behind,
                (sums.squares[0] / n).sqrt(),
                mean(&sums.progress),
                mean(&sums.time_gap_s),
                mean(&sums.imposed_mps2),
            );
            match space {
                EMERGENCIES => *contacts_percent = 100.0 * sums.contacts as f64 / n,
                TRAFFIC => *jerk_mps3 = rms_jerk_mps3,
                _ => {}
            }
        }
    }
    for file in figures {
        std::fs::write(&file, drawn(&names, &front, draws).document())?;
    }
    Ok(())
}

/// Safety against comfort: the better, the nearer to the lower left corner.
fn drawn(names: &[String], front: &[(f64, f64)], draws: u64) -> Svg {
    let frame = Frame { left: LEFT + 24.0, top: HEADING, width: 640.0, height: 360.0 };
    let most = front.iter().map(|at| at.0).fold(0.0, f64::max);
    let x = Axis::numbers("m/s³", (0.0, 1.1 * most), 8);
    let title = "Contacts in high-risk (%) against rms of jerk in everyday traffic";
    let mut panel = Panel::new(frame, title, x, Axis::numbers("", (0.0, 100.0), 6));
    let apart = |a: &(f64, f64), b: &(f64, f64)| ((a.0 - b.0) / most).hypot((a.1 - b.1) / 100.0);
    for (index, (name, at)) in names.iter().zip(front).enumerate() {
        let others = front.iter().enumerate().filter(|(other, _)| *other != index);
        let nearest = others.map(|(_, other)| other).min_by(|a, b| apart(a, at).total_cmp(&apart(b, at)));
        let stem = Path::new(name).file_stem().map_or(name.as_str().into(), |stem| stem.to_string_lossy());
        let marker = if name.ends_with(".safetensors") { Marker::Ring } else { Marker::Cross };
        panel.marks(&[*at], marker, Ink::Series(usize::from(name.ends_with(".safetensors"))));
        // The name is on the other side of its mark than the nearest mark.
        let is_left = nearest.is_some_and(|nearest| nearest.0 > at.0);
        let (side, anchor) = if is_left { (-0.012, Anchor::End) } else { (0.012, Anchor::Start) };
        panel.note((at.0 + side * most, at.1), anchor, &stem, Ink::Muted);
    }
    let content = panel.draw(&Svg::id("front", "frame"));
    let description = format!("{draws} draws of each space. Rings are policies of the preset road and its variants.");
    Svg::new("front", (LEFT + 24.0 + 640.0 + 24.0, HEADING + 360.0 + BELOW), title, &description, content)
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
