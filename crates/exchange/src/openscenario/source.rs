//! Files of a scenario: itself, its road and its catalogues. Each is parsed once.

use std::cell::RefCell;
use std::collections::HashMap;
use std::fs;
use std::io::{self, Read as _};
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::entities::entry_parameters;
use super::error::ScenarioImportError;
use super::limits::ensure_at_most;
use super::parameters::Parameters;
use super::xml::{MAX_XML_BYTES, MAX_XML_ITEMS, Node, SourceElement, count_items};
use crumple_core::regular_file;

type Result<T> = std::result::Result<T, ScenarioImportError>;

/// Maximum number of files in the folders of catalogues, of such folders, and of all files there.
const MAX_CATALOG_FILES: usize = 200;
const MAX_CATALOG_FOLDERS: usize = 50;
const MAX_FOLDER_ENTRIES: usize = 10_000;
/// Maximum number of elements and attributes of an entry of a catalogue, and of bytes of its attributes.
const MAX_ENTRY_ITEMS: usize = 1000;
const MAX_ENTRY_BYTES: usize = 100_000;

/// Parsed files by path.
#[derive(Debug)]
pub(super) struct FileCache {
    parsed: RefCell<HashMap<PathBuf, ParsedFile>>,
    /// False for fuzzing: no file is read from the disk.
    reads_disk: bool,
}

#[derive(Debug, Clone)]
struct ParsedFile {
    root: Rc<SourceElement>,
    bytes: u64,
    items: usize,
    /// The catalogue of the file, if it was used.
    catalog: Option<Rc<CatalogIndex>>,
}

/// Entries of a catalogue by name.
#[derive(Debug)]
struct CatalogIndex {
    name: Option<String>,
    /// Index of the catalogue among the children of the root.
    place: usize,
    /// Index of the first entry of each name among the children of the catalogue.
    entries: HashMap<String, usize>,
}

impl CatalogIndex {
    fn new(root: Node<'_>) -> Self {
        let (place, catalog) = root
            .children()
            .enumerate()
            .find(|(_, child)| child.name() == "Catalog")
            .unzip();
        let mut entries = HashMap::new();
        for (index, entry) in catalog.into_iter().flat_map(Node::children).enumerate() {
            if let Some(name) = entry.raw("name") {
                entries.entry(name.to_owned()).or_insert(index);
            }
        }
        let name = catalog
            .and_then(|catalog| catalog.raw("name"))
            .map(str::to_owned);
        Self {
            name,
            place: place.unwrap_or_default(),
            entries,
        }
    }
}

impl FileCache {
    pub(super) fn new(reads_disk: bool) -> Self {
        Self {
            parsed: RefCell::default(),
            reads_disk,
        }
    }

    /// Returns the number of tags and attributes of all files.
    pub(super) fn items(&self) -> usize {
        self.parsed.borrow().values().map(|file| file.items).sum()
    }

    /// Returns the parsed file, which is read at the first call.
    pub(super) fn load(&self, path: &Path, root: &str) -> Result<Rc<SourceElement>> {
        if let Some(found) = self.parsed.borrow().get(path) {
            return Ok(found.root.clone());
        }
        if !self.reads_disk {
            return Err(ScenarioImportError::read(
                path,
                io::ErrorKind::NotFound.into(),
            ));
        }
        let used: u64 = self.parsed.borrow().values().map(|file| file.bytes).sum();
        let bytes = read_bytes(path, MAX_XML_BYTES.saturating_sub(used));
        self.parse(
            &bytes.map_err(|source| ScenarioImportError::read(path, source))?,
            path,
            root,
        )
    }

    /// Parses a file, whose size counts together with that of the other files.
    pub(super) fn parse(&self, bytes: &[u8], path: &Path, root: &str) -> Result<Rc<SourceElement>> {
        let left = MAX_XML_ITEMS.saturating_sub(self.items());
        let root = Rc::new(SourceElement::parse(bytes, path, root, left)?);
        let file = ParsedFile {
            root: root.clone(),
            bytes: bytes.len() as u64,
            items: count_items(bytes),
            catalog: None,
        };
        self.parsed.borrow_mut().insert(path.to_owned(), file);
        Ok(root)
    }

