//! The order of packages, modules and files: what may use what.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::documentation::files_below;

/// Largest allowed number of files that import each other in a circle.
const MAX_CIRCLE_FILES: usize = 15;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Returns the folders of packages in the code map of the architecture page, in its order, and the packages that each
/// may use.
fn listed_packages() -> Vec<(String, BTreeSet<String>)> {
    let page = fs::read_to_string(root().join("docs/architecture.md")).unwrap();
    let (_, table) = page.split_once("| folder | content | uses |").unwrap();
    let rows = table.lines().skip(2).take_while(|row| row.starts_with('|'));
    let cells = rows.map(|row| {
        row.trim_matches([' ', '|'])
            .split(" | ")
            .collect::<Vec<_>>()
    });
    let row = |cells: Vec<&str>| {
        let [folder, _, uses] = cells[..] else {
            panic!("a row has three cells: {cells:?}")
        };
        let uses = uses.split(", ").filter(|name| *name != "–");
        let folder = folder.trim_matches(['`', '/']).to_owned();
        (folder, uses.map(str::to_owned).collect())
    };
    cells.map(row).collect()
}

/// Returns the folder of each package of the workspace, and the packages of the workspace that its program code uses.
fn packages_of_cargo() -> BTreeMap<String, BTreeSet<String>> {
    let output = Command::new(std::env::var_os("CARGO").unwrap_or("cargo".into()))
        .args(["metadata", "--no-deps", "--format-version", "1"])
        .current_dir(root())
        .output()
        .expect("cargo runs");
    let metadata: serde_json::Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let packages = metadata["packages"].as_array().unwrap();
    let names: BTreeSet<_> = packages
        .iter()
        .map(|package| package["name"].as_str())
        .collect();
    let row = |package: &serde_json::Value| {
        let manifest = Path::new(package["manifest_path"].as_str().unwrap());
        let folder = manifest.parent().unwrap().strip_prefix(root()).unwrap();
        let folder = match folder.to_str().unwrap() {
            "" => "src".to_owned(),
            other => other.to_owned(),
        };
        let dependencies = package["dependencies"].as_array().unwrap().iter();
        let used = dependencies
            .filter(|used| used["kind"].is_null() && names.contains(&used["name"].as_str()));
        let used = used.map(|used| {
            used["name"]
                .as_str()
                .unwrap()
                .trim_start_matches("crumple-")
                .to_owned()
        });
        (folder, used.collect())
    };
    packages.iter().map(row).collect()
}

#[test]
fn packages_use_only_those_that_the_architecture_page_lists() {
    let listed = listed_packages();
    let mut packages = packages_of_cargo();
    // A workspace of its own.
    packages.extend(
        listed
            .iter()
            .filter(|(folder, _)| folder == "fuzz")
            .cloned(),
    );
    assert_eq!(listed.iter().cloned().collect::<BTreeMap<_, _>>(), packages);
    let mut above = BTreeSet::new();
    for (folder, uses) in listed {
        let missing: Vec<_> = uses.difference(&above).collect();
        assert!(
            missing.is_empty(),
            "{folder} uses {missing:?}, which are listed below it"
        );
        let name = folder.rsplit('/').next().unwrap();
        above.insert(if name == "src" { "crumple" } else { name }.to_owned());
    }
}

/// Returns the modules that the table in the documentation of a `lib.rs` lists, in their order.
fn listed_modules(documented: &str) -> Vec<&str> {
    let rows = documented
        .lines()
        .filter_map(|line| line.strip_prefix("//! | "));
    let names = rows
        .filter_map(|row| row.split(" | ").next())
        .map(|name| name.trim_matches(['[', ']', '`']));
    names
        .filter(|name| {
            *name != "module" && name.chars().all(|c| c.is_ascii_lowercase() || c == '_')
        })
        .collect()
}

/// Returns the modules of the crate that the code of a file names, without its tests.
fn used_modules(source: &str) -> Vec<&str> {
    let code = source.split("#[cfg(test)]\nmod tests {").next().unwrap();
    let lines = code
        .lines()
        .filter(|line| !line.trim_start().starts_with("//"));
    let after = lines.flat_map(|line| line.split("crate::").skip(1));
    after
        .map(|rest| {
            rest.split(|c: char| !c.is_alphanumeric() && c != '_')
                .next()
                .unwrap()
        })
        .collect()
}

