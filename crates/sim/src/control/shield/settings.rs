//! Settings of a shield: parsing and printing as on the command line.

use super::ErrorBounds;
use crate::control::TwoSidedSettings;
use crate::settings::{InvalidSetting, ShieldSetting};

/// Settings of a shield that the user may choose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ShieldSettings {
    /// Assumed maximum deceleration of the leader on a dry road, in m/s²; `None` for its true limit.
    pub ahead_brake_mps2: Option<f64>,
    /// Error bounds of observations. `None` for bounds that follow from the estimator; they are 0 if it returns the
    /// true state.
    pub errors: Option<ErrorBounds>,
}

/// All settings. The limits of `ahead` are those of `max_brake_mps2` in scenarios.
const SETTINGS: [ShieldSetting<ShieldSettings>; 4] = [
    ShieldSetting {
        name: "ahead",
        range: [0.1, 30.0],
        is_switch: false,
        set: |settings, value| settings.ahead_brake_mps2 = Some(value),
        get: |settings| settings.ahead_brake_mps2,
    },
    ShieldSetting {
        name: "gap-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().gap_m = value,
        get: |settings| settings.errors.map(|errors| errors.gap_m),
    },
    ShieldSetting {
        name: "speed-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().speed_mps = value,
        get: |settings| settings.errors.map(|errors| errors.speed_mps),
    },
    ShieldSetting {
        name: "ahead-speed-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().ahead_speed_mps = value,
        get: |settings| settings.errors.map(|errors| errors.ahead_speed_mps),
    },
];

fn unknown_setting(setting: String) -> InvalidSetting {
    InvalidSetting::Unknown {
        found: setting,
        owner: "a shield",
        known: "there are ahead, gap-error, speed-error and ahead-speed-error, each with a number, as in \
            `shield,ahead=7.5,gap-error=0.2:policy`"
            .to_owned(),
    }
}

impl ShieldSettings {
    /// Parses the text between `shield` and the colon: settings, each after a comma. `ahead` (m/s²) is the maximum
    /// deceleration of the leader. `gap-error` (m), `speed-error` and `ahead-speed-error` (m/s) bound errors of
    /// observations; if any is given, the others are 0.
    ///
    /// ```
    /// use crumple_sim::control::ShieldSettings;
    ///
    /// let settings = ShieldSettings::parse(",ahead=7.5,gap-error=0.2").unwrap();
    /// assert_eq!(settings.ahead_brake_mps2, Some(7.5));
    /// assert!(ShieldSettings::parse(",ahead=-1").is_err());
    /// ```
    ///
    /// # Errors
    /// [`InvalidSetting`] for an unknown or repeated setting, or a value outside its range.
    pub fn parse(text: &str) -> Result<Self, InvalidSetting> {
        ShieldSetting::parse_all(&SETTINGS, text, "shield", unknown_setting)
    }

    /// Returns the text that [`Self::parse`] parses to this: the settings, each after a comma.
    #[must_use]
    pub fn to_arg(&self) -> String {
        ShieldSetting::print_all(&SETTINGS, self)
    }

    /// Returns the words before the name of a controller behind this shield: `shield,ahead=7:`.
    #[must_use]
    pub fn name_prefix(&self) -> String {
        format!("shield{}:", self.to_arg())
    }
}

/// A kind of shield with its settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum ShieldKind {
    /// `shield`: protects from a collision with the leader.
    Ahead(ShieldSettings),
    /// `shield2`: protects from a collision with the leader, and from one with a follower of a class.
    BothSides(TwoSidedSettings),
}

impl ShieldKind {
    /// Parses the text between `shield` and the colon: settings, for `shield2` after a 2.
    ///
    /// # Errors
    /// [`InvalidSetting`] for an unknown or repeated setting, or a value outside its range.
    pub fn parse(text: &str) -> Result<Self, InvalidSetting> {
        match text.strip_prefix('2') {
            Some(rest) if rest.is_empty() || rest.starts_with(',') => {
                TwoSidedSettings::parse(rest).map(Self::BothSides)
            }
            _ => ShieldSettings::parse(text).map(Self::Ahead),
        }
    }

    /// Returns the words before the name of a controller behind this shield: `shield,ahead=7:` or `shield2:`.
    #[must_use]
    pub fn name_prefix(&self) -> String {
        match self {
            Self::Ahead(settings) => settings.name_prefix(),
            Self::BothSides(settings) => settings.name_prefix(),
        }
    }
}

impl From<ShieldSettings> for ShieldKind {
    fn from(settings: ShieldSettings) -> Self {
        Self::Ahead(settings)
    }
}

impl From<TwoSidedSettings> for ShieldKind {
    fn from(settings: TwoSidedSettings) -> Self {
        Self::BothSides(settings)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_parsed_as_they_are_printed() {
        let errors = Some(ErrorBounds {
            gap_m: 0.5,
            speed_mps: 0.25,
            ahead_speed_mps: 1.0,
        });
        let settings = ShieldSettings {
            ahead_brake_mps2: Some(6.0),
            errors,
        };
        let text = ",ahead=6,gap-error=0.5,speed-error=0.25,ahead-speed-error=1";
        assert_eq!(settings.to_arg(), text);
        assert_eq!(ShieldSettings::parse(text), Ok(settings));
        assert_eq!(ShieldSettings::default().to_arg(), "");
        assert_eq!(ShieldSettings::parse(""), Ok(ShieldSettings::default()));
        let zero = ShieldSettings::parse(",speed-error=-0").map(|settings| settings.to_arg());
        let bounds = ",gap-error=0,speed-error=0,ahead-speed-error=0";
        assert_eq!(zero, Ok(bounds.to_owned()));
    }

    #[test]
    fn wrong_settings_are_refused_with_the_reason() {
        let unknown = |found: &str| {
            format!(
                "`{found}` is not a setting of a shield: there are ahead, gap-error, speed-error and \
                ahead-speed-error, each with a number, as in `shield,ahead=7.5,gap-error=0.2:policy`"
            )
        };
        let value = |name, from, to, found| {
            format!("shield: {name} must be a number from {from} to {to}, found `{found}`")
        };
        for (text, expected) in [
            ("s", unknown("s")),
            (",", unknown("")),
            (",colour=1", unknown("colour=1")),
            (",ahead=3,", unknown("")),
            (
                ",ahead=3,ahead=4",
                "shield: ahead is given twice".to_owned(),
            ),
            (
                ",gap-error=0,ahead=3,gap-error=0",
                "shield: gap-error is given twice".to_owned(),
            ),
            (",ahead", value("ahead", 0.1, 30.0, "")),
            (",ahead=-1", value("ahead", 0.1, 30.0, "-1")),
            (",ahead=nan", value("ahead", 0.1, 30.0, "nan")),
            (",ahead=0", value("ahead", 0.1, 30.0, "0")),
            (",ahead=31", value("ahead", 0.1, 30.0, "31")),
            (",gap-error=1e9", value("gap-error", 0.0, 100.0, "1e9")),
            (",speed-error=inf", value("speed-error", 0.0, 100.0, "inf")),
            (
                ",ahead-speed-error=fast",
                value("ahead-speed-error", 0.0, 100.0, "fast"),
            ),
        ] {
            let error = ShieldSettings::parse(text).unwrap_err();
            assert_eq!(error.to_string(), expected);
        }
    }
}
