//! Deserialization of single-precision numbers.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

/// Deserializes an f32 and rejects non-zero values that underflow to 0.
pub(super) fn deserialize_f32_no_underflow<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f32, D::Error> {
    let written = f64::deserialize(deserializer)?;
    let kept = written as f32;
    if kept == 0.0 && written != 0.0 {
        return Err(D::Error::custom(format!(
            "{written:e} is so small that it would count as 0: write 0, or a larger number"
        )));
    }
    Ok(kept)
}
