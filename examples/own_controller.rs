//! A custom controller, simulated, falsified and assessed together with built-in ones.
//!
//! `cargo run --release --example own_controller -- FOLDER` writes the campaign and the report to FOLDER.

use std::error::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crumple::report::assessment::{AssessConfig, AssessmentPlan, EvidenceCache, assess};
use crumple::sim::control::Ego;
use crumple::store::disk;
use crumple::{
    Campaign, Controller, ControllerFailure, ControllerSource, NamedController, Observation, Quiet,
    RecordingLevel, Run, RunOptions, Study, built_in_scenario, built_in_space, sha256, simulate,
};

/// Keeps a time gap to the vehicle ahead and brakes softly; fails if it observes no vehicle ahead.
#[derive(Clone)]
struct SoftFollower {
    time_gap_s: f64,
}

impl ControllerSource for SoftFollower {
    /// Covers everything that affects its commands: its settings, and a name that changes with the code.
    fn identity(&self) -> Option<String> {
        Some(sha256(format!(
            "soft follower, version 1, {} s",
            self.time_gap_s
        )))
    }

    fn interval_s(&self) -> Option<f64> {
        Some(0.1)
    }

    fn start(&self, _ego: &Ego, _seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(self.clone()))
    }
}

impl Controller for SoftFollower {
    fn decide(&mut self, seen: &Observation) -> Result<f64, ControllerFailure> {
        let Some(ahead) = seen.ahead else {
            return Err(ControllerFailure::Died {
                message: "no vehicle ahead".to_owned(),
            });
        };
        let spacing_error_m = ahead.gap_m - 2.0 - self.time_gap_s * seen.speed_mps;
        let wanted_mps2 = 0.2 * spacing_error_m + 0.8 * (ahead.speed_mps - seen.speed_mps);
        Ok(wanted_mps2.clamp(-4.0, 2.0))
    }
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(
        std::env::args()
            .nth(1)
            .unwrap_or_else(|| "own-controller".to_owned()),
    );
    let own =
        NamedController::from_source("soft-follower", Arc::new(SoftFollower { time_gap_s: 0.8 }));
    simulate_scenarios(&own)?;

    let campaign = Campaign::new(
        own.clone(),
        built_in_space("high-risk").ok_or("not built in")?,
    )
    .with_budget(200);
    // The controller's identity lets a second execution resume the campaign.
    let summary = campaign.run(&folder.join("campaign"), true, &Quiet)?;
    println!("{}", summary.to_text());

    assess_controller(own, &folder)
}

/// Simulates the controller in the paper's scenarios.
fn simulate_scenarios(own: &NamedController) -> Result<(), Box<dyn Error>> {
    for name in ["paper-1", "paper-2", "paper-3"] {
        let scenario = built_in_scenario(name).ok_or("not built in")?;
        let run = Run::new(&scenario, RunOptions::new(own.source.clone()))?;
        println!(
            "{name}: {:?}",
            simulate(&run, RecordingLevel::Summary).outcome
        );
    }
    Ok(())
}

/// Compares the controller with two others, and writes the report.
fn assess_controller(own: NamedController, folder: &Path) -> Result<(), Box<dyn Error>> {
    let mut config = AssessConfig::default();
    config.controllers = vec!["baseline".to_owned(), "idm".to_owned()];
    config.gates.clear();
    (config.draws, config.search.budget) = (100, 100);
    let plan = AssessmentPlan::new(config, [own], folder)?;
    let store = EvidenceCache::open(&folder.join("evidence"), "own_controller 1", false)?;
    let assessment = assess(&plan, &store, None, &Quiet)?;
    for (name, text) in assessment.files()? {
        let path = folder.join(name);
        disk::make_folder(path.parent().unwrap_or(folder))?;
        disk::write(&path, text)?;
    }
    println!(
        "{}wrote {}",
        assessment.first_page.to_plain_text(),
        folder.join("assessment.html").display()
    );
    Ok(())
}
