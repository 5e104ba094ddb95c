//! Conversion of a box of initial states to the terms of the checker.

use crumple_verify::Interval;
use crumple_verify::reach::{AccAebLaw, FollowerLaw, IdmLaw, InitialRanges};

use super::reach::{BoxSpec, InvalidBox, RangesSpec};
use crumple_sim::control::BuiltInController;
use crumple_sim::scenario::{Brake, Driver, LeadProfile, Scenario, VehicleSpec};

const LEADER_LIMIT_FIELD: &str = "leader_brakes_at_most_mps2";
const FOLLOWER_FIELD: &str = "follower_drives";

#[derive(Debug, Clone, PartialEq)]
pub(super) struct InitialSet {
    pub(super) step_s: f64,
    pub(super) steps: u32,
    pub(super) follower_ttc_s: Option<f64>,
    pub(super) follower_law: Option<FollowerLaw>,
    /// Limit of the leader's free braking. If given, `ranges` has 0 for the leader's deceleration and onset.
    pub(super) leader_brakes_at_most_mps2: Option<f64>,
    pub(super) ranges: InitialRanges,
    /// Limits of the vehicle under test: largest deceleration, negative, and acceleration, in m/s².
    pub(super) accel_limits_mps2: [f64; 2],
}

impl InitialSet {
    /// Creates the initial states of a box around a scenario.
    ///
    /// # Errors
    /// [`InvalidBox`] if the checker does not support the scenario.
    pub(super) fn new(scenario: &Scenario, spec: &BoxSpec) -> Result<Self, InvalidBox> {
        if let Some(limit_mps2) = spec.leader_brakes_at_most_mps2 {
            check_leader_limit(limit_mps2, scenario.usable_brake_mps2(0), &spec.ranges)?;
        }
        Self::from_valid_limit(scenario, spec)
    }

    fn from_valid_limit(scenario: &Scenario, spec: &BoxSpec) -> Result<Self, InvalidBox> {
        let [leader, ego, rest @ ..] = scenario.vehicles() else {
            return Err(invalid_scenario("has too few vehicles"));
        };
        let script = leader_script(leader, spec.leader_brakes_at_most_mps2)?;
        check_vehicles_and_sensors(scenario, ego)?;
        let follower = match (rest, &spec.follower_drives) {
            ([], None) => InitialFollower::default(),
            ([], Some(_)) => {
                return Err(InvalidBox::field(
                    FOLLOWER_FIELD,
                    "has no meaning without a follower",
                ));
            }
            ([follower], replacement) => InitialFollower::new(follower, replacement.as_ref())?,
            _ => {
                return Err(invalid_scenario(
                    "only one vehicle may follow the vehicle under test",
                ));
            }
        };
        let ranges = initial_ranges(scenario, script, &spec.ranges)?;
        if ranges.leader_brake_mps2.high() > scenario.usable_brake_mps2(0) {
            return Err(InvalidBox::field(
                "ranges.leader_brake_mps2",
                "exceeds the braking limit of the leader",
            ));
        }
        Ok(Self {
            step_s: scenario.spec().step_s,
            steps: scenario.steps() as u32,
            follower_ttc_s: follower.ttc_s,
            follower_law: follower.law,
            leader_brakes_at_most_mps2: spec.leader_brakes_at_most_mps2,
            ranges,
            accel_limits_mps2: [-scenario.usable_brake_mps2(1), ego.max_accel_mps2()],
        })
    }

    /// Creates the single initial state of a scenario, with the leader's profile or with free braking within a limit.
    ///
    /// # Errors
    /// [`InvalidBox`] if the checker does not support the scenario.
    pub(super) fn from_scenario(
        scenario: &Scenario,
        leader_brakes_at_most_mps2: Option<f64>,
    ) -> Result<Self, InvalidBox> {
        let point = BoxSpec::around(&scenario.spec().name, RangesSpec::default());
        Self::from_valid_limit(
            scenario,
            &BoxSpec {
                leader_brakes_at_most_mps2,
                ..point
            },
        )
    }

    /// True if the vehicle under test can execute all commands between these bounds.
    pub(super) fn can_execute(&self, [low_mps2, high_mps2]: [f64; 2]) -> bool {
        low_mps2 >= self.accel_limits_mps2[0] && high_mps2 <= self.accel_limits_mps2[1]
    }
}

