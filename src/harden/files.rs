//! Files of a hardening: each appears whole or not at all.

use std::fs;
use std::io;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use sha2::{Digest, Sha256};

use super::HardenError;
use crate::digest::hexadecimal;
use crate::falsify::campaign::write_whole;
use crate::scenario::Scenario;

/// SHA-256 over the JSON of scenarios, one after the other.
pub(super) fn scenarios_sha256<'a>(scenarios: impl Iterator<Item = &'a Scenario>) -> Result<String, HardenError> {
    let mut digest = Sha256::new();
    for scenario in scenarios {
        add(&mut digest, scenario)?;
    }
    Ok(hexadecimal(&digest.finalize()))
}

pub(super) fn add(digest: &mut Sha256, scenario: &Scenario) -> Result<(), HardenError> {
    digest.update(serde_json::to_string(scenario.spec()).map_err(HardenError::encoding)?);
    Ok(())
}

pub(super) fn to_json(value: &impl Serialize) -> Result<String, HardenError> {
    Ok(serde_json::to_string_pretty(value).map_err(HardenError::encoding)? + "\n")
}

pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), HardenError> {
    Ok(write_whole(path, to_json(value)?)?)
}

/// The value in a file; none if there is no such file.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, HardenError> {
    let Some(bytes) = read(path)? else { return Ok(None) };
    let damaged = |error| HardenError::Folder(format!("{}: not what a hardening wrote: {error}", path.display()));
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

/// The bytes of a file; none if there is no such file.
pub(super) fn read(path: &Path) -> Result<Option<Vec<u8>>, HardenError> {
    match fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(source) => Err(HardenError::environment(path, source)),
    }
}

pub(super) fn remove(path: &Path) -> Result<(), HardenError> {
    match fs::remove_file(path) {
        Err(error) if error.kind() != io::ErrorKind::NotFound => Err(HardenError::environment(path, error)),
        _ => Ok(()),
    }
}

pub(super) fn make_folder(path: &Path) -> Result<(), HardenError> {
    fs::create_dir_all(path).map_err(|source| HardenError::environment(path, source))
}
