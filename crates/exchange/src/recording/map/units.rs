//! Units of the columns of recordings, and marks in their text.

use serde::{Deserialize, Serialize};

macro_rules! units {
    ($(#[$about:meta])* $name:ident { $($(#[$doc:meta])* $unit:ident = $written:literal: $factor:expr;)* }) => {
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
        #[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
        pub enum $name {
            $($(#[$doc])* #[serde(rename = $written)] $unit,)*
        }

        impl $name {
            /// Every unit as a map names it, with its size in metric units.
            pub(in crate::recording) const ALL: &[(&'static str, f64)] = &[$(($written, $factor)),*];

            /// Returns the unit of a column for which the map states this one, or none.
            pub(in crate::recording) fn of_column(stated: Option<Self>) -> ColumnUnit {
                ColumnUnit::Quantity { units: Self::ALL, stated: stated.map(|unit| Self::ALL[unit as usize]) }
            }
        }
    };
}

units! {
    /// Units of time.
    TimeUnit {
        /// Seconds.
        #[default]
        Seconds = "s": 1.0;
        /// Milliseconds.
        Milliseconds = "ms": 1e-3;
        /// Microseconds.
        Microseconds = "us": 1e-6;
        /// Nanoseconds.
        Nanoseconds = "ns": 1e-9;
    }
}

impl TimeUnit {
    /// Returns the size of the unit.
    #[cfg(feature = "mdf")]
    pub(in crate::recording) fn seconds(self) -> f64 {
        Self::ALL[self as usize].1
    }
}

units! {
    /// Units of speed.
    SpeedUnit {
        /// Metres per second.
        #[default]
        MetresPerSecond = "m/s": 1.0;
        /// Kilometres per hour.
        KilometresPerHour = "km/h": 1.0 / 3.6;
        /// Feet per second.
        FeetPerSecond = "ft/s": 0.3048;
        /// Miles per hour.
        MilesPerHour = "mph": 0.447_04;
    }
}

units! {
    /// Units of length.
    LengthUnit {
        /// Metres.
        #[default]
        Metres = "m": 1.0;
        /// Feet.
        Feet = "ft": 0.3048;
        /// Centimetres.
        Centimetres = "cm": 1e-2;
    }
}

units! {
    /// Units of acceleration.
    AccelerationUnit {
        /// Metres per second squared.
        #[default]
        MetresPerSecondSquared = "m/s2": 1.0;
        /// Feet per second squared.
        FeetPerSecondSquared = "ft/s2": 0.3048;
        /// Standard gravity.
        Gravity = "g": 9.806_65;
    }
}

/// A unit as a map names it, with its size in metric units.
pub(in crate::recording) type NamedUnit = (&'static str, f64);

/// Unit of a column by the map.
#[derive(Debug, Clone, Copy)]
pub(in crate::recording) enum ColumnUnit {
    /// Ids have no unit.
    None,
    /// Frames of this duration in seconds.
    Frames(f64),
    /// One of the units of a quantity, if the map states one.
    Quantity {
        units: &'static [NamedUnit],
        stated: Option<NamedUnit>,
    },
}

/// Units in brackets that crumple recognises, but does not convert.
const OTHER_UNITS: [&str; 12] = [
    "kn", "kt", "knots", "cm/s", "mm/s", "km", "mm", "dm", "yd", "mi", "in", "min",
];

/// Returns the unit of a quantity that the name of a column states, such as `v [km/h]` or `v_kmh`.
pub(in crate::recording) fn unit_in_name(units: &[NamedUnit], name: &str) -> Option<NamedUnit> {
    let words = words(name);
    let is_named = |(unit, _): &&NamedUnit| {
        let joined = unit.replace('/', "");
        words
            .iter()
            .any(|word| *word == joined || plain_unit(word) == *unit)
    };
    // Longer units contain shorter ones.
    units
        .iter()
        .filter(is_named)
        .max_by_key(|(unit, _)| unit.len())
        .copied()
}

/// Returns the unit in brackets at the end of a name, if crumple does not convert it.
pub(in crate::recording) fn other_unit_in_name(name: &str) -> Option<&'static str> {
    let inner = name.trim_end().strip_suffix([']', ')'])?;
    let (_, unit) = inner.rsplit_once(['[', '('])?;
    OTHER_UNITS
        .into_iter()
        .find(|other| other.eq_ignore_ascii_case(unit.trim()))
}

/// Splits a name into words in lower case, at punctuation and where capitals begin; also the words joined in pairs.
pub(in crate::recording) fn words(name: &str) -> Vec<String> {
    let mut words: Vec<String> = Vec::new();
    let mut is_open = false;
    let mut was_lower = false;
    for letter in name.chars() {
        if !letter.is_alphanumeric() {
            is_open = false;
        } else {
            if !is_open || (letter.is_uppercase() && was_lower) {
                words.push(String::new());
            }
            is_open = true;
            words
                .iter_mut()
                .last()
                .into_iter()
                .for_each(|word| word.extend(letter.to_lowercase()));
        }
        was_lower = letter.is_lowercase();
    }
    let joined: Vec<String> = words.windows(2).map(|pair| pair.concat()).collect();
    words.extend(joined);
    words
}

/// Returns the size of a unit of speed, length or acceleration, by its name in a file.
pub(in crate::recording) fn factor_by_name(name: &str) -> Option<f64> {
    let plain = name
        .trim()
        .to_lowercase()
        .replace('²', "2")
        .replace('^', "");
    let mut all = [SpeedUnit::ALL, LengthUnit::ALL, AccelerationUnit::ALL]
        .into_iter()
        .flatten();
    all.find(|(unit, _)| *unit == plain_unit(&plain))
        .map(|(_, factor)| *factor)
}

/// Returns the name of a unit in maps, for another name of it in lower case.
pub(in crate::recording) fn plain_unit(name: &str) -> &str {
    match name {
        "kph" | "kmh" => "km/h",
        "mps" => "m/s",
        "fps" => "ft/s",
        "mi/h" => "mph",
        "feet" => "ft",
        other => other,
    }
}

/// A separator of columns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Delimiter {
    /// `,`
    #[default]
    Comma,
    /// `;`
    Semicolon,
    /// Tab.
    Tab,
}

impl Delimiter {
    pub(in crate::recording) fn byte(self) -> u8 {
        match self {
            Self::Comma => b',',
            Self::Semicolon => b';',
            Self::Tab => b'\t',
        }
    }
}

/// A mark of decimals.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum DecimalMark {
    /// `.`
    #[default]
    Point,
    /// `,`
    Comma,
}

/// Sign of a speed difference.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Sign {
    /// Negative when the gap closes.
    #[default]
    LeaderMinusFollower,
    /// Positive when the gap closes.
    FollowerMinusLeader,
}

/// Reference points of a spacing.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Spacing {
    /// From the leader's rear bumper to the own front bumper.
    #[default]
    BumperToBumper,
    /// From front bumper to front bumper, which includes the length of the leader.
    FrontToFront,
}

/// A reference point of a vehicle.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum ReferencePoint {
    /// Front bumper.
    Front,
    /// Midpoint between the bumpers.
    Centre,
    /// Rear bumper.
    Rear,
    /// Bumper with the smaller position, as in highD: the front one of vehicles that drive towards smaller positions.
    LowEnd,
}
