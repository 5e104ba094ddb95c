//! Journal of a campaign's evaluations, so that `kill -9` loses none of them.
//!
//! The journal begins with the identity of the run, because another build or seed computes other values. One record per
//! evaluation follows. Records hold no points: the search proposes the same points for the same values.
//!
//! A truncated record is ignored; a record with a wrong checksum prevents resuming. Records are synced at least once a
//! second; missing bytes or zeros at the end count as truncated. The manifest knows the synced prefix
//! ([`RunFolder::record_prefix`](crumple_store::run_folder::RunFolder::record_prefix)), so that further truncation is
//! detected. A complete campaign removes the journal, because the evaluation log has its contents.

mod record;

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crumple_core::digest::Sha256;
use crumple_core::regular_file;
use crumple_measure::RunVerdict;
use crumple_store::disk::{self, DiskError};
use crumple_store::run_folder::{Prefix, RunFolderError};
use record::{JournalEntry, RECORD_BYTES, is_all_zero, read_record, record_checksum};
pub(super) use record::{decode, encode};

/// Length of the first line: the identity of the run in hexadecimal, and a line feed.
const HEADER_BYTES: usize = 2 * 32 + 1;

pub(super) struct Journal {
    file: File,
    path: PathBuf,
    identity: String,
    /// Records of an earlier process that are not yet read.
    previous_records: Option<BufReader<File>>,
    /// Number of records read or written so far.
    record_count: u64,
    digest: Sha256,
    last_sync: Instant,
}

const SYNC_INTERVAL: Duration = Duration::from_secs(1);

const OTHER_CAMPAIGN_MESSAGE: &str = "belongs to another campaign, so this one cannot be resumed; \
    remove its folder, or use another --out";

impl Journal {
    fn create(path: &Path, identity: &str) -> Result<Self, RunFolderError> {
        let unusable = DiskError::at(path);
        let mut file = File::create(path).map_err(unusable)?;
        file.write_all(header_line(identity).as_bytes())
            .map_err(unusable)?;
        file.sync_all().map_err(unusable)?;
        disk::sync_parent_folder(path)?;
        Ok(Self::new(file, path, identity, None))
    }

    fn new(file: File, path: &Path, identity: &str, earlier: Option<BufReader<File>>) -> Self {
        Self {
            file,
            path: path.to_owned(),
            identity: identity.to_owned(),
            previous_records: earlier,
            record_count: 0,
            digest: Sha256::default().with(header_line(identity)),
            last_sync: Instant::now(),
        }
    }

    /// Checks that a run with this identity can resume from a journal. Changes nothing.
    pub(super) fn verify(path: &Path, identity: &str) -> Result<(), RunFolderError> {
        let unusable = DiskError::at(path);
        let file = match regular_file::open(path) {
            // The process ended before it created the journal.
            Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(()),
            file => file.map_err(unusable)?,
        };
        let mut records = BufReader::new(file);
        if !has_header(&mut records, identity)
            .map_err(unusable)?
            .ok_or_else(|| RunFolderError::damaged(path, OTHER_CAMPAIGN_MESSAGE))?
        {
            return Ok(());
        }
        let mut index = 0;
        while let JournalEntry::Record(..) = read_record(&mut records, path, identity, index)? {
            index += 1;
        }
        Ok(())
    }

