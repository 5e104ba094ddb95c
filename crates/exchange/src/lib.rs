//! Conversion of files of other tools to scenarios (recorded traffic and OpenSCENARIO), and of scenarios to
//! OpenSCENARIO.

mod number_text;
pub mod openscenario;
#[cfg_attr(
    not(any(feature = "mdf", feature = "parquet")),
    expect(dead_code, reason = "used by binary formats")
)]
pub mod recording;
