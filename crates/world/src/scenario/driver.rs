//! Who drives a vehicle: plain data. How each of them drives is in [`crate::control`] and [`super::profile`].

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::profile::LeadProfile;

/// Who decides a vehicle's acceleration.
///
/// In a file, either a bare name (`driver = "baseline"`) or one name with its settings
/// (`driver.brake = { onset_s = 1.0, rate_mps2 = 3.0 }`).
#[derive(Debug, Clone, PartialEq)]
pub enum Driver {
    /// The controller under test: whichever a run puts there.
    UnderTest,
    /// Scripted motion that reacts to nobody.
    Profile(LeadProfile),
    /// A named controller, the same in every run.
    Controller(ControllerSpec),
}

/// A built-in controller and its settings.
#[derive(Debug, Clone, PartialEq)]
pub enum ControllerSpec {
    /// The paper's baseline ADAS: hold speed, brake fully and for good once TTC falls below a threshold.
    Baseline(AebSettings),
    /// The same, but the brake is released whenever TTC is above the threshold.
    BaselineUnlatched(AebSettings),
    /// Command the acceleration that the vehicle ahead is seen to have.
    MatchLeader,
    /// Hold speed; brake at a constant rate from a moment after the vehicle ahead is seen to brake.
    ConstantBrake(ConstantBrakeSettings),
    /// Intelligent Driver Model.
    Idm(IdmSettings),
    /// Adaptive cruise control at a constant time headway, with automatic emergency braking by TTC.
    AccAeb(AccAebSettings),
    /// The committed reference policy.
    Policy,
}

/// Settings of the emergency brake of the baseline controllers.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct AebSettings {
    /// Brake once time to collision falls below this, in seconds (paper, algorithm 2: 1.4).
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub ttc_s: f64,
}

impl Default for AebSettings {
    fn default() -> Self {
        Self { ttc_s: 1.4 }
    }
}

/// Settings of the controller that brakes at a constant rate.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct ConstantBrakeSettings {
    /// Deceleration held to standstill, in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub rate_mps2: f64,
    /// The vehicle ahead counts as braking once it is seen to decelerate harder than this, in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub trigger_mps2: f64,
    /// Time between seeing that and braking, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub delay_s: f64,
}

impl Default for ConstantBrakeSettings {
    fn default() -> Self {
        Self { rate_mps2: 3.25, trigger_mps2: 1.5, delay_s: 0.05 }
    }
}

/// Settings of the Intelligent Driver Model (Treiber, Hennecke and Helbing, Phys. Rev. E 62, 1805 (2000), eq. 3 and 4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct IdmSettings {
    /// Speed on a free road, in m/s. Default: 120 km/h, the paper's table I.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.1, max = 100.0)))]
    pub desired_speed_mps: f64,
    /// Desired time headway, in seconds. Default 1.6, the paper's table I.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub time_headway_s: f64,
    /// Gap at standstill, in metres.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub standstill_gap_m: f64,
    /// Largest acceleration, in m/s².
    #[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 30.0)))]
    pub accel_mps2: f64,
    /// Comfortable deceleration, in m/s², positive.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.01, max = 30.0)))]
    pub comfortable_brake_mps2: f64,
}

impl Default for IdmSettings {
    fn default() -> Self {
        Self {
            desired_speed_mps: 120.0 / 3.6,
            time_headway_s: 1.6,
            standstill_gap_m: 2.0,
            accel_mps2: 0.73,
            comfortable_brake_mps2: 1.67,
        }
    }
}

/// Settings of adaptive cruise control with emergency braking.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(default, deny_unknown_fields)]
pub struct AccAebSettings {
    /// Time gap to follow at, bumper to bumper, in seconds (ISO 15622:2018, 6.2.3: at least 0.8 s in steady state).
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub time_headway_s: f64,
    /// Gap at standstill, in metres.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub standstill_gap_m: f64,
    /// Acceleration for each metre of spacing error, in 1/s².
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub gap_gain_per_s2: f64,
    /// Acceleration for each m/s of speed difference, in 1/s.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 10.0)))]
    pub speed_gain_per_s: f64,
    /// Hardest braking of the cruise control, in m/s², positive (ISO 15622:2018, 6.4: at most 3.5 at motorway speeds).
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub comfort_brake_mps2: f64,
    /// Hardest acceleration of the cruise control, in m/s².
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 30.0)))]
    pub comfort_accel_mps2: f64,
    /// Brake fully while time to collision is below this, in seconds.
    #[cfg_attr(feature = "schema", schemars(range(min = 0.0, max = 100.0)))]
    pub ttc_s: f64,
}

