//! Conversion of files of other tools to scenarios (recorded traffic and OpenSCENARIO), and of scenarios to
//! OpenSCENARIO.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`recording`] | recorded traffic, and scenarios of its braking episodes |
//! | [`openscenario`] | import and export of ASAM OpenSCENARIO XML |

pub mod openscenario;
#[cfg_attr(
    not(any(feature = "mdf", feature = "parquet")),
    expect(dead_code, reason = "used by binary formats")
)]
pub mod recording;
