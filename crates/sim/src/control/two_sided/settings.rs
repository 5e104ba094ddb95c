//! Settings of a two-sided shield: parsing and printing as on the command line.

use super::params::RearErrorBounds;
use crate::control::ErrorBounds;
use crate::settings::{InvalidSetting, ShieldSetting};

/// Settings of a two-sided shield that the user may choose.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct TwoSidedSettings {
    /// Deceleration of the leader on a dry road up to which the shield protects, in m/s²; `None` for its true limit.
    pub level_mps2: Option<f64>,
    /// Time to collision at which the follower's brake fires, in seconds; `None` for 1.4 (paper, algorithm 2).
    pub ttc_s: Option<f64>,
    /// Time within which the follower reacts to the ego vehicle's braking, in seconds; `None` for a follower whose
    /// brake fires at a time to collision.
    pub reacts_s: Option<f64>,
    /// Maximum time from firing to braking, in seconds; `None` for that of the scenario.
    pub reaction_s: Option<f64>,
    /// Minimum deceleration of the follower on a dry road, in m/s²; `None` for its true limit.
    pub behind_brake_mps2: Option<f64>,
    /// Maximum magnitude of the follower's acceleration before its brake fires, in m/s²; `None` for 0.3.
    pub drift_mps2: Option<f64>,
    /// Error bounds of observations. `None` for bounds that follow from the estimator; they are 0 if it returns the
    /// true state.
    pub errors: Option<(ErrorBounds, RearErrorBounds)>,
    /// True if the shield executes its plan early to wake the follower.
    pub raises: bool,
}

/// Name of the shield on the command line.
const NAME: &str = "shield2";

/// All settings, in the order in which they are printed. Decelerations have the limits of `max_brake_mps2` in
/// scenarios.
const SETTINGS: [ShieldSetting<TwoSidedSettings>; 12] = [
    ShieldSetting {
        name: "level",
        range: [0.1, 30.0],
        is_switch: false,
        set: |settings, value| settings.level_mps2 = Some(value),
        get: |settings| settings.level_mps2,
    },
    ShieldSetting {
        name: "ttc",
        range: [0.1, 10.0],
        is_switch: false,
        set: |settings, value| settings.ttc_s = Some(value),
        get: |settings| settings.ttc_s,
    },
    ShieldSetting {
        name: "reacts",
        range: [0.0, 10.0],
        is_switch: false,
        set: |settings, value| settings.reacts_s = Some(value),
        get: |settings| settings.reacts_s,
    },
    ShieldSetting {
        name: "reaction",
        range: [0.0, 10.0],
        is_switch: false,
        set: |settings, value| settings.reaction_s = Some(value),
        get: |settings| settings.reaction_s,
    },
    ShieldSetting {
        name: "behind-brake",
        range: [0.1, 30.0],
        is_switch: false,
        set: |settings, value| settings.behind_brake_mps2 = Some(value),
        get: |settings| settings.behind_brake_mps2,
    },
    ShieldSetting {
        name: "drift",
        range: [0.0, 3.0],
        is_switch: false,
        set: |settings, value| settings.drift_mps2 = Some(value),
        get: |settings| settings.drift_mps2,
    },
    ShieldSetting {
        name: "gap-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().0.gap_m = value,
        get: |settings| settings.errors.map(|(ahead, _)| ahead.gap_m),
    },
    ShieldSetting {
        name: "speed-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().0.speed_mps = value,
        get: |settings| settings.errors.map(|(ahead, _)| ahead.speed_mps),
    },
    ShieldSetting {
        name: "ahead-speed-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().0.ahead_speed_mps = value,
        get: |settings| settings.errors.map(|(ahead, _)| ahead.ahead_speed_mps),
    },
    ShieldSetting {
        name: "behind-gap-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().1.gap_m = value,
        get: |settings| settings.errors.map(|(_, rear)| rear.gap_m),
    },
    ShieldSetting {
        name: "behind-speed-error",
        range: [0.0, 100.0],
        is_switch: false,
        set: |settings, value| settings.errors.get_or_insert_default().1.speed_mps = value,
        get: |settings| settings.errors.map(|(_, rear)| rear.speed_mps),
    },
    ShieldSetting {
        name: "raise",
        range: [0.0, 1.0],
        is_switch: true,
        set: |settings, value| settings.raises = value > 0.0,
        get: |settings| settings.raises.then_some(1.0),
    },
];

fn unknown_setting(setting: String) -> InvalidSetting {
    InvalidSetting::Unknown {
        found: setting,
        owner: "a two-sided shield",
        known: "there are level, ttc, reacts, reaction, behind-brake, drift, gap-error, speed-error, \
            ahead-speed-error, behind-gap-error, behind-speed-error and raise, each with a number, as in \
            `shield2,level=4.5:policy`"
            .to_owned(),
    }
}

/// Names of the settings that bound errors of observation.
const ERROR_NAMES: [&str; 5] = [
    "gap-error",
    "speed-error",
    "ahead-speed-error",
    "behind-gap-error",
    "behind-speed-error",
];

/// Returns the first setting of an error of observation.
fn name_of_error_setting(text: &str) -> Option<&'static str> {
    let given = text
        .split(',')
        .filter_map(|setting| setting.split('=').next());
    given
        .flat_map(|given| ERROR_NAMES.into_iter().find(|name| *name == given))
        .next()
}

