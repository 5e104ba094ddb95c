//! Numbers and times as programs of several countries write them.

use super::map::{DecimalMark, Delimiter};

/// Longest number, in bytes.
const MAX_NUMBER_BYTES: usize = 64;
/// Most decimals of the seconds of a time stamp.
const MAX_FRACTION_DIGITS: usize = 12;
const BLANKS: [char; 5] = [' ', '\'', '\u{2019}', '\u{a0}', '\u{202f}'];

/// Parses a number without blanks around it. `None` unless each thousands separator precedes three digits.
pub(super) fn parse_number(text: &str, decimal: DecimalMark) -> Option<f64> {
    let (mark, other) = match decimal {
        DecimalMark::Point => ('.', ','),
        DecimalMark::Comma => (',', '.'),
    };
    if (decimal == DecimalMark::Point || !text.contains(['.', ',']))
        && let Ok(number) = text.parse()
    {
        return Some(number);
    }
    if text.len() > MAX_NUMBER_BYTES {
        return None;
    }
    let mut plain = [0; MAX_NUMBER_BYTES];
    let mut length = 0;
    let mut push = |letter: char| {
        if let Some(byte) = plain.get_mut(length) {
            *byte = letter as u8;
            length += 1;
        }
    };
    let end = text.find([mark, 'e', 'E']).unwrap_or(text.len());
    let (whole, rest) = text.split_at(end);
    // Digits since the last separator.
    let (mut separator, mut digits) = (None, 0);
    for letter in whole.chars() {
        match letter {
            '+' | '-' if digits == 0 && separator.is_none() => push(letter),
            '0'..='9' => {
                push(letter);
                digits += 1;
            }
            _ if letter == other || BLANKS.contains(&letter) => {
                let is_placed = match separator {
                    None => {
                        (1..=3).contains(&digits)
                            && !whole.trim_start_matches(['+', '-']).starts_with('0')
                    }
                    Some(_) => digits == 3,
                };
                if !is_placed || separator.is_some_and(|known| known != letter) {
                    return None;
                }
                (separator, digits) = (Some(letter), 0);
            }
            _ => return None,
        }
    }
    if separator.is_some() && digits != 3 {
        return None;
    }
    for letter in rest.chars() {
        match letter {
            _ if letter == mark => push('.'),
            '0'..='9' | 'e' | 'E' | '+' | '-' => push(letter),
            _ => return None,
        }
    }
    std::str::from_utf8(plain.get(..length)?).ok()?.parse().ok()
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
        let is_number = |decimal| parse_number(field, decimal).is_some();
        let count = match (is_number(DecimalMark::Comma), is_number(DecimalMark::Point)) {
            (false, false) => return,
            (true, false) => &mut self.commas,
            (false, true) => &mut self.points,
            (true, true) if field[last..].starts_with(',') => &mut self.unclear_commas,
            (true, true) => &mut self.unclear_points,
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

/// Parses an ISO 8601 time stamp, such as `2026-03-01T12:00:00.5+01:00`, or a time of day. Returns the seconds since
/// 1970, or since midnight; without time zone the date is taken for UTC.
pub(super) fn parse_iso_s(text: &str) -> Option<f64> {
    let (days, time) = match text.split_once(['T', ' ']) {
        Some((date, time)) => (days_since_1970(date)?, time.trim_start()),
        None if text.contains(':') => (0, text),
        None => return None,
    };
    let zone = time.rfind(['Z', '+', '-']).unwrap_or(time.len());
    let (clock, zone) = time.split_at(zone);
    let mut parts = clock.trim_end().split(':');
    let hours: i64 = digits(parts.next()?, 2)?;
    let minutes = digits(parts.next()?, 2)?;
    let (whole, fraction) = match parts.next() {
        None => (0, 0.0),
        Some(seconds) => {
            let (whole, fraction) = seconds.split_once(['.', ',']).unwrap_or((seconds, "0"));
            let places = fraction.len().min(MAX_FRACTION_DIGITS);
            (
                digits(whole, 2)?,
                digits(fraction, places)? as f64 / 10_f64.powi(places as i32),
            )
        }
    };
    let offset_minutes = match zone.strip_prefix(['+', '-']) {
        Some(offset) => {
            let (hours, minutes) = offset.split_at_checked(2)?;
            let minutes = minutes.strip_prefix(':').unwrap_or(minutes);
            let size = 60 * digits(hours, 2)?
                + if minutes.is_empty() {
                    0
                } else {
                    digits(minutes, 2)?
                };
            if zone.starts_with('+') { size } else { -size }
        }
        None => 0,
    };
    let is_valid = hours <= 24 && minutes < 60 && whole <= 60 && parts.next().is_none();
    is_valid.then(|| {
        (86_400 * days + 3600 * hours + 60 * (minutes - offset_minutes) + whole) as f64 + fraction
    })
}

fn digits(text: &str, count: usize) -> Option<i64> {
    (text.len() == count && text.bytes().all(|byte| byte.is_ascii_digit()))
        .then(|| text.parse().ok())?
}

/// Returns the days of a date (Hinnant, "chrono-compatible low-level date algorithms").
fn days_since_1970(date: &str) -> Option<i64> {
    let mut parts = date.split('-');
    let (year, month, day) = (
        digits(parts.next()?, 4)?,
        digits(parts.next()?, 2)?,
        digits(parts.next()?, 2)?,
    );
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
