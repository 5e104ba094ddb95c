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
            pub(in crate::recording) fn column_unit(stated: Option<Self>) -> ColumnUnit {
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
    /// Returns the name of the unit in maps.
    pub(in crate::recording) fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }

    /// Returns the size of the unit.
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

/// Units that crumple recognises in brackets, but does not convert.
#[rustfmt::skip]
const OTHER_UNITS: &[&str] = &[
    "kn", "kt", "kts", "knot", "knots", "cm/s", "mm/s", "km/s", "km/min", "m/min", "m/h", "ft/min", "in/s", "yd/s",
    "km", "kilometer", "kilometers", "kilometre", "kilometres", "mm", "millimeter", "millimeters", "millimetre",
    "millimetres", "dm", "yd", "yds", "yard", "yards", "mi", "mile", "miles", "nmi", "in", "inch", "inches", "furlong",
    "furlongs", "min", "mins", "minute", "minutes", "h", "hr", "hrs", "hour", "hours", "day", "days", "cm/s2", "mm/s2",
    "km/h/s", "mg", "gal", "deg", "rad", "%", "px", "pixel", "pixels",
];
/// Those of them that mean nothing else as a word of a name.
#[rustfmt::skip]
const OTHER_UNIT_WORDS: &[&str] = &[
    "km", "kilometer", "kilometers", "kilometre", "kilometres", "mm", "millimeter", "millimeters", "millimetre",
    "millimetres", "yd", "yds", "yards", "miles", "nmi", "inch", "inches", "furlong", "furlongs", "kts", "knots",
];
/// Those that are units as the last word of a name, and as the last word of the name of a time.
const OTHER_LAST_WORDS: &[&str] = &["dm", "mi", "kn", "kt"];
const OTHER_TIME_WORDS: &[&str] = &["min", "mins", "minutes", "h", "hr", "hrs", "hours"];
/// Texts in brackets behind the name of a time that are no units.
const TIME_SCALES: &[&str] = &[
    "utc", "gmt", "tai", "gps", "unix", "epoch", "posix", "local", "iso", "iso8601", "cet", "cest",
];

/// Returns the unit of a quantity that the name of a column states, such as `v [km/h]` or `v_kmh`.
pub(in crate::recording) fn unit_in_name(units: &[NamedUnit], name: &str) -> Option<NamedUnit> {
    let brackets = trailing_brackets(name);
    let mut in_brackets = brackets
        .iter()
        .filter_map(|bracket| unit_by_name(units, bracket.text));
    if let Some(unit) = in_brackets.next() {
        return Some(unit);
    }
    if brackets.iter().any(|bracket| is_other_unit(bracket.text)) {
        return None;
    }
    let words = words(name);
    let named_units = units
        .iter()
        .filter(|(unit, _)| words.iter().any(|word| is_name_of(unit, plain_unit(word))));
    // Longer units contain shorter ones.
    named_units.max_by_key(|(unit, _)| unit.len()).copied()
}

/// A text in a name that stands for a unit, but for none that crumple converts.
pub(in crate::recording) struct UnknownUnit {
    pub(in crate::recording) text: String,
    /// False for a text in round brackets that may be a remark.
    pub(in crate::recording) is_certain: bool,
}

/// Returns the unit that a name states, if it is none of those of its quantity.
pub(in crate::recording) fn unknown_unit_in_name(
    units: &[NamedUnit],
    name: &str,
) -> Option<UnknownUnit> {
    if unit_in_name(units, name).is_some() {
        return None;
    }
    let is_time = units == TimeUnit::ALL;
    unknown_unit_in_brackets(name, is_time, true)
        .or_else(|| unknown_unit_in_words(name, is_time))
        .or_else(|| unknown_unit_in_brackets(name, is_time, false))
}

/// Returns an unknown unit in the brackets at the end of a name, if it is as certain as demanded.
fn unknown_unit_in_brackets(name: &str, is_time: bool, is_certain: bool) -> Option<UnknownUnit> {
    let mut brackets = trailing_brackets(name).into_iter();
    let bracket = brackets.find(|bracket| {
        !is_remark(bracket.text, is_time)
            && (bracket.is_square || is_other_unit(bracket.text)) == is_certain
    })?;
    Some(UnknownUnit {
        text: bracket.text.to_owned(),
        is_certain,
    })
}

