//! What a campaign has found out so far, kept so that `kill -9` loses nothing.
//!
//! The journal is a flat file that begins with the identity of the work, for another build, or another seed, would find other
//! values; then one record an evaluation, in the order of evaluation, appended batch by batch. Which point
//! an evaluation was at need not be kept: asking the search again gives the same points, as long as it is told the
//! same values. A record that was cut short is not used; one that was changed is known by its checksum, and the campaign does
//! not go on from it. Records reach the disk once a second at least: a loss of power takes no more, and what it leaves instead of
//! them, nothing or zeros to the end, counts as cut short. How the journal began when it last reached the disk is known to the
//! folder's manifest ([`Work::grew`](crate::work::Work::grew)), so that nothing before that can be cut off. It is removed once the
//! campaign is complete: its contents are then in the Parquet files.

use std::fs::{self, File, OpenOptions};
use std::io::{self, BufReader, Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use crate::disk::{self, DiskError};
use crate::work::{Prefix, Work, WorkError};
use crumple_world::digest::Sha256;
use crumple_world::measure::{Braking, FirstContact, RunVerdict};
use crumple_world::scenario::VehicleClass;

/// Robustness, time and impact speed as doubles, two vehicles as 32-bit numbers, braking (or what stands in its place) and
/// class as bytes.
const BODY: usize = 3 * 8 + 2 * 4 + 2;
/// The first bytes of the SHA-256 of the work's identity and the record's number and body: a record in another's place is
/// damage, too.
const CHECKSUM: usize = 6;
const RECORD: usize = BODY + CHECKSUM;
/// The identity of the work, in hexadecimal, and the end of its line.
const HEADER: usize = 2 * 32 + 1;
/// In place of the braking where no vehicles touched.
const NO_CONTACT: u8 = u8::MAX;
/// In place of the braking where a controller failed; the vehicle that is hit is then its own.
const CONTROLLER_FAILED: u8 = u8::MAX - 1;

pub(super) struct Journal {
    file: File,
    path: PathBuf,
    identity: String,
    /// Records of an earlier run, not yet used.
    earlier: Option<BufReader<File>>,
    /// Records used or written so far.
    records: u64,
    /// Of all bytes used or written so far.
    digest: Sha256,
    /// When records last reached the disk.
    synced: Instant,
}

/// Between two times that records are made to reach the disk.
const BETWEEN: Duration = Duration::from_secs(1);

/// What is said of a journal whose first bytes are of something else.
const OTHER_WORK: &str = "not of this campaign: it cannot go on; remove its folder, or use another --out";

impl Journal {
    /// That of a work: an empty one, or the one of an earlier run.
    pub(super) fn in_work(work: &Work, name: &str, resume: bool) -> Result<Self, WorkError> {
        let (path, identity) = (work.path(name), work.identity());
        if resume { Self::resume(&path, &identity) } else { Self::create(&path, &identity) }
    }

    /// An empty journal of work with that identity.
    pub(super) fn create(path: &Path, identity: &str) -> Result<Self, WorkError> {
        let unusable = DiskError::at(path);
        let mut file = File::create(path).map_err(unusable)?;
        file.write_all(header(identity).as_bytes()).map_err(unusable)?;
        file.sync_all().map_err(unusable)?;
        disk::sync_names_beside(path)?;
        Ok(Self::of(file, path, identity, None))
    }

    fn of(file: File, path: &Path, identity: &str, earlier: Option<BufReader<File>>) -> Self {
        Self {
            file,
            path: path.to_owned(),
            identity: identity.to_owned(),
            earlier,
            records: 0,
            digest: Sha256::default().with(header(identity)),
            synced: Instant::now(),
        }
    }

    /// Looks whether work with that identity could go on with a journal, and changes nothing.
    pub(super) fn look(path: &Path, identity: &str) -> Result<(), WorkError> {
        let unusable = DiskError::at(path);
        let mut records = BufReader::new(File::open(path).map_err(unusable)?);
        if !begins(&mut records, identity).map_err(unusable)?.ok_or_else(|| WorkError::damaged(path, OTHER_WORK))? {
            return Ok(());
        }
        let mut index = 0;
        while let Found::Record(..) = record(&mut records, identity, index).map_err(unusable)?.at(path, index)? {
            index += 1;
        }
        Ok(())
    }

    /// The journal of an earlier run, or an empty one if there is none.
    pub(super) fn resume(path: &Path, identity: &str) -> Result<Self, WorkError> {
        let unusable = DiskError::at(path);
        let length = match fs::metadata(path) {
            Ok(data) => data.len(),
            Err(error) if error.kind() == io::ErrorKind::NotFound => 0,
            Err(error) => return Err(unusable(error).into()),
        };
        let Some(beyond) = length.checked_sub(HEADER as u64) else { return Self::create(path, identity) };
        let mut earlier = BufReader::new(File::open(path).map_err(unusable)?);
        let is_begun = begins(&mut earlier, identity).map_err(unusable)?;
        if !is_begun.ok_or_else(|| WorkError::damaged(path, OTHER_WORK))? {
            return Self::create(path, identity);
        }
        let file = OpenOptions::new().append(true).open(path).map_err(unusable)?;
        file.set_len(length - beyond % RECORD as u64).map_err(unusable)?;
        Ok(Self::of(file, path, identity, Some(earlier)))
    }

    /// The next verdict of an earlier run.
    pub(super) fn next(&mut self) -> Result<Option<RunVerdict>, WorkError> {
        let Some(earlier) = &mut self.earlier else { return Ok(None) };
        let unusable = DiskError::at(&self.path);
        match record(earlier, &self.identity, self.records).map_err(unusable)?.at(&self.path, self.records)? {
            Found::Record(body, checksum) => {
                self.records += 1;
                self.digest.update(body);
                self.digest.update(checksum);
                Ok(Some(decode(&body)))
            }
            found => {
                if matches!(found, Found::Zeros) {
                    self.file.set_len(self.bytes()).map_err(unusable)?;
                }
                self.earlier = None;
                Ok(None)
            }
        }
    }

    /// Of all records used or written so far.
    fn bytes(&self) -> u64 {
        HEADER as u64 + RECORD as u64 * self.records
    }

    /// Appends verdicts; they survive the end of the process, however sudden. What has reached the disk, if anything has.
    pub(super) fn append(&mut self, verdicts: &[RunVerdict]) -> Result<Option<Prefix>, DiskError> {
        let mut bytes = Vec::with_capacity(verdicts.len() * RECORD);
        for (verdict, index) in verdicts.iter().zip(self.records..) {
            let body = encode(verdict);
            bytes.extend(body);
            bytes.extend(checksum_of(&self.identity, index, &body));
        }
        self.records += verdicts.len() as u64;
        self.file.write_all(&bytes).map_err(DiskError::at(&self.path))?;
        self.digest.update(&bytes);
        if self.synced.elapsed() <= BETWEEN {
            return Ok(None);
        }
        self.file.sync_data().map_err(DiskError::at(&self.path))?;
        self.synced = Instant::now();
        Ok(Some(Prefix { bytes: self.bytes(), sha256: self.digest.clone().hexadecimal() }))
    }
}

/// Whether a journal begins as that of work with an identity does; none if it is another's. One whose header was cut short, or never
/// reached the disk, holds nothing.
fn begins(journal: &mut impl Read, identity: &str) -> io::Result<Option<bool>> {
    let mut found = [0; HEADER];
    match journal.read_exact(&mut found) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(Some(false)),
        read => read?,
    }
    if found == [0; HEADER] && is_zero(journal)? {
        return Ok(Some(false));
    }
    Ok((found == header(identity).as_bytes()).then_some(true))
}

