//! Records of the journal: the verdict of an evaluation in a fixed number of bytes, with a checksum.

use std::io::{self, Read};
use std::path::Path;

use crumple_core::digest::Sha256;
use crumple_measure::{BrakingLevel, FirstContact, RunVerdict};
use crumple_sim::scenario::VehicleClass;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// Robustness, time and impact speed (doubles), two vehicles (32 bits), braking level or a code, and class (bytes).
pub(super) const BODY_BYTES: usize = 3 * 8 + 2 * 4 + 2;
/// First bytes of the SHA-256 of the run's identity and the record's number and body, which detect a moved record.
pub(super) const CHECKSUM_BYTES: usize = 6;
pub(super) const RECORD_BYTES: usize = BODY_BYTES + CHECKSUM_BYTES;
/// Code in place of the braking level without a collision.
const NO_CONTACT: u8 = u8::MAX;
/// Code in place of the braking level if a controller failed. The field of the vehicle that is hit then holds the
/// vehicle of that controller.
const CONTROLLER_FAILED: u8 = u8::MAX - 1;

pub(super) enum JournalEntry {
    Record([u8; BODY_BYTES], [u8; CHECKSUM_BYTES]),
    /// The end of the file, or a truncated record.
    Truncated,
    /// Only zeros to the end, as a loss of power leaves them.
    Zeros,
}

/// Reads the next record, and rejects a damaged one.
pub(super) fn read_record(
    journal: &mut impl Read,
    path: &Path,
    identity: &str,
    index: u64,
) -> Result<JournalEntry, RunFolderError> {
    let unusable = DiskError::at(path);
    let (mut body, mut checksum) = ([0; BODY_BYTES], [0; CHECKSUM_BYTES]);
    match journal
        .read_exact(&mut body)
        .and_then(|()| journal.read_exact(&mut checksum))
    {
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => {
            return Ok(JournalEntry::Truncated);
        }
        read => read.map_err(unusable)?,
    }
    if checksum == record_checksum(identity, index, &body) {
        return Ok(JournalEntry::Record(body, checksum));
    }
    if body == [0; BODY_BYTES]
        && checksum == [0; CHECKSUM_BYTES]
        && is_all_zero(journal).map_err(unusable)?
    {
        return Ok(JournalEntry::Zeros);
    }
    let problem = format!(
        "record {} is damaged, its checksum does not match: this campaign cannot be resumed; remove its folder, or use \
         another --out",
        index + 1
    );
    Err(RunFolderError::damaged(path, problem))
}

pub(super) fn is_all_zero(rest: &mut impl Read) -> io::Result<bool> {
    let mut part = [0; 1 << 12];
    loop {
        match rest.read(&mut part)? {
            0 => return Ok(true),
            count if part.iter().take(count).any(|&byte| byte != 0) => return Ok(false),
            _ => {}
        }
    }
}

pub(super) fn record_checksum(
    identity: &str,
    index: u64,
    body: &[u8; BODY_BYTES],
) -> [u8; CHECKSUM_BYTES] {
    let digest = Sha256::default()
        .with(identity)
        .with(index.to_le_bytes())
        .with(body)
        .finish();
    let mut first = [0; CHECKSUM_BYTES];
    first
        .iter_mut()
        .zip(digest)
        .for_each(|(place, byte)| *place = byte);
    first
}

pub(in crate::falsify::campaign) fn encode(verdict: &RunVerdict) -> [u8; BODY_BYTES] {
    let (time_s, impact_speed_mps, vehicles, kind, class) = match (verdict.contact, verdict.failure)
    {
        (Some(contact), _) => {
            let FirstContact {
                time_s,
                front_vehicle,
                rear_vehicle,
                impact_speed_mps,
                ego_braking,
                rear_class,
            } = contact;
            (
                time_s,
                impact_speed_mps,
                [front_vehicle, rear_vehicle],
                ego_braking as u8,
                rear_class.number(),
            )
        }
        (None, Some((time_s, vehicle))) => (time_s, 0.0, [vehicle, 0], CONTROLLER_FAILED, 0),
        (None, None) => (0.0, 0.0, [0, 0], NO_CONTACT, 0),
    };
    let mut record = [0; BODY_BYTES];
    let doubles = [verdict.robustness, time_s, impact_speed_mps].map(f64::to_le_bytes);
    let vehicles = vehicles.map(u32::to_le_bytes);
    let bytes = doubles
        .concat()
        .into_iter()
        .chain(vehicles.concat())
        .chain([kind, class]);
    record
        .iter_mut()
        .zip(bytes)
        .for_each(|(place, byte)| *place = byte);
    record
}

pub(in crate::falsify::campaign) fn decode(record: &[u8; BODY_BYTES]) -> RunVerdict {
    let double = |index: usize| {
        let bytes = record
            .get(8 * index..8 * index + 8)
            .and_then(|bytes| bytes.try_into().ok());
        f64::from_le_bytes(bytes.unwrap_or_default())
    };
    let vehicle = |index: usize| {
        let bytes = record
            .get(24 + 4 * index..28 + 4 * index)
            .and_then(|bytes| bytes.try_into().ok());
        u32::from_le_bytes(bytes.unwrap_or_default())
    };
    let [.., braking, class] = *record;
    let contact = BrakingLevel::ALL
        .get(usize::from(braking))
        .map(|&ego_braking| FirstContact {
            time_s: double(1),
            front_vehicle: vehicle(0),
            rear_vehicle: vehicle(1),
            impact_speed_mps: double(2),
            ego_braking,
            rear_class: VehicleClass::ALL
                .get(usize::from(class))
                .copied()
                .unwrap_or(VehicleClass::Light),
        });
    let failed = (braking == CONTROLLER_FAILED).then(|| (double(1), vehicle(0)));
    RunVerdict {
        robustness: double(0),
        contact,
        failure: failed,
    }
}
