//! Learned policies: their origin, and their braking.

use serde::Serialize;

use super::{PaperScenarios, ScenarioCases};
use crate::assessment::case::CaseResult;
use crate::assessment::document::ReportDocument;
use crate::assessment::table::{ReportCell, ReportTable};
use crate::assessment::{AssessmentPlan, ReportPart, Rounded};
use crate::draw::{Axis, BOTTOM_MARGIN, HEADING_HEIGHT, Ink, LEFT_MARGIN, Panel, PixelRect, Stroke, Svg, TaggedLine};
use crumple_world::control::ControllerSpec;
use crumple_world::policy::{CurvePoint, LearningCurve, Policy};
use crumple_world::sim::{Trace, Track};

/// The learned policies among the controllers.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LearnedPolicies {
    /// One entry per policy.
    pub policies: Vec<LearnedPolicy>,
    /// Braking times of each policy and of the first controller in the paper's scenarios.
    pub braking: Vec<BrakingTimes>,
    /// Learning curve of the preset behind the reference policy; absent if that policy is not among the controllers.
    pub learning_curve: Option<LearningCurve>,
    #[serde(skip)]
    figures: Vec<(String, Svg)>,
}

/// The curve of `crumple train --preset fast --seeds 30`; `corpora/policy/README.md` has its provenance.
const REFERENCE_CURVE: &str = include_str!("../built_in/learning-curve.json");

/// A policy and its origin.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct LearnedPolicy {
    /// Name in this report.
    pub name: String,
    /// SHA-256 of the policy file.
    pub sha256: String,
    /// Release, preset, seed and episode of the training.
    pub origin: String,
    /// Network architecture and its use.
    pub network: String,
}

/// The times at which the first vehicle under test and its follower begin to brake.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct BrakingTimes {
    /// Name of the scenario.
    pub scenario: String,
    /// Name of the controller.
    pub controller: String,
    /// Time at which the leader first brakes, in seconds.
    pub leader_brakes_s: Option<Rounded<2>>,
    /// Time at which the first vehicle under test first brakes harder than [`BRAKING_MPS2`], in seconds.
    pub ego_brakes_s: Option<Rounded<2>>,
    /// Time at which the emergency brake of the last vehicle fires, in seconds.
    pub follower_brakes_s: Option<Rounded<2>>,
    /// Hardest deceleration of the first vehicle under test in the second before that, in m/s².
    pub ego_brake_before_mps2: Option<Rounded<2>>,
    /// Largest acceleration of the first vehicle under test after that while it still moves, in m/s².
    pub ego_acceleration_after_mps2: Option<Rounded<2>>,
}

/// Deceleration above which a vehicle counts as braking, in m/s².
pub const BRAKING_MPS2: f64 = 0.5;

impl LearnedPolicies {
    pub(in crate::assessment) fn new(plan: &AssessmentPlan, paper: &PaperScenarios) -> Option<Self> {
        let learned: Vec<_> = plan.controllers.iter().filter_map(|c| Some((c.name.clone(), c.policy()?))).collect();
        if learned.is_empty() {
            return None;
        }
        let first = plan.controllers.first().map(|controller| controller.name.as_str());
        let is_shown = |name: &str| Some(name) == first || learned.iter().any(|(policy, _)| policy == name);
        let mut braking = Vec::new();
        let mut figures = Vec::new();
        for scenario in &paper.scenarios {
            let shown: Vec<_> = scenario.cases.iter().filter(|case| is_shown(&case.controller)).collect();
            braking.extend(shown.iter().filter_map(|case| BrakingTimes::new(scenario, case)));
            for case in shown.iter().filter(|case| case.motion.is_some()) {
                let name = format!("{}, {}", scenario.scenario, case.controller);
                figures.extend(case.motion.as_ref().map(|(trace, _)| (name.clone(), draw_accelerations(&name, trace))));
            }
        }
        let policies = learned.iter().map(|(name, policy)| LearnedPolicy::new(name, policy)).collect();
        let has_reference = learned.iter().any(|(name, _)| name == ControllerSpec::Policy(Default::default()).name());
        let learning_curve = has_reference.then(|| serde_json::from_str(REFERENCE_CURVE).ok()).flatten();
        Some(Self { policies, braking, learning_curve, figures })
    }

    fn origin_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.policies,
            &[
                ("policy", &|policy| ReportCell::text(&policy.name)),
                ("training", &|policy| ReportCell::text(&policy.origin)),
                ("network", &|policy| ReportCell::text(&policy.network)),
                ("SHA-256", &|policy| ReportCell::digest(&policy.sha256)),
            ],
        )
    }

    fn braking_table(&self) -> ReportTable {
        ReportTable::from_items(
            &self.braking,
            &[
                ("scenario, controller", &|one| ReportCell::text(format!("{}, {}", one.scenario, one.controller))),
                ("leader brakes (s)", &|one| ReportCell::optional(one.leader_brakes_s)),
                ("ego brakes (s)", &|one| ReportCell::optional(one.ego_brakes_s)),
                ("follower's AEB (s)", &|one| ReportCell::optional(one.follower_brakes_s)),
                ("braking in the second before (m/s²)", &|one| ReportCell::optional(one.ego_brake_before_mps2)),
                ("peak acceleration after (m/s²)", &|one| ReportCell::optional(one.ego_acceleration_after_mps2)),
            ],
        )
    }
}

