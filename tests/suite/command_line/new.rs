//! Projects of `crumple new`; `.ci/new` runs their tests.

use super::*;

#[test]
fn a_project_has_its_name_and_never_replaces_anything() {
    let folder = temp_folder();
    let source = env!("CARGO_MANIFEST_DIR");
    for (template, files) in [("rust", 11), ("python", 7), ("c", 6)] {
        let name = format!("brake-{template}");
        run_ok(
            folder.path(),
            &format!("new {name} --template {template} --crumple {source}"),
        );
        let project = folder.path().join(&name);
        let written = all_files(&project);
        assert_eq!(written.len(), files, "{written:?}");
        for path in &written {
            let text = fs::read_to_string(path).unwrap();
            for old in [
                "my-controller",
                "my_controller",
                "github.com/crumple-rs/crumple\"",
            ] {
                assert!(!text.contains(old), "{}: {old}", path.display());
            }
        }
        assert_refused(
            &run_crumple(folder.path(), &format!("new {name} --template c")),
            "exists",
        );
        assert_eq!(all_files(&project), written);
    }
    fs::write(folder.path().join("taken"), "").unwrap();
    for (arguments, reason) in [
        ("taken", "exists"),
        ("Upper", "not the name of a project"),
        ("..", "not the name of a project"),
        ("fn", "not the name of a project: it is a keyword of Rust"),
        ("'a\nb'", "not the name of a project"),
        (
            "fine --crumple .",
            "not a folder with the source of crumple",
        ),
    ] {
        assert_refused(
            &run_crumple(folder.path(), &format!("new {arguments}")),
            reason,
        );
    }
    assert!(!folder.path().join("fine").exists());
    assert!(!stdout(&run_ok(folder.path(), "new --help")).contains("--allow-external"));
}

const IMPORTED: &str = "a module that pip, pytest, its plugins or crumple import";

/// Names of keywords, modules and folders would break the build, each in its template only.
#[test]
fn names_that_cannot_be_built_are_refused() {
    let folder = temp_folder();
    for (name, template, reason) in [
        ("build", "rust", "a folder that Cargo needs"),
        ("incremental", "rust", "a folder that Cargo needs"),
        ("true", "rust", "a keyword of Rust"),
        ("proc-macro", "rust", "a crate of Rust's standard library"),
        ("f64", "rust", "a type of Rust"),
        ("libfuzzer-sys", "rust", "a crate of the fuzz target"),
        ("crumple-sim", "rust", "begin with crumple"),
        ("brake-", "python", "do not end with -"),
        ("logging", "python", "a module of Python's standard library"),
        (
            "sre-parse",
            "python",
            "a module of Python's standard library",
        ),
        ("lambda", "python", "a keyword of Python"),
        ("packaging", "python", IMPORTED),
        ("coverage", "python", IMPORTED),
        ("pluggy", "python", IMPORTED),
        ("stable-baselines3", "python", IMPORTED),
        ("pytest-cov", "python", "names that begin with pytest-"),
        ("makefile", "c", "a file that `make` reads"),
        ("nul", "c", "a device of Windows"),
    ] {
        let refused = run_crumple(folder.path(), &format!("new {name} --template {template}"));
        assert_refused(&refused, &format!("{name}: is not the name of a project"));
        assert!(stderr(&refused).contains(reason), "{}", stderr(&refused));
    }
    assert!(file_names_in(folder.path()).is_empty());
    for (name, template) in [
        ("logging", "rust"),
        ("coverage", "rust"),
        ("deps", "python"),
        ("build", "c"),
    ] {
        run_ok(folder.path(), &format!("new {name} --template {template}"));
    }
}

/// The project names the release that created it, and the path of `--crumple` as it is. Only tests use the harness.
#[test]
fn a_project_depends_on_one_version_and_its_controller_on_no_test_harness() {
    let folder = temp_folder();
    let read = |file: &str| fs::read_to_string(folder.path().join(file)).unwrap();
    let tag = concat!("v", env!("CARGO_PKG_VERSION"));
    run_ok(folder.path(), "new aeb");
    let manifest: toml::Table = read("aeb/Cargo.toml").parse().unwrap();
    for (section, package) in [
        ("dependencies", "crumple-sim"),
        ("dev-dependencies", "crumple-testing"),
    ] {
        let dependencies = manifest[section].as_table().unwrap();
        assert!(
            dependencies.len() == 1 && dependencies[package]["tag"].as_str() == Some(tag),
            "{dependencies:?}"
        );
    }
    let workflow = read("aeb/.github/workflows/tests.yml");
    assert_contains(
        &workflow,
        &[
            "permissions:\n  contents: read\n",
            &format!(" --tag {tag} crumple\n"),
        ],
    );
    run_ok(folder.path(), "new aeb-python --template python");
    assert_contains(
        &read("aeb-python/pyproject.toml"),
        &[&format!("crumple-rs/crumple@{tag}#subdirectory=python")],
    );

    let source = "my-controller's my_controller #1";
    fs::create_dir_all(folder.path().join(source).join("crates/testing")).unwrap();
    let path = folder.path().canonicalize().unwrap().join(source);
    run_ok(folder.path(), &format!("new acc --crumple \"{source}\""));
    let manifest: toml::Table = read("acc/Cargo.toml").parse().unwrap();
    let world = manifest["dependencies"]["crumple-sim"]["path"]
        .as_str()
        .unwrap();
    assert_eq!(Path::new(world), path.join("crates/sim"));
    run_ok(
        folder.path(),
        &format!("new acc-python --template python --crumple \"{source}\""),
    );
    let expected = "/my-controller%27s%20my_controller%20%231/python\"";
    assert_contains(
        &read("acc-python/pyproject.toml"),
        &["crumple @ file:///", expected],
    );
}

fn all_files(folder: &Path) -> BTreeSet<std::path::PathBuf> {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                all_files(&path)
            } else {
                BTreeSet::from([path])
            }
        })
        .collect()
}