/// What is read where a record may be.
enum Found {
    Record([u8; BODY], [u8; CHECKSUM]),
    /// The end, or a record that was cut short.
    Cut,
    /// Nothing but zeros to the end: what a loss of power leaves.
    Zeros,
    /// Something else.
    Damaged,
}

impl Found {
    /// What was found, unless it is damage.
    fn at(self, path: &Path, index: u64) -> Result<Self, WorkError> {
        match self {
            Self::Damaged => Err(WorkError::damaged(
                path,
                format!(
                    "record {} is damaged, its checksum does not match: this campaign cannot go on; remove its folder, or use \
                     another --out",
                    index + 1
                ),
            )),
            found => Ok(found),
        }
    }
}

fn record(journal: &mut impl Read, identity: &str, index: u64) -> io::Result<Found> {
    let (mut body, mut checksum) = ([0; BODY], [0; CHECKSUM]);
    match journal.read_exact(&mut body).and_then(|()| journal.read_exact(&mut checksum)) {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => return Ok(Found::Cut),
        read => read?,
    }
    if checksum == checksum_of(identity, index, &body) {
        Ok(Found::Record(body, checksum))
    } else if body == [0; BODY] && checksum == [0; CHECKSUM] && is_zero(journal)? {
        Ok(Found::Zeros)
    } else {
        Ok(Found::Damaged)
    }
}