impl LearnedPolicy {
    fn new(name: &str, policy: &Policy) -> Self {
        let header = policy.header();
        let preset = header.training.get("name").and_then(serde_json::Value::as_str).unwrap_or("unnamed");
        Self {
            name: name.to_owned(),
            sha256: policy.digest(),
            origin: format!(
                "crumple {}, preset {preset}, seed {}, episode {}, estimator {}",
                header.crumple,
                header.seed,
                header.episode,
                header.estimator.name()
            ),
            network: format!("hidden layers {:?}, decision interval {} s", header.hidden, header.decision_interval_s),
        }
    }
}

impl BrakingTimes {
    /// Requires a scenario of the paper: vehicle 0 leads, vehicle 1 is the first under test, the last one follows.
    fn new(scenario: &ScenarioCases, case: &CaseResult) -> Option<Self> {
        let (trace, _) = case.motion.as_ref()?;
        let [leader, ego, .., follower] = trace.vehicles.as_slice() else { return None };
        let brakes_s = |track: &Track| {
            let sample = track.acceleration_mps2.iter().position(|&a| a < -BRAKING_MPS2)?;
            trace.time_s.get(sample).copied()
        };
        let fires_s = brakes_s(follower);
        let within = |from_s: f64, to_s: f64| {
            let samples = trace.time_s.iter().zip(&ego.acceleration_mps2).zip(&ego.speed_mps);
            samples.filter(move |((t, _), v)| **t >= from_s && **t < to_s && **v > 0.0).map(|((_, &a), _)| a)
        };
        Some(Self {
            scenario: scenario.scenario.clone(),
            controller: case.controller.clone(),
            leader_brakes_s: brakes_s(leader).map(Rounded::new),
            ego_brakes_s: brakes_s(ego).map(Rounded::new),
            follower_brakes_s: fires_s.map(Rounded::new),
            ego_brake_before_mps2: fires_s
                .and_then(|fires_s| within(fires_s - 1.0, fires_s).map(|a| -a).max_by(f64::total_cmp))
                .map(Rounded::new),
            ego_acceleration_after_mps2: fires_s
                .and_then(|fires_s| within(fires_s, f64::INFINITY).max_by(f64::total_cmp))
                .map(Rounded::new),
        })
    }
}

fn draw_accelerations(name: &str, trace: &Trace) -> Svg {
    let (width, height) = (720.0, 200.0);
    let frame = PixelRect { left: LEFT_MARGIN, top: HEADING_HEIGHT, width: width - LEFT_MARGIN - 16.0, height };
    let end_s = trace.time_s.last().copied().unwrap_or(1.0);
    let time = Axis::numeric("Time (s)", (0.0, end_s), 8);
    let mut panel = Panel::new(frame, &format!("Acceleration (m/s²): {name}"), time, Axis::numeric("", (-8.0, 4.0), 6));
    let mut tags = Vec::new();
    for (index, track) in trace.vehicles.iter().enumerate() {
        let samples = trace.time_s.iter().zip(&track.acceleration_mps2).zip(&track.speed_mps);
        // At standstill an acceleration is a brake command, not motion.
        let points: Vec<_> = samples.map(|((&t, &a), &v)| (t, if v > 0.0 { a } else { 0.0 })).collect();
        panel.add_line(&points, Stroke::series(index));
        tags.push(TaggedLine { points, tag: index.to_string(), ink: Ink::Series(index) });
    }
    panel.add_tags(&tags);
    let prefix = format!("acceleration-{name}");
    let description = "Acceleration of every vehicle over time, numbered from the front.";
    let size = (width, HEADING_HEIGHT + height + BOTTOM_MARGIN);
    Svg::new(&prefix, size, name, description, panel.draw(&Svg::id(&prefix, "panel")))
}

const INTRODUCTION: &str = "The paper reports that the learned controller brakes sharply early, which triggers the \
    follower's emergency brake in time, and that it may accelerate again at the end. The table shows when each policy \
    first brakes, its braking in the second before the follower's emergency brake, and its acceleration afterwards. A \
    policy that brakes before its leader has overfitted to the paper's scenarios, whose reward has no cost of braking.";

fn describe_learning_curve(curve: &LearningCurve) -> String {
    let reward = |point: Option<&CurvePoint>| point.map_or(0.0, |point| point.mean_reward);
    format!(
        "{} seeds of preset {} have a mean reward of {} before training and {} at the end; 22500 is no collision in \
         any run. A seed that has finished keeps its best reward in the curve.",
        curve.seeds,
        curve.preset,
        reward(curve.points.first()),
        reward(curve.points.last())
    )
}

impl ReportPart for LearnedPolicies {
    fn anchor_and_title(&self) -> (&'static str, String) {
        ("learned", "Driving of the learned policies".to_owned())
    }

    fn write(&self, out: &mut ReportDocument) {
        out.table(&self.origin_table());
        if let Some(curve) = &self.learning_curve {
            out.figure(crate::figures::draw_learning_curve(curve));
            out.paragraph(&describe_learning_curve(curve));
        }
        out.paragraph(INTRODUCTION);
        out.table(&self.braking_table());
        for (name, figure) in &self.figures {
            out.collapsible(&format!("accelerations: {name}"), |out| out.push_html(figure));
        }
    }
}
