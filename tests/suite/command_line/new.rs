//! Projects of `crumple new`; `.ci/new` runs their tests.

use super::*;

#[test]
fn a_project_has_its_name_and_never_replaces_anything() {
    let folder = temp_folder();
    let source = env!("CARGO_MANIFEST_DIR");
    for (template, files) in [("rust", 11), ("python", 7), ("c", 6)] {
        let name = format!("brake-{template}");
        run_ok(folder.path(), &format!("new {name} --template {template} --crumple {source}"));
        let project = folder.path().join(&name);
        let written = all_files(&project);
        assert_eq!(written.len(), files, "{written:?}");
        for path in &written {
            let text = fs::read_to_string(path).unwrap();
            for old in ["my-controller", "my_controller", "github.com/crumple-rs/crumple\""] {
                assert!(!text.contains(old), "{}: {old}", path.display());
            }
        }
        assert_refused(&run_crumple(folder.path(), &format!("new {name} --template c")), "exists");
        assert_eq!(all_files(&project), written);
    }
    fs::write(folder.path().join("taken"), "").unwrap();
    for (arguments, reason) in [
        ("taken", "exists"),
        ("Upper", "not the name of a project"),
        ("..", "not the name of a project"),
        ("fn", "not the name of a project"),
        ("'a\nb'", "not the name of a project"),
        ("fine --crumple .", "not a folder with the source of crumple"),
    ] {
        assert_refused(&run_crumple(folder.path(), &format!("new {arguments}")), reason);
    }
    assert!(!folder.path().join("fine").exists());
    assert!(!stdout(&run_ok(folder.path(), "new --help")).contains("--allow-external"));
}

fn all_files(folder: &Path) -> BTreeSet<std::path::PathBuf> {
    let entries = fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
    entries.flat_map(|path| if path.is_dir() { all_files(&path) } else { BTreeSet::from([path]) }).collect()
}
