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
    position: usize,
    /// Index of the first entry of each name among the children of the catalogue.
    entries: HashMap<String, usize>,
}

impl CatalogIndex {
    fn new(root: Node<'_>) -> Self {
        let position = root.children().position(|child| child.name() == "Catalog");
        let catalog = root.optional("Catalog");
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
            position: position.unwrap_or_default(),
            entries,
        }
    }

    fn entry<'r>(&self, root: Node<'r>, name: &str) -> Option<Node<'r>> {
        let catalog = root.element.children().get(self.position)?;
        let element = catalog.children().get(*self.entries.get(name)?)?;
        Some(Node { element, ..root })
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
        if let Some(file) = self.parsed.borrow().get(path) {
            return Ok(file.root.clone());
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

fn read_bytes(path: &Path, max_bytes: u64) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    regular_file::open(path)?
        .take(max_bytes + 1)
        .read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        let problem = format!(
            "the scenario with its road and its catalogues exceeds {} MiB",
            MAX_XML_BYTES >> 20
        );
        return Err(io::Error::new(io::ErrorKind::InvalidData, problem));
    }
    Ok(bytes)
}

/// Files of catalogues in the folders of a scenario.
struct CatalogFiles {
    paths: Vec<PathBuf>,
    /// Number of files that further folders may have.
    entries_left: usize,
    reads_disk: bool,
}

impl CatalogFiles {
    /// Adds a catalogue, or those of a folder. The folder may be missing if no element refers to its catalogues.
    fn add(&mut self, location: Node<'_>, path: PathBuf) -> Result<()> {
        if is_catalog(&path) {
            self.paths.push(path);
        } else if let Some(entries) = fs::read_dir(&path).ok().filter(|_| self.reads_disk) {
            let entries: Vec<_> = entries.take(self.entries_left + 1).collect();
            self.entries_left = self
                .entries_left
                .checked_sub(entries.len())
                .ok_or_else(|| {
                    location.refuse(format!(
                        "the folders of catalogues have more than {MAX_FOLDER_ENTRIES} files"
                    ))
                })?;
            let paths = entries.into_iter().flatten().map(|entry| entry.path());
            self.paths.extend(paths.filter(|path| is_catalog(path)));
        }
        if self.paths.len() > MAX_CATALOG_FILES {
            return Err(location.refuse(format!(
                "the folders have more than {MAX_CATALOG_FILES} catalogues"
            )));
        }
        Ok(())
    }
}

fn is_catalog(path: &Path) -> bool {
    path.extension()
        .is_some_and(|extension| extension == "xosc")
}

/// Refuses an entry of a catalogue that is too large, or of another kind than an element may refer to.
fn check_entry(entry: Node<'_>, kinds: &[&str]) -> Result<()> {
    let size = entry.element.size();
    ensure_at_most(
        entry,
        size.items,
        MAX_ENTRY_ITEMS,
        "elements and attributes",
    )?;
    ensure_at_most(entry, size.bytes, MAX_ENTRY_BYTES, "bytes of attributes")?;
    if kinds.contains(&entry.name()) {
        Ok(())
    } else {
        Err(entry.refuse(format!("expected {}", kinds.join(", "))))
    }
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
        let mut catalogs = CatalogFiles {
            paths: Vec::new(),
            entries_left: MAX_FOLDER_ENTRIES,
            reads_disk: cache.reads_disk,
        };
        if let Some(locations) = locations {
            let count = locations.children().count();
            let what = "folders of catalogues";
            ensure_at_most(locations, count, MAX_CATALOG_FOLDERS, what)?;
        }
        for location in locations.into_iter().flat_map(Node::children) {
            location.only(&["Directory"], &[])?;
            let path = folder.join(location.child("Directory")?.text("path")?);
            catalogs.add(location, path)?;
        }
        catalogs.paths.sort();
        Ok(Self {
            cache,
            folder,
            catalog_files: catalogs.paths,
        })
    }

    /// Reads the road file; `None` if there is none.
    pub(super) fn road(&self, reference: Node<'_>) -> Result<Option<Rc<SourceElement>>> {
        reference.only(&[], &["filepath"])?;
        let path = self.folder.join(reference.text("filepath")?);
        match self.cache.load(&path, "OpenDRIVE") {
            Err(ScenarioImportError::Read { source, .. })
                if source.kind() == io::ErrorKind::NotFound =>
            {
                Ok(None)
            }
            Err(error @ ScenarioImportError::Read { .. }) => {
                Err(reference.refuse(error.to_string()))
            }
            result => result.map(Some),
        }
    }

    /// Returns a road file with a text that takes the place of a missing file.
    pub(super) fn replacement_road(&self, text: &str) -> Result<Rc<SourceElement>> {
        self.cache
            .parse(text.as_bytes(), Path::new("replacement.xodr"), "OpenDRIVE")
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
        read(self.catalog_entry(reference, kinds)?.node(reference)?)
    }

    /// Returns the entry of a catalogue to which an element refers.
    pub(super) fn catalog_entry(
        &self,
        reference: Node<'_>,
        kinds: &[&str],
    ) -> Result<CatalogEntry> {
        reference.only(&["ParameterAssignments"], &["catalogName", "entryName"])?;
        let catalog = reference.text("catalogName")?;
        let name = reference.text("entryName")?;
        let none = Parameters::default();
        let mut is_known = false;
        for path in &self.catalog_files {
            let root = self.load(reference, path, "OpenSCENARIO")?;
            let node = Node {
                element: &root,
                parameters: &none,
            };
            let index = self.cache.catalog(path, node);
            if index.name.as_ref() != Some(&catalog) {
                continue;
            }
            // Several files may be parts of one catalogue.
            is_known = true;
            let Some(entry) = index.entry(node, &name) else {
                continue;
            };
            check_entry(entry, kinds)?;
            let parameters = entry_parameters(reference, entry)?;
            return Ok(CatalogEntry {
                root: root.clone(),
                index,
                name,
                parameters,
            });
        }
        Err(reference.refuse(if is_known {
            format!("the catalogue has no entry `{name}`")
        } else {
            format!("there is no catalogue `{catalog}` in the folders of CatalogLocations")
        }))
    }
}

/// An entry of a catalogue, with the values of its parameters.
#[derive(Debug)]
pub(super) struct CatalogEntry {
    root: Rc<SourceElement>,
    index: Rc<CatalogIndex>,
    name: String,
    parameters: Parameters,
}

impl CatalogEntry {
    /// Returns the entry to which `reference` refers.
    pub(super) fn node<'r>(&'r self, reference: Node<'_>) -> Result<Node<'r>> {
        let root = Node {
            element: &self.root,
            parameters: &self.parameters,
        };
        let entry = self.index.entry(root, &self.name);
        entry.ok_or_else(|| reference.refuse(format!("the catalogue has no entry `{}`", self.name)))
    }
}