/// Whether there is nothing but zeros to the end.
fn is_zero(rest: &mut impl Read) -> io::Result<bool> {
    let mut part = [0; 1 << 12];
    loop {
        match rest.read(&mut part)? {
            0 => return Ok(true),
            count if part.iter().take(count).any(|&byte| byte != 0) => return Ok(false),
            _ => {}
        }
    }
}

fn header(identity: &str) -> String {
    format!("{identity}\n")
}

fn checksum_of(identity: &str, index: u64, body: &[u8; BODY]) -> [u8; CHECKSUM] {
    let digest = Sha256::default().with(identity).with(index.to_le_bytes()).with(body).finish();
    let mut first = [0; CHECKSUM];
    first.iter_mut().zip(digest).for_each(|(place, byte)| *place = byte);
    first
}

pub(super) fn encode(verdict: &RunVerdict) -> [u8; BODY] {
    let (time_s, impact_speed_mps, vehicles, kind, class) = match (verdict.contact, verdict.failed) {
        (Some(contact), _) => {
            let FirstContact { time_s, front_vehicle, rear_vehicle, impact_speed_mps, ego_braking, rear_class } =
                contact;
            (time_s, impact_speed_mps, [front_vehicle, rear_vehicle], ego_braking as u8, rear_class.number())
        }
        (None, Some((time_s, vehicle))) => (time_s, 0.0, [vehicle, 0], CONTROLLER_FAILED, 0),
        (None, None) => (0.0, 0.0, [0, 0], NO_CONTACT, 0),
    };
    let mut record = [0; BODY];
    let doubles = [verdict.robustness, time_s, impact_speed_mps].map(f64::to_le_bytes);
    let vehicles = vehicles.map(u32::to_le_bytes);
    let bytes = doubles.concat().into_iter().chain(vehicles.concat()).chain([kind, class]);
    record.iter_mut().zip(bytes).for_each(|(place, byte)| *place = byte);
    record
}

