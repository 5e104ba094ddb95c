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

            /// Returns the size of the unit in metric units.
            pub(in crate::recording) fn factor(self) -> f64 {
                Self::ALL[self as usize].1
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

/// Returns the size of a unit of speed, length or acceleration, by its name in a file.
pub(in crate::recording) fn factor_by_name(name: &str) -> Option<f64> {
    let plain = name.trim().to_lowercase().replace('²', "2").replace('^', "");
    let mut all = [SpeedUnit::ALL, LengthUnit::ALL, AccelerationUnit::ALL].into_iter().flatten();
    all.find(|(unit, _)| *unit == plain_unit(&plain)).map(|(_, factor)| *factor)
}

/// Returns the name of a unit in maps, for another name of it in lower case.
pub(in crate::recording) fn plain_unit(name: &str) -> &str {
    match name {
        "kph" | "kmh" => "km/h",
        "mps" => "m/s",
        "fps" => "ft/s",
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
