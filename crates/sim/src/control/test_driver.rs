//! The driver of a vehicle on a test track, around any controller: does not exceed the test speed, and brakes after a
//! warning or at a place.
//!
//! Modelled on 49 CFR 571.127 (89 FR 39686): S7.3.2(d) for the speed; S7.3.3(b), S9.2.2(h) and S10 for the braking.

use std::sync::Arc;

use super::built_in::describe_known_settings;
use super::{
    Controller, ControllerFailure, ControllerSettings, ControllerSource, Ego, IntoSource,
    InvalidSetting, Override, ShieldRefusal, VehicleInRun,
};
use crate::observation::Observation;
use crate::policy::Policy;
use crate::settings::{parse_settings_after_name, settings};
use crumple_core::digest::sha256;

/// Time in which the driver would correct a deviation from the speed, in seconds.
const SPEED_CORRECTION_S: f64 = 1.0;

const NAME: &str = "test-driver";

settings! {
    /// Settings of the test driver.
    TestDriverSettings {
        /// Speed above which the driver does not let the vehicle accelerate, in m/s; 0 for no limit.
        hold_mps: 0.0, 0.0..=100.0, 0.0..=40.0, none 0.0;
        /// Deceleration of the manual braking, in m/s², positive; 0 for none.
        brake_mps2: 0.0, 0.0..=30.0, 0.0..=6.0, none 0.0;
        /// Time in which the manual braking builds up linearly, in seconds.
        ramp_s: 0.25, 0.0..=60.0, 0.0..=1.0;
        /// Time from the warning to the onset of the manual braking, in seconds.
        delay_s: 1.0, 0.0..=60.0, 0.0..=2.0;
        /// Time to collision of the reference warning, in seconds, for a controller that reports no warnings.
        warning_ttc_s: 2.1, 0.0..=60.0, 1.0..=3.0;
        /// Distance from the start after which the manual braking begins without a warning, in metres; 0 for after a
        /// warning.
        after_m: 0.0, 0.0..=1e6, 0.0..=200.0, none 0.0;
    }
}

impl TestDriverSettings {
    /// Parses the text between `test-driver` and the colon: settings, each after a comma.
    ///
    /// ```
    /// use crumple_sim::control::TestDriverSettings;
    ///
    /// let settings = TestDriverSettings::parse(",brake_mps2=4,delay_s=1.1").unwrap();
    /// assert_eq!((settings.brake_mps2, settings.delay_s, settings.ramp_s), (4.0, 1.1, 0.25));
    /// assert!(TestDriverSettings::parse(",brake_mps2=-1").is_err());
    /// ```
    ///
    /// # Errors
    /// [`InvalidSetting`] for an unknown or repeated setting, or a value outside its range.
    pub fn parse(text: &str) -> Result<Self, InvalidSetting> {
        let unknown = |setting| InvalidSetting::Unknown {
            found: setting,
            owner: "the test driver",
            known: describe_known_settings(Self::FIELDS),
        };
        let fields: Vec<_> = Self::FIELDS
            .iter()
            .map(|field| (field.name, field.range))
            .collect();
        let mut settings = Self::default();
        for (index, value) in parse_settings_after_name(text, NAME, &fields, unknown)? {
            if let Some(setting) = settings.get_mut(index) {
                *setting = value;
            }
        }
        Ok(settings)
    }

    /// Returns the words before the name of a controller with this driver: `test-driver,brake_mps2=4:`.
    #[must_use]
    pub fn name_prefix(&self) -> String {
        let default = Self::default();
        let mut words = NAME.to_owned();
        for (index, field) in Self::FIELDS.iter().enumerate() {
            if let Some(value) = self
                .get(index)
                .filter(|_| self.get(index) != default.get(index))
            {
                words += &format!(",{}={value}", field.name);
            }
        }
        words + ":"
    }

    /// Returns the manual braking at a time after its onset in seconds, in m/s², positive; 0 before the onset.
    #[must_use]
    pub fn manual_brake_mps2(&self, since_onset_s: f64) -> f64 {
        if since_onset_s < 0.0 {
            0.0
        } else if since_onset_s < self.ramp_s {
            self.brake_mps2 * since_onset_s / self.ramp_s
        } else {
            self.brake_mps2
        }
    }
}

/// A controller with a test driver.
#[derive(Clone)]
pub struct TestDriverSource {
    /// Controller that drives as long as the driver does not hold the speed or brakes harder.
    pub controller: Arc<dyn ControllerSource>,
    /// Settings of the driver.
    pub settings: TestDriverSettings,
}

impl TestDriverSource {
    fn with_driver(&self, controller: Box<dyn Controller>, ego: &Ego) -> Box<dyn Controller> {
        Box::new(TestDriver {
            reports_warnings: self.controller.reports_warnings(),
            controller,
            settings: self.settings.clone(),
            step_s: ego.step_s,
            steps: 0,
            travelled_m: 0.0,
            onset_s: None,
        })
    }

