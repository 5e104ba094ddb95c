//! Specifications and drivers that are derived from the table of built-in controllers.

use std::sync::Arc;

use super::*;
use crate::observation::Observation;
use crate::policy::Policy;
use crate::settings::parse_settings;
use crumple_core::digest::sha256;

/// Role of a built-in controller; lists are in this order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Role {
    /// A rule-based controller, in traffic or under test.
    Rule,
    /// A reference driver, for example of a regulation.
    Reference,
    /// A learned controller.
    Learned,
    /// A controller that is no way to drive; shows the effect of a shield.
    Probe,
}

/// A built-in controller, known by name.
pub trait BuiltIn {
    /// Name in files and on the command line.
    const NAME: &'static str;
    /// Summary, one line.
    const SUMMARY: &'static str;
    /// Role of the controller.
    const ROLE: Role = Role::Rule;
    /// True if the commands depend on the follower.
    const OBSERVES_FOLLOWER: bool = false;
    /// Numbers that parametrise the controller.
    type Settings: ControllerSettings;
    /// Controller type that drives the vehicle.
    type Driver: Controller;

    /// Returns the policy of a learned controller.
    fn policy() -> Option<Arc<Policy>> {
        None
    }

    /// Returns true if commands depend on the seed of [`Self::start`].
    fn acts_at_random(_settings: &Self::Settings) -> bool {
        false
    }

    /// Creates a controller for a vehicle. `seed` is the scenario's.
    fn start(settings: &Self::Settings, ego: &Ego, seed: u64) -> Self::Driver;
}

