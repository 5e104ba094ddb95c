//! Values of conversions and frames, and limits of links.

use std::io::Cursor;
use std::path::Path;

use super::test_file::{TestFile, TestFrame, frames_file};
use super::{DbcFile, MdfError, SignalSet, SignalStream, SignalUse};
use crate::recording::map::RecordingMap;

const DBC: &str = r#"VERSION ""

NS_ :

BS_:

BU_: ECU

BO_ 512 Radar: 8 ECU
 SG_ Gap : 0|16@1+ (0.01,0) [0|0] "m" ECU

BO_ 2566844926 CCVS: 8 ECU
 SG_ WheelSpeed : 8|16@1+ (0.00390625,0) [0|250.996] "km/h" ECU
 SG_ Parking : 2|2@1+ (1,0) [0|3] "" ECU

BO_ 2566846462 Other: 8 ECU
 SG_ Distance : 0|8@1+ (1,0) [0|250] "m" ECU

BO_ 2566846208 OwnSender: 8 ECU
 SG_ Unused : 0|8@1+ (1,0) [0|250] "m" ECU
"#;
/// CCVS from the sender 0x21, with another priority.
const CCVS: u32 = 0x8000_0000 | 0x0cfe_f121;

/// Returns the values of a signal of 16 bits with a conversion.
fn converted(
    build: impl FnOnce(&mut TestFile) -> u64,
    signal_use: SignalUse,
    raw: &[u16],
) -> Vec<f64> {
    let mut file = TestFile::new();
    let samples = file.samples(
        &raw.iter()
            .map(|raw| raw.to_le_bytes().to_vec())
            .collect::<Vec<_>>(),
    );
    let conversion = build(&mut file);
    file.group(&[("gap", 8, 16, 0, conversion)], 10, samples);
    let wanted = |name: &str| (name == "gap").then_some(signal_use);
    let mut stream = SignalStream::open(Cursor::new(file.bytes), None, &wanted).expect("readable");
    while stream.advance().expect("readable") {}
    stream.set.signals[0].values.clone()
}

fn assert_values(values: &[f64], expected: &[Option<f64>]) {
    let is_equal = |(value, expected): (&f64, &Option<f64>)| match expected {
        Some(expected) => value == expected,
        None => value.is_nan(),
    };
    assert!(
        values.len() == expected.len() && values.iter().zip(expected).all(is_equal),
        "{values:?} {expected:?}"
    );
}

/// The table names special values; all others have the scale of its default.
#[test]
fn texts_of_a_conversion_are_missing_and_other_values_have_its_scale() {
    let raw = [3500, 65535, 65534, 60001];
    let special_values = |file: &mut TestFile| {
        let scale = file.conversion(1, &[], &[-5.0, 0.01]);
        let [sna, error] = ["SNA", "error"].map(|text| file.text(text));
        file.conversion(7, &[sna, error, scale], &[65535.0, 65534.0])
    };
    let all_but_two = [Some(30.0), None, None, Some(60001.0 * 0.01 - 5.0)];
    assert_values(
        &converted(special_values, SignalUse::Number, &raw),
        &all_but_two,
    );
    let ranges = |file: &mut TestFile| {
        let scale = file.conversion(1, &[], &[-5.0, 0.01]);
        let sna = file.text("SNA");
        file.conversion(8, &[sna, scale, 0], &[65535.0, 65535.0, 0.0, 60000.0])
    };
    assert_values(
        &converted(ranges, SignalUse::Number, &raw),
        &[Some(30.0), None, None, None],
    );
    let nested = |file: &mut TestFile| {
        let scale = file.conversion(2, &[], &[0.0, 2.0, -70.0, 0.0, 0.0, 1.0]);
        let inner = file.conversion(8, &[scale, 0], &[0.0, 65000.0]);
        let sna = file.text("SNA");
        file.conversion(7, &[sna, inner], &[65535.0])
    };
    assert_values(
        &converted(nested, SignalUse::Number, &[35, 65535, 65534]),
        &[Some(0.0), None, None],
    );
}

/// Without any scale, the table only names values: lanes and ids keep their numbers.
#[test]
fn ids_keep_the_numbers_that_have_texts() {
    let lanes = |file: &mut TestFile| {
        let [left, right] = ["left", "right"].map(|text| file.text(text));
        file.conversion(7, &[left, right, 0], &[1.0, 2.0])
    };
    assert_values(
        &converted(lanes, SignalUse::Id, &[1, 2, 3]),
        &[Some(1.0), Some(2.0), Some(3.0)],
    );
    assert_values(
        &converted(lanes, SignalUse::Number, &[1, 2, 3]),
        &[None, None, Some(3.0)],
    );
}