    fn inner_vehicle<'r>(&'r self, vehicle: &VehicleInRun<'r>) -> VehicleInRun<'r> {
        VehicleInRun {
            source: &self.controller,
            ..*vehicle
        }
    }
}

impl IntoSource for TestDriverSource {
    fn into_source(self) -> Arc<dyn ControllerSource> {
        Arc::new(self)
    }
}

impl ControllerSource for TestDriverSource {
    fn identity(&self) -> Option<String> {
        let inner = self.controller.identity()?;
        Some(sha256(format!("{} {inner}", self.settings.name_prefix())))
    }

    fn inner(&self) -> Option<&dyn ControllerSource> {
        Some(&*self.controller)
    }

    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(self.with_driver(self.controller.start(ego, seed)?, ego))
    }

    fn description(&self) -> String {
        format!("with a test driver: {}", self.controller.description())
    }

    /// The driver's braking is not the policy's.
    fn policy(&self) -> Option<Arc<Policy>> {
        None
    }

    fn is_learned(&self) -> bool {
        false
    }

    fn check_vehicle(&self, vehicle: &VehicleInRun<'_>) -> Result<(), ShieldRefusal> {
        self.controller.check_vehicle(&self.inner_vehicle(vehicle))
    }

    fn start_in_run(
        &self,
        vehicle: &VehicleInRun<'_>,
    ) -> Result<Box<dyn Controller>, ControllerFailure> {
        let controller = self.controller.start_in_run(&self.inner_vehicle(vehicle))?;
        Ok(self.with_driver(controller, &vehicle.ego))
    }
}

struct TestDriver {
    controller: Box<dyn Controller>,
    reports_warnings: bool,
    settings: TestDriverSettings,
    step_s: f64,
    steps: usize,
    /// Distance from the start by the observed speeds.
    travelled_m: f64,
    /// Onset of the manual braking.
    onset_s: Option<f64>,
}

impl TestDriver {
    /// Returns the onset of the manual braking, if the vehicle reaches its place, or is warned, in this step.
    fn find_onset_s(&self, observation: &Observation, now_s: f64) -> Option<f64> {
        let TestDriverSettings {
            delay_s, after_m, ..
        } = self.settings;
        if after_m == 0.0 {
            return self.is_warned(observation).then_some(now_s + delay_s);
        }
        let beyond_m = self.travelled_m - after_m;
        let is_reached = beyond_m >= 0.0 && observation.speed_mps > 0.0;
        is_reached.then(|| now_s - (beyond_m / observation.speed_mps).min(self.step_s))
    }

    fn is_warned(&self, observation: &Observation) -> bool {
        if self.reports_warnings {
            return self.controller.is_warning();
        }
        observation.ahead.is_some_and(|ahead| {
            let closing_mps = observation.speed_mps - ahead.speed_mps;
            closing_mps > 0.0 && ahead.gap_m <= self.settings.warning_ttc_s * closing_mps
        })
    }

    /// Returns the largest acceleration that the driver allows now, in m/s².
    fn limit_mps2(&self, observation: &Observation, now_s: f64) -> f64 {
        let TestDriverSettings { hold_mps, .. } = self.settings;
        let hold_mps2 = if hold_mps == 0.0 {
            f64::INFINITY
        } else {
            (hold_mps - observation.speed_mps) / SPEED_CORRECTION_S
        };
        match self.onset_s.filter(|&onset_s| onset_s <= now_s) {
            Some(onset_s) => hold_mps2.min(-self.settings.manual_brake_mps2(now_s - onset_s)),
            None => hold_mps2,
        }
    }
}

impl Controller for TestDriver {
    fn perceive(&mut self, truth: &Observation) {
        self.controller.perceive(truth);
    }

    fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
        let wanted_mps2 = self.controller.decide(observation)?;
        let now_s = self.steps as f64 * self.step_s;
        if self.settings.brake_mps2 > 0.0 && self.onset_s.is_none() {
            self.onset_s = self.find_onset_s(observation, now_s);
        }
        let limit_mps2 = self.limit_mps2(observation, now_s);
        self.steps += 1;
        self.travelled_m += observation.speed_mps * self.step_s;
        if limit_mps2 < wanted_mps2 {
            self.controller.record_command(limit_mps2);
            return Ok(limit_mps2);
        }
        Ok(wanted_mps2)
    }

    fn record_command(&mut self, command_mps2: f64) {
        self.controller.record_command(command_mps2);
    }

    fn is_warning(&self) -> bool {
        self.controller.is_warning()
    }

    fn overrides(&self) -> &[Override] {
        self.controller.overrides()
    }
}

#[cfg(test)]
mod tests {
    use super::super::tests::{EGO, leader_observation};
    use super::super::{BuiltInController, stateless};
    use super::*;

