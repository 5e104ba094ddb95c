//! Opens controllers by name.
//!
//! Each module uses only modules above it:
//!
//! | module | content |
//! |---|---|
//! | `spec` | names: built-in controllers, paths, commands and shields |
//! | [`controller_file`] | controllers in files, and the controller file |
//! | `open` | from a name to a source of controllers |

pub mod controller_file;
mod open;
mod spec;

pub use open::{Controllers, UnknownController, find_and_try, find_for_user, open};
pub use spec::{ControllerSpec, InvalidControllerName, find_built_in};

pub use crumple_process::{ExternalPrograms, NameOrigin};