fn map(keys: &str) -> RecordingMap {
    let text = format!(
        "version = 1\nname = \"p\"\ndbc = \"bus.dbc\"\n{keys}\ntime.clock = {{ column = \"time\" }}\n[layout.pairs]\n\
         spacing = {{ column = \"Gap\" }}\nfollower_speed = {{ column = \"WheelSpeed\" }}\n\
         leader_speed = {{ column = \"Lead\" }}\n"
    );
    RecordingMap::from_toml(&text, Path::new("map.toml")).expect("a map")
}

fn values_of(signal: &str, frames: &[TestFrame], keys: &str) -> Result<Vec<f64>, MdfError> {
    let dbc =
        DbcFile::parse(DBC.as_bytes(), Path::new("bus.dbc"))?.with_frames_of(map(keys).spec())?;
    let signals = SignalSet::read(Cursor::new(frames_file(frames)), Some(&dbc), &|name| {
        name == signal
    })?;
    Ok(signals
        .signals
        .first()
        .map(|signal| signal.values.clone())
        .unwrap_or_default())
}

/// Two radars of one make send the same id on two buses.
#[test]
fn a_signal_of_two_bus_channels_needs_a_choice() {
    let gap = |channel: u8, metres: f64| {
        let [low, high] = ((metres * 100.0) as u16).to_le_bytes();
        (channel, 512, [low, high, 0, 0, 0, 0, 0, 0])
    };
    let frames = [gap(1, 30.0), gap(2, 45.0), gap(1, 29.0), gap(2, 44.0)];
    let message = values_of("Gap", &frames, "")
        .expect_err("ambiguous")
        .to_string();
    let expected = "the signal Gap is in frames of the bus channels 1 and 2: choose one with `bus_channel` in the map";
    assert_eq!(message, expected);
    assert_eq!(
        values_of("Gap", &frames, "bus_channel = 1"),
        Ok(vec![30.0, 29.0])
    );
    assert_eq!(
        values_of("Gap", &frames, "bus_channel = { Radar = 2 }"),
        Ok(vec![45.0, 44.0])
    );
    assert_eq!(values_of("Gap", &frames[..1], ""), Ok(vec![30.0]));
    // A choice for another message leaves this one ambiguous.
    assert!(values_of("Gap", &frames, "bus_channel = { CCVS = 2 }").is_err());
    let unknown = values_of("Gap", &frames, "bus_channel = { Lidar = 2 }")
        .expect_err("unknown")
        .to_string();
    assert_eq!(
        unknown,
        "bus.dbc: has no message Lidar, which `bus_channel` of the map names"
    );
}

#[test]
fn frames_from_any_sender_are_decoded_by_parameter_group() {
    let speed = |id: u32, raw: u16| {
        let [low, high] = raw.to_le_bytes();
        (1, id, [0xff, low, high, 0xff, 0xff, 0xff, 0xff, 0xff])
    };
    let frames = [
        speed(CCVS, 20_480),
        speed(0x8000_0000 | 0x18fe_f221, 1),
        speed(0x7f1, 2),
    ];
    assert_eq!(values_of("WheelSpeed", &frames, ""), Ok(vec![80.0]));
    // The priority is no part of the group.
    let frames = [speed(0x98fe_f121, 20_480), speed(CCVS, 20_736)];
    assert_eq!(values_of("WheelSpeed", &frames, ""), Ok(vec![80.0, 81.0]));
    let frames = [speed(CCVS, 20_480), speed(0x98fe_f100, 256)];
    let message = values_of("WheelSpeed", &frames, "")
        .expect_err("two senders")
        .to_string();
    assert!(
        message.contains("the source addresses 33 and 0: choose one with `source_address`"),
        "{message}"
    );
    assert_eq!(
        values_of("WheelSpeed", &frames, "source_address = 33"),
        Ok(vec![80.0])
    );
    assert_eq!(
        values_of("WheelSpeed", &frames, "source_address = { CCVS = 0 }"),
        Ok(vec![1.0])
    );
    // An id that the DBC file defines for one sender is another message.
    let frames =
        [speed(0x98fe_f700, 1), speed(0x98fe_f721, 2)].map(|(bus, id, _)| (bus, id, [7; 8]));
    assert_eq!(values_of("Distance", &frames, ""), Ok(vec![7.0]));
}