#[test]
fn modules_use_only_those_listed_above_them() {
    let (mut packages, mut compared) = (0, 0);
    for package in fs::read_dir(root().join("crates")).unwrap() {
        let source = package.unwrap().path().join("src");
        let documented = fs::read_to_string(source.join("lib.rs")).unwrap();
        if !documented.contains("//! Each module uses only modules above it:") {
            continue;
        }
        packages += 1;
        let modules = listed_modules(&documented);
        for (position, module) in modules.iter().enumerate() {
            let files = [source.join(format!("{module}.rs"))]
                .into_iter()
                .chain(files_below(source.join(module)));
            let is_code =
                |file: &PathBuf| file.is_file() && file.extension().is_some_and(|end| end == "rs");
            let is_test = |file: &PathBuf| {
                file.strip_prefix(&source)
                    .unwrap()
                    .to_str()
                    .unwrap()
                    .contains("test")
            };
            for file in files.filter(|file| is_code(file) && !is_test(file)) {
                let code = fs::read_to_string(&file).unwrap();
                let later = used_modules(&code)
                    .into_iter()
                    .find(|used| modules[position + 1..].contains(used));
                assert_eq!(
                    later,
                    None,
                    "{}: {module} is listed above it",
                    file.display()
                );
                compared += 1;
            }
        }
    }
    assert!(
        packages >= 8 && compared > 200,
        "{packages} packages, {compared} files"
    );
}

/// Splits the tree of a `use` into paths, each a list of names: `a::{b, c as d}` into `a::b` and `a::c`.
fn split_use_tree(tree: &str) -> Vec<Vec<String>> {
    let tree = tree.trim();
    if let Some(inner) = tree
        .strip_prefix('{')
        .and_then(|rest| rest.strip_suffix('}'))
    {
        let mut depth = 0;
        let parts = inner.split(|letter| {
            depth += i32::from(letter == '{') - i32::from(letter == '}');
            letter == ',' && depth == 0
        });
        return parts.flat_map(split_use_tree).collect();
    }
    match tree.split_once("::") {
        Some((first, rest)) => split_use_tree(rest)
            .into_iter()
            .map(|path| [vec![first.trim().to_owned()], path].concat())
            .collect(),
        None if tree.is_empty() => Vec::new(),
        None => {
            let name = tree.split(" as ").next().unwrap_or(tree);
            vec![if matches!(name, "self" | "*") {
                Vec::new()
            } else {
                vec![name.to_owned()]
            }]
        }
    }
}

/// A name `core` would replace Rust's own after `use crumple::*`.
#[test]
fn the_facade_has_few_names_and_none_of_rust() {
    let facade = fs::read_to_string(root().join("src/lib.rs")).unwrap();
    let trees = facade.split("pub use ").skip(1);
    let names: Vec<_> = trees
        .map(|rest| rest.split(';').next().unwrap())
        .flat_map(|tree| match tree.split_once(" as ") {
            Some((_, name)) => vec![name.to_owned()],
            None => {
                let paths = split_use_tree(tree).into_iter();
                paths.filter_map(|path| path.last().cloned()).collect()
            }
        })
        .collect();
    assert!((20..=35).contains(&names.len()), "{names:?}");
    for name in ["core", "std", "alloc"] {
        assert!(!names.contains(&name.to_owned()), "{name}");
    }
}

type ModulePath = Vec<String>;

/// The modules of a crate: each in a file, with the code of that file without comments and tests.
struct CrateModules {
    code: BTreeMap<ModulePath, String>,
    /// Paths to which `pub use` of a module gives a name.
    exported: BTreeMap<(ModulePath, String), ModulePath>,
}

impl CrateModules {
    fn read(source: &Path) -> Self {
        let mut code = BTreeMap::new();
        for file in files_below(source.to_owned()) {
            let path = file.strip_prefix(source).unwrap().with_extension("");
            let mut module: ModulePath = path
                .iter()
                .map(|part| part.to_str().unwrap().to_owned())
                .collect();
            let is_code = file.extension().is_some_and(|end| end == "rs");
            if !is_code || module.iter().any(|part| part.contains("test")) || module[0] == "bin" {
                continue;
            }
            module.retain(|part| !matches!(&**part, "mod" | "lib" | "main"));
            let text = fs::read_to_string(&file).unwrap();
            let text = text.split("#[cfg(test)]\nmod tests {").next().unwrap();
            let lines = text
                .lines()
                .map(|line| line.split("//").next().unwrap_or(line));
            code.insert(module, lines.collect::<Vec<_>>().join("\n"));
        }
        let mut modules = Self {
            code,
            exported: BTreeMap::new(),
        };
        let mut exported = BTreeMap::new();
        for module in modules.code.keys() {
            for path in modules.uses(module, true) {
                let name = path.last().cloned().unwrap_or_default();
                exported.insert((module.clone(), name), path);
            }
        }
        modules.exported = exported;
        modules
    }

