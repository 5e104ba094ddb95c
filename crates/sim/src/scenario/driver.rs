//! Drivers of vehicles as plain data; [`crate::control`] and [`super::profile`] implement them.

use std::path::{self, Path};
use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

use super::Scenario;
use super::invalid::FieldProblem;
use super::profile::LeadProfile;
use crate::control::{
    self, BuiltIn, BuiltInController, ControllerSource, StartRefusal, with_controllers,
};

/// The source of a vehicle's acceleration.
///
/// Files hold a bare name (`driver = "baseline"`) or a name with settings (`driver.brake = { onset_s = 1.0, rate_mps2 =
/// 3.0 }`).
#[derive(Debug, Clone, PartialEq)]
pub enum Driver {
    /// Controller under test, which each run supplies.
    UnderTest,
    /// Scripted motion, independent of other vehicles.
    Profile(LeadProfile),
    /// Named controller, the same in every run.
    Controller(BuiltInController),
    /// Controller from a file.
    File(FileDriver),
}

/// Opens the controllers that scenario files name as drivers.
pub trait OpenDriver: Sync {
    /// Opens the controller in the file at `path`.
    ///
    /// # Errors
    /// [`DriverProblem`] for a file without a usable controller, and for a program that may not start.
    fn open_driver(&self, path: &Path) -> Result<Arc<dyn ControllerSource>, DriverProblem>;
}

/// Reason why a file gives no driver.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DriverProblem {
    /// The file holds no usable controller.
    #[error("{0}")]
    Unusable(String),
    /// A program that only a file names.
    #[error(transparent)]
    StartRefused(#[from] StartRefusal),
}

/// Opens no file: for scenarios whose drivers are built in.
#[derive(Debug, Clone, Copy, Default)]
pub struct NoDriverFiles;

impl OpenDriver for NoDriverFiles {
    fn open_driver(&self, path: &Path) -> Result<Arc<dyn ControllerSource>, DriverProblem> {
        let path = path.display();
        let problem = format!("{path} is not read here: use a driver that is built in");
        Err(DriverProblem::Unusable(problem))
    }
}

/// Opens the drivers that a scenario has read already, for copies of it.
impl OpenDriver for Scenario {
    fn open_driver(&self, path: &Path) -> Result<Arc<dyn ControllerSource>, DriverProblem> {
        let mut drivers = self
            .vehicles()
            .iter()
            .filter_map(|vehicle| match &vehicle.driver {
                Driver::File(file) => Some(file),
                _ => None,
            });
        let driver = drivers.find(|file| Path::new(&file.path) == path);
        match driver.and_then(FileDriver::controller) {
            Some(controller) => Ok(Arc::clone(controller)),
            None => NoDriverFiles.open_driver(path),
        }
    }
}

/// A driver that is a controller from a file, the same in every run.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[cfg_attr(
    feature = "schema",
    schemars(rename = "FileForm", description = "As a scenario file states it.")
)]
#[serde(deny_unknown_fields)]
pub struct FileDriver {
    /// Path from the folder of the scenario file: a policy, a network or a controller file.
    path: String,
    /// Identity that the controller must have.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    sha256: Option<String>,
    /// Controller, after it was read.
    #[serde(skip)]
    controller: Option<Arc<dyn ControllerSource>>,
}

/// Compares paths and identities; reading the controller sets its identity.
impl PartialEq for FileDriver {
    fn eq(&self, other: &Self) -> bool {
        (&self.path, &self.sha256) == (&other.path, &other.sha256)
    }
}

impl FileDriver {
    /// Returns the controller, if it was read.
    #[must_use]
    pub fn controller(&self) -> Option<&Arc<dyn ControllerSource>> {
        self.controller.as_ref()
    }

    /// Returns the path of the file.
    #[must_use]
    pub fn path(&self) -> &str {
        &self.path
    }

    /// Reads the controller; its path is relative to `folder`. Then stores its identity and absolute path, so that a
    /// scenario written to another folder finds the same controller.
    pub(super) fn read(
        &mut self,
        folder: &Path,
        opener: &dyn OpenDriver,
    ) -> Result<(), FieldProblem> {
        if self.controller.is_some() {
            return Ok(());
        }
        let path =
            path::absolute(folder.join(&self.path)).map_err(|error| unusable(error.to_string()))?;
        if !path.is_file() {
            return Err(unusable(format!("there is no file {}", path.display())));
        }
        let controller = opener.open_driver(&path).map_err(|problem| match problem {
            DriverProblem::StartRefused(refused) => refused.into(),
            DriverProblem::Unusable(reason) => unusable(reason),
        })?;
        let Some(identity) = controller.identity() else {
            // Without an identity, the scenario does not determine its runs.
            return Err(unusable(format!(
                "{} has no identity: the driver of a scenario must list its `files` and be deterministic",
                path.display()
            )));
        };
        if let Some(wanted) = self.sha256.as_ref().filter(|wanted| **wanted != identity) {
            let problem = format!(
                "{} has the identity {identity}, and {wanted} is wanted",
                path.display()
            );
            return Err(unusable(problem));
        }
        let path = path
            .into_os_string()
            .into_string()
            .map_err(|path| unusable(format!("{} is a path that is not UTF-8", path.display())))?;
        *self = Self {
            path,
            sha256: Some(identity),
            controller: Some(controller),
        };
        Ok(())
    }
}