fn invalid_scenario(problem: &str) -> InvalidBox {
    InvalidBox::field("scenario", problem)
}

/// Returns the braking of the leader's script; `None` if the leader brakes freely within a limit.
fn leader_script(
    leader: &VehicleSpec,
    brakes_at_most_mps2: Option<f64>,
) -> Result<Option<&Brake>, InvalidBox> {
    match (&leader.driver, brakes_at_most_mps2) {
        (Driver::Profile(LeadProfile::Brake(brake)), None) => Ok(Some(brake)),
        (_, None) => Err(invalid_scenario("the leader must brake at a constant rate")),
        (Driver::Profile(_), Some(_)) => Ok(None),
        (_, Some(_)) => Err(invalid_scenario("the leader must be scripted")),
    }
}

/// Checks that the checker models all vehicles and sensors.
fn check_vehicles_and_sensors(scenario: &Scenario, ego: &VehicleSpec) -> Result<(), InvalidBox> {
    let is_plain = scenario.vehicles().iter().all(|v| {
        v.acceleration_noise_mps2 == 0.0
            && v.response().is_immediate()
            && v.multi_body().is_none()
            && v.keeps_lane()
    });
    if ego.driver != Driver::UnderTest || !is_plain {
        return Err(invalid_scenario(
            "one vehicle behind the leader must be under test, none may have noise, delay, lag or limited jerk, \
             all must have the plant `point-mass`, and all must stay in the lane",
        ));
    }
    if scenario.spec().sensors.faults.is_any() {
        return Err(invalid_scenario(
            "must have no sensor faults, which the checker does not model",
        ));
    }
    Ok(())
}

/// Returns the ranges of a box, with the values of the scenario where the box has no range.
fn initial_ranges(
    scenario: &Scenario,
    script: Option<&Brake>,
    ranges: &RangesSpec,
) -> Result<InitialRanges, InvalidBox> {
    let gap_m = |vehicle: usize| scenario.initial_gap_m(vehicle).unwrap_or(0.0);
    let [leader_mps, ego_mps, follower_mps] = std::array::from_fn(|vehicle| {
        let spec = scenario.vehicles().get(vehicle);
        spec.map_or(0.0, |spec| spec.speed_mps)
    });
    let has_follower = scenario.vehicles().len() > 2;
    let follower_brake_mps2 = if has_follower {
        scenario.usable_brake_mps2(2)
    } else {
        0.0
    };
    let onset_s = script.map_or(Interval::ZERO, |brake| {
        range_or_point(ranges.onset_s, brake.onset_s)
    });
    let step_s = scenario.spec().step_s;
    Ok(InitialRanges {
        gap_ahead_m: range_or_point(ranges.gap_ahead_m, gap_m(1)),
        gap_behind_m: range_or_point(ranges.gap_behind_m, gap_m(2)),
        leader_speed_mps: range_or_point(ranges.leader_speed_mps, leader_mps),
        ego_speed_mps: range_or_point(ranges.ego_speed_mps, ego_mps),
        follower_speed_mps: range_or_point(ranges.follower_speed_mps, follower_mps),
        leader_brake_mps2: script.map_or(Interval::ZERO, |brake| {
            range_or_point(ranges.leader_brake_mps2, brake.rate_mps2)
        }),
        follower_brake_mps2: range_or_point(ranges.follower_brake_mps2, follower_brake_mps2),
        onset_steps: Interval::new(onset_s.low() / step_s, onset_s.high() / step_s)
            .ok_or_else(|| InvalidBox::field("ranges.onset_s", "is too large"))?,
    })
}

fn range_or_point(range: Option<Interval>, value: f64) -> Interval {
    range.unwrap_or_else(|| Interval::point(value))
}

/// Model of a follower: the TTC threshold of its latched emergency brake, or a control law.
#[derive(Default)]
struct InitialFollower {
    ttc_s: Option<f64>,
    law: Option<FollowerLaw>,
}