    /// Opens the journal of an earlier process, or creates one if there is none.
    pub(super) fn resume(path: &Path, identity: &str) -> Result<Self, RunFolderError> {
        let unusable = DiskError::at(path);
        let length = match fs::metadata(path) {
            Ok(data) => data.len(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
            Err(error) => return Err(unusable(error).into()),
        };
        if length < HEADER_BYTES as u64 {
            return Self::create(path, identity);
        }
        let mut earlier = BufReader::new(regular_file::open(path).map_err(unusable)?);
        let is_begun = has_header(&mut earlier, identity).map_err(unusable)?;
        if !is_begun.ok_or_else(|| RunFolderError::damaged(path, OTHER_CAMPAIGN_MESSAGE))? {
            return Self::create(path, identity);
        }
        let file =
            regular_file::open_with(path, OpenOptions::new().append(true)).map_err(unusable)?;
        Ok(Self::new(file, path, identity, Some(earlier)))
    }

    pub(super) fn next_verdict(&mut self) -> Result<Option<RunVerdict>, RunFolderError> {
        let Some(earlier) = &mut self.previous_records else {
            return Ok(None);
        };
        let unusable = DiskError::at(&self.path);
        match read_record(earlier, &self.path, &self.identity, self.record_count)? {
            JournalEntry::Record(body, checksum) => {
                self.record_count += 1;
                self.digest.update(body);
                self.digest.update(checksum);
                Ok(Some(decode(&body)))
            }
            // Cut off a truncated record only now, so that a journal with a damaged record stays as it is.
            JournalEntry::Zeros | JournalEntry::Truncated => {
                self.file.set_len(self.length_bytes()).map_err(unusable)?;
                self.previous_records = None;
                Ok(None)
            }
        }
    }

    /// Returns the length of all records read or written so far, with the header.
    fn length_bytes(&self) -> u64 {
        HEADER_BYTES as u64 + RECORD_BYTES as u64 * self.record_count
    }

    /// Appends verdicts, which survive the end of the process. Returns the prefix on disk after a sync.
    pub(super) fn append(&mut self, verdicts: &[RunVerdict]) -> Result<Option<Prefix>, DiskError> {
        let mut bytes = Vec::with_capacity(verdicts.len() * RECORD_BYTES);
        for (verdict, index) in verdicts.iter().zip(self.record_count..) {
            let body = encode(verdict);
            bytes.extend(body);
            bytes.extend(record_checksum(&self.identity, index, &body));
        }
        self.record_count += verdicts.len() as u64;
        self.file
            .write_all(&bytes)
            .map_err(DiskError::at(&self.path))?;
        self.digest.update(&bytes);
        if self.last_sync.elapsed() <= SYNC_INTERVAL {
            return Ok(None);
        }
        self.file.sync_data().map_err(DiskError::at(&self.path))?;
        self.last_sync = Instant::now();
        Ok(Some(Prefix {
            bytes: self.length_bytes(),
            sha256: self.digest.clone().hexadecimal(),
        }))
    }
}

/// Returns true for the header of this run, false if it is truncated or missing, `None` for another run.
fn has_header(journal: &mut impl Read, identity: &str) -> io::Result<Option<bool>> {
    let mut header = [0; HEADER_BYTES];
    match journal.read_exact(&mut header) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(Some(false)),
        read => read?,
    }
    if header == [0; HEADER_BYTES] && is_all_zero(journal)? {
        return Ok(Some(false));
    }
    Ok((header == header_line(identity).as_bytes()).then_some(true))
}