    /// Returns the paths within the crate, from its root, that `use` names in a module: all, or those of `pub use`.
    fn uses(&self, module: &ModulePath, is_public: bool) -> Vec<ModulePath> {
        let statements = self.code[module].split(';').filter_map(|statement| {
            let (before, tree) = statement.rsplit_once("use ")?;
            let line = before.lines().last().unwrap_or("").trim();
            let is_statement = line.is_empty() || line.starts_with("pub");
            (is_statement && line.starts_with("pub") == is_public).then_some(tree)
        });
        statements
            .flat_map(split_use_tree)
            .filter_map(|path| self.local_path(module, &path))
            .collect()
    }

    /// Returns a path from the root of the crate; `None` for a path into another crate.
    fn local_path(&self, module: &ModulePath, path: &[String]) -> Option<ModulePath> {
        let supers = path.iter().take_while(|part| *part == "super").count();
        let (base, rest) = match path.first()?.as_str() {
            "crate" => (&[][..], &path[1..]),
            "self" => (&module[..], &path[1..]),
            "super" => (
                &module[..module.len().checked_sub(supers)?],
                &path[supers..],
            ),
            _ => (&module[..], path),
        };
        let whole = [base, rest].concat();
        let is_local = supers > 0 || matches!(&*path[0], "crate" | "self");
        let is_child = || self.code.contains_key(&whole[..=module.len()]);
        (is_local || is_child()).then_some(whole)
    }

    /// Returns the module that defines what a path names; re-exports are followed.
    fn defining_module(&self, path: &[String], depth: usize) -> ModulePath {
        let length = (0..=path.len())
            .rev()
            .find(|&length| self.code.contains_key(&path[..length]));
        let (module, rest) = path.split_at(length.unwrap_or(0));
        let exported = rest
            .first()
            .and_then(|name| self.exported.get(&(module.to_vec(), name.clone())));
        match exported {
            Some(target) if depth > 0 => {
                let target = [target, &rest[1..]].concat();
                self.defining_module(&target, depth - 1)
            }
            _ => module.to_vec(),
        }
    }

    /// Returns the modules whose items each module names.
    fn imports(&self) -> BTreeMap<&ModulePath, BTreeSet<ModulePath>> {
        let imports = self.code.iter().map(|(module, code)| {
            let inline = code
                .split(|letter: char| !letter.is_alphanumeric() && !matches!(letter, '_' | ':'))
                .filter(|word| word.starts_with("crate::") || word.starts_with("super::"));
            let inline = inline.map(|word| {
                word.split("::")
                    .filter(|part| !part.is_empty())
                    .map(str::to_owned)
                    .collect()
            });
            let inline = inline.filter_map(|path: Vec<String>| self.local_path(module, &path));
            let named = self.uses(module, false).into_iter().chain(inline);
            let defined = named.map(|path| self.defining_module(&path, 9));
            (module, defined.filter(|used| used != module).collect())
        });
        imports.collect()
    }
}

/// Returns the largest set of modules each of which reaches every other one through imports.
fn largest_circle<'m>(
    imports: &BTreeMap<&'m ModulePath, BTreeSet<ModulePath>>,
) -> Vec<&'m ModulePath> {
    let reached = |from: &ModulePath| {
        let mut reached = BTreeSet::new();
        let mut open = vec![from];
        while let Some(module) = open.pop() {
            open.extend(
                imports[module]
                    .iter()
                    .filter(|next| reached.insert((*next).clone())),
            );
        }
        reached
    };
    let reached: BTreeMap<_, _> = imports
        .keys()
        .map(|module| (*module, reached(module)))
        .collect();
    let circle = |module: &ModulePath| -> Vec<&'m ModulePath> {
        let modules = reached.keys().copied();
        modules
            .filter(|other| reached[module].contains(*other) && reached[*other].contains(module))
            .collect()
    };
    reached
        .keys()
        .map(|module| circle(module))
        .max_by_key(Vec::len)
        .unwrap_or_default()
}

/// A file imports another one if it names an item that the other one defines. Re-exports are followed, and tests left
/// out.
#[test]
fn few_files_import_each_other_in_a_circle() {
    let mut largest = (Vec::new(), String::new());
    for (folder, _) in listed_packages() {
        let source = match &*folder {
            "src" => root().join("src"),
            "fuzz" => continue,
            _ => root().join(&folder).join("src"),
        };
        let modules = CrateModules::read(&source);
        let circle = largest_circle(&modules.imports());
        let names: Vec<_> = circle.iter().map(|module| module.join("::")).collect();
        println!("{folder}: {} files in a circle", names.len());
        if names.len() > largest.0.len() {
            largest = (names, folder);
        }
    }
    let (names, folder) = largest;
    println!(
        "The largest circle has {} files, in {folder}: {}",
        names.len(),
        names.join(", ")
    );
    assert!(
        names.len() <= MAX_CIRCLE_FILES,
        "{folder}: {} files import each other: {names:?}",
        names.len()
    );
}
