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
use crumple::sim::engine::{
    NamedController, RecordingLevel, Run, RunOptions, simulate, simulate_batch,
};
use crumple::sim::observation::EstimatorKind;
use crumple::sim::scenario::{Driver, LeadProfile, SPEED_DIP_ONSET_S, Scenario, speed_dip};
use crumple::spaces::{BUILT_IN_SPACES, built_in_space};

const SEED: u64 = 0x626f_7468;
/// Scenarios simulated at once: each keeps its trace.
const BLOCK: u64 = 100;
/// Maximum number of random scenarios of each space: a day's work.
const MAX_DRAWS: u64 = 1_000_000;
/// Initial time gap of the line of five, in seconds.
const TIME_GAP_S: f64 = 1.5;

#[derive(Default)]
struct SpaceTotals {
    collisions: u64,
    leader_collisions: u64,
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
    collisions_percent: f64,
    /// False for a trained policy.
    is_untrained: bool,
}

const JERK_TICKS_MPS3: [f64; 8] = [0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0];
const COLLISION_TICKS_PERCENT: [f64; 8] = [0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0];

impl ParetoPoint {
    fn new(controller: &NamedController) -> Self {
        let name = &controller.name;
        Self {
            name: Path::new(name)
                .file_name()
                .map_or(name.as_str().into(), |name| name.to_string_lossy())
                .into_owned(),
            jerk_mps3: 0.0,
            collisions_percent: 0.0,
            is_untrained: !name.ends_with(".safetensors"),
        }
    }

    /// Returns the position on the logarithmic axes of the figure, within their ends.
    fn position(&self) -> (f64, f64) {
        (
            self.jerk_mps3
                .clamp(JERK_TICKS_MPS3[0], JERK_TICKS_MPS3[7])
                .log10(),
            self.collisions_percent
                .clamp(COLLISION_TICKS_PERCENT[0], COLLISION_TICKS_PERCENT[7])
                .log10(),
        )
    }
}

impl SpaceTotals {
    fn add_measures(&mut self, measures: UsefulnessMeasures) {
        self.hard += u64::from(!measures.hard.is_empty());
        self.unnecessary += u64::from(!measures.unnecessary.is_empty());
        self.squares[0] += measures.rms_acceleration_mps2.unwrap_or(0.0).powi(2);
        self.squares[1] += measures.rms_jerk_mps3.unwrap_or(0.0).powi(2);
        self.induced_braking_mps2
            .extend(measures.induced.and_then(|induced| induced.peak_brake_mps2));
        if let Some(following) = measures.following {
            self.fell_behind += u64::from(following.fell_behind);
            self.progress.extend(following.progress);
            self.time_gap_s.extend(following.mean_time_gap_s);
        }
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

impl std::str::FromStr for FollowerChange {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "later" => Ok(Self::Later),
            "softer" => Ok(Self::Softer),
            "no-brake" => Ok(Self::NoBrake),
            other => Err(format!("`{other}` is no change of the follower")),
        }
    }
}

fn find_space_name(name: &str) -> Result<&'static str, String> {
    BUILT_IN_SPACES
        .iter()
        .map(|(built_in, ..)| *built_in)
        .find(|built_in| *built_in == name)
        .ok_or_else(|| format!("there is no built-in space `{name}`"))
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
        let mut parsed = Self {
            draws,
            controllers: Vec::new(),
            figures: Vec::new(),
            spaces: Vec::new(),
            seed: SEED,
            estimator: EstimatorKind::Kalman,
            follower: FollowerChange::None,
        };
        for argument in arguments {
            parsed.add(argument)?;
        }
        if parsed.controllers.is_empty() {
            return Err("which controllers?".into());
        }
        if parsed.spaces.is_empty() {
            let names = BUILT_IN_SPACES.iter().map(|(name, ..)| *name);
            parsed.spaces.extend(names);
        }
        if let Some(missing) = [EMERGENCY_SPACE, TRAFFIC_SPACE]
            .iter()
            .find(|space| !parsed.figures.is_empty() && !parsed.spaces.contains(space))
        {
            return Err(format!("a figure needs the space `{missing}`").into());
        }
        Ok(parsed)
    }

    /// Adds an argument after the number of random scenarios.
    fn add(&mut self, argument: String) -> Result<(), ExperimentError> {
        if let Some(number) = argument.strip_prefix("seed=") {
            self.seed = number
                .parse()
                .map_err(|_| format!("`{number}` is no seed"))?;
        } else if argument == "estimator=truth" {
            self.estimator = EstimatorKind::Truth;
        } else if let Some(name) = argument.strip_prefix("follower=") {
            self.follower = name.parse()?;
        } else if let Some(name) = argument.strip_prefix("space=") {
            self.spaces.push(find_space_name(name)?);
        } else if argument.ends_with(".svg") {
            self.figures.push(argument);
        } else {
            self.controllers
                .push(find_and_try(&argument, Path::new(""))?);
        }
        Ok(())
    }

    /// Simulates the random scenarios of a space with a controller.
    fn simulate_draws(
        &self,
        space: &str,
        controller: &NamedController,
    ) -> Result<SpaceTotals, ExperimentError> {
        let space = built_in_space(space).ok_or("no such space")?;
        let options = RunOptions::new(controller.source.clone()).with_estimator(self.estimator);
        let mut totals = SpaceTotals::default();
        for from in (0..self.draws).step_by(BLOCK as usize) {
            let scenarios = (from..self.draws.min(from + BLOCK))
                .map(|index| self.follower.apply(space.draw(self.seed, index)?))
                .collect::<Result<Vec<_>, _>>()?;
            let runs = scenarios
                .iter()
                .map(|scenario| Run::new(scenario, options.clone()))
                .collect::<Result<Vec<_>, _>>()?;
            let results = simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
                let measures = result
                    .trace
                    .as_ref()
                    .and_then(|trace| UsefulnessMeasures::from_trace(trace, &result.impacts, 1));
                (result.outcome.collision().copied(), measures)
            });
            for (collision, measures) in results {
                totals.collisions += u64::from(collision.is_some());
                totals.leader_collisions +=
                    u64::from(collision.is_some_and(|collision| collision.front_vehicle == 0));
                if let Some(measures) = measures {
                    totals.add_measures(measures);
                }
            }
        }
        Ok(totals)
    }
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let arguments = SpaceComparisonArgs::parse(arguments.iter().cloned())?;
    println!(
        "| space | controller | collisions | with the leader | hard | unnecessary | fell behind | rms a | rms jerk | \
         progress | time gap s | induced |"
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|---|");
    let mut front: Vec<ParetoPoint> = arguments.controllers.iter().map(ParetoPoint::new).collect();
    for &space in &arguments.spaces {
        for (controller, point) in arguments.controllers.iter().zip(&mut front) {
            let totals = arguments.simulate_draws(space, controller)?;
            print_totals(space, &controller.name, &totals, arguments.draws);
            let n = arguments.draws as f64;
            match space {
                EMERGENCY_SPACE => point.collisions_percent = 100.0 * totals.collisions as f64 / n,
                TRAFFIC_SPACE => point.jerk_mps3 = (totals.squares[1] / n).sqrt(),
                _ => {}
            }
        }
    }
    print_line_gains(&arguments.controllers, arguments.estimator)?;
    for file in &arguments.figures {
        std::fs::write(file, draw_front(&front, arguments.draws).document())
            .map_err(|error| format!("{file}: {error}"))?;
    }
    Ok(())
}

