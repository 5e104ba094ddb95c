//! One controller in one scenario: the reported results.

use serde::{Deserialize, Serialize};

use super::Rounded;
use super::controller_arg::controller_arg;
use super::table::CellMark;
use crumple_measure::{CollisionRole, LevelMeasures, Measures};
use crumple_sim::control::TwoSidedSettings;
use crumple_sim::engine::{
    AfterCollision, Collision, FailedController, FailedControllerRuns, Impact, NamedController,
    RecordingLevel, Run, RunError, RunOptions, SimulationResult, Trace, simulate_batch,
};
use crumple_sim::observation::EstimatorKind;
use crumple_sim::scenario::Scenario;

/// The result of one controller in one scenario. With several vehicles under test, each measure is the worst among
/// them.
#[derive(Debug, Clone, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct CaseResult {
    /// Name of the controller.
    pub controller: String,
    /// Verdict on the run.
    pub verdict: CaseVerdict,
    /// Measures of a vehicle under test towards its leader.
    pub ahead: RoundedLeadMeasures,
    /// Measures of the follower towards a vehicle under test.
    pub behind: RoundedLeadMeasures,
    /// Smallest gap between any two vehicles until the first collision, in metres.
    pub min_gap_m: Option<Rounded<2>>,
    /// Regret, in metres: difference to the smallest gap of the best escape found. Absent if other vehicles collided
    /// first.
    pub regret_m: Option<Rounded<2>>,
    /// Hardest deceleration of a vehicle under test, in m/s².
    pub peak_brake_mps2: Option<Rounded<2>>,
    /// Largest jerk of a vehicle under test, in m/s³.
    pub peak_jerk_mps3: Option<Rounded<1>>,
    /// Hardest deceleration of the follower of a vehicle under test, in m/s².
    pub induced_brake_mps2: Option<Rounded<2>>,
    /// Level of a vehicle under test at the start, in m/s²: the hardest braking of the leader for which a plan avoids a
    /// collision on both sides with a follower of the default class of two-sided shields. Absent with delay or lag.
    pub start_level_mps2: Option<Rounded<2>>,
    /// Minimum level of a vehicle under test until the first collision, in m/s².
    pub min_level_mps2: Option<Rounded<2>>,
    /// Further collisions if all vehicles drive on after the first one.
    pub pile_up: Option<PileUp>,
    #[serde(skip)]
    pub(super) controller_arg: Option<String>,
    #[serde(skip)]
    pub(super) motion: Option<(Trace, Vec<Impact>)>,
}

/// The verdict on a run.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum CaseVerdict {
    /// No collision until the end of the scenario.
    Safe {
        /// Time to collision between a vehicle under test and a neighbour at the end of the scenario, in seconds, if
        /// below [`STILL_CLOSING_TTC_S`]. The scenario then ended too early.
        closing_ttc_s: Option<Rounded<1>>,
    },
    /// A vehicle under test hit its leader.
    Hit(RoundedCollision),
    /// A vehicle that is not under test hit a vehicle under test from behind.
    WasHit(RoundedCollision),
    /// A vehicle that repeats recorded speeds, and cannot react, hit a vehicle under test from behind. This is no
    /// evidence about the controller.
    HitByRecording(RoundedCollision),
    /// Two vehicles collided that are both not under test. This is no evidence about the controller.
    #[serde(alias = "others")]
    OthersCollided(RoundedCollision),
    /// The controller gave no usable answer, which ended the run.
    ControllerFailed {
        /// Time of the failure, in seconds.
        time_s: Rounded<2>,
        /// Index of the controller's vehicle.
        vehicle: usize,
        /// Reason in words.
        #[serde(alias = "because")]
        reason: String,
    },
}

/// Time to collision at the end of a run, in seconds, below which the report calls the run still closing.
pub const STILL_CLOSING_TTC_S: f64 = 30.0;

/// A collision, with rounded numbers.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RoundedCollision {
    /// Time of the collision, in seconds.
    pub time_s: Rounded<2>,
    /// Index of the vehicle that is hit.
    pub front_vehicle: usize,
    /// Index of the vehicle that hits it.
    pub rear_vehicle: usize,
    /// Relative speed of the vehicles, in m/s.
    pub impact_speed_mps: Rounded<1>,
}

