use std::fs;

use super::*;

const OPTIONS: RunFolderOptions<'_> = RunFolderOptions {
    kind: "count",
    configuration: "runs = 3",
    configuration_file: "count.toml",
    resume: true,
    outputs: &[],
};

/// Returns a folder with three files, one of which was changed and one removed.
fn finished_folder() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    work.transaction()
        .write("a.json", "first")
        .write("deep/b.json", "b")
        .write("c.json", "c")
        .write("count.toml", "runs = 3")
        .commit()
        .unwrap();
    work.write("a.json", "second").unwrap();
    work.transaction().remove("c.json").commit().unwrap();
    work.transaction().finish().unwrap();
    folder
}

fn assert_refused(folder: &Path, reason: &str) {
    let text = RunFolder::open(folder, OPTIONS).unwrap_err().to_string();
    assert!(text.contains(reason), "{text}");
}

#[test]
fn only_written_files_are_read() {
    let folder = finished_folder();
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    assert_eq!(work.read("a.json").unwrap().unwrap(), b"second");
    assert_eq!(
        (work.read("c.json").unwrap(), work.is_complete()),
        (None, true)
    );
    assert_eq!(
        work.lock_manifest().file_names(),
        ["a.json", "count.toml", "deep/b.json"]
    );
    fs::write(work.path("c.json"), "left over").unwrap();
    let text = work.read("c.json").unwrap_err().to_string();
    assert!(
        text.contains("c.json: work.json does not list this file"),
        "{text}"
    );
    assert!(matches!(
        RunFolder::open(folder.path(), OPTIONS),
        Err(RunFolderError::InUse { .. })
    ));
}

#[test]
fn a_run_of_another_kind_or_configuration_is_refused() {
    let folder = finished_folder();
    for (asked, expected) in [
        (
            RunFolderOptions {
                resume: false,
                ..OPTIONS
            },
            "already holds a count",
        ),
        (
            RunFolderOptions {
                kind: "training",
                ..OPTIONS
            },
            "the folder holds a count, not a training",
        ),
        (
            RunFolderOptions {
                configuration: "runs = 4",
                ..OPTIONS
            },
            "the count there has a different configuration: line 1 is `runs = 3` there, and `runs = 4` now",
        ),
    ] {
        let text = RunFolder::open(folder.path(), asked)
            .unwrap_err()
            .to_string();
        assert!(text.contains(expected), "{text}");
    }
}

/// Tests changes of a bit in every byte, every shorter length, removal, and swapped files: all are detected.
#[test]
fn any_damage_names_its_file() {
    let folder = finished_folder();
    let names = [MANIFEST_FILE, "a.json", "deep/b.json"];
    let whole = names.map(|name| fs::read(folder.path().join(name)).unwrap());
    let refused = |name: &str| {
        let error = RunFolder::open(folder.path(), OPTIONS)
            .err()
            .map(|error| error.to_string());
        let examination = examine(folder.path());
        let is_seen = examination.is_err()
            || examination.is_ok_and(|examination| {
                examination
                    .files
                    .iter()
                    .any(|(file, found)| file == name && found.is_err())
            });
        assert!(is_seen, "{name} is damaged, and no examination says so");
        error.unwrap_or_else(|| panic!("{name} is damaged, and believed"))
    };
    for (name, bytes) in names.iter().zip(&whole) {
        let path = folder.path().join(name);
        let says = |text: String| assert!(text.contains(name), "{name}: {text}");
        for byte in 0..bytes.len() {
            let mut damaged = bytes.clone();
            damaged[byte] ^= 1 << (byte % 8);
            fs::write(&path, damaged).unwrap();
            says(refused(name));
        }
        for length in 0..bytes.len() {
            fs::write(&path, &bytes[..length]).unwrap();
            says(refused(name));
        }
        for other in whole.iter().filter(|other| *other != bytes) {
            fs::write(&path, other).unwrap();
            says(refused(name));
        }
        fs::remove_file(&path).unwrap();
        if *name != MANIFEST_FILE {
            says(refused(name));
        }
        fs::write(&path, bytes).unwrap();
    }
    RunFolder::open(folder.path(), OPTIONS).unwrap();
}

