//! Records of the journal: the verdict of an evaluation in a fixed number of bytes, with a checksum.

use std::io::{self, Read};
use std::path::Path;

use crumple_core::digest::Sha256;
use crumple_measure::{BrakingLevel, FirstCollision, RunVerdict};
use crumple_sim::scenario::VehicleClass;
use crumple_store::disk::DiskError;
use crumple_store::run_folder::RunFolderError;

/// Robustness, time and impact speed (doubles), two vehicles (32 bits), braking level or a code, and class (bytes).
pub(super) const BODY_BYTES: usize = 3 * 8 + 2 * 4 + 2;
/// First bytes of the SHA-256 of the run's identity and the record's number and body, which detect a moved record.
pub(super) const CHECKSUM_BYTES: usize = 6;
pub(super) const RECORD_BYTES: usize = BODY_BYTES + CHECKSUM_BYTES;
/// Code in place of the braking level without a collision.
const NO_COLLISION: u8 = u8::MAX;
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
    let mut body = [0; BODY_BYTES];
    let mut checksum = [0; CHECKSUM_BYTES];
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
        .for_each(|(target, byte)| *target = byte);
    first
}

/// Fields of a record after the robustness.
struct RecordFields {
    time_s: f64,
    impact_speed_mps: f64,
    vehicles: [u32; 2],
    /// Braking of the ego vehicle, or a number that says that there is no collision.
    kind: u8,
    class: u8,
}

impl RecordFields {
    fn from_verdict(verdict: &RunVerdict) -> Self {
        match (verdict.collision, verdict.failure) {
            (Some(collision), _) => Self {
                time_s: collision.time_s,
                impact_speed_mps: collision.impact_speed_mps,
                vehicles: [collision.front_vehicle, collision.rear_vehicle],
                kind: collision.ego_braking as u8,
                class: collision.rear_class.number(),
            },
            (None, Some((time_s, vehicle))) => Self {
                time_s,
                impact_speed_mps: 0.0,
                vehicles: [vehicle, 0],
                kind: CONTROLLER_FAILED,
                class: 0,
            },
            (None, None) => Self {
                time_s: 0.0,
                impact_speed_mps: 0.0,
                vehicles: [0, 0],
                kind: NO_COLLISION,
                class: 0,
            },
        }
    }
}

pub(in crate::falsify::campaign) fn encode(verdict: &RunVerdict) -> [u8; BODY_BYTES] {
    let fields = RecordFields::from_verdict(verdict);
    let mut record = [0; BODY_BYTES];
    let doubles =
        [verdict.robustness, fields.time_s, fields.impact_speed_mps].map(f64::to_le_bytes);
    let vehicles = fields.vehicles.map(u32::to_le_bytes);
    let bytes = doubles
        .concat()
        .into_iter()
        .chain(vehicles.concat())
        .chain([fields.kind, fields.class]);
    record
        .iter_mut()
        .zip(bytes)
        .for_each(|(target, byte)| *target = byte);
    record
}

pub(in crate::falsify::campaign) fn decode(record: &[u8; BODY_BYTES]) -> RunVerdict {
    let [.., braking, class] = *record;
    let collision = BrakingLevel::ALL
        .get(usize::from(braking))
        .map(|&ego_braking| FirstCollision {
            time_s: decode_double(record, 1),
            front_vehicle: decode_vehicle(record, 0),
            rear_vehicle: decode_vehicle(record, 1),
            impact_speed_mps: decode_double(record, 2),
            ego_braking,
            rear_class: VehicleClass::ALL
                .get(usize::from(class))
                .copied()
                .unwrap_or(VehicleClass::Light),
        });
    let failure = (braking == CONTROLLER_FAILED)
        .then(|| (decode_double(record, 1), decode_vehicle(record, 0)));
    RunVerdict {
        robustness: decode_double(record, 0),
        collision,
        failure,
    }
}

/// Reads one of the leading numbers of a record.
fn decode_double(record: &[u8; BODY_BYTES], index: usize) -> f64 {
    let bytes = record
        .get(8 * index..8 * index + 8)
        .and_then(|bytes| bytes.try_into().ok());
    f64::from_le_bytes(bytes.unwrap_or_default())
}

/// Reads one of the two vehicle indices of a record.
fn decode_vehicle(record: &[u8; BODY_BYTES], index: usize) -> u32 {
    let bytes = record
        .get(24 + 4 * index..28 + 4 * index)
        .and_then(|bytes| bytes.try_into().ok());
    u32::from_le_bytes(bytes.unwrap_or_default())
}