impl Default for AccAebSettings {
    fn default() -> Self {
        Self {
            time_headway_s: 0.8,
            standstill_gap_m: 2.0,
            gap_gain_per_s2: 0.25,
            speed_gain_per_s: 0.8,
            comfort_brake_mps2: 3.5,
            comfort_accel_mps2: 2.0,
            ttc_s: 1.4,
        }
    }
}

impl ControllerSpec {
    /// Every built-in controller with its default settings, in the order `crumple list controllers` shows them.
    #[must_use]
    pub fn built_in() -> Vec<Self> {
        vec![
            Self::Baseline(AebSettings::default()),
            Self::BaselineUnlatched(AebSettings::default()),
            Self::MatchLeader,
            Self::ConstantBrake(ConstantBrakeSettings::default()),
            Self::Idm(IdmSettings::default()),
            Self::AccAeb(AccAebSettings::default()),
            Self::Policy,
        ]
    }

    /// The built-in controller of that name with its default settings.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        Self::built_in().into_iter().find(|controller| controller.name() == name)
    }

    /// The name used in files and on the command line.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::Baseline(_) => "baseline",
            Self::BaselineUnlatched(_) => "baseline-unlatched",
            Self::MatchLeader => "match-leader",
            Self::ConstantBrake(_) => "constant-brake",
            Self::Idm(_) => "idm",
            Self::AccAeb(_) => "acc-aeb",
            Self::Policy => "policy",
        }
    }

    /// What it does, in one line.
    #[must_use]
    pub fn summary(&self) -> &'static str {
        match self {
            Self::Baseline(_) => "the paper's ADAS: hold speed, then full braking to standstill once TTC < 1.4 s",
            Self::BaselineUnlatched(_) => "the same, but the brake is released when TTC recovers",
            Self::MatchLeader => "command the acceleration the vehicle ahead is seen to have",
            Self::ConstantBrake(_) => "brake at 3.25 m/s² from 0.05 s after the vehicle ahead is seen to brake",
            Self::Idm(_) => "Intelligent Driver Model (Treiber et al. 2000)",
            Self::AccAeb(_) => "cruise control at 0.8 s headway, emergency braking while TTC < 1.4 s",
            Self::Policy => "the committed reference policy, learned by DDPG",
        }
    }
}

/// The flat form of [`Driver`] in files: one externally tagged name, which keeps line numbers in error messages.
#[derive(Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case", rename = "Driver")]
enum DriverForm {
    /// The controller under test: whichever a run puts there.
    UnderTest {},
    /// Scripted: hold the speed.
    ConstantSpeed {},
    /// Scripted: brake at a constant rate to standstill.
    #[serde(rename = "brake")]
    Brake(super::profile::Brake),
    /// Scripted: build the braking up within a time, hold it, ease off just before standstill.
    RampBrake(super::profile::RampBrake),
    /// Scripted: brake at a constant rate to a lower speed and hold that.
    BrakeToSpeed(super::profile::BrakeToSpeed),
    /// Scripted: piecewise constant acceleration.
    Pieces(super::profile::Pieces),
    /// Scripted: follow recorded speeds.
    Recorded(super::profile::Recorded),
    /// The paper's baseline ADAS.
    Baseline(AebSettings),
    /// The baseline ADAS with a brake that is released when TTC recovers.
    BaselineUnlatched(AebSettings),
    /// Command the acceleration that the vehicle ahead is seen to have.
    MatchLeader {},
    /// Brake at a constant rate once the vehicle ahead is seen to brake.
    ConstantBrake(ConstantBrakeSettings),
    /// Intelligent Driver Model.
    Idm(IdmSettings),
    /// Adaptive cruise control with emergency braking.
    AccAeb(AccAebSettings),
    /// The committed reference policy.
    Policy {},
}