fn unusable(reason: String) -> FieldProblem {
    FieldProblem::DriverFile { reason }
}

macro_rules! define_form {
    (
        rules { $($(#[$doc:meta])* $rule:ident,)* }
        policies { $($(#[$policy_doc:meta])* $policy:ident($known_by:ident),)* }
    ) => {
        /// Flat form of [`Driver`] in files: an externally tagged name, which keeps line numbers in error messages.
        #[derive(Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(rename_all = "kebab-case", rename = "Driver")]
        enum DriverForm {
            /// Controller under test, which each run supplies.
            UnderTest {},
            /// Scripted: constant speed.
            ConstantSpeed {},
            /// Scripted: constant braking to standstill.
            Brake(super::profile::Brake),
            /// Scripted: braking that builds up within a time, is held, and eases off just before standstill.
            RampBrake(super::profile::RampBrake),
            /// Scripted: constant braking to a lower speed, which is then held.
            BrakeToSpeed(super::profile::BrakeToSpeed),
            /// Scripted: piecewise constant acceleration.
            Pieces(super::profile::PiecewiseAcceleration),
            /// Scripted: recorded speeds.
            Recorded(super::profile::RecordedSpeeds),
            $($(#[$doc])* $rule(<control::$rule as BuiltIn>::Settings),)*
            $($(#[$policy_doc])* $policy(<control::$known_by as BuiltIn>::Settings),)*
            /// Controller from a file.
            File(FileDriver),
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
                    $(F::$rule(settings) => Self::Controller(BuiltInController::$rule(settings)),)*
                    $(F::$policy(settings) => Self::Controller(BuiltInController::$policy(settings)),)*
                    F::File(file) => Self::File(file),
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
                    $(Driver::Controller(BuiltInController::$rule(settings)) => Self::$rule(settings),)*
                    $(Driver::Controller(BuiltInController::$policy(settings)) => Self::$policy(settings),)*
                    Driver::File(file) => Self::File(file),
                }
            }
        }
    };
}
with_controllers!(define_form);

impl Driver {
    /// Returns the name in files: `under-test`, the profile's or the controller's; `file` for a controller from a file.
    #[must_use]
    pub fn name(&self) -> &'static str {
        match self {
            Self::UnderTest => "under-test",
            Self::Profile(profile) => profile.name(),
            Self::Controller(controller) => controller.name(),
            Self::File(_) => "file",
        }
    }

    /// Returns true if the bare name determines all settings.
    fn is_default(&self) -> bool {
        match self {
            Self::UnderTest | Self::Profile(LeadProfile::ConstantSpeed) => true,
            Self::Profile(_) | Self::File(_) => false,
            Self::Controller(controller) => {
                BuiltInController::from_name(controller.name()).as_ref() == Some(controller)
            }
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
        struct DriverVisitor;
        impl<'de> de::Visitor<'de> for DriverVisitor {
            type Value = DriverForm;

            fn expecting(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                out.write_str("a driver's name, or a table with one driver and its settings")
            }

            fn visit_str<E: de::Error>(self, name: &str) -> Result<DriverForm, E> {
                if let Some(preset) = BuiltInController::from_preset(name) {
                    return Ok(Driver::Controller(preset).into());
                }
                if name.contains(':') {
                    return Err(de::Error::custom(format!(
                        "there is no preset `{name}`: use one of `crumple list controllers`"
                    )));
                }
                let no_settings = std::iter::empty::<(&str, &str)>();
                let settings = de::value::MapDeserializer::new(no_settings);
                let named = std::iter::once((name, settings));
                DriverForm::deserialize(de::value::MapAccessDeserializer::new(
                    de::value::MapDeserializer::new(named),
                ))
            }

            fn visit_map<A: de::MapAccess<'de>>(self, mut map: A) -> Result<DriverForm, A::Error> {
                let driver =
                    DriverForm::deserialize(de::value::MapAccessDeserializer::new(&mut map))?;
                match map.next_key::<String>()? {
                    None => Ok(driver),
                    Some(second) => Err(de::Error::custom(format!(
                        "a vehicle has one driver: remove the second one, `{second}`"
                    ))),
                }
            }
        }
        deserializer.deserialize_any(DriverVisitor).map(Into::into)
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
        names.extend(BuiltInController::all().iter().map(BuiltInController::name));
        names.extend(BuiltInController::presets().map(|preset| preset.name));
        schemars::json_schema!({
            "description": "Who drives: a bare name, or one name with its settings.",
            "anyOf": [{ "enum": names }, with_settings],
        })
    }
}
