//! Settings of controllers: numbers with a default, an allowed range and a typical range.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// One number of a controller's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SettingField {
    /// Name, with its unit.
    pub name: &'static str,
    /// Allowed minimum and maximum.
    pub range: [f64; 2],
    /// Realistic minimum and maximum, for searches and fuzzers.
    pub typical_range: [f64; 2],
    /// Value that switches the setting off, for example a set speed that is none.
    pub none_value: Option<f64>,
}

impl SettingField {
    /// Returns the unit that the name ends with.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        const ENDINGS: [(&str, &str); 8] = [
            ("_s2_per_m", "s²/m"),
            ("_mps3", "m/s³"),
            ("_per_s2", "1/s²"),
            ("_per_s", "1/s"),
            ("_mps2", "m/s²"),
            ("_mps", "m/s"),
            ("_m", "m"),
            ("_s", "s"),
        ];
        ENDINGS
            .iter()
            .find(|(ending, _)| self.name.ends_with(ending))
            .map_or("1", |(_, unit)| unit)
    }
}

/// Reason why a text states no settings of a controller or a shield.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InvalidSetting {
    /// An unknown setting.
    #[error("`{found}` is not a setting of {owner}: {known}")]
    Unknown {
        /// The text found.
        found: String,
        /// The controller, or `a shield`.
        owner: &'static str,
        /// The settings that there are, as a sentence.
        known: String,
    },
    /// A setting that is given twice.
    #[error("{controller}: {name} is given twice")]
    Duplicate {
        /// The controller, or `shield`.
        controller: &'static str,
        /// The setting.
        name: &'static str,
    },
    /// Two settings that exclude each other.
    #[error("{controller}: {} and {} exclude each other", names[0], names[1])]
    Conflict {
        /// The controller, or `shield`.
        controller: &'static str,
        /// The settings.
        names: [&'static str; 2],
    },
    /// A setting that is neither on nor off.
    #[error("{controller}: {name} must be 0 or 1, found {found}")]
    Switch {
        /// The controller, or `shield`.
        controller: &'static str,
        /// The setting.
        name: &'static str,
        /// The value found.
        found: f64,
    },
    /// A setting without an effect in this place.
    #[error("{name} has no effect here")]
    NoEffect {
        /// The setting.
        name: &'static str,
    },
    /// A value that is not a number in its range.
    #[error("{controller}: {name} must be a number from {} to {}, found `{found}`", range[0], range[1])]
    Value {
        /// The controller, or `shield`.
        controller: &'static str,
        /// The setting.
        name: &'static str,
        /// Allowed minimum and maximum.
        range: [f64; 2],
        /// The text found.
        found: String,
    },
}

