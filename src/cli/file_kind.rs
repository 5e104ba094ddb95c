//! Detection of crumple's file kinds, for a better error when a command gets the wrong kind.

use std::io::Read;
use std::path::Path;

use crumple_core::regular_file;

/// Number of bytes within which the header of a policy or a checkpoint begins.
const HEADER_BYTES: u64 = 4096;

/// Returns the kind of a file and the command that reads it; `None` if the first bytes do not identify it.
pub(super) fn detect(path: &Path) -> Option<&'static str> {
    let mut begin = Vec::new();
    // The command reads a pipe; this function must not.
    if path.is_file() {
        regular_file::open(path)
            .ok()?
            .take(HEADER_BYTES)
            .read_to_end(&mut begin)
            .ok()?;
    }
    let begins_with = |key: &str| {
        begin
            .windows(key.len())
            .any(|window| window == key.as_bytes())
    };
    if begins_with("\"crumple_policy\"") {
        Some(
            "a policy: use it with `crumple simulate paper-1 --controller FILE`, retrain it with `crumple retrain \
             --policy FILE`, or certify it with `crumple verify reach --controller FILE`",
        )
    } else if begins_with("\"crumple_training\"") {
        Some(
            "a checkpoint: resume it with `crumple train` or `crumple retrain`, --resume and --out with its folder",
        )
    } else {
        None
    }
}
