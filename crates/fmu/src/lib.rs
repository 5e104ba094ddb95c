//! Co-simulation FMUs (Functional Mock-up Units, FMI 2.0 and 3.0) as controllers.
//!
//! | module | what it holds |
//! |---|---|
//! | `archive` | the zip archive: its description, its library for this platform, and unpacking it |
//! | `listing` | the description as text, a line for each variable |
//! | `description` | `modelDescription.xml`: what the FMU is called, and its variables |
//! | `declarations`, `unit` | units and types of variables, and the conversion to SI units |
//! | `xml` | the elements and attributes that `description` needs, read in linear time |
//! | `host` (feature `host`) | the program: loads the library and answers crumple's questions by it |
//!
//! All but the host run nothing of an FMU's. All of crumple's `unsafe` code is in `host`, which nothing but the program
//! `crumple-fmu` calls: an FMU is native code of somebody else's, and what it breaks is that process.

mod archive;
mod declarations;
mod description;
#[cfg(feature = "host")]
pub mod host;
mod listing;
mod unit;
mod xml;

pub use archive::{Fmu, FmuError};
pub use description::{Causality, FmiVersion, InvalidDescription, ModelDescription, Variable, VariableType};
pub use unit::{Conversion, DeclaredUnit, UnitDimension};
