//! Import of long recordings: megabytes of the file per second of processor time, and the peak of memory.
//!
//! `cargo bench --bench recordings --all-features` writes files of 1 GB into the temporary folder, one after another;
//! `cargo bench --bench recordings --all-features -- 0.1` files of 0.1 GB. Targets: 200 MB/s of CSV, 400 MB/s of MDF,
//! and 500 MB of memory at any length.

#![allow(
    clippy::expect_used,
    clippy::print_stdout,
    reason = "a bench prints, and may stop at what cannot happen"
)]

use std::fs::File;
use std::io::{BufWriter, Result, Write};
use std::path::Path;

use crumple_exchange::recording::map::RecordingMap;
use crumple_exchange::recording::{ImportOptions, import};

const CHANNELS: usize = 16;
const PAIRS: &str = r#"version = 1
name = "pairs"
time.clock = { column = "c0" }

[layout.pairs]
spacing = { column = "c1", from = "bumper-to-bumper" }
follower_speed = { column = "c2" }
leader_speed = { column = "c3" }
"#;

/// Time measurements, shared with the bench of the targets.
#[allow(
    dead_code,
    unreachable_pub,
    reason = "this bench uses one of its functions"
)]
#[path = "targets/clock.rs"]
mod clock;

use clock::cpu_time_s;

fn main() {
    let size = std::env::args()
        .filter_map(|word| word.parse::<f64>().ok())
        .next()
        .unwrap_or(1.0);
    let bytes = (size * 1e9) as u64;
    let ngsim = RecordingMap::built_in("ngsim")
        .expect("built in")
        .expect("a map");
    let pairs = RecordingMap::from_toml(PAIRS, Path::new("pairs.toml")).expect("a map");
    let folder = tempfile::tempdir().expect("a folder");
    for (name, map, write) in [
        (
            "pairs.csv",
            &pairs,
            write_pairs as fn(&mut BufWriter<File>, u64) -> Result<()>,
        ),
        ("vehicle-by-vehicle.csv", &ngsim, write_tracks),
        ("pairs.mf4", &pairs, write_mdf),
    ] {
        let path = folder.path().join(name);
        let mut out = BufWriter::new(File::create(&path).expect("a file"));
        write(&mut out, bytes)
            .and_then(|()| out.flush())
            .expect("space on the disk");
        let length = path.metadata().expect("the file").len() as f64 / 1e6;
        let begin = cpu_time_s();
        let mut scenarios = 0;
        let mut take = |_| {
            scenarios += 1;
            true
        };
        import(
            std::slice::from_ref(&path),
            Some(map),
            &ImportOptions::default(),
            None,
            &mut take,
        )
        .expect("readable");
        let seconds = cpu_time_s() - begin;
        println!(
            "{name}: {length:.0} MB in {seconds:.2} s, {:.0} MB/s, {scenarios} scenarios",
            length / seconds
        );
        std::fs::remove_file(&path).expect("the file");
    }
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    status
        .lines()
        .filter(|line| line.starts_with("VmHWM"))
        .for_each(|line| println!("peak memory {line}"));
}

/// Returns time, gap, both speeds and other signals of a row at 10 Hz; the leader brakes each ten minutes.
fn row(index: u64) -> [f64; CHANNELS] {
    let at_s = index as f64 / 10.0;
    let speed_mps = |at_s: f64| 25.0 - 6.0 * (1.0 - ((at_s % 600.0) - 300.0).abs() / 4.0).max(0.0);
    let [leader_mps, own_mps] = [speed_mps(at_s), speed_mps(at_s - 1.0)];
    let mut row = [at_s; CHANNELS];
    row[1] = 25.0 + 0.5 * (leader_mps - own_mps);
    (row[2], row[3]) = (own_mps, leader_mps);
    row.iter_mut()
        .enumerate()
        .skip(4)
        .for_each(|(channel, value)| *value = (channel as f64 * at_s).sin());
    row
}

fn write_pairs(out: &mut BufWriter<File>, bytes: u64) -> Result<()> {
    let names: Vec<_> = (0..CHANNELS).map(|channel| format!("c{channel}")).collect();
    writeln!(out, "{}", names.join(","))?;
    let mut written = 0;
    for index in 0.. {
        let fields: Vec<_> = row(index)
            .iter()
            .map(|value| format!("{value:.3}"))
            .collect();
        let line = fields.join(",");
        writeln!(out, "{line}")?;
        written += line.len() as u64 + 1;
        if written > bytes {
            break;
        }
    }
    Ok(())
}

