//! Defaults of fields, and deserialization of single-precision numbers.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

pub(super) fn default_one<T: From<u8>>() -> T {
    T::from(1)
}

/// Deserializes an f32 and rejects non-zero values that underflow to 0.
pub(super) fn deserialize_f32_no_underflow<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> Result<f32, D::Error> {
    let written = f64::deserialize(deserializer)?;
    let number = written as f32;
    if number == 0.0 && written != 0.0 {
        let problem = format!(
            "{written:e} is so small that it would count as 0: write 0, or a larger number"
        );
        return Err(D::Error::custom(problem));
    }
    Ok(number)
}