fn header_line(identity: &str) -> String {
    format!("{identity}\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crumple_measure::{BrakingLevel, FirstCollision};
    use crumple_sim::scenario::VehicleClass;

    fn identity() -> String {
        "1a".repeat(32)
    }

    fn problem(error: RunFolderError) -> String {
        match error {
            RunFolderError::Damaged { problem, .. } => problem,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn whole_records_are_read_back_and_torn_ones_are_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let struck = FirstCollision {
            time_s: 1.25,
            front_vehicle: 1,
            rear_vehicle: 2,
            impact_speed_mps: 7.5,
            ego_braking: BrakingLevel::Full,
            rear_class: VehicleClass::Heavy,
        };
        let failed = RunVerdict {
            failure: Some((0.5, 1)),
            ..RunVerdict::new(f64::NEG_INFINITY)
        };
        let verdicts = [
            failed,
            RunVerdict {
                collision: Some(struck),
                ..RunVerdict::new(-7.5)
            },
        ];
        Journal::create(&path, &identity())
            .unwrap()
            .append(&verdicts)
            .unwrap();
        OpenOptions::new()
            .append(true)
            .open(&path)
            .unwrap()
            .write_all(&[1; RECORD_BYTES - 1])
            .unwrap();
        let mut journal = Journal::resume(&path, &identity()).unwrap();
        assert_eq!(journal.next_verdict().unwrap(), Some(verdicts[0]));
        assert_eq!(journal.next_verdict().unwrap(), Some(verdicts[1]));
        assert_eq!(journal.next_verdict().unwrap(), None);
        journal.append(&verdicts[..1]).unwrap();
        assert_eq!(
            std::fs::metadata(&path).unwrap().len(),
            (HEADER_BYTES + 3 * RECORD_BYTES) as u64
        );
        let mut again = Journal::resume(&path, &identity()).unwrap();
        for expected in [verdicts[0], verdicts[1], verdicts[0]] {
            assert_eq!(again.next_verdict().unwrap(), Some(expected));
        }
    }

    /// A campaign that refuses its journal changes nothing.
    #[test]
    fn a_damaged_journal_is_not_changed() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        Journal::create(&path, &identity())
            .unwrap()
            .append(&[RunVerdict::new(1.0)])
            .unwrap();
        let mut damaged = std::fs::read(&path).unwrap();
        damaged.extend([7; RECORD_BYTES + 5]);
        std::fs::write(&path, &damaged).unwrap();
        let mut journal = Journal::resume(&path, &identity()).unwrap();
        assert!(journal.next_verdict().unwrap().is_some());
        problem(journal.next_verdict().unwrap_err());
        assert_eq!(std::fs::read(&path).unwrap(), damaged);
    }

    /// Tests a change of any bit of the header or a record, and an exchange of two records.
    #[test]
    fn damage_is_reported_at_its_record() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let verdicts = [1.0, 2.0, 3.0].map(RunVerdict::new);
        Journal::create(&path, &identity())
            .unwrap()
            .append(&verdicts)
            .unwrap();
        let whole = std::fs::read(&path).unwrap();
        let going_on = || {
            let mut journal = match Journal::resume(&path, &identity()) {
                Ok(journal) => journal,
                Err(error) => return Some(problem(error)),
            };
            loop {
                match journal.next_verdict() {
                    Ok(Some(_)) => {}
                    Ok(None) => return None,
                    Err(error) => return Some(problem(error)),
                }
            }
        };
        let first_damage = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let looked = Journal::verify(&path, &identity()).err().map(problem);
            assert_eq!(
                std::fs::read(&path).unwrap(),
                bytes,
                "looking changes nothing"
            );
            let left = going_on();
            assert_eq!(looked, left);
            left
        };
        assert_eq!(first_damage(&whole), None);
        for bit in 0..8 * whole.len() {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let expected = match (bit / 8).checked_sub(HEADER_BYTES) {
                None => OTHER_CAMPAIGN_MESSAGE.to_owned(),
                Some(beyond) => format!("record {} is damaged", beyond / RECORD_BYTES + 1),
            };
            assert!(first_damage(&bytes).unwrap().starts_with(&expected));
            assert_eq!(
                std::fs::read(&path).unwrap(),
                bytes,
                "nothing is cut from what is refused"
            );
        }
        let (header, [one, two]) = (
            &whole[..HEADER_BYTES],
            [0, 1].map(|at| &whole[HEADER_BYTES + at * RECORD_BYTES..][..RECORD_BYTES]),
        );
        assert!(
            first_damage(&[header, two, one].concat())
                .unwrap()
                .starts_with("record 1 is damaged")
        );
        assert_eq!(first_damage(&header[1..]), None, "it begins anew");
        assert_eq!(
            first_damage(&[header, one, &[0; 3 * RECORD_BYTES + 5]].concat()),
            None,
            "what a loss of power leaves"
        );
        assert_eq!(std::fs::read(&path).unwrap(), [header, one].concat());
        assert!(
            first_damage(&[header, one, &[0; RECORD_BYTES], two].concat())
                .unwrap()
                .starts_with("record 2 is damaged")
        );
    }
}