    /// Returns the entries of a file that was loaded.
    fn catalog(&self, path: &Path, root: Node<'_>) -> Rc<CatalogIndex> {
        let mut parsed = self.parsed.borrow_mut();
        match parsed.get_mut(path) {
            Some(file) => file
                .catalog
                .get_or_insert_with(|| Rc::new(CatalogIndex::new(root)))
                .clone(),
            None => Rc::new(CatalogIndex::new(root)),
        }
    }
}

fn read_bytes(path: &Path, most: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    regular_file::open(path)?
        .take(most + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > most {
        let problem = format!(
            "the scenario with its road and its catalogues exceeds {} MiB",
            MAX_XML_BYTES >> 20
        );
        return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
    }
    Ok(bytes)
}

/// Files to which a scenario refers.
pub(super) struct SourceFiles<'a> {
    cache: &'a FileCache,
    folder: &'a Path,
    catalog_files: Vec<PathBuf>,
}

impl<'a> SourceFiles<'a> {
    /// `locations` is the element `CatalogLocations`.
    pub(super) fn new(
        cache: &'a FileCache,
        folder: &'a Path,
        locations: Option<Node<'_>>,
    ) -> Result<Self> {
        let (mut catalog_files, mut entries_left) = (Vec::new(), MAX_FOLDER_ENTRIES);
        if let Some(locations) = locations {
            ensure_at_most(
                locations,
                locations.children().count(),
                MAX_CATALOG_FOLDERS,
                "folders of catalogues",
            )?;
        }
        for location in locations.into_iter().flat_map(Node::children) {
            location.only(&["Directory"], &[])?;
            let place = folder.join(location.child("Directory")?.text("path")?);
            let is_catalog = |path: &PathBuf| {
                path.extension()
                    .is_some_and(|extension| extension == "xosc")
            };
            if is_catalog(&place) {
                catalog_files.push(place);
            } else if let Some(entries) = fs::read_dir(&place).ok().filter(|_| cache.reads_disk) {
                // A folder may be missing if no element refers to its catalogues.
                let entries: Vec<_> = entries.take(entries_left + 1).collect();
                entries_left = entries_left.checked_sub(entries.len()).ok_or_else(|| {
                    location.refuse(format!(
                        "the folders of catalogues have more than {MAX_FOLDER_ENTRIES} files"
                    ))
                })?;
                catalog_files.extend(
                    entries
                        .into_iter()
                        .flatten()
                        .map(|entry| entry.path())
                        .filter(is_catalog),
                );
            }
            if catalog_files.len() > MAX_CATALOG_FILES {
                return Err(location.refuse(format!(
                    "the folders have more than {MAX_CATALOG_FILES} catalogues"
                )));
            }
        }
        catalog_files.sort();
        Ok(Self {
            cache,
            folder,
            catalog_files,
        })
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
        for path in &self.catalog_files {
            let root = self.load(reference, path, "OpenSCENARIO")?;
            let root = Node {
                element: &root,
                parameters: &none,
            };
            let index = self.cache.catalog(path, root);
            let found = root
                .element
                .children()
                .get(index.place)
                .filter(|_| index.name.as_ref() == Some(&catalog));
            let Some(found) = found else { continue };
            let entry = index
                .entries
                .get(&name)
                .and_then(|index| found.children().get(*index));
            let entry = entry
                .ok_or_else(|| reference.refuse(format!("the catalogue has no entry `{name}`")))?;
            let entry = Node {
                element: entry,
                ..root
            };
            let (items, bytes) = entry.element.size();
            ensure_at_most(entry, items, MAX_ENTRY_ITEMS, "elements and attributes")?;
            ensure_at_most(entry, bytes, MAX_ENTRY_BYTES, "bytes of attributes")?;
            if !kinds.contains(&entry.name()) {
                return Err(entry.refuse(format!("expected {}", kinds.join(", "))));
            }
            let parameters = entry_parameters(reference, entry)?;
            return read(Node {
                parameters: &parameters,
                ..entry
            });
        }
        Err(reference.refuse(format!(
            "there is no catalogue `{catalog}` in the folders of CatalogLocations"
        )))
    }
}
