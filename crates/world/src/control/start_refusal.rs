//! Refusal of programs that only a file names.

/// Refusal to start a program, or to load an FMU, that only a file names.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "{location}: a file names a program or an FMU, and crumple does not run it without permission: add \
    --allow-external if you trust the file"
)]
pub struct StartRefusal {
    /// Place that names the program: file, line and field, or the name itself.
    pub location: String,
}
