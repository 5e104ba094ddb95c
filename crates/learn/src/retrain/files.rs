//! Files of a retraining: each appears whole or not at all.

use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;

use super::RetrainError;
use crumple_search::disk;
use crumple_world::digest::Sha256;
use crumple_world::scenario::Scenario;

/// SHA-256 over the JSON of scenarios, one after the other.
pub(super) fn scenarios_sha256<'a>(scenarios: impl Iterator<Item = &'a Scenario>) -> Result<String, RetrainError> {
    let mut digest = Sha256::default();
    for scenario in scenarios {
        add(&mut digest, scenario)?;
    }
    Ok(digest.hexadecimal())
}

pub(super) fn add(digest: &mut Sha256, scenario: &Scenario) -> Result<(), RetrainError> {
    digest.update(serde_json::to_string(scenario.spec()).map_err(RetrainError::encoding)?);
    Ok(())
}

pub(super) fn to_json(value: &impl Serialize) -> Result<String, RetrainError> {
    Ok(serde_json::to_string_pretty(value).map_err(RetrainError::encoding)? + "\n")
}

pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), RetrainError> {
    Ok(disk::write(path, to_json(value)?)?)
}

/// The bytes of a file that must be there.
pub(super) fn read_present(path: &Path) -> Result<Vec<u8>, RetrainError> {
    disk::read(path)?.ok_or_else(|| RetrainError::Folder(format!("{}: the file is missing", path.display())))
}

/// The value in a file; none if there is no such file.
pub(super) fn read_json<T: DeserializeOwned>(path: &Path) -> Result<Option<T>, RetrainError> {
    let Some(bytes) = disk::read(path)? else { return Ok(None) };
    let damaged = |error| RetrainError::Folder(format!("{}: not what a retraining wrote: {error}", path.display()));
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}
