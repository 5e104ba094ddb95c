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
        .filter_map(|one| unit_by_name(units, one.text));
    if let Some(unit) = in_brackets.next() {
        return Some(unit);
    }
    if brackets.iter().any(|one| is_other_unit(one.text)) {
        return None;
    }
    let words = words(name);
    let is_named =
        |(unit, _): &&NamedUnit| words.iter().any(|word| is_name_of(unit, plain_unit(word)));
    // Longer units contain shorter ones.
    units
        .iter()
        .filter(is_named)
        .max_by_key(|(unit, _)| unit.len())
        .copied()
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
    let in_brackets = |is_certain: bool| {
        let brackets = trailing_brackets(name);
        let mut found = brackets.into_iter().filter(|one| {
            !is_remark(one.text, is_time)
                && (one.is_square || is_other_unit(one.text)) == is_certain
        });
        let text = found.next()?.text.to_owned();
        Some(UnknownUnit { text, is_certain })
    };
    let words = words(split_brackets(name).0);
    let last = words.get(words.len().div_ceil(2).saturating_sub(1));
    let is_last = |known: &[&str]| last.is_some_and(|last| known.contains(&last.as_str()));
    let in_words = words
        .iter()
        .find(|word| OTHER_UNIT_WORDS.contains(&word.as_str()))
        .or(last.filter(|_| is_last(OTHER_LAST_WORDS) || is_time && is_last(OTHER_TIME_WORDS)));
    let of_word = |word: &String| UnknownUnit {
        text: word.clone(),
        is_certain: true,
    };
    in_brackets(true)
        .or(in_words.map(of_word))
        .or_else(|| in_brackets(false))
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
    let (mut found, mut rest) = (Vec::new(), name.trim_end());
    while let Some(inner) = rest.strip_suffix([']', ')']) {
        let opening = if rest.ends_with(']') { '[' } else { '(' };
        let Some((before, text)) = inner.rsplit_once(opening) else {
            break;
        };
        found.push(BracketText {
            text: text.trim(),
            is_square: opening == '[',
        });
        rest = before.trim_end();
    }
    (rest, found)
}

/// Returns whether a text in brackets is no unit: an index, a sign for no unit, or the scale of a time.
fn is_remark(text: &str, is_time: bool) -> bool {
    let is_scale = || {
        let plain = plain_name(text);
        TIME_SCALES.contains(&plain.as_str()) || plain.contains(':') || plain.contains("yyyy")
    };
    !text.chars().any(char::is_alphabetic) && text != "%" || is_time && is_scale()
}

/// Returns whether a text names a unit of any quantity.
fn is_other_unit(text: &str) -> bool {
    let is_of = |units: &[NamedUnit]| unit_by_name(units, text).is_some();
    OTHER_UNITS.contains(&plain_name(text).as_str())
        || is_of(TimeUnit::ALL)
        || is_of(SpeedUnit::ALL)
        || is_of(LengthUnit::ALL)
        || is_of(AccelerationUnit::ALL)
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
    let is_named = |(unit, _): &&NamedUnit| is_name_of(unit, plain_unit(&plain));
    units.iter().find(is_named).copied()
}

/// Returns whether a name is that of a unit in maps, or that without its stroke.
fn is_name_of(unit: &str, name: &str) -> bool {
    name == unit || unit.contains('/') && name == unit.replace('/', "")
}

/// Returns the name of a unit in lower case, without blanks and raised digits.
fn plain_name(name: &str) -> String {
    let letter = |letter: char| match letter {
        '²' => Some('2'),
        'µ' | 'μ' => Some('u'),
        '^' | '*' => None,
        letter if letter.is_whitespace() => None,
        letter => Some(letter),
    };
    name.to_lowercase().chars().filter_map(letter).collect()
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