/// The next process completes an announced change. A mixture of two states is damage.
#[test]
fn the_next_writer_completes_an_announced_change() {
    let announced = || {
        let folder = finished_folder();
        let before =
            ["a.json", "deep/b.json"].map(|name| fs::read(folder.path().join(name)).unwrap());
        {
            let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
            let mut manifest = work.lock_manifest();
            for ((name, contents), unfinished) in [("a.json", "third"), ("new/c.json", "third")]
                .into_iter()
                .zip(manifest.unfinished_names())
            {
                fs::write(folder.path().join(&unfinished), contents).unwrap();
                manifest.add_pending_move(
                    name,
                    unfinished,
                    FileState::from_contents(contents.as_bytes()),
                );
            }
            manifest.add_pending_removal("deep/b.json");
            manifest.program = Some(work.program.to_owned());
            manifest.write(folder.path()).unwrap();
        }
        (folder, before)
    };
    let is_new = |folder: &Path| {
        let work = RunFolder::open(folder, OPTIONS).unwrap();
        assert!(!work.is_complete());
        let read = |name| String::from_utf8(work.read_required(name).unwrap()).unwrap();
        assert_eq!(
            (read("a.json"), read("new/c.json")),
            ("third".to_owned(), "third".to_owned())
        );
        assert_eq!(work.read("deep/b.json").unwrap(), None);
        work.write("a.json", "fourth").unwrap();
        drop(work);
        assert_eq!(
            RunFolder::open(folder, OPTIONS)
                .unwrap()
                .read_required("a.json")
                .unwrap(),
            b"fourth"
        );
    };
    for changes in 0..=3 {
        let (folder, _) = announced();
        let path = |name: &str| folder.path().join(name);
        if changes > 0 {
            fs::rename(path(".crumple-unfinished-0"), path("a.json")).unwrap();
        }
        if changes > 1 {
            fs::create_dir(path("new")).unwrap();
            fs::rename(path(".crumple-unfinished-1"), path("new/c.json")).unwrap();
        }
        if changes > 2 {
            fs::remove_file(path("deep/b.json")).unwrap();
        }
        let examination = examine(folder.path()).unwrap();
        assert!(
            examination.files.iter().all(|(_, state)| state.is_ok()),
            "{examination:?}"
        );
        is_new(folder.path());
    }
    // Once the change is applied, the previous contents are damage, and so are contents that were never announced.
    for (name, contents) in [
        ("a.json", "second"),
        ("a.json", "fourth"),
        ("new/c.json", ""),
    ] {
        let (folder, _) = announced();
        drop(RunFolder::open(folder.path(), OPTIONS).unwrap());
        fs::write(folder.path().join(name), contents).unwrap();
        assert_refused(
            folder.path(),
            &format!("{name}: has changed since it was written"),
        );
    }
    let (folder, _) = announced();
    fs::write(folder.path().join(".crumple-unfinished-1"), "changed").unwrap();
    assert_refused(folder.path(), "new/c.json: the file is missing");
    let (folder, before) = announced();
    fs::write(
        folder.path().join("deep/b.json"),
        [&before[1][..], b"!"].concat(),
    )
    .unwrap();
    assert_refused(
        folder.path(),
        "deep/b.json: has changed since it was written",
    );
}

/// An append-only file may be longer than its recorded prefix. Announcing it again keeps the prefix.
#[test]
fn the_recorded_prefix_of_a_growing_file_survives_a_resume() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("journal");
    let open = || RunFolder::open(folder.path(), OPTIONS);
    let work = open().unwrap();
    work.transaction()
        .write("plan.json", "plan")
        .append_only("journal")
        .commit()
        .unwrap();
    fs::write(&path, "first").unwrap();
    work.record_prefix(
        "journal",
        Prefix {
            bytes: 5,
            sha256: sha256("first"),
        },
    )
    .unwrap();
    drop(work);
    for whole in ["first", "first, second"] {
        fs::write(&path, whole).unwrap();
        open()
            .unwrap()
            .transaction()
            .write("plan.json", "plan")
            .append_only("journal")
            .commit()
            .unwrap();
    }
    for (damaged, text) in [
        ("firs", "shorter than the 5 bytes"),
        (
            "First, second",
            "its first 5 bytes have changed since they were written",
        ),
    ] {
        fs::write(&path, damaged).unwrap();
        assert_refused(folder.path(), &format!("journal: {text}"));
    }
    fs::remove_file(&path).unwrap();
    assert_refused(folder.path(), "journal: the file is missing");
}