/// Returns an unknown unit that is a word of a name.
fn unknown_unit_in_words(name: &str, is_time: bool) -> Option<UnknownUnit> {
    let words = words(split_brackets(name).0);
    let last = words.get(words.len().div_ceil(2).saturating_sub(1));
    let word = words
        .iter()
        .find(|word| OTHER_UNIT_WORDS.contains(&word.as_str()))
        .or(last.filter(|last| {
            OTHER_LAST_WORDS.contains(&last.as_str())
                || is_time && OTHER_TIME_WORDS.contains(&last.as_str())
        }))?;
    Some(UnknownUnit {
        text: word.clone(),
        is_certain: true,
    })
}

/// A text in brackets.
struct BracketText<'n> {
    text: &'n str,
    is_square: bool,
}

/// Returns the texts in brackets at the end of a name, the last one first.
fn trailing_brackets(name: &str) -> Vec<BracketText<'_>> {
    split_brackets(name).1
}

/// Returns a name without the texts in brackets at its end, and these.
fn split_brackets(name: &str) -> (&str, Vec<BracketText<'_>>) {
    let mut brackets = Vec::new();
    let mut rest = name.trim_end();
    while let Some(inner) = rest.strip_suffix([']', ')']) {
        let opening = if rest.ends_with(']') { '[' } else { '(' };
        let Some((before, text)) = inner.rsplit_once(opening) else {
            break;
        };
        brackets.push(BracketText {
            text: text.trim(),
            is_square: opening == '[',
        });
        rest = before.trim_end();
    }
    (rest, brackets)
}

/// Returns whether a text in brackets is no unit: an index, a sign for no unit, or the scale of a time.
fn is_remark(text: &str, is_time: bool) -> bool {
    !text.chars().any(char::is_alphabetic) && text != "%" || is_time && is_time_scale(text)
}

/// Returns whether a text in brackets behind the name of a time is a scale or a format.
fn is_time_scale(text: &str) -> bool {
    let plain = plain_name(text);
    TIME_SCALES.contains(&plain.as_str()) || plain.contains(':') || plain.contains("yyyy")
}

/// Returns whether a text names a unit of any quantity.
fn is_other_unit(text: &str) -> bool {
    let quantities = [
        TimeUnit::ALL,
        SpeedUnit::ALL,
        LengthUnit::ALL,
        AccelerationUnit::ALL,
    ];
    OTHER_UNITS.contains(&plain_name(text).as_str())
        || quantities
            .into_iter()
            .any(|units| unit_by_name(units, text).is_some())
}

/// Returns the names of units, for an error.
pub(in crate::recording) fn list_units(units: &[NamedUnit]) -> String {
    let names: Vec<_> = units.iter().map(|(unit, _)| *unit).collect();
    names.join(", ")
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

/// Returns the unit of a quantity by any name of it.
pub(in crate::recording) fn unit_by_name(units: &[NamedUnit], name: &str) -> Option<NamedUnit> {
    let plain = plain_name(name);
    units
        .iter()
        .find(|(unit, _)| is_name_of(unit, plain_unit(&plain)))
        .copied()
}

/// Returns whether a name is that of a unit in maps, or that without its stroke.
fn is_name_of(unit: &str, name: &str) -> bool {
    name == unit || unit.contains('/') && name == unit.replace('/', "")
}

/// Returns the name of a unit in lower case, without blanks and raised digits.
fn plain_name(name: &str) -> String {
    let lower = name.to_lowercase();
    let letters = lower.chars().filter_map(|letter| match letter {
        '²' => Some('2'),
        'µ' | 'μ' => Some('u'),
        '^' | '*' => None,
        letter if letter.is_whitespace() => None,
        letter => Some(letter),
    });
    letters.collect()
}

/// Returns the name of a unit in maps, for another name of it in lower case.
fn plain_unit(name: &str) -> &str {
    match name {
        "kph" | "kmph" | "km/hr" | "kmhr" | "km/hour" => "km/h",
        "mps" | "m/sec" | "m/second" | "meters/second" | "metres/second" | "ms-1" => "m/s",
        "fps" | "ft/sec" | "ftsec" | "feet/s" | "feet/sec" | "feet/second" => "ft/s",
        "mi/h" | "mi/hr" | "miles/h" | "miles/hr" | "miles/hour" => "mph",
        "meter" | "meters" | "metre" | "metres" => "m",
        "feet" | "foot" => "ft",
        "centimeter" | "centimeters" | "centimetre" | "centimetres" => "cm",
        "sec" | "secs" | "second" | "seconds" => "s",
        "msec" | "msecs" | "millisecond" | "milliseconds" => "ms",
        "usec" | "microsecond" | "microseconds" => "us",
        "nsec" | "nanosecond" | "nanoseconds" => "ns",
        "m/s/s" | "m/sec2" | "mps2" | "ms-2" => "m/s2",
        "ft/sec2" | "fps2" => "ft/s2",
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
