//! Points of a long recording of traffic, sorted by time in temporary files.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
use std::collections::binary_heap::PeekMut;
use std::fs::{self, File};
use std::io::{self, BufReader, BufWriter, Read, Seek, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use super::tracks::TrackPoint;

/// Bytes of a point in a file.
const POINT_BYTES: usize = 56;

/// Sorted points in files, each of which is sorted.
#[derive(Default)]
pub(super) struct SpilledPoints {
    runs: Vec<TemporaryFile>,
}

/// A file that is removed when it is dropped.
struct TemporaryFile {
    file: File,
    /// Path, unless the system has already removed the name.
    path: Option<PathBuf>,
}

impl TemporaryFile {
    fn create() -> io::Result<Self> {
        static NUMBER: AtomicUsize = AtomicUsize::new(0);
        let number = NUMBER.fetch_add(1, Ordering::Relaxed);
        let path =
            std::env::temp_dir().join(format!("crumple-{}-{number}.points", std::process::id()));
        let file = File::options()
            .read(true)
            .write(true)
            .create_new(true)
            .open(&path)?;
        // Windows removes no open file.
        let path = Some(path).filter(|path| fs::remove_file(path).is_err());
        Ok(Self { file, path })
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        if let Some(path) = &self.path {
            let _ = fs::remove_file(path);
        }
    }
}

impl SpilledPoints {
    pub(super) fn is_empty(&self) -> bool {
        self.runs.is_empty()
    }

    /// Sorts points by time, writes them to a file, and clears them.
    pub(super) fn write(&mut self, points: &mut Vec<TrackPoint>) -> io::Result<()> {
        // Points are in order of their lines. A stable sort merges the sorted rows of each vehicle.
        let mut order: Vec<(i64, usize)> =
            points.iter().map(|point| point.time_ms).zip(0..).collect();
        order.sort_by_key(|&(time_ms, _)| time_ms);
        let mut run = TemporaryFile::create()?;
        let mut out = BufWriter::new(&run.file);
        order
            .into_iter()
            .try_for_each(|(_, index)| out.write_all(&encode(&points[index])))?;
        points.clear();
        out.flush()?;
        drop(out);
        run.file.rewind()?;
        self.runs.push(run);
        Ok(())
    }

    /// Returns all points in order of time.
    pub(super) fn read(&mut self) -> io::Result<SortedPoints<'_>> {
        let runs = self
            .runs
            .iter_mut()
            .map(|run| BufReader::with_capacity(1 << 16, &mut run.file));
        let mut sorted = SortedPoints {
            runs: runs.collect(),
            heads: Vec::new(),
            order: BinaryHeap::new(),
        };
        for (run, file) in sorted.runs.iter_mut().enumerate() {
            let head = read_point(file)?;
            sorted
                .order
                .extend(head.map(|head| Reverse((head.time_ms, head.line, run))));
            sorted.heads.push(head.unwrap_or_default());
        }
        Ok(sorted)
    }
}

/// Returns the next point of a file; `None` at its end.
fn read_point(file: &mut impl Read) -> io::Result<Option<TrackPoint>> {
    let mut bytes = [0; POINT_BYTES];
    match file.read_exact(&mut bytes) {
        Ok(()) => Ok(Some(decode(&bytes))),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(None),
        Err(error) => Err(error),
    }
}

pub(super) struct SortedPoints<'s> {
    runs: Vec<BufReader<&'s mut File>>,
    /// Next point of each run.
    heads: Vec<TrackPoint>,
    /// Time, line and run of these points.
    order: BinaryHeap<Reverse<(i64, u64, usize)>>,
}

impl SortedPoints<'_> {
    pub(super) fn next(&mut self) -> io::Result<Option<TrackPoint>> {
        let Some(mut first) = self.order.peek_mut() else {
            return Ok(None);
        };
        let Reverse((_, _, run)) = *first;
        let Some(next) = read_point(&mut self.runs[run])? else {
            PeekMut::pop(first);
            return Ok(Some(self.heads[run]));
        };
        *first = Reverse((next.time_ms, next.line, run));
        Ok(Some(std::mem::replace(&mut self.heads[run], next)))
    }
}

/// Unknown numbers are NaN.
fn encode(point: &TrackPoint) -> [u8; POINT_BYTES] {
    let ids = u64::from(point.vehicle) | u64::from(point.lane) << 32;
    let acceleration_mps2 = point.acceleration_mps2.map(f64::from);
    let [position, speed, length, acceleration] = [
        point.position_m,
        point.speed_mps,
        point.length_m,
        acceleration_mps2,
    ]
    .map(|value| value.unwrap_or(f64::NAN).to_bits());
    let words = [
        ids,
        point.time_ms as u64,
        point.line,
        position,
        speed,
        length,
        acceleration,
    ];
    let mut bytes = [0; POINT_BYTES];
    for (bytes, word) in bytes.chunks_exact_mut(8).zip(words) {
        bytes.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

fn decode(bytes: &[u8; POINT_BYTES]) -> TrackPoint {
    let mut words = [0; POINT_BYTES / 8];
    for (word, bytes) in words.iter_mut().zip(bytes.chunks_exact(8)) {
        *word = bytes
            .iter()
            .rev()
            .fold(0, |all: u64, byte| all << 8 | u64::from(*byte));
    }
    let [ids, time, line, position, speed, length, acceleration] = words;
    let [position_m, speed_mps, length_m, acceleration_mps2] =
        [position, speed, length, acceleration]
            .map(|bits| Some(f64::from_bits(bits)).filter(|value| !value.is_nan()));
    TrackPoint {
        vehicle: ids as u32,
        lane: (ids >> 32) as u32,
        time_ms: time as i64,
        line,
        position_m,
        speed_mps,
        length_m,
        acceleration_mps2: acceleration_mps2.map(|value| value as f32),
        ..Default::default()
    }
}
