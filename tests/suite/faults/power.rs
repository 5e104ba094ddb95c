//! A simulated disk that loses unsynchronised changes in a power failure.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// A change of the disk: a line of the trace, and the bytes that it writes.
pub(super) struct DiskOperation {
    name: String,
    arguments: String,
    bytes: Vec<u8>,
}

/// Part of the unsynchronised changes that is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PowerLoss {
    Everything,
    /// Contents, but not names.
    Contents,
    /// Contents, but not names and lengths: zeros remain.
    Zeros,
    /// Names, but not contents.
    Names,
}

impl PowerLoss {
    pub(super) const ALL: [Self; 4] = [Self::Everything, Self::Contents, Self::Zeros, Self::Names];
}

pub(super) fn parse_operations(trace: &[u8]) -> Vec<DiskOperation> {
    let (mut rest, mut operations) = (trace, Vec::new());
    while let Some(end) = rest.iter().position(|&byte| byte == b'\n') {
        let line = std::str::from_utf8(&rest[..end]).unwrap();
        rest = &rest[end + 1..];
        let (name, arguments) = line.split_once(' ').unwrap();
        let mut bytes = Vec::new();
        match name {
            "calls" => break,
            "write" => {
                let count: usize = arguments.rsplit(' ').next().unwrap().parse().unwrap();
                bytes.extend_from_slice(&rest[..count]);
                rest = &rest[count + 1..];
            }
            _ => {}
        }
        operations.push(DiskOperation {
            name: name.to_owned(),
            arguments: arguments.to_owned(),
            bytes,
        });
    }
    operations
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum DiskNode {
    File(usize),
    Folder,
}

#[derive(Debug, Default, Clone)]
struct DurableContents {
    now: Vec<u8>,
    durable: Vec<u8>,
}

/// Names and files, current and synchronised. The root folder is permanent.
#[derive(Default)]
struct Disk {
    root: String,
    files: Vec<DurableContents>,
    now: BTreeMap<String, DiskNode>,
    durable: BTreeMap<String, DiskNode>,
    handles: BTreeMap<usize, String>,
    /// Files of open handles, whatever their names are now.
    open_files: BTreeMap<usize, usize>,
}

/// Remaining contents of a folder by name; `None` for folders.
pub(super) struct SurvivingFiles(BTreeMap<String, Option<Vec<u8>>>);

pub(super) fn disk_after_power_loss(changes: &[DiskOperation], loss: PowerLoss) -> SurvivingFiles {
    let mut disk = Disk::default();
    for change in changes {
        disk.apply(change);
    }
    let names = if matches!(loss, PowerLoss::Everything | PowerLoss::Names) {
        &disk.durable
    } else {
        &disk.now
    };
    let contents = |file: usize| {
        let DurableContents { now, durable } = &disk.files[file];
        match loss {
            PowerLoss::Everything | PowerLoss::Contents => durable.clone(),
            PowerLoss::Names => now.clone(),
            PowerLoss::Zeros => {
                let mut bytes = durable.clone();
                bytes.resize(now.len(), 0);
                bytes
            }
        }
    };
    let left = names
        .iter()
        .filter(|(path, _)| **path != disk.root)
        .map(|(path, node)| {
            let name = path
                .strip_prefix(&disk.root)
                .unwrap()
                .trim_start_matches('/')
                .to_owned();
            match node {
                DiskNode::File(file) => (name, Some(contents(*file))),
                DiskNode::Folder => (name, None),
            }
        });
    SurvivingFiles(left.collect())
}

impl Disk {
    fn apply(
        &mut self,
        DiskOperation {
            name,
            arguments,
            bytes,
        }: &DiskOperation,
    ) {
        let number = |text: &str| text.parse::<usize>().unwrap();
        let two = |separator: char| arguments.split_once(separator).unwrap();
        let owned = |(one, other): (&str, &str)| (one.to_owned(), other.to_owned());
        match name.as_str() {
            "folder" => {
                if self.root.is_empty() {
                    self.root.clone_from(arguments);
                    self.durable.insert(arguments.clone(), DiskNode::Folder);
                }
                self.now.insert(arguments.clone(), DiskNode::Folder);
            }
            // A file was opened, created if missing, truncated if requested.
            "open" => {
                let (handle, (emptied, path)) =
                    (number(two(' ').0), two(' ').1.split_once(' ').unwrap());
                let file = match self.now.get(path) {
                    Some(DiskNode::File(file)) => *file,
                    _ => {
                        self.files.push(DurableContents::default());
                        self.now
                            .insert(path.to_owned(), DiskNode::File(self.files.len() - 1));
                        self.files.len() - 1
                    }
                };
                if emptied == "1" {
                    self.files[file].now.clear();
                }
                self.handles.insert(handle, path.to_owned());
                self.open_files.insert(handle, file);
            }
            "reopen" => {
                let (handle, path) = (number(two(' ').0), two(' ').1);
                self.handles.insert(handle, path.to_owned());
                match self.now.get(path) {
                    Some(DiskNode::File(file)) => self.open_files.insert(handle, *file),
                    _ => self.open_files.remove(&handle),
                };
            }
            "close" => {
                self.handles.remove(&number(arguments));
                self.open_files.remove(&number(arguments));
            }
            "write" => {
                let (handle, offset) = (
                    number(two(' ').0),
                    number(two(' ').1.split(' ').next().unwrap()),
                );
                let now = &mut self.files[self.open_files[&handle]].now;
                now.resize(now.len().max(offset + bytes.len()), 0);
                now[offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            "cut" => self.files[self.open_files[&number(two(' ').0)]]
                .now
                .resize(number(two(' ').1), 0),
            // The contents of a file, or the names in a folder, were synchronised.
            "sync" => match self.open_files.get(&number(arguments)) {
                Some(&file) => self.files[file].durable = self.files[file].now.clone(),
                None => self.sync_names(&self.handles[&number(arguments)].clone()),
            },
            "rename" => {
                let (from, to) = owned(two('\t'));
                let node = self.now.remove(&from).unwrap();
                self.now.insert(to, node);
            }
            "link" => {
                let (from, to) = owned(two('\t'));
                self.now.insert(to, self.now[&from]);
            }
            "remove" => drop(self.now.remove(arguments)),
            other => panic!("{other}"),
        }
    }

    /// Synchronises the names in a folder, without its subfolders.
    fn sync_names(&mut self, folder: &str) {
        let is_in = |path: &str| {
            path.rsplit_once('/')
                .is_some_and(|(parent, _)| parent == folder)
        };
        self.durable
            .retain(|path, _| !is_in(path) || self.now.contains_key(path));
        self.durable.extend(
            self.now
                .iter()
                .filter(|(path, _)| is_in(path))
                .map(|(path, node)| (path.clone(), *node)),
        );
    }
}

impl SurvivingFiles {
    pub(super) fn write_to(&self, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for (name, contents) in &self.0 {
            let path = folder.join(name);
            match contents {
                // Contents of a lost folder are lost, too.
                Some(bytes) if path.parent().is_some_and(Path::is_dir) => {
                    fs::write(path, bytes).unwrap()
                }
                None if path.parent().is_some_and(Path::is_dir) => fs::create_dir(path).unwrap(),
                _ => {}
            }
        }
    }
}