/// Measures of one vehicle towards its leader.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct RoundedLeadMeasures {
    /// Smallest gap, in metres.
    pub min_gap_m: Option<Rounded<2>>,
    /// Smallest time to collision, in seconds.
    pub min_ttc_s: Option<Rounded<2>>,
    /// Smallest time headway, front bumper to front bumper, in seconds.
    pub min_time_headway_s: Option<Rounded<2>>,
    /// Smallest time gap, bumper to bumper, in seconds.
    pub min_time_gap_s: Option<Rounded<2>>,
    /// Largest deceleration rate to avoid a crash (DRAC), in m/s²; absent after a collision.
    pub max_drac_mps2: Option<Rounded<2>>,
    /// Largest deceleration required against the braking of the leader, in m/s²; absent after a collision.
    pub max_required_brake_mps2: Option<Rounded<2>>,
    /// Time exposed time to collision (TET), in seconds.
    pub tet_s: Rounded<2>,
    /// Time integrated time to collision (TIT), in s².
    pub tit_s2: Rounded<2>,
    /// Gap at standstill, in metres.
    pub standstill_gap_m: Option<Rounded<2>>,
}

/// A pile-up: the collision simulated until all vehicles stand, with vehicles that stick together.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PileUp {
    /// Number of impacts.
    pub impacts: usize,
    /// Number of vehicles involved.
    pub vehicles: usize,
    /// Largest change of speed of any vehicle in one impact, in m/s.
    pub max_delta_v_mps: Option<Rounded<1>>,
}

impl CaseVerdict {
    /// Determines the verdict on a run of a scenario. Without a trace, `closing_ttc_s` is `None`.
    #[must_use]
    pub fn new(simulated: &SimulationResult, scenario: &Scenario) -> Self {
        if let Some(FailedController {
            time_s,
            vehicle,
            failure,
        }) = simulated.outcome.failed_controller()
        {
            return Self::ControllerFailed {
                time_s: (*time_s).into(),
                vehicle: *vehicle,
                reason: failure.to_string(),
            };
        }
        let Some(collision) = simulated.outcome.collision() else {
            let tested = (1..scenario.vehicles().len())
                .filter(|&rear| scenario.is_under_test(rear) || scenario.is_under_test(rear - 1));
            let closing = tested.map(|rear| closing_ttc_s(simulated.trace.as_ref()?, rear));
            return Self::Safe {
                closing_ttc_s: smallest(closing).map(Rounded::new),
            };
        };
        match CollisionRole::new(collision, scenario) {
            CollisionRole::Hits => Self::Hit(collision.into()),
            CollisionRole::HitFromBehind => Self::WasHit(collision.into()),
            CollisionRole::HitByRecording => Self::HitByRecording(collision.into()),
            CollisionRole::Bystander => Self::OthersCollided(collision.into()),
        }
    }

    /// True if a vehicle under test collided, or its controller gave no answer.
    #[must_use]
    pub fn is_failure(&self) -> bool {
        matches!(
            self,
            Self::Hit(_) | Self::WasHit(_) | Self::ControllerFailed { .. }
        )
    }

    /// Returns the failure of the controller to answer, if any.
    #[must_use]
    pub(crate) fn unanswered(&self) -> Option<FailedControllerRuns> {
        match self {
            Self::ControllerFailed { time_s, reason, .. } => Some(FailedControllerRuns {
                runs: 1,
                reason: format!("at {time_s} s, {reason}"),
            }),
            Self::Safe { .. }
            | Self::Hit(_)
            | Self::WasHit(_)
            | Self::HitByRecording(_)
            | Self::OthersCollided(_) => None,
        }
    }

    /// True if the run is evidence about the controller: false if other vehicles, or one that repeats recorded speeds,
    /// collided first.
    #[must_use]
    pub fn is_conclusive(&self) -> bool {
        !matches!(self, Self::HitByRecording(_) | Self::OthersCollided(_))
    }

    pub(super) fn mark(&self) -> CellMark {
        match self {
            Self::Safe { .. } => CellMark::Good,
            Self::Hit(_) | Self::WasHit(_) | Self::ControllerFailed { .. } => CellMark::Bad,
            Self::HitByRecording(_) | Self::OthersCollided(_) => CellMark::Neutral,
        }
    }