macro_rules! define {
    (
        rules { $($(#[$doc:meta])* $rule:ident,)* }
        policies { $($(#[$policy_doc:meta])* $policy:ident($known_by:ident),)* }
    ) => {
        /// A built-in controller and its settings.
        #[derive(Debug, Clone, PartialEq)]
        pub enum BuiltInController {
            $($(#[$doc])* $rule(<$rule as BuiltIn>::Settings),)*
            $($(#[$policy_doc])* $policy(<$known_by as BuiltIn>::Settings),)*
        }

        /// Evaluates `$of` for the row of a specification, with its type and its settings.
        macro_rules! of_row {
            ($spec:expr, |$row:ident, $settings:ident| $of:expr) => {
                match $spec {
                    $(BuiltInController::$rule($settings) => { type $row = $rule; $of })*
                    $(BuiltInController::$policy($settings) => { type $row = $known_by; $of })*
                }
            };
        }

        impl BuiltInController {
            /// Returns every built-in controller with its default settings, in the order of `crumple list controllers`.
            #[must_use]
            pub fn all() -> Vec<Self> {
                let mut all = vec![$(Self::$rule(Default::default()),)* $(Self::$policy(Default::default()),)*];
                all.sort_by_key(Self::role);
                all
            }
        }

        /// A controller that drives one vehicle. The engines call rules and policies directly, all others by a dynamic
        /// call.
        pub(crate) enum AnyController {
            $($(#[$doc])* $rule($rule),)*
            Policy(PolicyDriver),
            Other(Box<dyn Controller>),
        }

        impl Controller for AnyController {
            #[inline]
            fn decide(&mut self, observation: &Observation) -> Result<f64, ControllerFailure> {
                match self {
                    $(Self::$rule(controller) => controller.decide(observation),)*
                    Self::Policy(controller) => controller.decide(observation),
                    Self::Other(controller) => controller.decide(observation),
                }
            }

            #[inline]
            fn perceive(&mut self, truth: &Observation) {
                match self {
                    $(Self::$rule(controller) => controller.perceive(truth),)*
                    Self::Policy(controller) => controller.perceive(truth),
                    Self::Other(controller) => controller.perceive(truth),
                }
            }

            fn record_command(&mut self, command_mps2: f64) {
                match self {
                    $(Self::$rule(controller) => controller.record_command(command_mps2),)*
                    Self::Policy(controller) => controller.record_command(command_mps2),
                    Self::Other(controller) => controller.record_command(command_mps2),
                }
            }

            fn is_warning(&self) -> bool {
                match self {
                    $(Self::$rule(controller) => controller.is_warning(),)*
                    Self::Policy(controller) => controller.is_warning(),
                    Self::Other(controller) => controller.is_warning(),
                }
            }

            fn overrides(&self) -> &[Override] {
                match self {
                    Self::Other(controller) => controller.overrides(),
                    _ => &[],
                }
            }
        }

        impl AnyController {
            pub(crate) fn from_spec(spec: &BuiltInController, ego: &Ego, seed: u64) -> Self {
                match spec {
                    $(BuiltInController::$rule(settings) => Self::$rule($rule::start(settings, ego, seed)),)*
                    $(BuiltInController::$policy(settings) => Self::Policy($known_by::start(settings, ego, seed)),)*
                }
            }
        }
    };
}
with_controllers!(define);

pub(super) fn describe_known_settings(fields: &[SettingField]) -> String {
    match fields {
        [] => "it has none".to_owned(),
        [first, ..] => {
            let names: Vec<_> = fields.iter().map(|field| field.name).collect();
            format!(
                "there are {}, each with a number, as in `{}={}`",
                names.join(", "),
                first.name,
                first.typical_range[1]
            )
        }
    }
}

impl BuiltInController {
    /// Returns the built-in controller of that name with its default settings.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Self::all()
            .into_iter()
            .find(|controller| controller.name() == name)
    }

    /// Iterates over all presets: [`CONTROLLER_PRESETS`], then [`CRUISE_PRESETS`].
    pub fn presets() -> impl Iterator<Item = &'static ControllerPreset> {
        CONTROLLER_PRESETS.iter().chain(&CRUISE_PRESETS)
    }

    /// Returns the preset with this name.
    #[must_use]
    pub fn from_preset(name: &str) -> Option<Self> {
        let preset = Self::presets().find(|preset| preset.name == name)?;
        Some(preset.controller.clone())
    }

    /// Returns the built-in controller with this name, with its default settings, or the preset with this name.
    #[must_use]
    pub fn from_name_or_preset(name: &str) -> Option<Self> {
        Self::from_name(name).or_else(|| Self::from_preset(name))
    }

    /// Parses a built-in controller from the command line: its name or that of a preset, and settings that differ
    /// from it, each after a comma (`acc-aeb,ttc_s=2.0`). Returns `None` if the name is not built in.
    ///
    /// ```
    /// use crumple_sim::control::BuiltInController;
    ///
    /// let spec = BuiltInController::parse("acc-aeb,ttc_s=2.0").unwrap().unwrap();
    /// assert_eq!(spec.to_arg(), "acc-aeb,ttc_s=2");
    /// assert!(BuiltInController::parse("acc-aeb,ttc_s=-1").unwrap().is_err());
    /// ```
    #[must_use]
    pub fn parse(words: &str) -> Option<Result<Self, InvalidSetting>> {
        let mut words = words.split(',');
        let name = words.next()?;
        Some(Self::from_name_or_preset(name)?.with_settings(words))
    }

    /// Returns this controller with settings that texts such as `ttc_s=2.0` state.
    fn with_settings<'t>(
        mut self,
        texts: impl Iterator<Item = &'t str>,
    ) -> Result<Self, InvalidSetting> {
        let controller = self.name();
        let fields = self.fields();
        let names_and_ranges: Vec<_> = fields
            .iter()
            .map(|field| (field.name, field.range))
            .collect();
        let settings = parse_settings(texts, controller, &names_and_ranges, |setting| {
            InvalidSetting::Unknown {
                found: setting,
                owner: controller,
                known: describe_known_settings(fields),
            }
        })?;
        for (index, value) in settings {
            if let Some(setting) = self.get_mut(index) {
                *setting = value;
            }
        }
        Ok(self)
    }

    /// Returns the preset with these settings.
    fn preset(&self) -> Option<&'static ControllerPreset> {
        Self::presets().find(|preset| preset.controller == *self)
    }

    /// Returns the name of the preset with these settings.
    #[must_use]
    pub fn preset_name(&self) -> Option<&'static str> {
        Some(self.preset()?.name)
    }

    /// Returns the text that [`Self::parse`] parses to this; equal specifications have the same text.
    #[must_use]
    pub fn to_arg(&self) -> String {
        if let Some(name) = self.preset_name() {
            return name.to_owned();
        }
        let changed = self.changed_settings().into_iter();
        changed.fold(self.name().to_owned(), |words, (name, value, _)| {
            format!("{words},{name}={value}")
        })
    }

    /// Returns name, value and default of each setting that differs from its default.
    fn changed_settings(&self) -> Vec<(&'static str, f64, f64)> {
        let default = Self::from_name(self.name());
        let default = default.iter().flat_map(Self::values);
        self.values()
            .zip(default)
            .filter(|(own, default)| own.1 != default.1)
            .map(|((field, value), (_, default))| (field.name, value, default))
            .collect()
    }

    /// Returns those of [`Self::all`] that drive, without those that serve tests and comparisons.
    #[must_use]
    pub fn all_that_drive() -> Vec<Self> {
        let mut controllers = Self::all();
        controllers.retain(|controller| !CONTROLLERS_FOR_TESTS.contains(&controller.name()));
        controllers
    }

    /// Returns the name in files and on the command line, without settings.
    #[must_use]
    pub fn name(&self) -> &'static str {
        of_row!(self, |Row, _settings| Row::NAME)
    }

    /// Returns the summary, one line.
    #[must_use]
    pub fn summary(&self) -> &'static str {
        of_row!(self, |Row, _settings| Row::SUMMARY)
    }

    /// Returns the role.
    #[must_use]
    pub fn role(&self) -> Role {
        of_row!(self, |Row, _settings| Row::ROLE)
    }

    /// True if the commands depend on the follower.
    #[must_use]
    pub fn observes_follower(&self) -> bool {
        self.policy().is_some() || of_row!(self, |Row, _settings| Row::OBSERVES_FOLLOWER)
    }

    /// Returns the policy of a learned controller.
    #[must_use]
    pub fn policy(&self) -> Option<Arc<Policy>> {
        of_row!(self, |Row, _settings| Row::policy())
    }

    /// Returns the descriptions of the settings, in the order of the files.
    #[must_use]
    pub fn fields(&self) -> &'static [SettingField] {
        of_row!(self, |Row, _settings| <Row as BuiltIn>::Settings::FIELDS)
    }

    /// Returns the settings with their values.
    pub fn values(&self) -> impl Iterator<Item = (&'static SettingField, f64)> {
        (0..)
            .zip(self.fields())
            .filter_map(|(index, field)| Some((field, self.get(index)?)))
    }

    fn get(&self, index: usize) -> Option<f64> {
        of_row!(self, |_Row, settings| settings.get(index))
    }

    /// Returns a reference to the value of the `index`-th of [`Self::fields`].
    pub fn get_mut(&mut self, index: usize) -> Option<&mut f64> {
        of_row!(self, |_Row, settings| settings.get_mut(index))
    }

    /// Returns the SHA-256, in hexadecimal, of a policy's file, or of a rule's name and settings.
    #[must_use]
    pub fn sha256(&self) -> String {
        if let Some(policy) = self.policy() {
            return policy.digest();
        }
        let values: Vec<_> = self
            .values()
            .map(|(_, value)| (value + 0.0).to_bits().to_string())
            .collect();
        sha256(format!("rule {} {}", self.name(), values.join(" ")))
    }
}

impl ControllerSource for BuiltInController {
    fn identity(&self) -> Option<String> {
        Some(self.sha256())
    }

    fn start(&self, ego: &Ego, seed: u64) -> Result<Box<dyn Controller>, ControllerFailure> {
        Ok(Box::new(AnyController::from_spec(self, ego, seed)))
    }

    fn holds_answers(&self) -> bool {
        true
    }

    fn acts_at_random(&self) -> bool {
        of_row!(self, |Row, settings| Row::acts_at_random(settings))
    }

    fn interval_s(&self) -> Option<f64> {
        Self::policy(self).map(|policy| policy.header().decision_interval_s)
    }

    /// The summary states default values, so that changed settings follow.
    fn description(&self) -> String {
        if let Some(preset) = self.preset() {
            return preset.summary.to_owned();
        }
        let changed: Vec<_> = self
            .changed_settings()
            .into_iter()
            .map(|(name, value, default)| format!("{name} = {value} instead of {default}"))
            .collect();
        match changed.as_slice() {
            [] => self.summary().to_owned(),
            _ => format!("{}, but with {}", self.summary(), changed.join(", ")),
        }
    }

    fn warnings(&self) -> Vec<String> {
        let domain = self.preset().and_then(|preset| preset.domain);
        domain.into_iter().map(str::to_owned).collect()
    }

    fn policy(&self) -> Option<Arc<Policy>> {
        Self::policy(self)
    }

    fn is_learned(&self) -> bool {
        Self::policy(self).is_some()
    }

    fn can_fail(&self) -> bool {
        false
    }
}
