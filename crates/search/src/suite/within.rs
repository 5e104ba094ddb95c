//! The worst point of the ranges that a clause allows, between the values of its grid too.

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use serde::Serialize;

use super::figure::Figure;
use super::result::{Failed, TestVerdict};
use super::run::{Driven, Seen};
use super::spec::{Lead, TestSpec};
use crumple_world::digest::sha256;
use crumple_world::random::{self, Purpose, Stream};
use crumple_world::scenario::Scenario;

/// Points that are drawn evenly, then how often and how many near the worst so far.
const DRAWN: usize = 256;
const ROUNDS: i32 = 5;
const NEAR: usize = 48;

/// The worst point that was found within the ranges of a test.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Within {
    /// The point in words.
    pub point: String,
    /// What happened there.
    pub verdict: TestVerdict,
    /// The smallest gap there, in metres.
    pub min_gap_m: Option<f64>,
    /// How many points were tried: that none of them failed proves nothing of the others.
    pub tried: usize,
    /// What is known of it, if it failed.
    pub failed: Option<Failed>,
}

/// A point, its scenario and what a run showed.
pub(super) struct Worst {
    pub(super) point: Vec<f64>,
    pub(super) scenario: Scenario,
    pub(super) seen: Seen,
    pub(super) tried: usize,
}

/// The worst point found within the ranges of a test; none of a test without ranges. What is drawn depends on the test alone.
pub(super) fn worst(name: &str, about: &str, test: &TestSpec, lead: Lead, driven: &Driven<'_>) -> Option<Worst> {
    let ranges: Vec<(usize, &Figure)> = test.ranges.iter().filter_map(|&parameter| test.place(parameter)).collect();
    if ranges.is_empty() {
        return None;
    }
    let grid = test.grid();
    let mut stream = random::stream(0, Purpose::Search, 1);
    let drawn = (0..DRAWN).filter_map(|index| {
        let mut point = grid.get(index % grid.len())?.clone();
        for &(place, figure) in &ranges {
            let [low, high] = ends(figure)?;
            *point.get_mut(place)? = rounded(low + (high - low) * stream.random::<f64>());
        }
        Some(point)
    });
    let drawn: Vec<Vec<f64>> = drawn.collect();
    let mut worst: Option<Worst> = None;
    let mut tried = 0;
    let mut look = |points: Vec<Vec<f64>>, worst: &mut Option<Worst>| {
        let made = points.into_iter().filter_map(|point| {
            let name = format!("{name}-within-{}", sha256(test.in_words(&point)).get(..8)?);
            let about = format!("{about} ({}.)", test.in_words(&point));
            Some((test.scenario(&name, &about, &point).ok()?, point))
        });
        let (scenarios, points): (Vec<Scenario>, Vec<Vec<f64>>) = made.unzip();
        tried += scenarios.len();
        let seen = driven.seen(lead, &scenarios);
        for ((point, scenario), seen) in points.into_iter().zip(scenarios).zip(seen) {
            if worst.as_ref().is_none_or(|worst| badness(&seen) > badness(&worst.seen)) {
                *worst = Some(Worst { point, scenario, seen, tried: 0 });
            }
        }
    };
    look(drawn, &mut worst);
    for round in 1..=ROUNDS {
        let Some(centre) = worst.as_ref().map(|worst| worst.point.clone()) else { break };
        let width = 0.25 * 0.5_f64.powi(round);
        let near = (0..NEAR).map(|_| near(&centre, &ranges, width, &mut stream));
        look(near.collect(), &mut worst);
    }
    worst.map(|worst| Worst { tried, ..worst })
}

fn ends(figure: &Figure) -> Option<[f64; 2]> {
    Some([*figure.values.first()?, *figure.values.last()?])
}

fn near(centre: &[f64], ranges: &[(usize, &Figure)], width: f64, stream: &mut Stream) -> Vec<f64> {
    let mut point = centre.to_vec();
    for &(place, figure) in ranges {
        if let (Some([low, high]), Some(value)) = (ends(figure), point.get_mut(place)) {
            let normal: f64 = StandardNormal.sample(stream);
            *value = rounded(*value + width * (high - low) * normal).clamp(low, high);
        }
    }
    point
}

/// A value as somebody would state it.
fn rounded(value: f64) -> f64 {
    (value * 1e3).round() / 1e3
}

/// How bad a point is: contacts by their speed, then failures of controllers, then small gaps; what was refused is not looked for.
fn badness(seen: &Seen) -> (u8, f64) {
    match &seen.verdict {
        TestVerdict::Refused { .. } => (0, 0.0),
        TestVerdict::Passed => (1, -seen.min_gap_m.unwrap_or(f64::INFINITY)),
        TestVerdict::ControllerFailed { .. } => (2, 0.0),
        TestVerdict::Failed { impact_speed_mps, .. } => (3, *impact_speed_mps),
    }
}
