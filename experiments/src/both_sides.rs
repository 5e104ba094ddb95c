//! Compares safety and usability of controllers in the built-in scenario spaces: collisions and unnecessary braking.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- both_sides 1000 policy idm acc-aeb runs/seed-0/policy.safetensors
//! ```
//! The first argument is the number of random scenarios of each space, with a seed that no training or selection uses.
//! An argument that ends in `.svg` is a figure: collisions in `high-risk` against jerk in `traffic`. `space=NAME`
//! restricts the spaces; it may be repeated.
//!
//! `seed=N` takes other random scenarios, `estimator=truth` shows the true state to the controllers, and `follower=`
//! changes the vehicle behind: `later` reacts 0.5 s later, `softer` brakes with 0.7 times its deceleration, and
//! `no-brake` holds its speed.
//!
//! Columns count random scenarios; the brackets have exact 95 % bounds in percent. `hard`: braking harder than 4 m/s²
//! where less than 3 m/s² was necessary. `needless`: braking more than 2 m/s² harder than necessary. The measure
//! `measure::UnnecessaryBraking` defines necessary braking and counts braking of at least 0.2 s. The last table has the
//! gain of a line of five: the change of speed of the last vehicle relative to that of the leader, which slows down.

use crumple_controllers::find_and_try;
use std::path::Path;

use crate::ExperimentError;
use crumple::evidence::RateInterval;
use crumple::measure::{SpeedAmplification, UsefulnessMeasures};
use crumple::report::draw::{
    Anchor, Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Marker, Panel, PixelRect, Svg,
};
use crumple::spaces::{BUILT_IN_SPACES, built_in_space};
use crumple::world::observation::EstimatorKind;
use crumple::world::scenario::{Driver, LeadProfile, SPEED_DIP_ONSET_S, Scenario, speed_dip};
use crumple::world::sim::{
    NamedController, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};

const SEED: u64 = 0x626f_7468;
/// Scenarios simulated at once: each keeps its trace.
const BLOCK: u64 = 100;
/// Maximum number of random scenarios of each space: a day's work.
const MAX_DRAWS: u64 = 1_000_000;
/// Initial time gap of the line of five, in seconds.
const TIME_GAP_S: f64 = 1.5;

#[derive(Default)]
struct SpaceTotals {
    contacts: u64,
    leader_contacts: u64,
    hard: u64,
    unnecessary: u64,
    fell_behind: u64,
    squares: [f64; 2],
    progress: Vec<f64>,
    time_gap_s: Vec<f64>,
    induced_braking_mps2: Vec<f64>,
}

/// The figure plots collisions in the first space against jerk in the second.
const EMERGENCY_SPACE: &str = "high-risk";
const TRAFFIC_SPACE: &str = "traffic";

struct ParetoPoint {
    name: String,
    /// RMS jerk in `traffic`.
    jerk_mps3: f64,
    /// Share of random scenarios of `high-risk`.
    contacts_percent: f64,
    /// False for a trained policy.
    is_untrained: bool,
}

impl ParetoPoint {
    fn position(&self) -> (f64, f64) {
        (self.jerk_mps3, self.contacts_percent)
    }
}

struct SpaceComparisonArgs {
    draws: u64,
    controllers: Vec<NamedController>,
    figures: Vec<String>,
    spaces: Vec<&'static str>,
    seed: u64,
    estimator: EstimatorKind,
    follower: FollowerChange,
}

/// Change of the vehicle behind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum FollowerChange {
    None,
    Later,
    Softer,
    NoBrake,
}

impl FollowerChange {
    fn apply(self, scenario: Scenario) -> Result<Scenario, ExperimentError> {
        if self == Self::None {
            return Ok(scenario);
        }
        let mut spec = scenario.spec().clone();
        if let Some(behind) = spec.vehicles.get_mut(2) {
            match self {
                Self::None => {}
                Self::Later => behind.reaction_delay_s += 0.5,
                Self::Softer => {
                    let brake_mps2 = behind
                        .max_brake_mps2
                        .unwrap_or(behind.class.max_brake_mps2());
                    behind.max_brake_mps2 = Some(0.7 * brake_mps2);
                }
                Self::NoBrake => {
                    behind.driver = Driver::Profile(LeadProfile::ConstantSpeed);
                    behind.reaction_delay_s = 0.0;
                }
            }
        }
        Ok(Scenario::new(spec)?)
    }
}