    /// Describes the verdict in a few words.
    #[must_use]
    pub fn describe(&self) -> String {
        match self {
            Self::Safe { closing_ttc_s } => closing_ttc_s
                .map_or("no collision".to_owned(), |ttc_s| {
                    format!("no collision, but TTC {ttc_s} s at the end")
                }),
            Self::Hit(collision) => collision.describe_hit(),
            Self::WasHit(collision) => collision.describe_hit_from_behind(),
            Self::HitByRecording(collision) => format!(
                "{} (recorded speeds, does not count against the controller)",
                collision.describe_hit_from_behind()
            ),
            Self::ControllerFailed {
                time_s,
                vehicle,
                reason,
            } => {
                format!("controller of {vehicle} failed at {time_s} s: {reason}")
            }
            Self::OthersCollided(collision) => {
                format!("other vehicles: {}", collision.describe_hit())
            }
        }
    }
}

/// Returns the time to collision at the last sample, if below [`STILL_CLOSING_TTC_S`].
fn closing_ttc_s(trace: &Trace, rear: usize) -> Option<f64> {
    let pairs = trace.pairs(rear);
    let pair = pairs.last().filter(|pair| pair.span_s[1].is_infinite())?;
    let closing_mps = pair.rear.speed_mps.last()? - pair.front.speed_mps.last()?;
    crumple_measure::ttc_s(pair.gaps_m().next_back()?.1, closing_mps)
        .filter(|&ttc_s| ttc_s < STILL_CLOSING_TTC_S)
}

impl RoundedCollision {
    fn describe_hit(&self) -> String {
        format!(
            "{} hits {} at {} s, {} m/s",
            self.rear_vehicle, self.front_vehicle, self.time_s, self.impact_speed_mps
        )
    }

    fn describe_hit_from_behind(&self) -> String {
        format!(
            "{} hit from behind by {} at {} s, {} m/s",
            self.front_vehicle, self.rear_vehicle, self.time_s, self.impact_speed_mps
        )
    }
}

