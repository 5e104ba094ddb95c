//! Co-simulation FMUs (Functional Mock-up Units, FMI 2.0 and 3.0) as controllers.
//!
//! | module | content |
//! |---|---|
//! | `archive` | zip archive: description, library for this platform, unpacking |
//! | `listing` | description as text, one line per variable |
//! | `description` | `modelDescription.xml`: name and variables of the FMU |
//! | `declarations`, `unit` | units and types of variables, and the conversion to SI units |
//! | `xml` | elements and attributes that `description` needs, read in linear time |
//! | `report` | description as text and as JSON |
//! | `host` (feature `host`) | program that loads the library and answers crumple's requests |
//!
//! Only `host` runs code of an FMU and contains `unsafe` code. Only the program `crumple-fmu` calls it, because an FMU
//! is foreign native code that can crash its process.

mod archive;
mod declarations;
mod description;
#[cfg(feature = "host")]
pub mod host;
mod listing;
mod report;
mod unit;
mod xml;

pub use archive::{Fmu, FmuError};
pub use description::{
    Causality, FmiVersion, InvalidDescription, ModelDescription, Variable, VariableType,
};
pub use report::{FmuReport, FmuVariableReport};
pub use unit::{Conversion, DeclaredUnit, UnitDimension};
