//! A disk that forgets: what was changed since it was last made to reach the disk is lost with the power.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

/// One change, as the shim wrote it down.
#[derive(Debug, Clone)]
pub(super) enum Change {
    /// A file was opened, made if it was not there, emptied if so asked.
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
    Cut {
        handle: u32,
        length: usize,
    },
    /// A file's contents, or a folder's names, reached the disk.
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

/// What of the changes that had not reached the disk is lost.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Loss {
    /// Everything.
    Everything,
    /// Contents, but not names.
    Contents,
    /// Contents, but not names and lengths: there are zeros.
    Zeros,
    /// Names, but not contents.
    Names,
}

impl Loss {
    pub(super) const ALL: [Self; 4] = [Self::Everything, Self::Contents, Self::Zeros, Self::Names];
}

/// The changes in a trace, in order.
pub(super) fn changes(trace: &[u8]) -> Vec<Change> {
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
                Change::Open { handle: handle(next()), emptied: next() == "1", path: next().to_owned() }
            }
            "reopen" => Change::Reopen { handle: handle(&two(' ').0), path: two(' ').1 },
            "close" => Change::Close { handle: handle(arguments) },
            "write" => {
                let parts: Vec<_> = arguments.split(' ').collect();
                let (offset, count) = (number(parts[1]), number(parts[2]));
                let bytes = rest[..count].to_vec();
                rest = &rest[count + 1..];
                Change::Write { handle: handle(parts[0]), offset, bytes }
            }
            "cut" => Change::Cut { handle: handle(&two(' ').0), length: number(&two(' ').1) },
            "sync" => Change::Sync { handle: handle(arguments) },
            "rename" => Change::Rename { from: two('\t').0, to: two('\t').1 },
            "link" => Change::Link { from: two('\t').0, to: two('\t').1 },
            "remove" => Change::Remove { path: arguments.to_owned() },
            "folder" => Change::Folder { path: arguments.to_owned() },
            "calls" => break,
            other => panic!("{other}"),
        });
    }
    changes
}

/// A name's file, or folder.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Node {
    File(usize),
    Folder,
}

#[derive(Debug, Default, Clone)]
struct Contents {
    now: Vec<u8>,
    durable: Vec<u8>,
}

/// Names and files, as they are and as the disk has them. The first folder is there for good.
#[derive(Default)]
struct Disk {
    root: String,
    files: Vec<Contents>,
    now: BTreeMap<String, Node>,
    durable: BTreeMap<String, Node>,
    handles: BTreeMap<u32, String>,
    /// Files that handles are of, whatever their names are now.
    opened: BTreeMap<u32, usize>,
}

/// What is left of a folder, by names in it; none for folders.
pub(super) struct Left(BTreeMap<String, Option<Vec<u8>>>);

/// The disk when the power comes back.
pub(super) fn disk_after(changes: &[Change], loss: Loss) -> Left {
    let mut disk = Disk::default();
    for change in changes {
        disk.make(change);
    }
    let names = if matches!(loss, Loss::Everything | Loss::Names) { &disk.durable } else { &disk.now };
    let contents = |file: usize| {
        let Contents { now, durable } = &disk.files[file];
        match loss {
            Loss::Everything | Loss::Contents => durable.clone(),
            Loss::Names => now.clone(),
            Loss::Zeros => {
                let mut bytes = durable.clone();
                bytes.resize(now.len(), 0);
                bytes
            }
        }
    };
    let left = names.iter().filter(|(path, _)| **path != disk.root).map(|(path, node)| {
        let name = path.strip_prefix(&disk.root).unwrap().trim_start_matches('/').to_owned();
        match node {
            Node::File(file) => (name, Some(contents(*file))),
            Node::Folder => (name, None),
        }
    });
    Left(left.collect())
}

impl Disk {
    fn make(&mut self, change: &Change) {
        match change {
            Change::Folder { path } => {
                if self.root.is_empty() {
                    self.root.clone_from(path);
                    self.durable.insert(path.clone(), Node::Folder);
                }
                self.now.insert(path.clone(), Node::Folder);
            }
            Change::Open { handle, emptied, path } => {
                let file = match self.now.get(path) {
                    Some(Node::File(file)) => *file,
                    _ => {
                        self.files.push(Contents::default());
                        self.now.insert(path.clone(), Node::File(self.files.len() - 1));
                        self.files.len() - 1
                    }
                };
                if *emptied {
                    self.files[file].now.clear();
                }
                self.handles.insert(*handle, path.clone());
                self.opened.insert(*handle, file);
            }
            Change::Reopen { handle, path } => {
                self.handles.insert(*handle, path.clone());
                match self.now.get(path) {
                    Some(Node::File(file)) => self.opened.insert(*handle, *file),
                    _ => self.opened.remove(handle),
                };
            }
            Change::Close { handle } => {
                self.handles.remove(handle);
                self.opened.remove(handle);
            }
            Change::Write { handle, offset, bytes } => {
                let now = &mut self.files[self.opened[handle]].now;
                now.resize(now.len().max(offset + bytes.len()), 0);
                now[*offset..offset + bytes.len()].copy_from_slice(bytes);
            }
            Change::Cut { handle, length } => self.files[self.opened[handle]].now.resize(*length, 0),
            Change::Sync { handle } => match self.opened.get(handle) {
                Some(&file) => self.files[file].durable = self.files[file].now.clone(),
                None => self.sync_names(&self.handles[handle].clone()),
            },
            Change::Rename { from, to } => {
                let node = self.now.remove(from).unwrap();
                self.now.insert(to.clone(), node);
            }
            Change::Link { from, to } => {
                self.now.insert(to.clone(), self.now[from]);
            }
            Change::Remove { path } => {
                self.now.remove(path);
            }
        }
    }

    /// The names in a folder, not those in the folders in it.
    fn sync_names(&mut self, folder: &str) {
        let is_in = |path: &str| path.rsplit_once('/').is_some_and(|(parent, _)| parent == folder);
        self.durable.retain(|path, _| !is_in(path) || self.now.contains_key(path));
        self.durable.extend(self.now.iter().filter(|(path, _)| is_in(path)).map(|(path, node)| (path.clone(), *node)));
    }
}

impl Left {
    pub(super) fn write_to(&self, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for (name, contents) in &self.0 {
            let path = folder.join(name);
            match contents {
                // What lies in a folder whose name is lost is lost with it.
                Some(bytes) if path.parent().is_some_and(Path::is_dir) => fs::write(path, bytes).unwrap(),
                None if path.parent().is_some_and(Path::is_dir) => fs::create_dir(path).unwrap(),
                _ => {}
            }
        }
    }
}
