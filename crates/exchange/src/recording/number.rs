//! Numbers and times as programs of several countries write them.

use super::map::{DecimalMark, Delimiter};

/// Longest number, in bytes.
const MAX_NUMBER_BYTES: usize = 64;
/// Most decimals of the seconds of a time stamp.
const MAX_FRACTION_DIGITS: usize = 12;
const BLANKS: [char; 5] = [' ', '\'', '\u{2019}', '\u{a0}', '\u{202f}'];

/// Parses a number without blanks around it. `None` unless each thousands separator precedes three digits.
pub(super) fn parse_number(text: &str, decimal: DecimalMark) -> Option<f64> {
    if (decimal == DecimalMark::Point || !text.contains(['.', ',']))
        && let Ok(number) = text.parse()
    {
        return Some(number);
    }
    if text.len() > MAX_NUMBER_BYTES {
        return None;
    }
    let [mark, other_mark] = match decimal {
        DecimalMark::Point => ['.', ','],
        DecimalMark::Comma => [',', '.'],
    };
    let end = text.find([mark, 'e', 'E']).unwrap_or(text.len());
    let mut plain = PlainNumber::default();
    plain.add_whole(&text[..end], other_mark)?;
    plain.add_rest(&text[end..], mark)?;
    plain.parse()
}

/// Letters of a number without thousands separators, and with a decimal point.
struct PlainNumber {
    bytes: [u8; MAX_NUMBER_BYTES],
    length: usize,
}

impl Default for PlainNumber {
    fn default() -> Self {
        Self {
            bytes: [0; MAX_NUMBER_BYTES],
            length: 0,
        }
    }
}

impl PlainNumber {
    fn push(&mut self, letter: char) {
        if let Some(byte) = self.bytes.get_mut(self.length) {
            *byte = letter as u8;
            self.length += 1;
        }
    }

    /// Adds sign and digits before the decimal mark; `None` for other letters and misplaced separators.
    fn add_whole(&mut self, whole: &str, other_mark: char) -> Option<()> {
        let mut separator = None;
        // Digits since the last separator.
        let mut digits = 0;
        for letter in whole.chars() {
            match letter {
                '+' | '-' if digits == 0 && separator.is_none() => self.push(letter),
                '0'..='9' => {
                    self.push(letter);
                    digits += 1;
                }
                _ if letter == other_mark || BLANKS.contains(&letter) => {
                    let is_placed = match separator {
                        None => {
                            (1..=3).contains(&digits)
                                && !whole.trim_start_matches(['+', '-']).starts_with('0')
                        }
                        Some(first) => digits == 3 && first == letter,
                    };
                    if !is_placed {
                        return None;
                    }
                    separator = Some(letter);
                    digits = 0;
                }
                _ => return None,
            }
        }
        (separator.is_none() || digits == 3).then_some(())
    }

    /// Adds decimals and exponent; `None` for other letters.
    fn add_rest(&mut self, rest: &str, mark: char) -> Option<()> {
        for letter in rest.chars() {
            match letter {
                _ if letter == mark => self.push('.'),
                '0'..='9' | 'e' | 'E' | '+' | '-' => self.push(letter),
                _ => return None,
            }
        }
        Some(())
    }

    fn parse(&self) -> Option<f64> {
        let bytes = self.bytes.get(..self.length)?;
        std::str::from_utf8(bytes).ok()?.parse().ok()
    }
}

/// Numbers of fields that show a decimal mark.
#[derive(Default)]
pub(super) struct NumberMarks {
    commas: usize,
    points: usize,
    /// Fields such as `1,234`, whose mark may separate decimals or thousands.
    unclear_commas: usize,
    unclear_points: usize,
}

impl NumberMarks {
    /// Counts the mark of a field, if it is a number.
    pub(super) fn add(&mut self, field: &str) {
        let Some(last) = field.rfind(['.', ',']) else {
            return;
        };
        let is_number = [DecimalMark::Comma, DecimalMark::Point]
            .map(|decimal| parse_number(field, decimal).is_some());
        let count = match is_number {
            [false, false] => return,
            [true, false] => &mut self.commas,
            [false, true] => &mut self.points,
            [true, true] if field[last..].starts_with(',') => &mut self.unclear_commas,
            [true, true] => &mut self.unclear_points,
        };
        *count += 1;
    }