impl InitialFollower {
    /// Creates the model, with `replacement` instead of the follower's controller if given.
    fn new(follower: &VehicleSpec, replacement: Option<&Driver>) -> Result<Self, InvalidBox> {
        let driver = replacement.unwrap_or(&follower.driver);
        let model = match driver {
            Driver::Controller(BuiltInController::Baseline(aeb)) => Self {
                ttc_s: Some(aeb.ttc_s),
                law: None,
            },
            Driver::Controller(spec) => Self {
                ttc_s: None,
                law: control_law(spec, follower.max_accel_mps2()),
            },
            _ => Self::default(),
        };
        if model.ttc_s.is_some() || model.law.is_some() {
            return Ok(model);
        }
        let problem = format!(
            "must drive with baseline, idm or acc-aeb, found {}",
            driver.name()
        );
        Err(match replacement {
            Some(_) => InvalidBox::field(FOLLOWER_FIELD, problem),
            None => InvalidBox::field("scenario", format!("its follower {problem}")),
        })
    }
}

/// Returns the law of `idm` or `acc-aeb` for the checker.
pub(super) fn control_law(spec: &BuiltInController, max_accel_mps2: f64) -> Option<FollowerLaw> {
    match spec {
        BuiltInController::Idm(idm) => Some(FollowerLaw::Idm(IdmLaw {
            desired_speed_mps: idm.desired_speed_mps,
            time_headway_s: idm.time_headway_s,
            standstill_gap_m: idm.standstill_gap_m,
            accel_mps2: idm.accel_mps2,
            comfortable_brake_mps2: idm.comfortable_brake_mps2,
            max_accel_mps2,
        })),
        BuiltInController::AccAeb(acc) => Some(FollowerLaw::AccAeb(AccAebLaw {
            ttc_s: acc.ttc_s,
            time_headway_s: acc.time_headway_s,
            standstill_gap_m: acc.standstill_gap_m,
            gap_gain_per_s2: acc.gap_gain_per_s2,
            speed_gain_per_s: acc.speed_gain_per_s,
            comfort_brake_mps2: acc.comfort_brake_mps2,
            comfort_accel_mps2: acc.comfort_accel_mps2,
            set_speed_mps: acc.set_speed(),
            max_accel_mps2,
        })),
        _ => None,
    }
}

fn check_leader_limit(
    limit_mps2: f64,
    usable_brake_mps2: f64,
    ranges: &RangesSpec,
) -> Result<(), InvalidBox> {
    if !(limit_mps2 >= 0.0 && limit_mps2.is_finite()) {
        return Err(InvalidBox::field(
            LEADER_LIMIT_FIELD,
            format!("must be 0 or more, found {limit_mps2}"),
        ));
    }
    if limit_mps2 > usable_brake_mps2 {
        let problem = format!(
            "exceeds the braking limit of the leader: must be at most {usable_brake_mps2} m/s², found {limit_mps2}"
        );
        return Err(InvalidBox::field(LEADER_LIMIT_FIELD, problem));
    }
    let script_ranges = [
        ("leader_brake_mps2", ranges.leader_brake_mps2),
        ("onset_s", ranges.onset_s),
    ];
    match script_ranges.into_iter().find(|(_, range)| range.is_some()) {
        Some((name, _)) => {
            let problem = format!(
                "has no meaning with `{LEADER_LIMIT_FIELD}`: the leader brakes arbitrarily up to that limit"
            );
            Err(InvalidBox::field(&format!("ranges.{name}"), problem))
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_sim::scenario::{PlantKind, built_in_scenario};

    #[test]
    fn other_plants_and_sensor_faults_are_refused() {
        let paper = built_in_scenario("paper-1").unwrap();
        let refusal = |scenario: &Scenario| {
            InitialSet::new(scenario, &BoxSpec::around("paper-1", RangesSpec::default()))
                .err()
                .map(|e| e.to_string())
        };
        assert_eq!(refusal(&paper), None);
        let multi_body = refusal(&paper.with_plant(PlantKind::MultiBody).unwrap()).unwrap();
        assert!(
            multi_body.contains("the plant `point-mass`"),
            "{multi_body}"
        );
        let faulty = refusal(
            &paper
                .edited(|spec| spec.sensors.faults.latency_s = 0.1)
                .unwrap(),
        )
        .unwrap();
        assert!(faulty.contains("no sensor faults"), "{faulty}");
    }
}