/// A log without any frame of a message has no signal of it, as a text without a column.
#[test]
fn a_message_without_frames_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("bus.dbc"), DBC).expect("written");
    let map = "version = 1\nname = \"p\"\ndbc = \"bus.dbc\"\nbus_channel = 1\ntime.clock = { column = \"time\" }\n\
               [layout.pairs]\nspacing = { column = \"Gap\" }\nfollower_speed = { column = \"WheelSpeed\" }\n\
               relative_speed = { column = \"Parking\" }\n";
    let map = RecordingMap::from_toml(map, &folder.path().join("map.toml")).expect("a map");
    let frames: Vec<TestFrame> = (0..20)
        .map(|_| (1, 512, [0x88, 0x13, 0, 0, 0, 0, 0, 0]))
        .collect();
    let read = crate::recording::read(&frames_file(&frames), Path::new("a.mf4"), Some(&map));
    let message = read.expect_err("no frame").to_string();
    let expected = "a.mf4: the file has no frame with the signal WheelSpeed of the message CCVS (id 0x18fef1fe, \
                    parameter group 65265) on the bus channel 1";
    assert_eq!(message, expected);
}

/// SAE J1939-71 reserves the values from 0xFB in the first byte on.
#[test]
fn reserved_values_of_j1939_are_missing() {
    let speed = |raw: u16| {
        let [low, high] = raw.to_le_bytes();
        (1, CCVS, [0b1111_0011, low, high, 0, 0, 0, 0, 0])
    };
    let frames = [0xfaff, 0xfb00, 0xfe00, 0xffff, 0].map(speed);
    let values = values_of("WheelSpeed", &frames, "").expect("readable");
    assert_values(
        &values,
        &[Some(250.996_093_75), None, None, None, Some(0.0)],
    );
    let bits = |bits: u8| (1, CCVS, [bits << 2, 0, 0, 0, 0, 0, 0, 0]);
    let values = values_of("Parking", &[0, 1, 2, 3].map(bits), "").expect("readable");
    assert_values(&values, &[Some(0.0), Some(1.0), None, None]);
    // Standard ids are not J1939.
    let gap = values_of("Gap", &[(1, 512, [0xff; 8])], "").expect("readable");
    assert_values(&gap, &[Some(655.35)]);
}

#[test]
fn links_that_name_a_block_repeatedly_are_refused() {
    let read = |file: TestFile| {
        let bytes = file.bytes;
        SignalSet::read(Cursor::new(bytes), None, &|name| name.starts_with("gap")).map(drop)
    };
    // A list that names one block of samples twice.
    let mut file = TestFile::new();
    let samples = file.samples(&[vec![0, 1]]);
    let list = file.add(b"DL", &[0, samples, samples], &[0; 16]);
    file.group(&[("gap", 8, 16, 0, 0)], 10, list);
    assert_eq!(
        read(file),
        Err(MdfError::Damaged {
            offset: samples,
            problem: "two links name the block"
        })
    );
    // Blocks within each other, all of which end with the file.
    let mut file = TestFile::new();
    let blocks: Vec<u64> = (0..100).map(|_| file.add(b"DT", &[], &[])).collect();
    let list = file.add(b"DL", &[&[0][..], &blocks].concat(), &[0; 16]);
    file.group(&[("gap", 8, 16, 0, 0)], 10, list);
    let end = file.bytes.len() as u64;
    for &at in &blocks {
        file.bytes[at as usize + 8..at as usize + 16].copy_from_slice(&(end - at).to_le_bytes());
    }
    let refused = read(file).expect_err("within each other").to_string();
    assert!(
        refused.contains("two blocks with samples share bytes"),
        "{refused}"
    );
    // Many channels with one long conversion.
    let mut file = TestFile::new();
    let values: Vec<f64> = (0..60_000).map(f64::from).collect();
    let conversion = file.conversion(4, &[], &values);
    let samples = file.samples(&[vec![0, 1]]);
    let names: Vec<String> = (0..200).map(|index| format!("gap{index}")).collect();
    let channels: Vec<_> = names
        .iter()
        .map(|name| (name.as_str(), 8, 16, 0, conversion))
        .collect();
    file.group(&channels, 10, samples);
    let refused = read(file).expect_err("480 KB, 200 times").to_string();
    assert!(
        refused.contains("the links name the same blocks too often"),
        "{refused}"
    );
}

