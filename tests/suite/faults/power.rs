//! A simulated disk that loses unsynchronised changes in a power failure.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

#[derive(Debug, Clone)]
pub(super) enum DiskOperation {
    /// A file was opened, created if missing, truncated if requested.
    Open {
        handle: u32,
        emptied: bool,
        path: String,
    },
    Reopen {
        handle: u32,
        path: String,
    },
    Close {
        handle: u32,
    },
    Write {
        handle: u32,
        offset: usize,
        bytes: Vec<u8>,
    },
    Truncate {
        handle: u32,
        length: usize,
    },
    /// The contents of a file, or the names in a folder, were synchronised.
    Sync {
        handle: u32,
    },
    Rename {
        from: String,
        to: String,
    },
    Link {
        from: String,
        to: String,
    },
    Remove {
        path: String,
    },
    Folder {
        path: String,
    },
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
    let (mut rest, mut changes) = (trace, Vec::new());
    while let Some(end) = rest.iter().position(|&byte| byte == b'\n') {
        let line = String::from_utf8(rest[..end].to_vec()).unwrap();
        rest = &rest[end + 1..];
        let (word, arguments) = line.split_once(' ').unwrap();
        let number = |text: &str| text.parse::<usize>().unwrap();
        let handle = |text: &str| text.parse::<u32>().unwrap();
        let two = |separator| {
            let (a, b): (&str, &str) = arguments.split_once(separator).unwrap();
            (a.to_owned(), b.to_owned())
        };
        changes.push(match word {
            "open" => {
                let mut parts = arguments.splitn(3, ' ');
                let mut next = || parts.next().unwrap();
                DiskOperation::Open { handle: handle(next()), emptied: next() == "1", path: next().to_owned() }
            }
            "reopen" => DiskOperation::Reopen { handle: handle(&two(' ').0), path: two(' ').1 },
            "close" => DiskOperation::Close { handle: handle(arguments) },
            "write" => {
                let parts: Vec<_> = arguments.split(' ').collect();
                let (offset, count) = (number(parts[1]), number(parts[2]));
                let bytes = rest[..count].to_vec();
                rest = &rest[count + 1..];
                DiskOperation::Write { handle: handle(parts[0]), offset, bytes }
            }
            "cut" => DiskOperation::Truncate { handle: handle(&two(' ').0), length: number(&two(' ').1) },
            "sync" => DiskOperation::Sync { handle: handle(arguments) },
            "rename" => DiskOperation::Rename { from: two('\t').0, to: two('\t').1 },
            "link" => DiskOperation::Link { from: two('\t').0, to: two('\t').1 },
            "remove" => DiskOperation::Remove { path: arguments.to_owned() },
            "folder" => DiskOperation::Folder { path: arguments.to_owned() },
            "calls" => break,
            other => panic!("{other}"),
        });
    }
    changes
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
    handles: BTreeMap<u32, String>,
    /// Files of open handles, whatever their names are now.
    open_files: BTreeMap<u32, usize>,
}

/// Remaining contents of a folder by name; `None` for folders.
pub(super) struct SurvivingFiles(BTreeMap<String, Option<Vec<u8>>>);

pub(super) fn disk_after_power_loss(changes: &[DiskOperation], loss: PowerLoss) -> SurvivingFiles {
    let mut disk = Disk::default();
    for change in changes {
        disk.apply(change);
    }
    let names = if matches!(loss, PowerLoss::Everything | PowerLoss::Names) { &disk.durable } else { &disk.now };
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
    let left = names.iter().filter(|(path, _)| **path != disk.root).map(|(path, node)| {
        let name = path.strip_prefix(&disk.root).unwrap().trim_start_matches('/').to_owned();
        match node {
            DiskNode::File(file) => (name, Some(contents(*file))),
            DiskNode::Folder => (name, None),
        }
    });
    SurvivingFiles(left.collect())
}

impl Disk {
    fn apply(&mut self, change: &DiskOperation) {
        match change {
            DiskOperation::Folder { path } => {
                if self.root.is_empty() {
                    self.root.clone_from(path);
                    self.durable.insert(path.clone(), DiskNode::Folder);
                }
                self.now.insert(path.clone(), DiskNode::Folder);
            }
            DiskOperation::Open { handle, emptied, path } => {
                let file = match self.now.get(path) {
                    Some(DiskNode::File(file)) => *file,
                    _ => {
                        self.files.push(DurableContents::default());
                        self.now.insert(path.clone(), DiskNode::File(self.files.len() - 1));
                        self.files.len() - 1
                    }
                };
                if *emptied {
                    self.files[file].now.clear();
                }
                self.handles.insert(*handle, path.clone());
                self.open_files.insert(*handle, file);
            }
            DiskOperation::Reopen { handle, path } => {
                self.handles.insert(*handle, path.clone());
                match self.now.get(path) {
                    Some(DiskNode::File(file)) => self.open_files.insert(*handle, *file),
                    _ => self.open_files.remove(handle),
                };
            }
            DiskOperation::Close { handle } => {
                self.handles.remove(handle);
                self.open_files.remove(handle);
            }
            DiskOperation::Write { handle, offset, bytes } => {
                let now = &mut self.files[self.open_files[handle]].now;
                now.resize(now.len().max(offset + bytes.len()), 0);
                now[*offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            DiskOperation::Truncate { handle, length } => self.files[self.open_files[handle]].now.resize(*length, 0),
            DiskOperation::Sync { handle } => match self.open_files.get(handle) {
                Some(&file) => self.files[file].durable = self.files[file].now.clone(),
                None => self.sync_names(&self.handles[handle].clone()),
            },
            DiskOperation::Rename { from, to } => {
                let node = self.now.remove(from).unwrap();
                self.now.insert(to.clone(), node);
            }
            DiskOperation::Link { from, to } => {
                self.now.insert(to.clone(), self.now[from]);
            }
            DiskOperation::Remove { path } => {
                self.now.remove(path);
            }
        }
    }

    /// Synchronises the names in a folder, without its subfolders.
    fn sync_names(&mut self, folder: &str) {
        let is_in = |path: &str| path.rsplit_once('/').is_some_and(|(parent, _)| parent == folder);
        self.durable.retain(|path, _| !is_in(path) || self.now.contains_key(path));
        self.durable.extend(self.now.iter().filter(|(path, _)| is_in(path)).map(|(path, node)| (path.clone(), *node)));
    }
}

impl SurvivingFiles {
    pub(super) fn write_to(&self, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for (name, contents) in &self.0 {
            let path = folder.join(name);
            match contents {
                // Contents of a lost folder are lost, too.
                Some(bytes) if path.parent().is_some_and(Path::is_dir) => fs::write(path, bytes).unwrap(),
                None if path.parent().is_some_and(Path::is_dir) => fs::create_dir(path).unwrap(),
                _ => {}
            }
        }
    }
}
