use std::fs;
use std::path::{Path, PathBuf};

use proptest::prelude::*;

use crate::recording::map::RecordingMap;
use crate::recording::{Recording, RecordingError, load, read};

const MAP: &str = "map.toml";

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("../../corpora/recordings/parquet")
        .join(name)
}

fn map() -> RecordingMap {
    RecordingMap::load(&file(MAP)).expect("a map")
}

fn error_of(bytes: &[u8]) -> String {
    read(bytes, Path::new("a.parquet"), Some(&map()))
        .expect_err("must be refused")
        .to_string()
}

/// Files of polars (zstd) and pyarrow (gzip, and Snappy with other encodings and pages of version 2) have the values of
/// the text.
#[test]
fn files_of_other_programs_equal_the_text() {
    let read =
        |name: &str| load(&file(name), Some(&map())).unwrap_or_else(|error| panic!("{error}"));
    let platoons = |name: &str| -> Vec<_> {
        let Recording { platoons, .. } = read(name);
        let values = |platoon: &crate::recording::RecordedPlatoon| {
            (
                platoon.event.clone(),
                platoon.time_s.clone(),
                platoon.gap_ahead_m(1).to_vec(),
                platoon.vehicles.clone(),
            )
        };
        platoons.iter().map(values).collect()
    };
    let expected = platoons("pairs.csv");
    assert_eq!(
        expected
            .iter()
            .map(|(event, ..)| event.as_deref())
            .collect::<Vec<_>>(),
        [Some("a"), Some("b")]
    );
    assert_eq!(expected[0].2[10], None);
    for name in [
        "polars-zstd.parquet",
        "pyarrow-gzip.parquet",
        "pyarrow-delta.parquet",
    ] {
        assert_eq!(platoons(name), expected, "{name}");
    }
}

#[test]
fn other_compression_is_refused_by_its_name() {
    let message = load(&file("pyarrow-brotli.parquet"), Some(&map()))
        .expect_err("not read")
        .to_string();
    let expected = "pyarrow-brotli.parquet: the Parquet file cannot be read: crumple does not read compression with \
                    Brotli: use zstd, gzip, Snappy or none";
    assert!(message.ends_with(expected), "{message}");
}

/// Returns a number in Thrift's compact protocol.
fn varint(mut number: u64) -> Vec<u8> {
    let mut bytes = Vec::new();
    while number > 0x7f {
        bytes.push(number as u8 | 0x80);
        number >>= 7;
    }
    bytes.push(number as u8);
    bytes
}

/// Returns a file without rows whose schema has a root with this number of children, and these elements.
fn file_with_schema(children: u64, elements: &[Vec<u8>]) -> Vec<u8> {
    let root = [&b"\x48\x01r\x15"[..], &varint(2 * children), &[0]].concat();
    let count = varint(1 + elements.len() as u64);
    let footer = [
        &b"\x15\x02\x19\xfc"[..],
        &count,
        &root,
        &elements.concat(),
        b"\x16\x00\x19\x0c\x00",
    ]
    .concat();
    [
        b"PAR1",
        &footer[..],
        &(footer.len() as u32).to_le_bytes(),
        b"PAR1",
    ]
    .concat()
}

#[test]
fn sizes_in_the_schema_are_limited_before_memory_is_reserved() {
    let column = b"\x15\x0a\x25\x00\x18\x03gap\x00".to_vec();
    for children in [0, 2, 1 << 30, u64::MAX >> 1] {
        let message = error_of(&file_with_schema(children, std::slice::from_ref(&column)));
        assert!(
            message.ends_with("it is damaged: a number of columns is wrong"),
            "{message}"
        );
    }
    // Columns within columns, 50 000 deep.
    let nested = b"\x35\x00\x18\x01n\x15\x02\x00".to_vec();
    let message = error_of(&file_with_schema(1, &vec![nested; 50_000]));
    assert!(
        message.contains("it has more than 64 levels of nested columns"),
        "{message}"
    );
    // More structures within each other than any writer nests.
    let deep = [b"\x48\x01r\x15\x02", &vec![0x4c; 100_000][..]].concat();
    let message = error_of(&file_with_schema(1, &[deep]));
    assert!(message.contains("breaks the rules of Thrift"), "{message}");
    let message = error_of(&file_with_schema(1, &[column]));
    assert!(
        message.ends_with("time: there is no such column or signal; the file has gap"),
        "{message}"
    );
}

proptest! {
    #![proptest_config(crumple_cases::with_cases(512))]

    /// Damaged files end with an error or other values, without panic.
    #[test]
    fn damaged_files_are_read_without_panic(
        which in 0..3_usize,
        cut in 0.5..1.5f64,
        changes in prop::collection::vec((any::<usize>(), any::<u8>()), 0..12),
    ) {
        let name = ["polars-zstd.parquet", "pyarrow-gzip.parquet", "pyarrow-delta.parquet"][which];
        let mut bytes = fs::read(file(name)).unwrap();
        bytes.truncate((bytes.len() as f64 * cut) as usize);
        for (at, byte) in changes {
            let at = at % bytes.len();
            bytes[at] = byte;
        }
        match read(&bytes, Path::new("a.parquet"), Some(&map())) {
            Ok(_) | Err(RecordingError::Line { .. }) => {}
            Err(error) => prop_assert!(error.to_string().len() < 2000, "{error}"),
        }
    }
}