pub(super) fn decode(record: &[u8; BODY]) -> RunVerdict {
    let double = |index: usize| {
        let bytes = record.get(8 * index..8 * index + 8).and_then(|bytes| bytes.try_into().ok());
        f64::from_le_bytes(bytes.unwrap_or_default())
    };
    let vehicle = |index: usize| {
        let bytes = record.get(24 + 4 * index..28 + 4 * index).and_then(|bytes| bytes.try_into().ok());
        u32::from_le_bytes(bytes.unwrap_or_default())
    };
    let [.., braking, class] = *record;
    let contact = Braking::ALL.get(usize::from(braking)).map(|&ego_braking| FirstContact {
        time_s: double(1),
        front_vehicle: vehicle(0),
        rear_vehicle: vehicle(1),
        impact_speed_mps: double(2),
        ego_braking,
        rear_class: VehicleClass::ALL.get(usize::from(class)).copied().unwrap_or(VehicleClass::Light),
    });
    let failed = (braking == CONTROLLER_FAILED).then(|| (double(1), vehicle(0)));
    RunVerdict { robustness: double(0), contact, failed }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity() -> String {
        "1a".repeat(32)
    }

    fn problem(error: WorkError) -> String {
        match error {
            WorkError::Damaged { problem, .. } => problem,
            other => panic!("{other}"),
        }
    }

    #[test]
    fn verdicts_survive_and_torn_records_do_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let struck = FirstContact {
            time_s: 1.25,
            front_vehicle: 1,
            rear_vehicle: 2,
            impact_speed_mps: 7.5,
            ego_braking: Braking::Full,
            rear_class: VehicleClass::Heavy,
        };
        let failed = RunVerdict { failed: Some((0.5, 1)), ..RunVerdict::new(f64::NEG_INFINITY) };
        let verdicts = [failed, RunVerdict { contact: Some(struck), ..RunVerdict::new(-7.5) }];
        Journal::create(&path, &identity()).unwrap().append(&verdicts).unwrap();
        OpenOptions::new().append(true).open(&path).unwrap().write_all(&[1; RECORD - 1]).unwrap();
        let mut journal = Journal::resume(&path, &identity()).unwrap();
        assert_eq!(journal.next().unwrap(), Some(verdicts[0]));
        assert_eq!(journal.next().unwrap(), Some(verdicts[1]));
        assert_eq!(journal.next().unwrap(), None);
        journal.append(&verdicts[..1]).unwrap();
        assert_eq!(std::fs::metadata(&path).unwrap().len(), (HEADER + 3 * RECORD) as u64);
        let mut again = Journal::resume(&path, &identity()).unwrap();
        for expected in [verdicts[0], verdicts[1], verdicts[0]] {
            assert_eq!(again.next().unwrap(), Some(expected));
        }
    }

    /// Any bit of the header or any record, and two whole records that change places.
    #[test]
    fn damage_is_found_where_it_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal");
        let verdicts = [1.0, 2.0, 3.0].map(RunVerdict::new);
        Journal::create(&path, &identity()).unwrap().append(&verdicts).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let going_on = || {
            let mut journal = match Journal::resume(&path, &identity()) {
                Ok(journal) => journal,
                Err(error) => return Some(problem(error)),
            };
            loop {
                match journal.next() {
                    Ok(Some(_)) => {}
                    Ok(None) => return None,
                    Err(error) => return Some(problem(error)),
                }
            }
        };
        let first_damage = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            let looked = Journal::look(&path, &identity()).err().map(problem);
            assert_eq!(std::fs::read(&path).unwrap(), bytes, "looking changes nothing");
            let found = going_on();
            assert_eq!(looked, found);
            found
        };
        assert_eq!(first_damage(&whole), None);
        for bit in 0..8 * whole.len() {
            let mut bytes = whole.clone();
            bytes[bit / 8] ^= 1 << (bit % 8);
            let expected = match (bit / 8).checked_sub(HEADER) {
                None => OTHER_WORK.to_owned(),
                Some(beyond) => format!("record {} is damaged", beyond / RECORD + 1),
            };
            assert!(first_damage(&bytes).unwrap().starts_with(&expected));
            assert_eq!(std::fs::read(&path).unwrap(), bytes, "nothing is cut from what is refused");
        }
        let (header, [one, two]) = (&whole[..HEADER], [0, 1].map(|at| &whole[HEADER + at * RECORD..][..RECORD]));
        assert!(first_damage(&[header, two, one].concat()).unwrap().starts_with("record 1 is damaged"));
        assert_eq!(first_damage(&header[1..]), None, "it begins anew");
        assert_eq!(first_damage(&[header, one, &[0; 3 * RECORD + 5]].concat()), None, "what a loss of power leaves");
        assert_eq!(std::fs::read(&path).unwrap(), [header, one].concat());
        assert!(first_damage(&[header, one, &[0; RECORD], two].concat()).unwrap().starts_with("record 2 is damaged"));
    }
}