impl SpaceComparisonArgs {
    fn parse(mut arguments: impl Iterator<Item = String>) -> Result<Self, ExperimentError> {
        let draws = arguments.next().ok_or("how many draws?")?;
        let draws = match draws.parse() {
            Ok(count) if (1..=MAX_DRAWS).contains(&count) => count,
            _ => {
                return Err(
                    format!("`{draws}` is no number of draws from 1 to {MAX_DRAWS}").into(),
                );
            }
        };
        let (mut controllers, mut figures, mut spaces) = (Vec::new(), Vec::new(), Vec::new());
        let (mut seed, mut estimator, mut follower) =
            (SEED, EstimatorKind::Kalman, FollowerChange::None);
        for argument in arguments {
            if let Some(number) = argument.strip_prefix("seed=") {
                seed = number
                    .parse()
                    .map_err(|_| format!("`{number}` is no seed"))?;
            } else if argument == "estimator=truth" {
                estimator = EstimatorKind::Truth;
            } else if let Some(name) = argument.strip_prefix("follower=") {
                follower = match name {
                    "later" => FollowerChange::Later,
                    "softer" => FollowerChange::Softer,
                    "no-brake" => FollowerChange::NoBrake,
                    other => return Err(format!("`{other}` is no change of the follower").into()),
                };
            } else if let Some(name) = argument.strip_prefix("space=") {
                let known = BUILT_IN_SPACES.iter().find(|(known, ..)| *known == name);
                spaces.push(
                    known
                        .ok_or_else(|| format!("there is no built-in space `{name}`"))?
                        .0,
                );
            } else if argument.ends_with(".svg") {
                figures.push(argument);
            } else {
                controllers.push(find_and_try(&argument, Path::new(""))?);
            }
        }
        if controllers.is_empty() {
            return Err("which controllers?".into());
        }
        if spaces.is_empty() {
            spaces.extend(BUILT_IN_SPACES.iter().map(|(name, ..)| *name));
        }
        if let Some(missing) = [EMERGENCY_SPACE, TRAFFIC_SPACE]
            .iter()
            .find(|space| !figures.is_empty() && !spaces.contains(space))
        {
            return Err(format!("a figure needs the space `{missing}`").into());
        }
        Ok(Self {
            draws,
            controllers,
            figures,
            spaces,
            seed,
            estimator,
            follower,
        })
    }
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let SpaceComparisonArgs {
        draws,
        controllers,
        figures,
        spaces,
        seed,
        estimator,
        follower,
    } = SpaceComparisonArgs::parse(arguments.iter().cloned())?;
    println!(
        "| space | controller | contacts | into the leader | hard | needless | left behind | rms a | rms jerk | \
         progress | time gap s | imposed |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mark_of = |NamedController { name, .. }: &NamedController| ParetoPoint {
        name: Path::new(name)
            .file_name()
            .map_or(name.as_str().into(), |name| name.to_string_lossy())
            .into_owned(),
        jerk_mps3: 0.0,
        contacts_percent: 0.0,
        is_untrained: !name.ends_with(".safetensors"),
    };
    let mut front: Vec<ParetoPoint> = controllers.iter().map(mark_of).collect();
    for space in spaces {
        for (controller, mark) in controllers.iter().zip(&mut front) {
            let name = &controller.name;
            let sums = simulate_draws(space, controller, draws, seed, (estimator, follower))?;
            let n = draws as f64;
            let mean = |of: &[f64]| of.iter().sum::<f64>() / of.len().max(1) as f64;
            let rms_jerk_mps3 = (sums.squares[1] / n).sqrt();
            let bounds = RateInterval::clopper_pearson(sums.contacts, draws, 0.95);
            println!(
                "| {space} | {name} | {} ({:.2} to {:.2}) | {} | {} | {} | {} | {:.2} | {rms_jerk_mps3:.3} | {:.3} | \
                 {:.2} | {:.2} |",
                sums.contacts,
                100.0 * bounds.lower,
                100.0 * bounds.upper,
                sums.leader_contacts,
                sums.hard,
                sums.unnecessary,
                sums.fell_behind,
                (sums.squares[0] / n).sqrt(),
                mean(&sums.progress),
                mean(&sums.time_gap_s),
                mean(&sums.induced_braking_mps2),
            );
            match space {
                EMERGENCY_SPACE => mark.contacts_percent = 100.0 * sums.contacts as f64 / n,
                TRAFFIC_SPACE => mark.jerk_mps3 = rms_jerk_mps3,
                _ => {}
            }
        }
    }
    println!("\n| controller | gain of a line of five |\n|---|---|");
    let line = speed_dip(5, TIME_GAP_S)?;
    for controller in &controllers {
        let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
        let run = simulate(&Run::new(&line, options)?, RecordingLevel::Trace);
        let found = run.trace.as_ref().filter(|_| run.outcome.is_safe());
        let found =
            found.and_then(|trace| SpeedAmplification::from_trace(trace, SPEED_DIP_ONSET_S));
        let gain = found.map_or("none".to_owned(), |found| format!("{:.2}", found.overall));
        println!("| {} | {gain} |", controller.name);
    }
    for file in figures {
        std::fs::write(&file, draw_front(&front, draws).document())
            .map_err(|error| format!("{file}: {error}"))?;
    }
    Ok(())
}

