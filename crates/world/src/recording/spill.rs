//! Points of a long recording of traffic, sorted by time in temporary files.

use std::cmp::Reverse;
use std::collections::BinaryHeap;
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
        let path = std::env::temp_dir().join(format!("crumple-{}-{number}.points", std::process::id()));
        let file = File::options().read(true).write(true).create_new(true).open(&path)?;
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
        points.sort_by_cached_key(|point| (point.time_ms, point.line));
        let mut run = TemporaryFile::create()?;
        let mut out = BufWriter::new(&run.file);
        points.drain(..).try_for_each(|point| out.write_all(&encode(&point)))?;
        out.flush()?;
        drop(out);
        run.file.rewind()?;
        self.runs.push(run);
        Ok(())
    }

    /// Returns all points in order of time.
    pub(super) fn read(&mut self) -> io::Result<SortedPoints<'_>> {
        let runs = self.runs.iter_mut().map(|run| BufReader::with_capacity(1 << 16, &mut run.file));
        let mut sorted = SortedPoints { runs: runs.collect(), heads: Vec::new(), order: BinaryHeap::new() };
        sorted.heads = vec![TrackPoint::default(); sorted.runs.len()];
        (0..sorted.runs.len()).try_for_each(|run| sorted.advance(run))?;
        Ok(sorted)
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
        let Some(Reverse((_, _, run))) = self.order.pop() else { return Ok(None) };
        let point = self.heads[run];
        self.advance(run)?;
        Ok(Some(point))
    }

    fn advance(&mut self, run: usize) -> io::Result<()> {
        let mut bytes = [0; POINT_BYTES];
        match self.runs[run].read_exact(&mut bytes) {
            Ok(()) => {
                let point = decode(&bytes);
                self.order.push(Reverse((point.time_ms, point.line, run)));
                self.heads[run] = point;
                Ok(())
            }
            Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(()),
            Err(error) => Err(error),
        }
    }
}

/// Unknown numbers are NaN.
fn encode(point: &TrackPoint) -> [u8; POINT_BYTES] {
    let number = |value: Option<f64>| value.unwrap_or(f64::NAN).to_bits();
    let ids = u64::from(point.vehicle) | u64::from(point.lane) << 32;
    let [position, speed, length] = [point.position_m, point.speed_mps, point.length_m].map(number);
    let acceleration = number(point.acceleration_mps2.map(f64::from));
    let words = [ids, point.time_ms as u64, point.line, position, speed, length, acceleration];
    let mut bytes = [0; POINT_BYTES];
    for (place, word) in bytes.chunks_exact_mut(8).zip(words) {
        place.copy_from_slice(&word.to_le_bytes());
    }
    bytes
}

fn decode(bytes: &[u8; POINT_BYTES]) -> TrackPoint {
    let mut words = [0; POINT_BYTES / 8];
    for (word, place) in words.iter_mut().zip(bytes.chunks_exact(8)) {
        *word = place.iter().rev().fold(0, |all: u64, byte| all << 8 | u64::from(*byte));
    }
    let [ids, time, line, position, speed, length, acceleration] = words;
    let number = |bits| Some(f64::from_bits(bits)).filter(|value| !value.is_nan());
    TrackPoint {
        vehicle: ids as u32,
        lane: (ids >> 32) as u32,
        time_ms: time as i64,
        line,
        position_m: number(position),
        speed_mps: number(speed),
        length_m: number(length),
        acceleration_mps2: number(acceleration).map(|value| value as f32),
        ..Default::default()
    }
}
