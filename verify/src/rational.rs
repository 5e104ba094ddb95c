//! Exact numbers in files: `"15/2"`, `"6"`, `"7.5"` or `"1e-6"`.

use num_rational::BigRational;
use serde::{Deserialize, Deserializer, Serializer, de};

/// Longest number that is read, in characters.
const MOST_CHARACTERS: usize = 100;

/// The number that a text states; none if it states none.
#[must_use]
pub fn parse(text: &str) -> Option<BigRational> {
    if text.len() > MOST_CHARACTERS || text.contains('+') {
        return None;
    }
    if text.contains('/') {
        return text.parse().ok();
    }
    let (decimal, exponent) = text.split_once('e').map_or(Some((text, 0)), |(decimal, exponent)| {
        Some((decimal, exponent.parse::<i32>().ok().filter(|exponent| exponent.abs() <= 300)?))
    })?;
    let (whole, fraction) = decimal.split_once('.').unwrap_or((decimal, ""));
    let digits: BigRational = format!("{whole}{fraction}").parse().ok()?;
    let ten = BigRational::from_integer(10.into());
    Some(digits * ten.pow(exponent - i32::try_from(fraction.len()).ok()?))
}

pub(crate) fn serialize<S: Serializer>(value: &BigRational, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.collect_str(value)
}

pub(crate) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<BigRational, D::Error> {
    let text = String::deserialize(deserializer)?;
    parse(&text).ok_or_else(|| de::Error::custom(format!("`{text}` is not a number such as \"15/2\" or \"7.5\"")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reads_what_it_says_and_nothing_else() {
        for (text, quotient) in
            [("7.5", "15/2"), ("-0.25", "-1/4"), ("15/2", "15/2"), ("1e-6", "1/1000000"), ("2.5e1", "25")]
        {
            assert_eq!(parse(text).unwrap().to_string(), quotient);
        }
        for text in ["", "x", "1/0", "1.2.3", "1e999999999", "0x10", "1/2/3", "+1", "1e+2", "."] {
            assert!(parse(text).is_none(), "{text}");
        }
    }
}