/// Plots safety against comfort on logarithmic axes; the lower left corner is best.
fn draw_front(front: &[ParetoPoint], draws: u64) -> Svg {
    let frame = PixelRect {
        left: LEFT_MARGIN + 24.0,
        top: HEADING_HEIGHT,
        width: 640.0,
        height: 360.0,
    };
    let axis = |unit: &str, ticks: &[f64]| {
        let ends = (ticks[0].log10(), ticks[ticks.len() - 1].log10());
        Axis::with_ticks(
            unit,
            ends,
            ticks
                .iter()
                .map(|tick| (tick.log10(), tick.to_string()))
                .collect(),
        )
    };
    let title = "Collisions in high-risk (%) against rms of jerk in everyday traffic";
    let (x, y) = (
        [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0],
        [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0],
    );
    let mut panel = Panel::new(frame, title, axis("m/s³", &x), axis("", &y));
    let position = |mark: &ParetoPoint| {
        let (jerk, contacts) = mark.position();
        (
            jerk.clamp(x[0], x[7]).log10(),
            contacts.clamp(y[0], y[7]).log10(),
        )
    };
    for (index, mark) in front.iter().enumerate() {
        let at = position(mark);
        let others = front
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .map(|(_, other)| position(other));
        // The label is on the left if the nearest mark to the right would be under it.
        let is_left = others
            .into_iter()
            .any(|(x, y)| (0.0..0.6).contains(&(x - at.0)) && (y - at.1).abs() < 0.08);
        let marker = if mark.is_untrained {
            Marker::Cross
        } else {
            Marker::Ring
        };
        panel.add_markers(&[at], marker, Ink::Series(usize::from(!mark.is_untrained)));
        let (side, anchor) = if is_left {
            (-0.03, Anchor::End)
        } else {
            (0.03, Anchor::Start)
        };
        panel.add_note((at.0 + side, at.1), anchor, &mark.name, Ink::Muted);
    }
    let content = panel.draw(&Svg::id("front", "frame"));
    let description =
        format!("{draws} random scenarios of each space. Rings are policies from a file.");
    Svg::new(
        "front",
        (
            LEFT_MARGIN + 24.0 + 640.0 + 24.0,
            HEADING_HEIGHT + 360.0 + BOTTOM_MARGIN,
        ),
        title,
        &description,
        content,
    )
}

fn simulate_draws(
    space: &str,
    controller: &NamedController,
    draws: u64,
    seed: u64,
    (estimator, follower): (EstimatorKind, FollowerChange),
) -> Result<SpaceTotals, ExperimentError> {
    let space = built_in_space(space).ok_or("no such space")?;
    let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
    let mut sums = SpaceTotals::default();
    for from in (0..draws).step_by(BLOCK as usize) {
        let scenarios = (from..draws.min(from + BLOCK))
            .map(|index| follower.apply(space.draw(seed, index)?))
            .collect::<Result<Vec<_>, _>>()?;
        let runs = scenarios
            .iter()
            .map(|one| Run::new(one, options.clone()))
            .collect::<Result<Vec<_>, _>>()?;
        let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
            let useful = result
                .trace
                .as_ref()
                .and_then(|trace| UsefulnessMeasures::from_trace(trace, &result.impacts, 1));
            (result.outcome.contact().copied(), useful)
        });
        for (contact, useful) in results {
            sums.contacts += u64::from(contact.is_some());
            sums.leader_contacts +=
                u64::from(contact.is_some_and(|contact| contact.front_vehicle == 0));
            let Some(useful) = useful else { continue };
            sums.hard += u64::from(!useful.hard.is_empty());
            sums.unnecessary += u64::from(!useful.unnecessary.is_empty());
            sums.squares[0] += useful.rms_acceleration_mps2.unwrap_or(0.0).powi(2);
            sums.squares[1] += useful.rms_jerk_mps3.unwrap_or(0.0).powi(2);
            sums.induced_braking_mps2
                .extend(useful.induced.and_then(|imposed| imposed.peak_brake_mps2));
            let Some(following) = useful.following else {
                continue;
            };
            sums.fell_behind += u64::from(following.fell_behind);
            sums.progress.extend(following.progress);
            sums.time_gap_s.extend(following.mean_time_gap_s);
        }
    }
    Ok(sums)
}

#[cfg(test)]
mod tests;
