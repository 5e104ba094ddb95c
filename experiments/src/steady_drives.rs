//! Compares controllers in steady driving: behind a leader that holds its speed, no follower is a reason to brake.
//!
//! ```sh
//! cargo run --release -p crumple-experiments -- steady_drives 2000 idm predictive road seed=909090
//! ```
//! The arguments are the number of drives, and controllers, of which the first is the reference. `seed=N` takes other
//! drives. A drive is a random scenario of `everyday` at 10 m/s or more, in which leader, vehicle under test and
//! follower start at the same speed, and the leader holds it for a minute.
//!
//! Lines: each kind of follower, and those of all kinds. Columns: drives; collisions; the largest difference of hardest
//! braking from the reference in m/s², and drives in which it exceeds 0.3 m/s²; the largest difference of final speeds
//! in m/s, and drives in which it exceeds 0.5 m/s.

use std::collections::BTreeMap;
use std::path::Path;

use crate::ExperimentError;
use crate::follower_kinds::follower_kind;
use crumple::sim::engine::{NamedController, RecordingLevel, Run, RunOptions, simulate_batch};
use crumple::sim::scenario::{Driver, LeadProfile, Scenario};
use crumple::spaces::{ScenarioSpace, built_in_space};
use crumple_controllers::find_and_try;

const SEED: u64 = 0x7374_6561;
/// Maximum number of drives: a day's work.
const MAX_DRIVES: usize = 1_000_000;
/// Drives simulated at once: each keeps its trace.
const BLOCK: usize = 100;
const DURATION_S: f64 = 60.0;
/// Slowest speed of a drive, in m/s.
const MIN_SPEED_MPS: f64 = 10.0;
/// Largest accepted difference of hardest braking from the reference, in m/s².
const MAX_EXTRA_BRAKE_MPS2: f64 = 0.3;
/// Largest accepted difference of final speed from the reference, in m/s.
const MAX_SPEED_DIFFERENCE_MPS: f64 = 0.5;
/// Index of the vehicle under test.
const EGO: usize = 1;

struct SteadyDriveArgs {
    drives: usize,
    controllers: Vec<NamedController>,
    seed: u64,
}

impl SteadyDriveArgs {
    fn parse(arguments: &[String]) -> Result<Self, ExperimentError> {
        let (drives, others) = arguments.split_first().ok_or("how many drives?")?;
        let count: usize = drives
            .parse()
            .ok()
            .filter(|count| (1..=MAX_DRIVES).contains(count))
            .ok_or_else(|| format!("`{drives}` is no number of drives from 1 to {MAX_DRIVES}"))?;
        let mut parsed = Self {
            drives: count,
            controllers: Vec::new(),
            seed: SEED,
        };
        for argument in others {
            if let Some(number) = argument.strip_prefix("seed=") {
                parsed.seed = number.parse()?;
            } else {
                let controller = find_and_try(argument, Path::new(""))?;
                parsed.controllers.push(controller);
            }
        }
        if parsed.controllers.is_empty() {
            return Err("which controllers?".into());
        }
        Ok(parsed)
    }
}

struct SteadyDrive {
    scenario: Scenario,
    follower: String,
}

impl SteadyDrive {
    /// Draws the scenario `index`; `None` below the slowest speed.
    fn draw(space: &ScenarioSpace, seed: u64, index: u64) -> Result<Option<Self>, ExperimentError> {
        let drawn = space.draw(seed, index)?;
        let speed_mps = drawn.spec().vehicles[EGO].speed_mps;
        if speed_mps < MIN_SPEED_MPS {
            return Ok(None);
        }
        let scenario = drawn.edited(|spec| {
            spec.duration_s = DURATION_S;
            spec.vehicles[0].driver = Driver::Profile(LeadProfile::ConstantSpeed);
            for vehicle in &mut spec.vehicles {
                vehicle.speed_mps = speed_mps;
            }
        })?;
        let follower = follower_kind(space, seed, index);
        Ok(Some(Self { scenario, follower }))
    }
}

/// Outcome of one drive.
#[derive(Debug, Clone, Copy)]
struct SteadyOutcome {
    collides: bool,
    hardest_mps2: f64,
    final_mps: f64,
}

/// Differences from the reference.
#[derive(Debug, Clone, Copy, Default)]
struct Differences {
    drives: usize,
    collisions: usize,
    max_extra_brake_mps2: f64,
    hard: usize,
    max_speed_mps: f64,
    far: usize,
}

impl Differences {
    fn add(&mut self, drive: &SteadyOutcome, reference: &SteadyOutcome) {
        let extra_brake_mps2 = drive.hardest_mps2 - reference.hardest_mps2;
        let speed_mps = (drive.final_mps - reference.final_mps).abs();
        self.drives += 1;
        self.collisions += usize::from(drive.collides);
        self.max_extra_brake_mps2 = self.max_extra_brake_mps2.max(extra_brake_mps2);
        self.hard += usize::from(extra_brake_mps2 > MAX_EXTRA_BRAKE_MPS2);
        self.max_speed_mps = self.max_speed_mps.max(speed_mps);
        self.far += usize::from(speed_mps > MAX_SPEED_DIFFERENCE_MPS);
    }
}