impl From<&Collision> for RoundedCollision {
    fn from(collision: &Collision) -> Self {
        Self {
            time_s: collision.time_s.into(),
            front_vehicle: collision.front_vehicle,
            rear_vehicle: collision.rear_vehicle,
            impact_speed_mps: collision.impact_speed_mps.into(),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum MotionRetention {
    Keep,
    Drop,
}

/// Runs every controller in every scenario. Shape of the result: `[scenario][controller]`, in the order given.
pub(super) fn run_cases(
    scenarios: &[&Scenario],
    controllers: &[NamedController],
    estimator: EstimatorKind,
    motion: MotionRetention,
) -> Result<Vec<Vec<CaseResult>>, RunError> {
    let pairs: Vec<(&Scenario, &NamedController)> = scenarios
        .iter()
        .flat_map(|&scenario| {
            controllers
                .iter()
                .map(move |controller| (scenario, controller))
        })
        .collect();
    let runs = prepare_runs(&pairs, estimator, AfterCollision::Stop)?;
    let mut cases = simulate_batch(&runs, RecordingLevel::Trace, |index, simulated| {
        let levels = measure_levels(&runs[index], &simulated);
        let mut case = CaseResult::new(pairs[index].0, pairs[index].1, simulated);
        case.start_level_mps2 =
            smallest(levels.iter().map(|level| Some(level.start_mps2))).map(Rounded::new);
        case.min_level_mps2 =
            smallest(levels.iter().map(|level| Some(level.min_mps2))).map(Rounded::new);
        if motion == MotionRetention::Drop {
            case.motion = None;
        }
        case
    });
    let collided: Vec<usize> = (0..cases.len())
        .filter(|&index| !matches!(cases[index].verdict, CaseVerdict::Safe { .. }))
        .collect();
    let collided_pairs: Vec<_> = collided.iter().map(|&index| pairs[index]).collect();
    let runs = prepare_runs(&collided_pairs, estimator, AfterCollision::Continue)?;
    let pile_ups = simulate_batch(&runs, RecordingLevel::Summary, |_, simulated| {
        PileUp::from_simulated(&simulated)
    });
    for (index, pile_up) in collided.into_iter().zip(pile_ups) {
        cases[index].pile_up = pile_up;
    }
    let mut cases = cases.into_iter();
    Ok(scenarios
        .iter()
        .map(|_| cases.by_ref().take(controllers.len()).collect())
        .collect())
}

fn prepare_runs(
    pairs: &[(&Scenario, &NamedController)],
    estimator: EstimatorKind,
    after_collision: AfterCollision,
) -> Result<Vec<Run>, RunError> {
    pairs
        .iter()
        .map(|(scenario, controller)| {
            let options = RunOptions::new(controller.source.clone())
                .with_estimator(estimator)
                .with_after_collision(after_collision);
            Run::new(scenario, options)
        })
        .collect()
}

impl PileUp {
    fn from_simulated(simulated: &SimulationResult) -> Option<Self> {
        let delta_v_mps = (0..simulated.vehicles.len())
            .map(|vehicle| crumple_measure::max_delta_v_mps(&simulated.impacts, vehicle));
        (!simulated.impacts.is_empty()).then(|| Self {
            impacts: simulated.impacts.len(),
            vehicles: simulated.vehicles_involved(),
            max_delta_v_mps: largest(delta_v_mps).map(Rounded::new),
        })
    }
}

impl CaseResult {
    fn new(scenario: &Scenario, controller: &NamedController, simulated: SimulationResult) -> Self {
        let under_test: Vec<usize> = (0..scenario.vehicles().len())
            .filter(|&index| scenario.is_under_test(index))
            .collect();
        let own: Vec<Measures> = under_test
            .iter()
            .filter_map(|&index| measure_vehicle(&simulated, index))
            .collect();
        let followers: Vec<Measures> = under_test
            .iter()
            .filter_map(|&index| measure_vehicle(&simulated, index + 1))
            .collect();
        Self {
            controller: controller.name.clone(),
            verdict: CaseVerdict::new(&simulated, scenario),
            ahead: RoundedLeadMeasures::worst(&own),
            behind: RoundedLeadMeasures::worst(&followers),
            min_gap_m: smallest(simulated.vehicles.iter().map(|vehicle| vehicle.min_gap_m))
                .map(Rounded::new),
            regret_m: None,
            peak_brake_mps2: largest(own.iter().map(|m| m.peak_brake_mps2)).map(Rounded::new),
            peak_jerk_mps3: largest(own.iter().map(|m| m.peak_jerk_mps3)).map(Rounded::new),
            induced_brake_mps2: largest(
                own.iter()
                    .map(|m| m.induced.and_then(|induced| induced.peak_brake_mps2)),
            )
            .map(Rounded::new),
            start_level_mps2: None,
            min_level_mps2: None,
            pile_up: None,
            controller_arg: controller_arg(&*controller.source),
            motion: simulated.trace.map(|trace| (trace, simulated.impacts)),
        }
    }
}

/// Returns the levels of the vehicles under test that have one.
fn measure_levels(run: &Run, simulated: &SimulationResult) -> Vec<LevelMeasures> {
    LevelMeasures::of_vehicles_under_test(run, simulated, &TwoSidedSettings::default())
        .into_iter()
        .filter_map(|(_, level)| level.ok())
        .collect()
}

fn measure_vehicle(simulated: &SimulationResult, index: usize) -> Option<Measures> {
    Measures::from_trace(simulated.trace.as_ref()?, &simulated.impacts, index)
}

impl RoundedLeadMeasures {
    fn worst(vehicles: &[Measures]) -> Self {
        let ahead: Vec<_> = vehicles
            .iter()
            .filter_map(|measures| measures.ahead)
            .collect();
        // At a collision the required deceleration is infinite, so there is no maximum.
        let has_collided = ahead.iter().any(|a| a.min_gap_m == Some(0.0));
        let without_collision = if has_collided { &[] } else { ahead.as_slice() };
        Self {
            min_gap_m: smallest(ahead.iter().map(|a| a.min_gap_m)).map(Rounded::new),
            min_ttc_s: smallest(ahead.iter().map(|a| a.min_ttc_s)).map(Rounded::new),
            min_time_headway_s: smallest(ahead.iter().map(|a| a.min_time_headway_s))
                .map(Rounded::new),
            min_time_gap_s: smallest(ahead.iter().map(|a| a.min_time_gap_s)).map(Rounded::new),
            max_drac_mps2: largest(without_collision.iter().map(|a| a.max_drac_mps2))
                .map(Rounded::new),
            max_required_brake_mps2: largest(
                without_collision.iter().map(|a| a.max_required_brake_mps2),
            )
            .map(Rounded::new),
            tet_s: largest(ahead.iter().map(|a| Some(a.tet_s)))
                .unwrap_or(0.0)
                .into(),
            tit_s2: largest(ahead.iter().map(|a| Some(a.tit_s2)))
                .unwrap_or(0.0)
                .into(),
            standstill_gap_m: smallest(ahead.iter().map(|a| a.standstill_gap_m)).map(Rounded::new),
        }
    }
}

pub(super) fn smallest(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    values.flatten().min_by(f64::total_cmp)
}

pub(super) fn largest(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    values.flatten().max_by(f64::total_cmp)
}
