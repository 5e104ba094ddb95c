//! Units of variables by "Definition of Units" of FMI 2.0 (2.2.2) and FMI 3.0 (2.4.3).

use std::fmt;

/// Base units of FMI, in the order of [`UnitDimension`].
pub(crate) const BASE_UNITS: [&str; 8] = ["kg", "m", "s", "A", "K", "mol", "cd", "rad"];

/// Exponents of the SI base units kg, m, s, A, K, mol, cd, and of rad.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct UnitDimension(pub(crate) [i32; 8]);

impl UnitDimension {
    /// Dimension of a plain number.
    pub const NONE: Self = Self([0; 8]);

    /// Returns the dimension of metres and seconds to these powers: (1, -2) is an acceleration.
    #[must_use]
    pub const fn metres_seconds(metres: i32, seconds: i32) -> Self {
        Self([0, metres, seconds, 0, 0, 0, 0, 0])
    }

    /// Returns the dimension of an SI unit that is known by its name, without a definition.
    fn from_si_name(name: &str) -> Option<Self> {
        Some(match name {
            "1" => Self::NONE,
            "m" => Self::metres_seconds(1, 0),
            "s" => Self::metres_seconds(0, 1),
            "1/s" | "s-1" => Self::metres_seconds(0, -1),
            "m/s" | "m.s-1" | "m*s-1" => Self::metres_seconds(1, -1),
            "m/s2" | "m/s^2" | "m/s**2" | "m/s²" | "m.s-2" | "m*s-2" => {
                Self::metres_seconds(1, -2)
            }
            "kg" => Self([1, 0, 0, 0, 0, 0, 0, 0]),
            "K" => Self([0, 0, 0, 0, 1, 0, 0, 0]),
            "rad" => Self([0, 0, 0, 0, 0, 0, 0, 1]),
            "rad/s" => Self([0, 0, -1, 0, 0, 0, 0, 1]),
            "N" => Self([1, 1, -2, 0, 0, 0, 0, 0]),
            _ => return None,
        })
    }
}

/// Writes the unit in Modelica syntax: `m.s-2`, or `1` for a plain number.
impl fmt::Display for UnitDimension {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut separator = "";
        for (name, exponent) in BASE_UNITS
            .iter()
            .zip(self.0)
            .filter(|(_, exponent)| *exponent != 0)
        {
            write!(out, "{separator}{name}")?;
            if exponent != 1 {
                write!(out, "{exponent}")?;
            }
            separator = ".";
        }
        if separator.is_empty() {
            out.write_str("1")
        } else {
            Ok(())
        }
    }
}

/// Conversion of a unit to SI base units: SI value = factor · value + offset.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Conversion {
    /// Dimension of both values.
    pub dimension: UnitDimension,
    /// SI units in one of this unit; finite and not 0.
    pub factor: f64,
    /// SI value of 0 in this unit; finite.
    pub offset: f64,
}

impl Conversion {
    /// Converts an SI value into this unit.
    #[must_use]
    pub fn from_si(&self, value: f64) -> f64 {
        (value - self.offset) / self.factor
    }
}

/// Unit of a variable as declared.
#[derive(Debug, Clone, PartialEq)]
pub struct DeclaredUnit {
    /// Name, as written.
    pub name: String,
    /// Conversion to SI units; none if the description does not define the unit and its name is no SI unit.
    pub conversion: Option<Conversion>,
}

impl DeclaredUnit {
    pub(crate) fn undefined(name: &str) -> Self {
        Self {
            name: name.to_owned(),
            conversion: UnitDimension::from_si_name(name).map(|dimension| Conversion {
                dimension,
                factor: 1.0,
                offset: 0.0,
            }),
        }
    }
}

/// Writes the name, and the conversion of a unit that is not an SI unit.
impl fmt::Display for DeclaredUnit {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str(&self.name)?;
        match &self.conversion {
            None => out.write_str(" (not defined)"),
            Some(Conversion {
                factor: 1.0,
                offset: 0.0,
                ..
            }) => Ok(()),
            Some(Conversion {
                dimension,
                factor,
                offset,
            }) => {
                write!(out, " (SI: {factor} x")?;
                if *offset != 0.0 {
                    write!(out, " + {offset}")?;
                }
                write!(out, " {dimension})")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_are_written_with_their_conversion() {
        let unit = |name: &str, dimension, factor, offset| {
            DeclaredUnit {
                name: name.to_owned(),
                conversion: Some(Conversion {
                    dimension,
                    factor,
                    offset,
                }),
            }
            .to_string()
        };
        assert_eq!(
            unit("m/s", UnitDimension::metres_seconds(1, -1), 1.0, 0.0),
            "m/s"
        );
        assert_eq!(
            unit("ft", UnitDimension::metres_seconds(1, 0), 0.3048, 0.0),
            "ft (SI: 0.3048 x m)"
        );
        assert_eq!(
            unit("degC", UnitDimension([0, 0, 0, 0, 1, 0, 0, 0]), 1.0, 273.15),
            "degC (SI: 1 x + 273.15 K)"
        );
        assert_eq!(
            DeclaredUnit::undefined("furlong").to_string(),
            "furlong (not defined)"
        );
        assert_eq!(UnitDimension::NONE.to_string(), "1");
        assert_eq!(UnitDimension::metres_seconds(1, -2).to_string(), "m.s-2");
        let si = DeclaredUnit::undefined("m/s²").conversion.unwrap();
        assert_eq!(si.dimension, UnitDimension::metres_seconds(1, -2));
    }

    #[test]
    fn si_values_are_converted_by_factor_and_offset() {
        let fahrenheit = Conversion {
            dimension: UnitDimension::NONE,
            factor: 5.0 / 9.0,
            offset: 459.67 * 5.0 / 9.0,
        };
        assert!((fahrenheit.from_si(273.15) - 32.0).abs() < 1e-9);
        assert!(
            (Conversion {
                offset: 0.0,
                ..fahrenheit
            }
            .from_si(10.0)
                - 18.0)
                .abs()
                < 1e-9
        );
    }
}
