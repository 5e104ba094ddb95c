//! Simulation of longitudinal traffic: scenarios, controllers, and engines with identical results.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | [`random`] | seeded random streams |
//! | [`observation`] | observations of controllers |
//! | `settings` | settings of controllers: numbers with a default, a range and a typical range |
//! | `idm` | the Intelligent Driver Model: a controller, a base controller and a reference |
//! | [`required_brake`] | the deceleration that avoids a braking leader |
//! | [`policy`] | actor networks, their file and their evaluation |
//! | [`control`] | controllers: one trait, one table, one file each |
//! | [`scenario`] | scenarios: vehicles, lead profiles, the file format, the paper's scenarios |
//! | [`estimate`] | sensors and the Kalman filter |
//! | [`sim`] | exact steps, collision times, three step loops with identical results, the trace |

pub mod control;
pub mod estimate;
mod idm;
pub mod observation;
pub mod policy;
pub mod random;
pub mod required_brake;
pub mod scenario;
mod settings;
pub mod sim;