impl From<DriverForm> for Driver {
    fn from(form: DriverForm) -> Self {
        use DriverForm as F;
        match form {
            F::UnderTest {} => Self::UnderTest,
            F::ConstantSpeed {} => Self::Profile(LeadProfile::ConstantSpeed),
            F::Brake(profile) => Self::Profile(LeadProfile::Brake(profile)),
            F::RampBrake(profile) => Self::Profile(LeadProfile::RampBrake(profile)),
            F::BrakeToSpeed(profile) => Self::Profile(LeadProfile::BrakeToSpeed(profile)),
            F::Pieces(profile) => Self::Profile(LeadProfile::Pieces(profile)),
            F::Recorded(profile) => Self::Profile(LeadProfile::Recorded(profile)),
            F::Baseline(settings) => Self::Controller(ControllerSpec::Baseline(settings)),
            F::BaselineUnlatched(settings) => Self::Controller(ControllerSpec::BaselineUnlatched(settings)),
            F::MatchLeader {} => Self::Controller(ControllerSpec::MatchLeader),
            F::ConstantBrake(settings) => Self::Controller(ControllerSpec::ConstantBrake(settings)),
            F::Idm(settings) => Self::Controller(ControllerSpec::Idm(settings)),
            F::AccAeb(settings) => Self::Controller(ControllerSpec::AccAeb(settings)),
            F::Policy {} => Self::Controller(ControllerSpec::Policy),
        }
    }
}

impl From<Driver> for DriverForm {
    fn from(driver: Driver) -> Self {
        match driver {
            Driver::UnderTest => Self::UnderTest {},
            Driver::Profile(LeadProfile::ConstantSpeed) => Self::ConstantSpeed {},
            Driver::Profile(LeadProfile::Brake(profile)) => Self::Brake(profile),
            Driver::Profile(LeadProfile::RampBrake(profile)) => Self::RampBrake(profile),
            Driver::Profile(LeadProfile::BrakeToSpeed(profile)) => Self::BrakeToSpeed(profile),
            Driver::Profile(LeadProfile::Pieces(profile)) => Self::Pieces(profile),
            Driver::Profile(LeadProfile::Recorded(profile)) => Self::Recorded(profile),
            Driver::Controller(ControllerSpec::Baseline(settings)) => Self::Baseline(settings),
            Driver::Controller(ControllerSpec::BaselineUnlatched(settings)) => Self::BaselineUnlatched(settings),
            Driver::Controller(ControllerSpec::MatchLeader) => Self::MatchLeader {},
            Driver::Controller(ControllerSpec::ConstantBrake(settings)) => Self::ConstantBrake(settings),
            Driver::Controller(ControllerSpec::Idm(settings)) => Self::Idm(settings),
            Driver::Controller(ControllerSpec::AccAeb(settings)) => Self::AccAeb(settings),
            Driver::Controller(ControllerSpec::Policy) => Self::Policy {},
        }
    }
}

impl Driver {
    /// The driver's name in files: `under-test`, the profile's or the controller's.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::UnderTest => "under-test",
            Self::Profile(profile) => profile.name(),
            Self::Controller(controller) => controller.name(),
        }
    }

    /// Whether the bare name says everything, so that a file need not spell out the settings.
    fn is_default(&self) -> bool {
        match self {
            Self::UnderTest | Self::Profile(LeadProfile::ConstantSpeed) => true,
            Self::Profile(_) => false,
            Self::Controller(controller) => ControllerSpec::named(controller.name()).as_ref() == Some(controller),
        }
    }
}

impl Serialize for Driver {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.is_default() {
            serializer.serialize_str(self.name())
        } else {
            DriverForm::from(self.clone()).serialize(serializer)
        }
    }
}

impl<'de> Deserialize<'de> for Driver {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct NameOrTable;
        impl<'de> de::Visitor<'de> for NameOrTable {
            type Value = DriverForm;

            fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str("a driver's name, or a table with one driver and its settings")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<DriverForm, E> {
                let no_settings = std::iter::empty::<(&str, &str)>();
                let settings = de::value::MapDeserializer::new(no_settings);
                let named = std::iter::once((name, settings));
                DriverForm::deserialize(de::value::MapAccessDeserializer::new(de::value::MapDeserializer::new(named)))
            }

            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<DriverForm, A::Error> {
                let driver = DriverForm::deserialize(de::value::MapAccessDeserializer::new(&mut map))?;
                match map.next_key::<String>()? {
                    None => Ok(driver),
                    Some(second) => Err(de::Error::custom(format!("a vehicle has one driver, `{second}` is a second"))),
                }
            }
        }
        deserializer.deserialize_any(NameOrTable).map(Into::into)
    }
}

#[cfg(feature = "schema")]
impl schemars::JsonSchema for Driver {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Driver".into()
    }

    fn json_schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let with_settings = generator.subschema_for::<DriverForm>();
        let mut names = vec!["under-test", "constant-speed"];
        names.extend(ControllerSpec::built_in().iter().map(ControllerSpec::name));
        schemars::json_schema!({
            "description": "Who drives: a bare name, or one name with its settings.",
            "anyOf": [{ "enum": names }, with_settings],
        })
    }
}
