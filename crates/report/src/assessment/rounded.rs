//! Numbers that are rounded in the type, so that reports and snapshots do not change with the last bit.

use std::fmt;

use serde::{Deserialize, Serialize, Serializer};

/// A number shown and stored with `D` decimals.
#[derive(Debug, Clone, Copy, Default, PartialEq, PartialOrd, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Rounded<const D: usize>(f64);

impl<const D: usize> Rounded<D> {
    /// Rounds a number.
    #[must_use]
    pub fn new(value: f64) -> Self {
        let scale = 10_f64.powi(D as i32);
        let rounded = (value * scale).round() / scale;
        // Keep numbers whose scaling overflows, and turn -0 into 0.
        Self(if rounded.is_finite() {
            rounded + 0.0
        } else {
            value
        })
    }

    /// Rounds up: for upper bounds, which must stay true.
    #[must_use]
    pub fn up(value: f64) -> Self {
        let nearest = Self::new(value);
        if nearest.0 >= value {
            nearest
        } else {
            Self::new(value + 0.5 * 10_f64.powi(-(D as i32)))
        }
    }

    /// Rounds down: for lower bounds.
    #[must_use]
    pub(crate) fn down(value: f64) -> Self {
        let nearest = Self::new(value);
        if nearest.0 <= value {
            nearest
        } else {
            Self::new(value - 0.5 * 10_f64.powi(-(D as i32)))
        }
    }

    /// Returns the rounded number.
    #[must_use]
    pub fn value(self) -> f64 {
        self.0
    }
}

impl<const D: usize> From<f64> for Rounded<D> {
    fn from(value: f64) -> Self {
        Self::new(value)
    }
}

impl<const D: usize> fmt::Display for Rounded<D> {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.pad(&format!("{:.D$}", self.0))
    }
}

impl<const D: usize> Serialize for Rounded<D> {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.0.serialize(serializer)
    }
}

/// Formats a number, or a dash for `None`.
pub(super) fn or_dash<const D: usize>(value: Option<Rounded<D>>) -> String {
    value.map_or_else(|| "–".to_owned(), |value| value.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stored_and_shown_numbers_are_equal() {
        let number = Rounded::<2>::new(-0.0012);
        assert_eq!(
            (
                number.to_string().as_str(),
                serde_json::to_string(&number).unwrap().as_str()
            ),
            ("0.00", "0.0")
        );
        assert_eq!(Rounded::<2>::new(1.005_000_1).value(), 1.01);
        assert_eq!(Rounded::<2>::new(1e300).value(), 1e300);
        assert_eq!(
            (
                Rounded::<2>::up(0.0037).value(),
                Rounded::<2>::down(0.0099).value()
            ),
            (0.01, 0.0)
        );
        assert_eq!(
            (
                Rounded::<2>::up(1.25).value(),
                Rounded::<2>::down(1.25).value()
            ),
            (1.25, 1.25)
        );
    }
}
