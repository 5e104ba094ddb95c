use super::*;

fn get(cache: &EvidenceCache, inputs: &str, value: f64) -> f64 {
    cache
        .get_or_gather::<_, CacheError>("a piece", &inputs, || Ok(value))
        .unwrap()
}

#[test]
fn changed_inputs_or_programs_gather_the_evidence_again() {
    let folder = tempfile::tempdir().unwrap();
    let open = |program, fresh| EvidenceCache::open(folder.path(), program, fresh).unwrap();
    {
        let cache = open("program", false);
        assert!(matches!(
            EvidenceCache::open(folder.path(), "program", false),
            Err(CacheError::InUse(_))
        ));
        assert_eq!(
            (get(&cache, "inputs", 0.1), get(&cache, "inputs", 0.2)),
            (0.1, 0.1)
        );
        assert_eq!(get(&cache, "other inputs", 0.3), 0.3);
        assert_eq!(
            (cache.reuse_counts(), cache.damaged_files().len()),
            ((3, 1), 0)
        );
    }
    assert_eq!(get(&open("other program", false), "inputs", 0.4), 0.4);
    assert_eq!(get(&EvidenceCache::disabled(), "inputs", 0.6), 0.6);
    assert_eq!(get(&open("program", true), "inputs", 0.7), 0.7);
}

/// Covers changed bytes, truncation, deletion and swapped files: gathering again restores the file.
#[test]
fn damaged_cache_entries_are_gathered_again_and_restored() {
    let folder = tempfile::tempdir().unwrap();
    let names = ["a piece", "another", "a third"];
    let gather = |name: &str| {
        let cache = EvidenceCache::open(folder.path(), "program", false).unwrap();
        let value = cache
            .get_or_gather::<_, CacheError>(name, &"inputs", || Ok(format!("says {name}")))
            .unwrap();
        assert_eq!(value, format!("says {name}"));
        cache.reuse_counts() == (1, 1)
    };
    names.into_iter().for_each(|name| assert!(!gather(name)));
    names.into_iter().for_each(|name| assert!(gather(name)));
    let path = |name: &str| {
        let cache = EvidenceCache::open(folder.path(), "program", false).unwrap();
        folder
            .path()
            .join(cache.file_stem(name, &sha256(to_json(&"inputs").unwrap())) + ".json")
    };
    let genuine = names.map(|name| fs::read(path(name)).unwrap());
    for (name, bytes) in names.into_iter().zip(&genuine) {
        let path = path(name);
        let is_gathered_again = |what: &str| {
            assert!(!gather(name), "{name}, {what}: believed");
            assert_eq!(
                fs::read(&path).unwrap(),
                *bytes,
                "{name}, {what}: another file"
            );
        };
        for index in 0..bytes.len() {
            let mut changed = bytes.clone();
            changed[index] ^= 1 << (index % 8);
            fs::write(&path, changed).unwrap();
            is_gathered_again("flipped");
            fs::write(&path, &bytes[..index]).unwrap();
            is_gathered_again("cut");
        }
        for other in genuine.iter().filter(|other| *other != bytes) {
            fs::write(&path, other).unwrap();
            is_gathered_again("swapped");
        }
        fs::remove_file(&path).unwrap();
        is_gathered_again("removed");
    }
}
