//! Settings of controllers: numbers with a default, the range they must be in, and the range they usually are in.

use serde::Serialize;
use serde::de::DeserializeOwned;

/// One number of a controller's settings.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SettingField {
    /// Its name, with its unit.
    pub name: &'static str,
    /// The least and the largest value there may be.
    pub range: [f64; 2],
    /// The values that make sense on a road, for searches and fuzzers.
    pub typical_range: [f64; 2],
}

impl SettingField {
    /// Its unit, as its name ends.
    #[must_use]
    pub fn unit(&self) -> &'static str {
        const ENDINGS: [(&str, &str); 6] =
            [("_per_s2", "1/s²"), ("_per_s", "1/s"), ("_mps2", "m/s²"), ("_mps", "m/s"), ("_m", "m"), ("_s", "s")];
        ENDINGS.iter().find(|(ending, _)| self.name.ends_with(ending)).map_or("1", |(_, unit)| unit)
    }
}

/// The numbers that decide how a controller drives.
pub trait ControllerSettings: Clone + PartialEq + Default + Serialize + DeserializeOwned {
    /// Its numbers, in the order in which files state them.
    const FIELDS: &'static [SettingField];

    /// The value of the `index`-th of [`Self::FIELDS`].
    fn get(&self, index: usize) -> Option<f64>;

    /// The place of the value of the `index`-th of [`Self::FIELDS`].
    fn get_mut(&mut self, index: usize) -> Option<&mut f64>;
}

/// Declares settings: `name: default, range, usual range;` a number, its documentation before it.
macro_rules! settings {
    ($(#[$about:meta])* $name:ident {
        $($(#[$doc:meta])* $field:ident: $default:expr, $low:literal..=$high:literal, $from:literal..=$to:literal;)*
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
                $($crate::settings::SettingField { name: stringify!($field), range: [$low, $high], typical_range: [$from, $to] },)*
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
