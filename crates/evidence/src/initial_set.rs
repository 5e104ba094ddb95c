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
        let wrong = |why: &str| InvalidBox::field("scenario", why);
        let vehicles = scenario.vehicles();
        let [leader, ego, rest @ ..] = vehicles else {
            return Err(wrong("has too few vehicles"));
        };
        let led = spec.leader_brakes_at_most_mps2;
        let script = match (&leader.driver, led) {
            (Driver::Profile(LeadProfile::Brake(brake)), None) => Some(brake),
            (_, None) => return Err(wrong("the leader must brake at a constant rate")),
            (Driver::Profile(_), Some(_)) => None,
            (_, Some(_)) => return Err(wrong("the leader must be scripted")),
        };
        let is_plain = vehicles.iter().all(|v| {
            v.acceleration_noise_mps2 == 0.0
                && v.response().is_immediate()
                && v.multi_body().is_none()
                && v.keeps_lane()
        });
        if ego.driver != Driver::UnderTest || !is_plain {
            return Err(wrong(
                "one vehicle behind the leader must be under test, none may have noise, delay, lag or limited jerk, \
                 all must have the plant `point-mass`, and all must stay in the lane",
            ));
        }
        if scenario.spec().sensors.faults.is_any() {
            return Err(wrong(
                "must have no sensor faults, which the checker does not model",
            ));
        }
        let (follower_ttc_s, follower_law) = match (rest, &spec.follower_drives) {
            ([], None) => (None, None),
            ([], Some(_)) => {
                return Err(InvalidBox::field(
                    FOLLOWER_FIELD,
                    "has no meaning without a follower",
                ));
            }
            ([follower], in_place) => follower_model(follower, in_place.as_ref())?,
            _ => return Err(wrong("only one vehicle may follow the vehicle under test")),
        };
        let step_s = scenario.spec().step_s;
        let or =
            |range: Option<Interval>, value: f64| range.unwrap_or_else(|| Interval::point(value));
        let behind =
            |range, value: fn(&VehicleSpec) -> f64| or(range, rest.first().map_or(0.0, value));
        let given = &spec.ranges;
        let of_script = |range, value: fn(&Brake) -> f64| {
            script.map_or(Interval::ZERO, |brake| or(range, value(brake)))
        };
        let onset_s = of_script(given.onset_s, |brake| brake.onset_s);
        let ranges = InitialRanges {
            gap_ahead_m: or(given.gap_ahead_m, scenario.initial_gap_m(1).unwrap_or(0.0)),
            gap_behind_m: or(given.gap_behind_m, scenario.initial_gap_m(2).unwrap_or(0.0)),
            leader_speed_mps: or(given.leader_speed_mps, leader.speed_mps),
            ego_speed_mps: or(given.ego_speed_mps, ego.speed_mps),
            follower_speed_mps: behind(given.follower_speed_mps, |v| v.speed_mps),
            leader_brake_mps2: of_script(given.leader_brake_mps2, |brake| brake.rate_mps2),
            follower_brake_mps2: or(
                given.follower_brake_mps2,
                rest.first().map_or(0.0, |_| scenario.usable_brake_mps2(2)),
            ),
            onset_steps: Interval::new(onset_s.low() / step_s, onset_s.high() / step_s)
                .ok_or_else(|| InvalidBox::field("ranges.onset_s", "is too large"))?,
        };
        if ranges.leader_brake_mps2.high() > scenario.usable_brake_mps2(0) {
            return Err(InvalidBox::field(
                "ranges.leader_brake_mps2",
                "exceeds the braking limit of the leader",
            ));
        }
        let able_mps2 = [-scenario.usable_brake_mps2(1), ego.max_accel_mps2()];
        Ok(Self {
            step_s,
            steps: scenario.steps() as u32,
            follower_ttc_s,
            follower_law,
            leader_brakes_at_most_mps2: led,
            ranges,
            accel_limits_mps2: able_mps2,
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

/// Returns the model of a follower, with `in_place` instead of its controller if given: the TTC threshold of its
/// latched emergency brake, or a control law.
fn follower_model(
    follower: &VehicleSpec,
    in_place: Option<&Driver>,
) -> Result<(Option<f64>, Option<FollowerLaw>), InvalidBox> {
    let driver = in_place.unwrap_or(&follower.driver);
    let law = match driver {
        Driver::Controller(BuiltInController::Baseline(aeb)) => return Ok((Some(aeb.ttc_s), None)),
        Driver::Controller(spec) => control_law(spec, follower.max_accel_mps2()),
        _ => None,
    };
    match law {
        Some(law) => Ok((None, Some(law))),
        None => {
            let problem = format!(
                "must drive with baseline, idm or acc-aeb, found {}",
                driver.name()
            );
            Err(match in_place {
                Some(_) => InvalidBox::field(FOLLOWER_FIELD, problem),
                None => InvalidBox::field("scenario", format!("its follower {problem}")),
            })
        }
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
    able_mps2: f64,
    given: &RangesSpec,
) -> Result<(), InvalidBox> {
    if !(limit_mps2 >= 0.0 && limit_mps2.is_finite()) {
        return Err(InvalidBox::field(
            LEADER_LIMIT_FIELD,
            format!("must be 0 or more, found {limit_mps2}"),
        ));
    }
    if limit_mps2 > able_mps2 {
        let problem = format!(
            "exceeds the braking limit of the leader: must be at most {able_mps2} m/s², found {limit_mps2}"
        );
        return Err(InvalidBox::field(LEADER_LIMIT_FIELD, problem));
    }
    let of_script = [
        ("leader_brake_mps2", given.leader_brake_mps2),
        ("onset_s", given.onset_s),
    ];
    match of_script.into_iter().find(|(_, range)| range.is_some()) {
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
