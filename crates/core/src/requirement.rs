//! Names of requirements that gates and tests verify.

/// Maximum number of requirements of a gate or a test.
pub const MAX_REQUIREMENTS: usize = 100;

/// Maximum length of the name of a requirement, in bytes.
pub const MAX_REQUIREMENT_BYTES: usize = 200;

/// A list of names of requirements that is not allowed.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InvalidRequirement {
    /// More names than the maximum.
    #[error("must be at most {MAX_REQUIREMENTS} names, found {found}")]
    TooMany {
        /// Number of names.
        found: usize,
    },
    /// A name that is empty, too long, or has a character that JUnit properties cannot have.
    #[error(
        "a name must have 1 to {MAX_REQUIREMENT_BYTES} bytes, no comma and no control character, found {name:?}"
    )]
    Name {
        /// The name.
        name: String,
    },
}

/// Checks the names of requirements. A comma separates them in JUnit, so that no name contains one.
///
/// # Errors
/// [`InvalidRequirement`] for too many names, and for a name that is not allowed.
pub fn check_requirements(names: &[String]) -> Result<(), InvalidRequirement> {
    if names.len() > MAX_REQUIREMENTS {
        return Err(InvalidRequirement::TooMany { found: names.len() });
    }
    let is_valid = |name: &&String| {
        !name.trim().is_empty()
            && name.len() <= MAX_REQUIREMENT_BYTES
            && !name.contains(|letter: char| letter == ',' || letter.is_control())
    };
    match names.iter().find(|name| !is_valid(name)) {
        None => Ok(()),
        Some(name) => Err(InvalidRequirement::Name { name: name.clone() }),
    }
}
