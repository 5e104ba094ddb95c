//! Exact and compact text for verdicts and cells: journal bytes, or bits, in hexadecimal.

pub(in crate::falsify) mod verdict {
    use crumple_world::measure::RunVerdict;
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    use crate::falsify::campaign::journal;

    pub(in crate::falsify) fn serialize<S: Serializer>(verdict: &RunVerdict, to: S) -> Result<S::Ok, S::Error> {
        super::to_hex(&journal::encode(verdict)).serialize(to)
    }

    pub(in crate::falsify) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<RunVerdict, D::Error> {
        let text = String::deserialize(from)?;
        let read = super::parse_hex(&text).and_then(|bytes| bytes.try_into().ok());
        let verdict = read.as_ref().map(journal::decode).filter(|verdict| !verdict.robustness.is_nan());
        // Reject bytes that are not written back identically, such as an unknown braking level or class.
        let is_whole = |verdict: &RunVerdict| super::to_hex(&journal::encode(verdict)) == text;
        verdict.filter(is_whole).ok_or_else(|| de::Error::custom("expected an encoded verdict"))
    }
}

pub(super) mod cells {
    use serde::{Deserialize, Deserializer, Serialize, Serializer, de};

    pub(in crate::falsify) fn serialize<S: Serializer>(cells: &[bool], to: S) -> Result<S::Ok, S::Error> {
        let byte = |eight: &[bool]| eight.iter().fold(0, |byte, &cell| byte << 1 | u8::from(cell)) << (8 - eight.len());
        let bytes: Vec<u8> = cells.chunks(8).map(byte).collect();
        (cells.len(), super::to_hex(&bytes)).serialize(to)
    }

    pub(in crate::falsify) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<bool>, D::Error> {
        let (length, text) = <(usize, String)>::deserialize(from)?;
        let bytes = super::parse_hex(&text).filter(|bytes| bytes.len() == length.div_ceil(8));
        let bytes = bytes.ok_or_else(|| de::Error::custom("the number of cells differs from the stated number"))?;
        let cells = bytes.iter().flat_map(|byte| (0..8).rev().map(move |bit| byte >> bit & 1 == 1));
        Ok(cells.take(length).collect())
    }
}

fn to_hex(bytes: &[u8]) -> String {
    let digit = |half: u8| char::from_digit(u32::from(half), 16).unwrap_or('0');
    bytes.iter().flat_map(|byte| [digit(byte >> 4), digit(byte & 15)]).collect()
}

fn parse_hex(text: &str) -> Option<Vec<u8>> {
    let digit = |letter: &u8| char::from(*letter).to_digit(16).filter(|_| !letter.is_ascii_uppercase());
    let pair = |pair: &[u8]| match pair {
        [high, low] => Some((digit(high)? << 4 | digit(low)?) as u8),
        _ => None,
    };
    text.as_bytes().chunks(2).map(pair).collect()
}

#[cfg(test)]
mod tests {
    use serde::{Deserialize, Serialize};

    #[derive(Debug, PartialEq, Serialize, Deserialize)]
    struct Cells(#[serde(with = "super::cells")] Vec<bool>);

    #[test]
    fn cells_are_read_as_they_were_written() {
        for length in 0..40 {
            let cells = Cells((0..length).map(|cell| cell % 3 == 0 || cell % 7 == 2).collect());
            let text = serde_json::to_string(&cells).unwrap();
            assert_eq!(serde_json::from_str::<Cells>(&text).unwrap(), cells, "{text}");
        }
        for wrong in ["[9,\"ff\"]", "[8,\"f\"]", "[8,\"fg\"]", "[8,\"FF\"]", "[8,\"é\"]", "[1000000000000,\"\"]"] {
            assert!(serde_json::from_str::<Cells>(wrong).is_err(), "{wrong}");
        }
    }
}