/// An unlisted file in a folder of the run, or at the path of an output, is named, and the run cannot resume.
#[test]
fn unlisted_files_are_named_and_prevent_a_resume() {
    let folder = tempfile::tempdir().unwrap();
    let root = folder.path();
    let asked = RunFolderOptions {
        outputs: &["result.json", "parts/"],
        ..OPTIONS
    };
    let named = |unlisted: &[&str]| {
        let examination = examine(root).unwrap();
        assert!(
            examination.unlisted_files == unlisted
                && examination.is_intact() == unlisted.is_empty(),
            "{examination:?}"
        );
        match (unlisted.first(), RunFolder::open(root, asked).err()) {
            (None, error) => assert!(error.is_none(), "{error:?}"),
            (Some(name), error) => {
                let (text, path) = (error.unwrap().to_string(), root.join(name));
                assert!(
                    text.starts_with(&format!("{}: {UNLISTED_FILE_MESSAGE}", path.display())),
                    "{text}"
                );
            }
        }
    };
    RunFolder::open(root, asked)
        .unwrap()
        .write("plan.json", "plan")
        .unwrap();
    fs::create_dir(root.join("parts")).unwrap();
    fs::write(root.join("notes.txt"), "beside the work").unwrap();
    named(&[]);
    for unlisted_file in ["result.json", "parts/x.json"] {
        fs::write(root.join(unlisted_file), "of another").unwrap();
        named(&[unlisted_file]);
        fs::remove_file(root.join(unlisted_file)).unwrap();
    }
    // A completed run in a subfolder belongs to the run, and no other file may lie there.
    let inner = RunFolder::open(&root.join("inner"), OPTIONS).unwrap();
    inner.write("a", "a").unwrap();
    inner.transaction().finish().unwrap();
    drop(inner);
    let work = RunFolder::open(root, asked).unwrap();
    work.include("inner").unwrap();
    work.transaction()
        .write("result.json", "result")
        .write("parts/a", "a")
        .commit()
        .unwrap();
    work.transaction().finish().unwrap();
    drop(work);
    named(&[]);
    fs::write(root.join("inner/mine.txt"), "of another").unwrap();
    named(&["inner/mine.txt"]);
    fs::remove_file(root.join("inner/mine.txt")).unwrap();
    fs::create_dir(root.join("parts/other")).unwrap();
    named(&["parts/other"]);
    fs::remove_dir(root.join("parts/other")).unwrap();
    #[cfg(unix)]
    {
        let elsewhere = tempfile::tempdir().unwrap();
        fs::rename(root.join("parts"), elsewhere.path().join("parts")).unwrap();
        std::os::unix::fs::symlink(elsewhere.path().join("parts"), root.join("parts")).unwrap();
        named(&["parts"]);
    }
}

/// A forged manifest cannot name a file outside its folder.
#[test]
fn nothing_outside_of_the_folder_is_moved_or_removed() {
    let folder = finished_folder();
    let outside = folder.path().join("outside");
    fs::write(&outside, "mine").unwrap();
    let inner = folder.path().join("inner");
    for (name, unfinished) in [
        ("../outside", ".crumple-unfinished-0"),
        ("a.json", "../outside"),
        ("a.json", "b.json"),
    ] {
        fs::create_dir_all(&inner).unwrap();
        let mut manifest = Manifest::new(
            "count",
            program::identity().unwrap(),
            &sha256(OPTIONS.configuration),
            &[],
        );
        manifest.add_pending_move(
            name,
            unfinished.to_owned(),
            FileState::from_contents(b"mine"),
        );
        manifest.write(&inner).unwrap();
        assert_refused(
            &inner,
            "work.json: sha256: the file has changed since it was written",
        );
        assert_eq!(fs::read_to_string(&outside).unwrap(), "mine");
        fs::remove_dir_all(&inner).unwrap();
    }
}

#[test]
fn leftover_files_are_neither_overwritten_nor_included() {
    let folder = tempfile::tempdir().unwrap();
    fs::create_dir(folder.path().join("parts")).unwrap();
    for name in ["notes.txt", "a.json", "parts/7"] {
        fs::write(folder.path().join(name), "mine").unwrap();
    }
    // A process that ended while it wrote the first manifest left this file.
    let first = folder.path().join(".crumple-unfinished-a");
    fs::write(&first, "{").unwrap();
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    assert!(!first.exists());
    for (name, left_over) in [("a.json", "a.json"), ("parts/1", "parts/7")] {
        let text = work.write(name, "ours").unwrap_err().to_string();
        assert!(
            text.contains(&format!("{left_over}: {UNLISTED_FILE_MESSAGE}")),
            "{text}"
        );
    }
    work.write("b.json", "ours").unwrap();
    drop(work);
    for name in ["notes.txt", "a.json", "parts/7"] {
        assert_eq!(
            fs::read_to_string(folder.path().join(name)).unwrap(),
            "mine"
        );
    }
    fs::remove_dir_all(folder.path().join("parts")).unwrap();
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    work.write("parts/1", "ours").unwrap();
    drop(work);
    let unfinished = folder.path().join("parts/.crumple-unfinished-x");
    fs::write(&unfinished, "half").unwrap();
    drop(RunFolder::open(folder.path(), OPTIONS).unwrap());
    assert!(!unfinished.exists());
    fs::write(folder.path().join("parts/2"), "mine").unwrap();
    assert_refused(folder.path(), "parts/2: work.json does not list this file");
}