    /// Reports a warning from its third decision on.
    struct Warning(usize);

    impl Controller for Warning {
        fn decide(&mut self, _: &Observation) -> Result<f64, ControllerFailure> {
            self.0 += 1;
            Ok(1.0)
        }

        fn is_warning(&self) -> bool {
            self.0 >= 3
        }
    }

    struct WarningSource;

    impl ControllerSource for WarningSource {
        fn identity(&self) -> Option<String> {
            None
        }

        fn start(&self, _: &Ego, _: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
            Ok(Box::new(Warning(0)))
        }

        fn reports_warnings(&self) -> bool {
            true
        }
    }

    fn driver(controller: Arc<dyn ControllerSource>, settings: &str) -> Box<dyn Controller> {
        let settings = TestDriverSettings::parse(settings).unwrap();
        let source = TestDriverSource {
            controller,
            settings,
        };
        source.start(&EGO, 0).unwrap()
    }

    /// Returns the first step in which the driver brakes, and the steps until it brakes fully.
    fn braking_steps(driver: &mut dyn Controller, observation: &Observation) -> [usize; 2] {
        let commands: Vec<f64> = (0..1000)
            .map(|_| driver.decide(observation).unwrap())
            .collect();
        let first = |limit_mps2: f64| commands.iter().position(|command| *command < limit_mps2);
        [first(-1e-9).unwrap(), first(-3.999).unwrap()]
    }

    #[test]
    fn the_driver_brakes_its_delay_after_a_reported_warning() {
        // Far away: the reference warning would never be given.
        let far = leader_observation(20.0, 500.0, 20.0, 0.0);
        let mut driver = driver(Arc::new(WarningSource), ",brake_mps2=4,delay_s=0.5");
        // Warned at step 2; the ramp begins at step 52 with 0 m/s².
        assert_eq!(braking_steps(&mut *driver, &far), [53, 77]);
    }

    #[test]
    fn the_reference_warning_has_a_time_to_collision() {
        let idle = || stateless(|_| 1.0);
        let at = |gap_m| leader_observation(20.0, gap_m, 10.0, 0.0);
        let settings = ",brake_mps2=4,ramp_s=0,delay_s=1,warning_ttc_s=2.1";
        let mut late = driver(idle(), settings);
        assert_eq!(late.decide(&at(21.01)), Ok(1.0));
        assert_eq!(braking_steps(&mut *late, &at(21.0)), [100, 100]);
        let receding = leader_observation(20.0, 1.0, 20.0, 0.0);
        let mut never = driver(idle(), settings);
        assert!((0..1000).all(|_| never.decide(&receding) == Ok(1.0)));
    }

    #[test]
    fn the_driver_brakes_at_a_place() {
        let road = leader_observation(20.0, 500.0, 20.0, 0.0);
        let mut driver = driver(stateless(|_| 0.0), ",brake_mps2=4,ramp_s=0,after_m=29.9");
        // 29.9 m at 20 m/s are 1.495 s; the next step begins at 1.5 s.
        assert_eq!(braking_steps(&mut *driver, &road), [150, 150]);
    }

    #[test]
    fn the_driver_limits_the_speed_and_weakens_no_braking() {
        let alone = |speed_mps| leader_observation(speed_mps, 500.0, 30.0, 0.0);
        let mut fast = driver(stateless(|_| 2.0), ",hold_mps=20");
        for (speed_mps, command_mps2) in [(15.0, 2.0), (19.0, 1.0), (20.0, 0.0), (20.5, -0.5)] {
            assert_eq!(fast.decide(&alone(speed_mps)), Ok(command_mps2));
        }
        let mut braking = driver(stateless(|_| -6.0), ",hold_mps=20,brake_mps2=4,after_m=1");
        assert!((0..100).all(|_| braking.decide(&alone(20.5)) == Ok(-6.0)));
    }

    #[test]
    fn settings_are_parsed_as_they_are_printed() {
        for text in [
            "",
            ",hold_mps=22.5",
            ",brake_mps2=3.9,ramp_s=0,after_m=86.5",
        ] {
            let settings = TestDriverSettings::parse(text).unwrap();
            assert_eq!(settings.name_prefix(), format!("test-driver{text}:"));
        }
        let refused = TestDriverSettings::parse(",speed=3")
            .unwrap_err()
            .to_string();
        assert!(
            refused.starts_with("`speed=3` is not a setting of the test driver"),
            "{refused}"
        );
    }

    #[test]
    fn settings_belong_to_the_identity() {
        let with = |settings: &str| {
            let source = TestDriverSource {
                controller: Arc::new(BuiltInController::from_name("idm").unwrap()),
                settings: TestDriverSettings::parse(settings).unwrap(),
            };
            source.identity().unwrap()
        };
        assert_ne!(with(""), with(",hold_mps=3"));
    }
}
