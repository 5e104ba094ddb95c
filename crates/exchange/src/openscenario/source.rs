//! Files of a scenario: itself, its road and its catalogues. Each is parsed once.

use std::cell::RefCell;
use std::collections::HashMap;
use std::fs::{self, File};
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::entities::entry_parameters;
use super::error::ScenarioImportError;
use super::parameters::Parameters;
use super::xml::{MAX_XML_BYTES, Node, SourceElement};

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum number of files in the folders of catalogues.
const MAX_CATALOG_FILES: usize = 200;

/// Parsed files by path.
#[derive(Debug)]
pub(super) struct FileCache {
    parsed: RefCell<HashMap<PathBuf, Rc<SourceElement>>>,
    /// False for fuzzing: no file is read from the disk.
    reads_disk: bool,
}

impl FileCache {
    pub(super) fn new(reads_disk: bool) -> Self {
        Self { parsed: RefCell::default(), reads_disk }
    }

    /// Returns the parsed file, which is read at the first call.
    pub(super) fn load(&self, path: &Path, root: &str) -> Result<Rc<SourceElement>> {
        if let Some(found) = self.parsed.borrow().get(path) {
            return Ok(found.clone());
        }
        if !self.reads_disk {
            return Err(ScenarioImportError::read(path, io::ErrorKind::NotFound.into()));
        }
        let element = Rc::new(SourceElement::parse(&read_bytes(path)?, path, root)?);
        self.parsed.borrow_mut().insert(path.to_owned(), element.clone());
        Ok(element)
    }

    pub(super) fn insert(&self, path: &Path, element: SourceElement) -> Rc<SourceElement> {
        let element = Rc::new(element);
        self.parsed.borrow_mut().insert(path.to_owned(), element.clone());
        element
    }
}

fn read_bytes(path: &Path) -> Result<Vec<u8>> {
    let read = || {
        if !fs::metadata(path)?.is_file() {
            return Err(io::Error::new(io::ErrorKind::InvalidData, "is not a regular file"));
        }
        let mut bytes = Vec::new();
        File::open(path)?.take(MAX_XML_BYTES + 1).read_to_end(&mut bytes)?;
        if bytes.len() as u64 > MAX_XML_BYTES {
            let problem = format!("the file exceeds {} MiB", MAX_XML_BYTES >> 20);
            return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
        }
        Ok(bytes)
    };
    read().map_err(|source| ScenarioImportError::read(path, source))
}

/// Files to which a scenario refers.
pub(super) struct SourceFiles<'a> {
    cache: &'a FileCache,
    folder: &'a Path,
    catalog_files: Vec<PathBuf>,
}

impl<'a> SourceFiles<'a> {
    /// `locations` is the element `CatalogLocations`.
    pub(super) fn new(cache: &'a FileCache, folder: &'a Path, locations: Option<Node<'_>>) -> Result<Self> {
        let mut catalog_files = Vec::new();
        for location in locations.into_iter().flat_map(|node| node.children().collect::<Vec<_>>()) {
            location.only(&["Directory"], &[])?;
            let place = folder.join(location.child("Directory")?.text("path")?);
            let is_catalog = |path: &PathBuf| path.extension().is_some_and(|extension| extension == "xosc");
            if is_catalog(&place) {
                catalog_files.push(place);
            } else if let Some(entries) = fs::read_dir(&place).ok().filter(|_| cache.reads_disk) {
                // A folder may be missing if no element refers to its catalogues.
                catalog_files.extend(entries.flatten().map(|entry| entry.path()).filter(is_catalog));
            }
            if catalog_files.len() > MAX_CATALOG_FILES {
                return Err(location.refuse(format!("the folders have more than {MAX_CATALOG_FILES} catalogues")));
            }
        }
        catalog_files.sort();
        Ok(Self { cache, folder, catalog_files })
    }

    pub(super) fn road(&self, reference: Node<'_>) -> Result<Rc<SourceElement>> {
        reference.only(&[], &["filepath"])?;
        let path = reference.text("filepath")?;
        self.load(reference, &self.folder.join(path), "OpenDRIVE")
    }

    /// Reads a file. The error for an unreadable file names the element that refers to it.
    fn load(&self, reference: Node<'_>, path: &Path, root: &str) -> Result<Rc<SourceElement>> {
        self.cache.load(path, root).map_err(|error| match error {
            ScenarioImportError::Read { .. } => reference.refuse(error.to_string()),
            other => other,
        })
    }

    /// Reads the entry of a catalogue to which an element refers.
    pub(super) fn with_catalog_entry<T>(
        &self,
        reference: Node<'_>,
        kinds: &[&str],
        read: impl FnOnce(Node<'_>) -> Result<T>,
    ) -> Result<T> {
        reference.only(&["ParameterAssignments"], &["catalogName", "entryName"])?;
        let (catalog, name) = (reference.text("catalogName")?, reference.text("entryName")?);
        let none = Parameters::default();
        for file in &self.catalog_files {
            let root = self.load(reference, file, "OpenSCENARIO")?;
            let root = Node { element: &root, parameters: &none };
            let Some(found) = root.optional("Catalog").filter(|found| found.raw("name") == Some(&catalog)) else {
                continue;
            };
            let entry = found.children().find(|entry| entry.raw("name") == Some(&name));
            let entry = entry.ok_or_else(|| reference.refuse(format!("the catalogue has no entry `{name}`")))?;
            if !kinds.contains(&entry.name()) {
                return Err(entry.refuse(format!("expected {}", kinds.join(", "))));
            }
            let parameters = entry_parameters(reference, entry)?;
            return read(Node { parameters: &parameters, ..entry });
        }
        Err(reference.refuse(format!("there is no catalogue `{catalog}` in the folders of CatalogLocations")))
    }
}