impl TwoSidedSettings {
    /// Parses the text between `shield2` and the colon: settings, each after a comma. If any error bound is given, the
    /// others are 0.
    ///
    /// ```
    /// use crumple_sim::control::TwoSidedSettings;
    ///
    /// let settings = TwoSidedSettings::parse(",level=4.5,raise=1").unwrap();
    /// assert_eq!((settings.level_mps2, settings.raises), (Some(4.5), true));
    /// assert!(TwoSidedSettings::parse(",level=-1").is_err());
    /// ```
    ///
    /// # Errors
    /// [`InvalidSetting`] for an unknown or repeated setting, a value outside its range, or `reacts` with `ttc` or
    /// `reaction`.
    pub fn parse(text: &str) -> Result<Self, InvalidSetting> {
        let settings: Self = ShieldSetting::parse_all(&SETTINGS, text, NAME, unknown_setting)?;
        let excluded = [
            ("ttc", settings.ttc_s.is_some()),
            ("reaction", settings.reaction_s.is_some()),
        ];
        let conflict = excluded.iter().find(|(_, is_given)| *is_given);
        if let (Some((name, _)), Some(_)) = (conflict, settings.reacts_s) {
            return Err(InvalidSetting::Conflict {
                controller: NAME,
                names: ["reacts", name],
            });
        }
        Ok(settings)
    }

    /// Parses settings of the level, the class and the errors, without a comma before the first, for a certificate.
    ///
    /// # Errors
    /// Those of [`Self::parse`], and [`InvalidSetting::NoEffect`] for `raise`.
    pub fn parse_for_certificate(text: &str) -> Result<Self, InvalidSetting> {
        let comma = if text.is_empty() { "" } else { "," };
        let settings = Self::parse(&format!("{comma}{text}"))?;
        match settings.raises {
            true => Err(InvalidSetting::NoEffect { name: "raise" }),
            false => Ok(settings),
        }
    }

    /// Parses settings of the follower's class, without a comma before the first, for the measurement of levels at the
    /// true state.
    ///
    /// # Errors
    /// Those of [`Self::parse_for_certificate`], and [`InvalidSetting::NoEffect`] for `level` and for errors of
    /// observation.
    ///
    /// ```
    /// use crumple_sim::control::TwoSidedSettings;
    ///
    /// assert_eq!(TwoSidedSettings::parse_for_levels("ttc=2").unwrap().ttc_s, Some(2.0));
    /// assert!(TwoSidedSettings::parse_for_levels("level=3").is_err());
    /// ```
    pub fn parse_for_levels(text: &str) -> Result<Self, InvalidSetting> {
        let settings = Self::parse_for_certificate(text)?;
        if settings.level_mps2.is_some() {
            return Err(InvalidSetting::NoEffect { name: "level" });
        }
        match name_of_error_setting(text) {
            Some(name) => Err(InvalidSetting::NoEffect { name }),
            None => Ok(settings),
        }
    }

    /// Returns the text that [`Self::parse`] parses to this: the settings, each after a comma.
    #[must_use]
    pub fn to_arg(&self) -> String {
        ShieldSetting::print_all(&SETTINGS, self)
    }

    /// Returns the words before the name of a controller behind this shield: `shield2,level=4.5:`.
    #[must_use]
    pub fn name_prefix(&self) -> String {
        format!("shield2{}:", self.to_arg())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_are_parsed_as_they_are_printed() {
        let text = ",level=4.5,ttc=2,reaction=0.2,behind-brake=5,drift=0.25,gap-error=0.5,speed-error=0.1,\
            ahead-speed-error=1,behind-gap-error=0.4,behind-speed-error=0.75,raise=1";
        let settings = TwoSidedSettings::parse(text).unwrap();
        assert_eq!(settings.to_arg(), text);
        assert_eq!(TwoSidedSettings::parse(""), Ok(TwoSidedSettings::default()));
        assert_eq!(TwoSidedSettings::default().to_arg(), "");
        assert_eq!(
            settings
                .errors
                .map(|(ahead, rear)| (ahead.gap_m, rear.speed_mps)),
            Some((0.5, 0.75))
        );
        let behind_only =
            TwoSidedSettings::parse(",behind-gap-error=0.5").map(|settings| settings.to_arg());
        let all = ",gap-error=0,speed-error=0,ahead-speed-error=0,behind-gap-error=0.5,behind-speed-error=0";
        assert_eq!(behind_only, Ok(all.to_owned()));
    }

    #[test]
    fn wrong_settings_are_refused_with_the_reason() {
        for (text, expected) in [
            (
                ",level=0",
                "shield2: level must be a number from 0.1 to 30, found `0`",
            ),
            (
                ",raise=2",
                "shield2: raise must be a number from 0 to 1, found `2`",
            ),
            (",raise=0.5", "shield2: raise must be 0 or 1, found 0.5"),
            (",ttc=1,ttc=1", "shield2: ttc is given twice"),
            (
                ",reacts=1,reaction=0.5",
                "shield2: reacts and reaction exclude each other",
            ),
        ] {
            assert_eq!(
                TwoSidedSettings::parse(text).unwrap_err().to_string(),
                expected
            );
        }
        let unknown = TwoSidedSettings::parse(",ahead=7").unwrap_err().to_string();
        assert!(
            unknown
                .starts_with("`ahead=7` is not a setting of a two-sided shield: there are level,"),
            "{unknown}"
        );
    }
}