/// Parses settings, each as `name=value`, for `controller` with these names and ranges. Returns the index of each
/// of them that is set, and its value.
pub(crate) fn parse_settings<'t>(
    texts: impl Iterator<Item = &'t str>,
    controller: &'static str,
    names_and_ranges: &[(&'static str, [f64; 2])],
    unknown: impl Fn(String) -> InvalidSetting,
) -> Result<Vec<(usize, f64)>, InvalidSetting> {
    let mut settings: Vec<(usize, f64)> = Vec::new();
    for text in texts {
        let (stated, value) = text.split_once('=').unwrap_or((text, ""));
        let mut candidates = (0..).zip(names_and_ranges);
        let setting = candidates.find(|(_, (name, _))| *name == stated);
        let (index, &(name, range)) = setting.ok_or_else(|| unknown(text.to_owned()))?;
        if settings.iter().any(|&(earlier, _)| earlier == index) {
            return Err(InvalidSetting::Duplicate { controller, name });
        }
        let number = value.parse::<f64>().ok();
        let number = number
            .filter(|number| (range[0]..=range[1]).contains(number))
            .ok_or_else(|| InvalidSetting::Value {
                controller,
                name,
                range,
                found: value.to_owned(),
            })?;
        // The sum turns -0 into 0.
        settings.push((index, number + 0.0));
    }
    Ok(settings)
}

/// Parses the text between a name such as `shield` and a colon: settings, each after a comma, as [`parse_settings`]
/// does.
pub(crate) fn parse_settings_after_name(
    text: &str,
    controller: &'static str,
    names_and_ranges: &[(&'static str, [f64; 2])],
    unknown: impl Fn(String) -> InvalidSetting,
) -> Result<Vec<(usize, f64)>, InvalidSetting> {
    let mut parts = text.split(',');
    match parts.next() {
        Some(before) if !before.is_empty() => Err(unknown(before.to_owned())),
        _ => parse_settings(parts, controller, names_and_ranges, unknown),
    }
}

/// Name and allowed range of a setting of a shield, and its effect.
pub(crate) struct ShieldSetting<S> {
    pub(crate) name: &'static str,
    pub(crate) range: [f64; 2],
    /// True if only 0 and 1 are allowed.
    pub(crate) is_switch: bool,
    pub(crate) set: fn(&mut S, f64),
    pub(crate) get: fn(&S) -> Option<f64>,
}

impl<S: Default> ShieldSetting<S> {
    /// Parses the text between the name of a shield and the colon: settings, each after a comma.
    pub(crate) fn parse_all(
        table: &[Self],
        text: &str,
        shield: &'static str,
        unknown: impl Fn(String) -> InvalidSetting,
    ) -> Result<S, InvalidSetting> {
        let fields: Vec<_> = table.iter().map(|row| (row.name, row.range)).collect();
        let mut settings = S::default();
        for (index, value) in parse_settings_after_name(text, shield, &fields, unknown)? {
            let Some(row) = table.get(index) else {
                continue;
            };
            if row.is_switch && value != 0.0 && value != 1.0 {
                return Err(InvalidSetting::Switch {
                    controller: shield,
                    name: row.name,
                    found: value,
                });
            }
            (row.set)(&mut settings, value);
        }
        Ok(settings)
    }

    /// Returns the text that [`Self::parse_all`] parses to these settings.
    pub(crate) fn print_all(table: &[Self], settings: &S) -> String {
        table
            .iter()
            .filter_map(|row| (row.get)(settings).map(|value| format!(",{}={value}", row.name)))
            .collect()
    }
}

/// The numbers that parametrise a controller.
pub trait ControllerSettings: Clone + PartialEq + Default + Serialize + DeserializeOwned {
    /// Descriptions of the numbers, in the order of the files.
    const FIELDS: &'static [SettingField];

    /// Returns the value of the `index`-th of [`Self::FIELDS`].
    fn get(&self, index: usize) -> Option<f64>;

    /// Returns a reference to the value of the `index`-th of [`Self::FIELDS`].
    fn get_mut(&mut self, index: usize) -> Option<&mut f64>;
}

/// Declares settings: one `name: default, range, typical range;` per number, after its documentation. `none VALUE` may
/// follow the typical range: a value that switches the setting off.
macro_rules! settings {
    ($(#[$about:meta])* $name:ident {
        $($(#[$doc:meta])* $field:ident: $default:expr, $low:literal..=$high:literal, $from:literal..=$to:literal
          $(, none $none:expr)?;)*
    }) => {
        #[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        #[serde(default, deny_unknown_fields)]
        $(#[$about])*
        pub struct $name {
            $($(#[$doc])* #[cfg_attr(feature = "schema", schemars(range(min = $low, max = $high)))] pub $field: f64,)*
        }

        impl Default for $name {
            fn default() -> Self {
                Self { $($field: $default,)* }
            }
        }

        impl $crate::settings::ControllerSettings for $name {
            const FIELDS: &'static [$crate::settings::SettingField] = &[
                $($crate::settings::SettingField {
                    name: stringify!($field), range: [$low, $high], typical_range: [$from, $to],
                    none_value: [$(Some($none),)? None][0],
                },)*
            ];

            fn get(&self, index: usize) -> Option<f64> {
                let all: [f64; Self::FIELDS.len()] = [$(self.$field),*];
                all.get(index).copied()
            }

            fn get_mut(&mut self, index: usize) -> Option<&mut f64> {
                let all: [&mut f64; Self::FIELDS.len()] = [$(&mut self.$field),*];
                all.into_iter().nth(index)
            }
        }
    };
}
pub(crate) use settings;

settings! {
    /// Settings of a controller that has none.
    #[cfg_attr(feature = "schema", schemars(inline))]
    NoSettings {}
}
