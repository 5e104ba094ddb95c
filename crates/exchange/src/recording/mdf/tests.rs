use std::fs;
use std::io::Cursor;
use std::path::{Path, PathBuf};

use proptest::prelude::*;
use serde_json::Value;

use super::{DbcFile, MdfError, SignalSet};

/// Files of asammdf with the values that it reads: `.ci/mdf` generates a thousand, a few are in the corpus.
fn files() -> Vec<PathBuf> {
    let corpus = concat!(env!("CARGO_MANIFEST_DIR"), "/../../corpora/recordings/mdf");
    let folder = std::env::var("MDF_FILES").unwrap_or_else(|_| corpus.to_owned());
    let paths = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let mut files: Vec<_> = paths
        .filter(|path| path.extension().is_some_and(|extension| extension == "mf4"))
        .collect();
    files.sort();
    files
}

fn read(bytes: Vec<u8>, path: &Path) -> Result<SignalSet, MdfError> {
    let dbc = Some(path.with_extension("dbc"))
        .filter(|dbc| dbc.exists())
        .map(|dbc| DbcFile::load(&dbc))
        .transpose()?;
    SignalSet::read(Cursor::new(bytes), dbc.as_ref(), &|name| {
        name != "t" && !name.contains('.')
    })
}

#[test]
fn signals_equal_those_of_asammdf_and_cantools_bit_by_bit() {
    for path in files() {
        let signals = read(fs::read(&path).unwrap(), &path)
            .unwrap_or_else(|error| panic!("{}: {error}", path.display()));
        let Value::Object(expected) =
            serde_json::from_slice(&fs::read(path.with_extension("json")).unwrap()).unwrap()
        else {
            panic!("{}: no table", path.display())
        };
        for (name, expected) in expected {
            let label = || format!("{}: {name}", path.display());
            let signal = signals
                .signals
                .iter()
                .find(|signal| signal.name == name)
                .unwrap_or_else(|| panic!("{}", label()));
            for (values, key) in [
                (&signal.values, "values"),
                (&signals.clocks_s[signal.clock], "times"),
            ] {
                let expected = expected[key].as_array().unwrap();
                assert_eq!(values.len(), expected.len(), "{}: {key}", label());
                for (index, (value, expected)) in values.iter().zip(expected).enumerate() {
                    assert_eq!(
                        format!("{:016x}", value.to_bits()),
                        *expected,
                        "{}: {key}[{index}]",
                        label()
                    );
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(256))]

    /// Damaged files end with an error or other values, without panic.
    #[test]
    fn damaged_files_are_read_without_panic(
        seed in any::<usize>(),
        cut in 0.5..1.0f64,
        changes in prop::collection::vec((any::<usize>(), any::<u8>()), 0..20),
    ) {
        let files = files();
        let path = &files[seed % files.len()];
        let mut bytes = fs::read(path).unwrap();
        bytes.truncate((bytes.len() as f64 * cut) as usize + usize::from(cut > 0.75) * bytes.len());
        for (at, byte) in changes {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        if let Err(error) = read(bytes, path) {
            prop_assert!(!error.to_string().contains('\n'), "{error}");
        }
    }
}
