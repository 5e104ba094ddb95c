//! Serialisation of numbers that may be infinite, such as a logarithm of zero, as the texts `inf` and `-inf`.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged)]
enum NumberOrText {
    Number(f64),
    Text(Infinity),
}

#[derive(Serialize, Deserialize)]
enum Infinity {
    #[serde(rename = "inf")]
    Positive,
    #[serde(rename = "-inf")]
    Negative,
}

impl From<f64> for NumberOrText {
    fn from(value: f64) -> Self {
        match value {
            f64::INFINITY => Self::Text(Infinity::Positive),
            f64::NEG_INFINITY => Self::Text(Infinity::Negative),
            _ => Self::Number(value),
        }
    }
}

impl From<NumberOrText> for f64 {
    fn from(value: NumberOrText) -> Self {
        match value {
            NumberOrText::Number(value) => value,
            NumberOrText::Text(Infinity::Positive) => f64::INFINITY,
            NumberOrText::Text(Infinity::Negative) => f64::NEG_INFINITY,
        }
    }
}

/// Writes a number.
///
/// # Errors
/// Any error of the serialiser.
pub fn serialize<S: Serializer>(value: &f64, serializer: S) -> Result<S::Ok, S::Error> {
    NumberOrText::from(*value).serialize(serializer)
}

/// Reads a number.
///
/// # Errors
/// Any error of the deserialiser, and for any content but a number or one of the two texts.
pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    NumberOrText::deserialize(deserializer).map(f64::from)
}

/// Serialisation of numbers that may be infinite or missing.
pub mod optional {
    use super::{Deserialize, Deserializer, NumberOrText, Serialize, Serializer};

    /// Writes a number, if there is one.
    ///
    /// # Errors
    /// Any error of the serialiser.
    pub fn serialize<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
        value.map(NumberOrText::from).serialize(serializer)
    }

    /// Reads a number, if there is one.
    ///
    /// # Errors
    /// Any error of the deserialiser, and for any content but a number or one of the two texts.
    pub fn deserialize<'de, D: Deserializer<'de>>(
        deserializer: D,
    ) -> Result<Option<f64>, D::Error> {
        Ok(Option::<NumberOrText>::deserialize(deserializer)?.map(f64::from))
    }
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct RequiredAndOptional {
        #[serde(with = "super")]
        required: f64,
        #[serde(with = "super::optional")]
        optional: Option<f64>,
    }

    #[test]
    fn infinite_numbers_survive_writing_and_reading() {
        for (required, optional) in [
            (f64::NEG_INFINITY, None),
            (f64::INFINITY, Some(f64::NEG_INFINITY)),
            (-1.5, Some(0.1)),
        ] {
            let numbers = RequiredAndOptional { required, optional };
            let text = serde_json::to_string(&numbers).unwrap();
            assert_eq!(
                serde_json::from_str::<RequiredAndOptional>(&text).unwrap(),
                numbers,
                "{text}"
            );
        }
    }
}