/// A bomb of compressed zeros has a limit after decompression.
#[test]
fn blocks_decompress_to_a_limited_size() {
    use std::io::Write;
    let mut file = TestFile::new();
    let zeros = vec![0; 64 << 20];
    let mut packed = flate2::write::ZlibEncoder::new(Vec::new(), flate2::Compression::best());
    packed.write_all(&zeros).unwrap();
    let packed = packed.finish().unwrap();
    let mut header = [0; 24];
    header[..2].copy_from_slice(b"DT");
    header[8..16].copy_from_slice(&(zeros.len() as u64).to_le_bytes());
    header[16..24].copy_from_slice(&(packed.len() as u64).to_le_bytes());
    let blocks: Vec<u64> = (0..9)
        .map(|_| file.add(b"DZ", &[], &[&header[..], &packed].concat()))
        .collect();
    let list = file.add(b"DL", &[&[0][..], &blocks].concat(), &[0; 16]);
    // A record of a MiB, so that few values are read.
    file.group(&[("gap", 8, 16, 0, 0)], 1 << 20, list);
    let refused =
        SignalSet::read(Cursor::new(file.bytes), None, &|name| name == "gap").expect_err("576 MiB");
    assert_eq!(
        refused,
        MdfError::TooLarge {
            limit: 512 << 20,
            what: "bytes after decompression"
        }
    );
}

#[test]
fn multiplexers_that_select_each_other_are_refused() {
    let dbc = "VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ECU\n\nBO_ 513 X: 8 ECU\n SG_ A M : 0|4@1+ (1,0) [0|0] \"\" ECU\n \
               SG_ B m3M : 4|4@1+ (1,0) [0|0] \"\" ECU\n SG_ Gap m5 : 8|16@1+ (0.01,-5) [0|0] \"m\" ECU\n\n\
               SG_MUL_VAL_ 513 B A 3-3;\nSG_MUL_VAL_ 513 A B 1-2;\nSG_MUL_VAL_ 513 Gap B 5-5;\n";
    let dbc = DbcFile::parse(dbc.as_bytes(), Path::new("bus.dbc")).expect("a DBC file");
    let read = SignalSet::read(Cursor::new(frames_file(&[])), Some(&dbc), &|name| {
        name == "Gap"
    });
    let message = read.expect_err("a circle").to_string();
    assert_eq!(
        message,
        "bus.dbc:12: more than 16 multiplexers select signal Gap, or each other"
    );
}

/// A signal, or its multiplexer, of an impossible length is named with its length.
#[test]
fn signals_of_impossible_length_are_named() {
    for (signals, expected) in [
        (
            " SG_ Gap : 0|0@1+ (0.01,-5) [0|0] \"m\" ECU\n",
            "bus.dbc:10: signal Gap has 0 bits, and crumple reads 1 to 64",
        ),
        (
            " SG_ Gap : 0|65@1+ (0.01,-5) [0|0] \"m\" ECU\n",
            "bus.dbc:10: signal Gap has 65 bits, and crumple reads 1 to 64",
        ),
        (
            " SG_ Gap : 0|16@1- (0.01,-5) [0|0] \"m\" ECU\n\nSIG_VALTYPE_ 513 Gap : 1;\n",
            "bus.dbc:10: signal Gap has 16 bits, but its floating-point numbers have 32",
        ),
        (
            " SG_ A M : 0|0@1+ (1,0) [0|0] \"\" ECU\n SG_ Gap m5 : 8|16@1+ (0.01,-5) [0|0] \"m\" ECU\n",
            "bus.dbc:10: signal A has 0 bits, and crumple reads 1 to 64",
        ),
    ] {
        let text =
            format!("VERSION \"\"\n\nNS_ :\n\nBS_:\n\nBU_: ECU\n\nBO_ 513 X: 16 ECU\n{signals}");
        let dbc = DbcFile::parse(text.as_bytes(), Path::new("bus.dbc")).expect("a DBC file");
        let read = SignalSet::read(Cursor::new(frames_file(&[])), Some(&dbc), &|name| {
            name == "Gap"
        });
        assert_eq!(read.expect_err("wrong").to_string(), expected);
    }
}

/// The id of a frame cannot come from the number of its record.
#[test]
fn a_virtual_channel_is_no_part_of_a_frame() {
    let mut file = frames_file(&[(1, 512, [0; 8])]);
    // Byte 9 and 32 bits, the place of the id.
    let byte_and_bits = [9, 0, 0, 0, 32, 0, 0, 0];
    let at = file
        .windows(byte_and_bits.len())
        .position(|bytes| bytes == byte_and_bits)
        .expect("the channel of the id");
    const VIRTUAL: u8 = 6;
    (file[at - 4], file[at + 4]) = (VIRTUAL, 0);
    let dbc = DbcFile::parse(DBC.as_bytes(), Path::new("bus.dbc"))
        .and_then(|dbc| dbc.with_frames_of(map("").spec()))
        .expect("a DBC file");
    let read = SignalSet::read(Cursor::new(file), Some(&dbc), &|name| name == "Gap");
    let message = read.expect_err("no id").to_string();
    assert!(
        message.contains("`CAN_DataFrame.ID` as a virtual channel"),
        "{message}"
    );
}
