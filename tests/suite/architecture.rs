//! Modules use only those above them in the map at the top of `src/lib.rs`.

use std::fs;
use std::path::Path;

/// From the ground up.
const ORDER: [&str; 19] = [
    "digest",
    "random",
    "scenario",
    "estimate",
    "policy",
    "control",
    "sim",
    "measure",
    "recording",
    "export",
    "draw",
    "rl",
    "worst_case",
    "falsify",
    "evidence",
    "report",
    "harden",
    "trial",
    "cli",
];

#[test]
fn modules_depend_downwards_only() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut uses = 0;
    for (height, module) in ORDER.iter().enumerate() {
        for file in rust_files(&source.join(module), &source.join(format!("{module}.rs"))) {
            let text = fs::read_to_string(&file).expect("readable");
            let code: String = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
            for used in code.split("crate::").skip(1) {
                let name: String = used.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect();
                let Some(used_height) = ORDER.iter().position(|known| *known == name) else { continue };
                uses += 1;
                assert!(used_height <= height, "{}: {module} must not use {name}", file.display());
            }
        }
    }
    assert!(uses > 100, "the scan found only {uses} uses: it no longer reads the code");
}

#[test]
fn every_module_has_its_place_in_the_order() {
    let library = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("src/lib.rs")).expect("readable");
    // Private ones too.
    let declared = library.lines().filter_map(|line| {
        let item = line.strip_prefix("pub ").unwrap_or(line);
        item.strip_prefix("mod ")?.strip_suffix(';')
    });
    let mut declared: Vec<_> = declared.collect();
    let mut ordered = ORDER.to_vec();
    declared.sort_unstable();
    ordered.sort_unstable();
    assert_eq!(declared, ordered);
}

fn rust_files(folder: &Path, file: &Path) -> Vec<std::path::PathBuf> {
    let mut found = if file.exists() { vec![file.to_owned()] } else { Vec::new() };
    let mut folders = vec![folder.to_owned()];
    while let Some(folder) = folders.pop() {
        let Ok(entries) = fs::read_dir(&folder) else { continue };
        for path in entries.flatten().map(|entry| entry.path()) {
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                found.push(path);
            }
        }
    }
    found
}
