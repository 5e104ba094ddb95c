//! What a file of crumple's own is that stands where another was wanted.

use std::fs::File;
use std::io::Read;
use std::path::Path;

/// The header of a policy or a checkpoint begins within so many bytes.
const HEADER_BYTES: u64 = 4096;

/// What a file is, and which command takes it; none of any file that is not told by how it begins.
pub(super) fn detect(path: &Path) -> Option<&'static str> {
    let mut begin = Vec::new();
    if path.is_file() {
        File::open(path).ok()?.take(HEADER_BYTES).read_to_end(&mut begin).ok()?;
    }
    let begins_with = |key: &str| begin.windows(key.len()).any(|found| found == key.as_bytes());
    if begins_with("\"crumple_policy\"") {
        Some(
            "a policy, which is a controller as it is: `crumple simulate paper-1 --controller FILE` drives with it, `crumple retrain --policy FILE` \
             trains it on, and `crumple verify reach --controller FILE` makes a certificate about it",
        )
    } else if begins_with("\"crumple_training\"") {
        Some(
            "a checkpoint, from which `crumple train` or `crumple retrain` goes on with --resume and the --out that it lies in",
        )
    } else {
        None
    }
}