fn print_totals(space: &str, name: &str, totals: &SpaceTotals, draws: u64) {
    let n = draws as f64;
    let bounds = RateInterval::clopper_pearson(totals.collisions, draws, 0.95);
    println!(
        "| {space} | {name} | {} ({:.2} to {:.2}) | {} | {} | {} | {} | {:.2} | {:.3} | {:.3} | {:.2} | {:.2} |",
        totals.collisions,
        100.0 * bounds.lower,
        100.0 * bounds.upper,
        totals.leader_collisions,
        totals.hard,
        totals.unnecessary,
        totals.fell_behind,
        (totals.squares[0] / n).sqrt(),
        (totals.squares[1] / n).sqrt(),
        mean(&totals.progress),
        mean(&totals.time_gap_s),
        mean(&totals.induced_braking_mps2),
    );
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// Prints the gain of a line of five vehicles for each controller.
fn print_line_gains(
    controllers: &[NamedController],
    estimator: EstimatorKind,
) -> Result<(), ExperimentError> {
    println!("\n| controller | gain of a line of five |\n|---|---|");
    let line = speed_dip(5, TIME_GAP_S)?;
    for controller in controllers {
        let options = RunOptions::new(controller.source.clone()).with_estimator(estimator);
        let result = simulate(&Run::new(&line, options)?, RecordingLevel::Trace);
        let gain = result
            .trace
            .as_ref()
            .filter(|_| result.outcome.is_safe())
            .and_then(|trace| SpeedAmplification::from_trace(trace, SPEED_DIP_ONSET_S))
            .map_or("none".to_owned(), |amplification| {
                format!("{:.2}", amplification.overall)
            });
        println!("| {} | {gain} |", controller.name);
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
    let title = "Collisions in high-risk (%) against rms of jerk in everyday traffic";
    let mut panel = Panel::new(
        frame,
        title,
        logarithmic_axis("m/s³", &JERK_TICKS_MPS3),
        logarithmic_axis("", &COLLISION_TICKS_PERCENT),
    );
    let positions: Vec<(f64, f64)> = front.iter().map(ParetoPoint::position).collect();
    for (index, (point, &(x, y))) in front.iter().zip(&positions).enumerate() {
        // The label is on the left if the nearest mark to the right would be under it.
        let is_left = positions
            .iter()
            .enumerate()
            .filter(|(other, _)| *other != index)
            .any(|(_, other)| (0.0..0.6).contains(&(other.0 - x)) && (other.1 - y).abs() < 0.08);
        let marker = if point.is_untrained {
            Marker::Cross
        } else {
            Marker::Ring
        };
        let ink = Ink::Series(usize::from(!point.is_untrained));
        panel.add_markers(&[(x, y)], marker, ink);
        if is_left {
            panel.add_note((x - 0.03, y), Anchor::End, &point.name, Ink::Muted);
        } else {
            panel.add_note((x + 0.03, y), Anchor::Start, &point.name, Ink::Muted);
        }
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

fn logarithmic_axis(unit: &str, ticks: &[f64]) -> Axis {
    let ends = (ticks[0].log10(), ticks[ticks.len() - 1].log10());
    Axis::with_ticks(
        unit,
        ends,
        ticks
            .iter()
            .map(|tick| (tick.log10(), tick.to_string()))
            .collect(),
    )
}

#[cfg(test)]
mod tests;
