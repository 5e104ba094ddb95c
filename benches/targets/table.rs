//! The table: quantity, target, measured value, ratio.

#[derive(Clone, Copy)]
pub enum TargetBound {
    AtMost,
    AtLeast,
}

pub struct Measurement {
    pub name: String,
    pub side: TargetBound,
    pub target: f64,
    pub unit: &'static str,
    pub measured: f64,
}

impl Measurement {
    pub fn at_most(
        target: f64,
        unit: &'static str,
        name: impl Into<String>,
        measured: f64,
    ) -> Self {
        Self {
            name: name.into(),
            side: TargetBound::AtMost,
            target,
            unit,
            measured,
        }
    }

    pub fn at_least(
        target: f64,
        unit: &'static str,
        name: impl Into<String>,
        measured: f64,
    ) -> Self {
        Self {
            name: name.into(),
            side: TargetBound::AtLeast,
            target,
            unit,
            measured,
        }
    }

    pub fn markdown_row(&self) -> String {
        let Self {
            name,
            side,
            target,
            unit,
            measured,
        } = self;
        let ratio = measured / target;
        let (sign, met) = match side {
            TargetBound::AtMost => ("at most", ratio <= 1.0),
            TargetBound::AtLeast => ("at least", ratio >= 1.0),
        };
        let met = if met { "met" } else { "not met" };
        format!(
            "| {name} | {sign} {target} {unit} | {} {unit} | {ratio:.2} | {met} |",
            format_three_digits(*measured)
        )
    }
}

pub const HEADER: &str = "| figure | target | measured | ratio | |\n|---|---|---|---|---|";

pub const LIMITS_HEADER: &str = "| limit of this machine | measured |\n|---|---|";

pub fn format_three_digits(value: f64) -> String {
    let before = value.abs().max(1e-9).log10().floor() as i32;
    format!("{value:.*}", (2 - before).clamp(0, 6) as usize)
}
