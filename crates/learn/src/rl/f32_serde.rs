//! Numbers of single precision, as people write them.

use serde::de::Error;
use serde::{Deserialize, Deserializer};

/// A number of single precision, which is 0 only where 0 was written: what is nearer to it than any number of that precision would be taken
/// for 0 without a word.
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
