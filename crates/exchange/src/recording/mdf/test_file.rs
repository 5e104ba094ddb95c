//! Writer of small MDF 4 files for tests.

/// Channel of a group: name, first byte, number of bits, data type, and offset of its conversion.
pub(super) type TestChannel<'n> = (&'n str, u32, u32, u8, u64);

/// A file under construction.
pub(super) struct TestFile {
    pub(super) bytes: Vec<u8>,
}

impl TestFile {
    pub(super) fn new() -> Self {
        let mut bytes = vec![0; 64];
        bytes[..12].copy_from_slice(b"MDF     4.10");
        bytes[28..30].copy_from_slice(&410_u16.to_le_bytes());
        let mut file = Self { bytes };
        file.add(b"HD", &[0; 6], &[0; 32]);
        file
    }

    /// Adds a block. Returns its offset.
    pub(super) fn add(&mut self, kind: &[u8; 2], links: &[u64], data: &[u8]) -> u64 {
        let at = self.bytes.len() as u64;
        let length = (24 + 8 * links.len() + data.len()) as u64;
        self.bytes
            .extend([&b"##"[..], kind, &[0; 4], &length.to_le_bytes()].concat());
        [links.len() as u64]
            .iter()
            .chain(links)
            .for_each(|number| self.bytes.extend(number.to_le_bytes()));
        self.bytes.extend(data);
        self.bytes.resize(self.bytes.len().div_ceil(8) * 8, 0);
        at
    }

    pub(super) fn text(&mut self, text: &str) -> u64 {
        self.add(b"TX", &[], format!("{text}\0").as_bytes())
    }

    /// Adds a conversion with its texts and conversions.
    pub(super) fn conversion(&mut self, kind: u8, references: &[u64], values: &[f64]) -> u64 {
        let mut data = vec![kind, 0, 0, 0];
        data.extend((references.len() as u16).to_le_bytes());
        data.extend((values.len() as u16).to_le_bytes());
        data.extend([0; 16]);
        data.extend(values.iter().flat_map(|value| value.to_le_bytes()));
        self.add(b"CC", &[&[0; 4], references].concat(), &data)
    }

    /// Adds a group of channels, whose clock is the first 8 bytes of each record, and links to its samples.
    pub(super) fn group(&mut self, channels: &[TestChannel<'_>], record_bytes: u32, samples: u64) {
        let mut next = 0;
        let clock = ("time", 0, 64, 4, 0);
        for (name, byte, bits, data_type, conversion) in
            channels.iter().copied().rev().chain([clock])
        {
            let name_at = self.text(name);
            let mut data = [0; 72];
            (data[0], data[1], data[2]) = (
                if name == "time" { 2 } else { 0 },
                u8::from(name == "time"),
                data_type,
            );
            data[4..8].copy_from_slice(&byte.to_le_bytes());
            data[8..12].copy_from_slice(&bits.to_le_bytes());
            next = self.add(b"CN", &[next, 0, name_at, 0, conversion, 0, 0, 0], &data);
        }
        let mut data = [0; 32];
        data[24..28].copy_from_slice(&record_bytes.to_le_bytes());
        let group = self.add(b"CG", &[0, next, 0, 0, 0, 0], &data);
        let data_group = self.add(b"DG", &[0, group, samples, 0], &[0; 8]);
        // The link of the header to the first group of data.
        self.bytes[88..96].copy_from_slice(&data_group.to_le_bytes());
    }

    /// Adds samples: a time each 0.1 s with the other bytes of the record.
    pub(super) fn samples(&mut self, records: &[Vec<u8>]) -> u64 {
        let times = (0..records.len()).map(|index| index as f64 / 10.0);
        let data: Vec<u8> = times
            .zip(records)
            .flat_map(|(at_s, rest)| [&at_s.to_le_bytes()[..], rest].concat())
            .collect();
        self.add(b"DT", &[], &data)
    }
}

/// A frame: bus channel, id with the bit of extended ones, and its bytes.
pub(in crate::recording) type TestFrame = (u8, u32, [u8; 8]);

/// Returns the record of a frame without its time.
fn frame_record((channel, id, bytes): &TestFrame) -> Vec<u8> {
    let plain = id & 0x1fff_ffff;
    [
        &[*channel][..],
        &plain.to_le_bytes(),
        &[u8::from(id >> 31 == 1), 8],
        bytes,
    ]
    .concat()
}

/// Returns a file of raw CAN frames.
pub(in crate::recording) fn frames_file(frames: &[TestFrame]) -> Vec<u8> {
    let mut file = TestFile::new();
    let samples = file.samples(&frames.iter().map(frame_record).collect::<Vec<_>>());
    let channels = [
        ("CAN_DataFrame.BusChannel", 8, 8, 0, 0),
        ("CAN_DataFrame.ID", 9, 32, 0, 0),
        ("CAN_DataFrame.IDE", 13, 8, 0, 0),
        ("CAN_DataFrame.DataLength", 14, 8, 0, 0),
        ("CAN_DataFrame.DataBytes", 15, 64, 10, 0),
    ];
    file.group(&channels, 23, samples);
    file.bytes
}