    pub(super) fn decimal(&self, delimiter: Delimiter) -> DecimalMark {
        let only_unclear = self.commas == 0 && self.points == 0 && delimiter != Delimiter::Comma;
        let is_comma = if only_unclear {
            self.unclear_commas > 0 && self.unclear_points == 0
        } else {
            self.commas > self.points
        };
        if is_comma {
            DecimalMark::Comma
        } else {
            DecimalMark::Point
        }
    }
}

/// Characters between date and time.
const DATE_END: [char; 2] = ['T', ' '];

/// Parses an ISO 8601 time stamp, such as `2026-03-01T12:00:00.5+01:00`, or a time of day. Returns the seconds since
/// 1970, or since midnight; without time zone the date is taken for UTC.
pub(super) fn parse_iso_s(text: &str) -> Option<f64> {
    match text.split_once(DATE_END) {
        Some((date, time)) => parse_time_s(days_since_1970(date)?, time.trim_start()),
        None if is_time_of_day(text) => parse_time_s(0, text),
        None => None,
    }
}

/// Returns whether a text that [`parse_iso_s`] reads has no date.
pub(super) fn is_time_of_day(text: &str) -> bool {
    text.contains(':') && !text.contains(DATE_END)
}

/// Parses a time with its zone on a day. Returns the seconds since day 0.
fn parse_time_s(days: i64, time: &str) -> Option<f64> {
    let end = time.rfind(['Z', '+', '-']).unwrap_or(time.len());
    let offset_minutes = parse_offset_minutes(&time[end..])?;
    let mut parts = time[..end].trim_end().split(':');
    let hours: i64 = digits(parts.next()?, 2)?;
    let minutes = digits(parts.next()?, 2)?;
    let seconds = parts.next().unwrap_or("00");
    let (whole, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, "0"));
    let whole = digits(whole, 2)?;
    let places = fraction.len().min(MAX_FRACTION_DIGITS);
    let fraction_s = digits(fraction, places)? as f64 / 10_f64.powi(places as i32);
    let is_valid = hours <= 24 && minutes < 60 && whole <= 60 && parts.next().is_none();
    is_valid.then(|| {
        (86_400 * days + 3600 * hours + 60 * (minutes - offset_minutes) + whole) as f64 + fraction_s
    })
}

/// Parses the offset of a time zone from UTC, such as `+01:00`; 0 for any text without sign.
fn parse_offset_minutes(zone: &str) -> Option<i64> {
    let Some(offset) = zone.strip_prefix(['+', '-']) else {
        return Some(0);
    };
    let (hours, minutes) = offset.split_at_checked(2)?;
    let minutes = minutes.strip_prefix(':').unwrap_or(minutes);
    let minutes = if minutes.is_empty() {
        0
    } else {
        digits(minutes, 2)?
    };
    let size = 60 * digits(hours, 2)? + minutes;
    Some(if zone.starts_with('+') { size } else { -size })
}

fn digits(text: &str, count: usize) -> Option<i64> {
    (text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit()))
        .then(|| text.parse().ok())?
}

/// Returns the days of a date (Hinnant, "chrono-compatible low-level date algorithms").
fn days_since_1970(date: &str) -> Option<i64> {
    let mut parts = date.split('-');
    let year = digits(parts.next()?, 4)?;
    let month = digits(parts.next()?, 2)?;
    let day = digits(parts.next()?, 2)?;
    let is_leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
    let days = match month {
        2 => 28 + i64::from(is_leap),
        4 | 6 | 9 | 11 => 30,
        _ => 31,
    };
    if parts.next().is_some() || !(1..=12).contains(&month) || !(1..=days).contains(&day) {
        return None;
    }
    let year = if month <= 2 { year - 1 } else { year };
    let of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    Some(
        365 * year + year.div_euclid(4) - year.div_euclid(100) + year.div_euclid(400) + of_year
            - 719_468,
    )
}