/// An incomplete run belongs to its build; any build may read a complete one.
#[test]
fn an_incomplete_run_of_another_build_is_refused() {
    let folder = finished_folder();
    let path = folder.path().join(MANIFEST_FILE);
    let mut manifest = Manifest::read(&path).unwrap().unwrap();
    assert!(
        RunFolder::open(folder.path(), OPTIONS)
            .unwrap()
            .is_complete()
    );
    manifest.program = Some("0".repeat(64));
    manifest.write(folder.path()).unwrap();
    let text = RunFolder::open(folder.path(), OPTIONS)
        .unwrap_err()
        .to_string();
    assert!(text.ends_with(OTHER_BUILD_MESSAGE), "{text}");
    assert!(!examine(folder.path()).unwrap().is_of_this_build);
}

/// Folders of earlier versions, with backups in `previous/` until the run was complete, are still supported.
#[test]
fn a_folder_with_older_copies_is_examined_and_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    work.transaction()
        .write("log", "2")
        .write("previous/log", "1")
        .commit()
        .unwrap();
    drop(work);
    fs::copy(
        folder.path().join(MANIFEST_FILE),
        folder.path().join("previous").join(MANIFEST_FILE),
    )
    .unwrap();
    let examination = examine(folder.path()).unwrap();
    assert!(
        examination.is_intact() && examination.unrelated_files.is_empty(),
        "{examination:?}"
    );
    let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
    work.write("log", "3").unwrap();
    work.transaction().finish().unwrap();
    drop(work);
    assert!(examine(folder.path()).unwrap().is_intact());
    assert!(matches!(
        read_state(folder.path()).unwrap(),
        RunState::Complete(_)
    ));
}

/// Files and manifest of an included run belong to both runs.
#[test]
fn damage_of_an_included_folder_is_damage() {
    for name in ["a.json", "deep/b.json", MANIFEST_FILE] {
        let folder = tempfile::tempdir().unwrap();
        let work = RunFolder::open(folder.path(), OPTIONS).unwrap();
        let inner = RunFolder::open(&folder.path().join("rounds/01"), OPTIONS).unwrap();
        inner
            .transaction()
            .write("a.json", "a")
            .write("deep/b.json", "b")
            .commit()
            .unwrap();
        inner.transaction().finish().unwrap();
        drop(inner);
        work.include("rounds/01").unwrap();
        work.write("rounds/found.json", "beside it").unwrap();
        drop(work);
        drop(RunFolder::open(folder.path(), OPTIONS).unwrap());
        fs::write(folder.path().join("rounds/01").join(name), "{}").unwrap();
        assert_refused(folder.path(), &format!("rounds/01/{name}: "));
        let damage = examine(folder.path())
            .unwrap()
            .files
            .into_iter()
            .find(|(_, state)| state.is_err());
        assert_eq!(damage.unwrap().0, format!("rounds/01/{name}"));
    }
}

/// Longer files, links, pipes, folders in the place of files, and additional files are named, and never read.
#[cfg(unix)]
#[test]
fn files_of_a_wrong_size_are_not_read() {
    let replaced: [fn(&Path); 4] = [
        |path| fs::File::create(path).unwrap().set_len(1 << 40).unwrap(),
        |path| std::os::unix::fs::symlink("/dev/zero", path).unwrap(),
        |path| fs::create_dir(path).unwrap(),
        |path| {
            assert!(
                std::process::Command::new("mkfifo")
                    .arg(path)
                    .status()
                    .unwrap()
                    .success()
            )
        },
    ];
    for name in [
        MANIFEST_FILE,
        "a.json",
        "deep/b.json",
        "deep/left-over.json",
    ] {
        for replace in replaced {
            let folder = finished_folder();
            let path = folder.path().join(name);
            let _ = fs::remove_file(&path);
            replace(&path);
            if name.ends_with("left-over.json") && path.is_dir() {
                continue;
            }
            assert_refused(folder.path(), name);
            match examine(folder.path()) {
                Ok(examination) => {
                    let is_damaged = examination
                        .files
                        .iter()
                        .any(|(file, state)| file == name && state.is_err());
                    assert!(is_damaged || examination.unlisted_files == [name], "{name}");
                }
                Err(error) => assert!(error.to_string().contains(name)),
            }
        }
    }
}