/// Writes vehicles of NGSIM, each for a minute, one second after the one ahead in its lane.
fn write_tracks(out: &mut BufWriter<File>, bytes: u64) -> Result<()> {
    writeln!(
        out,
        "Vehicle_ID,Frame_ID,Total_Frames,Global_Time,Local_X,Local_Y,Global_X,Global_Y,v_Length,v_Width,v_Class,\
         v_Vel,v_Acc,Lane_ID,Preceding,Following,Space_Headway,Time_Headway"
    )?;
    let mut written = 0;
    for vehicle in 0.. {
        let (lane, start) = (vehicle % 5 + 1, vehicle / 5 * 20);
        for frame in 0..600 {
            let at_s = frame as f64 / 10.0;
            let line = format!(
                "{vehicle},{},600,{},12.345,{:.3},6451137.641,1873344.962,14.5,4.9,2,{:.2},0.00,{lane},{},{},65.62,\
                 2.00\n",
                start + frame,
                1_118_846_980_200_u64 + 100 * (start + frame),
                at_s * 32.81,
                32.81,
                vehicle.max(5) - 5,
                vehicle + 5
            );
            out.write_all(line.as_bytes())?;
            written += line.len() as u64;
        }
        if written > bytes {
            break;
        }
    }
    Ok(())
}

/// Writes an MDF 4 file with one group of channels of 8 bytes, without compression.
fn write_mdf(out: &mut BufWriter<File>, bytes: u64) -> Result<()> {
    let record_bytes = 8 * CHANNELS as u64;
    let rows = bytes / record_bytes;
    let mut blocks = vec![0; 64];
    blocks[..12].copy_from_slice(b"MDF     4.10");
    blocks[28..30].copy_from_slice(&410_u16.to_le_bytes());
    let mut add = |kind: &[u8], links: &[u64], data: &[u8]| {
        let at = blocks.len() as u64;
        let length = 24 + 8 * links.len() + data.len();
        blocks.extend([&b"##"[..], kind, &[0; 4], &(length as u64).to_le_bytes()].concat());
        [links.len() as u64]
            .iter()
            .chain(links)
            .for_each(|number| blocks.extend(number.to_le_bytes()));
        blocks.extend(data);
        blocks.resize(blocks.len().div_ceil(8) * 8, 0);
        at
    };
    // The header block comes first, and links to the group behind all other blocks.
    let channel_bytes = (24 + 64 + 72) + (24 + 8);
    let group_at = 64 + 24 + 48 + 32 + CHANNELS as u64 * channel_bytes;
    add(b"HD", &[group_at + 24 + 48 + 32, 0, 0, 0, 0, 0], &[0; 32]);
    let mut next = 0;
    for channel in (0..CHANNELS).rev() {
        let mut name = format!("c{channel}").into_bytes();
        name.resize(8, 0);
        let name = add(b"TX", &[], &name);
        let mut data = [0; 72];
        (data[0], data[1], data[2]) = if channel == 0 { (2, 1, 4) } else { (0, 0, 4) };
        data[4..8].copy_from_slice(&(8 * channel as u32).to_le_bytes());
        data[8..12].copy_from_slice(&64_u32.to_le_bytes());
        next = add(b"CN", &[next, 0, name, 0, 0, 0, 0, 0], &data);
    }
    let mut data = [0; 32];
    data[8..16].copy_from_slice(&rows.to_le_bytes());
    data[24..28].copy_from_slice(&(record_bytes as u32).to_le_bytes());
    let group = add(b"CG", &[0, next, 0, 0, 0, 0], &data);
    let samples = group + (24 + 48 + 32) + (24 + 32 + 8);
    add(b"DG", &[0, group, samples, 0], &[0; 8]);
    let begin = [
        &b"##DT"[..],
        &[0; 4],
        &(24 + rows * record_bytes).to_le_bytes(),
        &[0; 8],
    ]
    .concat();
    out.write_all(&blocks)?;
    out.write_all(&begin)?;
    for index in 0..rows {
        row(index)
            .iter()
            .try_for_each(|value| out.write_all(&value.to_le_bytes()))?;
    }
    Ok(())
}