pub(crate) fn run(arguments: &[String]) -> Result<(), ExperimentError> {
    let arguments = SteadyDriveArgs::parse(arguments)?;
    let space = built_in_space("everyday").ok_or("there is no space `everyday`")?;
    let mut drives = Vec::new();
    let mut index = 0;
    while drives.len() < arguments.drives {
        drives.extend(SteadyDrive::draw(&space, arguments.seed, index)?);
        index += 1;
    }
    let mut totals: BTreeMap<(String, usize), Differences> = BTreeMap::new();
    for block in drives.chunks(BLOCK) {
        let results = arguments
            .controllers
            .iter()
            .map(|controller| drive_all(block, controller))
            .collect::<Result<Vec<_>, _>>()?;
        for (position, drive) in block.iter().enumerate() {
            for kind in [drive.follower.as_str(), "all"] {
                for (number, of_controller) in results.iter().enumerate() {
                    let total = totals.entry((kind.to_owned(), number)).or_default();
                    total.add(&of_controller[position], &results[0][position]);
                }
            }
        }
    }
    print(&totals, &arguments.controllers);
    Ok(())
}

fn print(totals: &BTreeMap<(String, usize), Differences>, controllers: &[NamedController]) {
    println!(
        "| follower | controller | drives | collisions | brakes harder by, m/s² | by more than \
         {MAX_EXTRA_BRAKE_MPS2} | final speed differs by, m/s | by more than {MAX_SPEED_DIFFERENCE_MPS} |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    for ((kind, number), total) in totals {
        println!(
            "| {kind} | {} | {} | {} | {:.3} | {} | {:.3} | {} |",
            controllers[*number].name,
            total.drives,
            total.collisions,
            total.max_extra_brake_mps2,
            total.hard,
            total.max_speed_mps,
            total.far,
        );
    }
}

fn drive_all(
    drives: &[SteadyDrive],
    controller: &NamedController,
) -> Result<Vec<SteadyOutcome>, ExperimentError> {
    let options = RunOptions::new(controller.source.clone());
    let runs = drives
        .iter()
        .map(|drive| Run::new(&drive.scenario, options.clone()))
        .collect::<Result<Vec<_>, _>>()?;
    Ok(simulate_batch(&runs, RecordingLevel::Trace, |_, result| {
        SteadyOutcome {
            collides: result.outcome.collision().is_some(),
            hardest_mps2: result.vehicles[EGO].max_brake_mps2,
            final_mps: result
                .trace
                .as_ref()
                .and_then(|trace| trace.vehicles[EGO].speed_mps.last().copied())
                .unwrap_or(f64::NAN),
        }
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arguments_that_make_no_sense_are_named() {
        for (arguments, expected) in [
            (&[][..], "how many drives?"),
            (
                &["0", "idm"][..],
                "`0` is no number of drives from 1 to 1000000",
            ),
            (&["10"][..], "which controllers?"),
        ] {
            let arguments: Vec<_> = arguments.iter().map(|word| (*word).to_owned()).collect();
            let error = SteadyDriveArgs::parse(&arguments).err().unwrap();
            assert_eq!(error.to_string(), expected);
        }
    }

    #[test]
    fn a_drive_starts_at_one_speed_behind_a_leader_that_holds_it() {
        let space = built_in_space("everyday").unwrap();
        let drives: Vec<_> = (0..200)
            .filter_map(|index| SteadyDrive::draw(&space, 1, index).unwrap())
            .collect();
        assert!((120..200).contains(&drives.len()), "{}", drives.len());
        for drive in &drives {
            let vehicles = drive.scenario.vehicles();
            assert_eq!(vehicles.len() == 2, drive.follower == "none");
            assert_eq!(
                vehicles[0].driver,
                Driver::Profile(LeadProfile::ConstantSpeed)
            );
            assert!(vehicles[0].speed_mps >= MIN_SPEED_MPS);
            assert!(
                vehicles
                    .iter()
                    .all(|vehicle| vehicle.speed_mps == vehicles[0].speed_mps)
            );
        }
    }

    #[test]
    fn differences_beyond_the_limits_are_counted() {
        let reference = SteadyOutcome {
            collides: false,
            hardest_mps2: 0.8,
            final_mps: 20.0,
        };
        let mut total = Differences::default();
        for [hardest_mps2, final_mps] in [[1.0, 19.6], [1.2, 20.4], [0.1, 19.0]] {
            let drive = SteadyOutcome {
                hardest_mps2,
                final_mps,
                ..reference
            };
            total.add(&drive, &reference);
        }
        assert_eq!((total.drives, total.hard, total.far), (3, 1, 1));
        assert!((total.max_extra_brake_mps2 - 0.4).abs() < 1e-12);
        assert!((total.max_speed_mps - 1.0).abs() < 1e-12);
    }
}
