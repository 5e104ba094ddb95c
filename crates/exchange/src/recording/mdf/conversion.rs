//! Conversions of raw numbers to the unit of their channel.

use super::blocks::{Block, Blocks};
use super::{MdfError, SignalUse};

/// Maximum number of conversions within each other.
const MAX_DEPTH: usize = 3;
/// Maximum number of ranges that overlap each other, which are searched one after the other.
const MAX_OVERLAPPING: usize = 64;
/// Index of the first link of a conversion to a text or to another conversion.
const FIRST_REFERENCE: usize = 4;

#[derive(Debug, Clone)]
pub(super) enum ChannelConversion {
    Identity,
    /// A text, or no value at all.
    Missing,
    Linear {
        offset: f64,
        factor: f64,
    },
    Rational([f64; 6]),
    /// Keys and values; the nearest key counts unless values are interpolated.
    Table {
        points: Vec<[f64; 2]>,
        is_interpolated: bool,
    },
    /// Ranges with their values, and the value of all others.
    Ranges {
        ranges: Ranges,
        values: Vec<f64>,
        otherwise: f64,
    },
    /// Ranges or single values with their conversions, and the conversion of all others. Texts are missing values.
    Partial {
        ranges: Ranges,
        conversions: Vec<ChannelConversion>,
        otherwise: Box<ChannelConversion>,
    },
}

/// Ranges of numbers, each of which may be a single number.
#[derive(Debug, Clone)]
pub(super) struct Ranges {
    /// Lowest and highest number of each range, and its index, by the lowest number unless they overlap.
    bounds: Vec<([f64; 2], usize)>,
    includes_end: bool,
    overlap: bool,
}

impl ChannelConversion {
    /// Reads the conversion of a channel. `is_float` states that raw numbers are floating point numbers.
    pub(super) fn read(
        blocks: &mut Blocks,
        block: &Block,
        is_float: bool,
        signal_use: SignalUse,
    ) -> Result<Self, MdfError> {
        match block.number(0, 1)? {
            // Texts do not replace the number of an id.
            7..=10 if signal_use == SignalUse::Id => Ok(Self::Identity),
            _ => Self::read_nested(blocks, block, is_float, 0),
        }
    }

    fn read_nested(
        blocks: &mut Blocks,
        block: &Block,
        is_float: bool,
        depth: usize,
    ) -> Result<Self, MdfError> {
        let kind = block.number(0, 1)?;
        if matches!(kind, 7 | 8) {
            return Self::read_partial(blocks, block, (kind == 8, is_float), depth);
        }
        let values = block.floats(24);
        Ok(match (kind, &values[..]) {
            // Raw texts are no numbers.
            (0 | 9 | 10, _) => Self::Identity,
            (1, &[offset, factor, ..]) => Self::Linear { offset, factor },
            (2, &[a, b, c, d, e, f, ..]) => Self::Rational([a, b, c, d, e, f]),
            (3, _) => {
                return Err(MdfError::Unsupported(
                    "a conversion by an algebraic formula".to_owned(),
                ));
            }
            (kind @ (4 | 5), values) if values.len() >= 2 => {
                let points = values.chunks_exact(2).map(|pair| [pair[0], pair[1]]);
                Self::Table {
                    points: points.collect(),
                    is_interpolated: kind == 4,
                }
            }
            (6, ranges) if !ranges.is_empty() => {
                let bounds = ranges.chunks_exact(3).map(|range| [range[0], range[1]]);
                Self::Ranges {
                    ranges: Ranges::new(block, bounds, !is_float)?,
                    values: ranges.chunks_exact(3).map(|range| range[2]).collect(),
                    otherwise: ranges.last().copied().unwrap_or(f64::NAN),
                }
            }
            _ => return Err(block.damaged("the conversion lacks values")),
        })
    }

    /// Reads a conversion of values or ranges to texts or to further conversions.
    fn read_partial(
        blocks: &mut Blocks,
        block: &Block,
        (has_ranges, is_float): (bool, bool),
        depth: usize,
    ) -> Result<Self, MdfError> {
        if depth >= MAX_DEPTH {
            return Err(block.damaged("the conversions are nested too deep"));
        }
        let keys: Vec<f64> = block
            .floats(24)
            .into_iter()
            .take(block.number(6, 2)? as usize)
            .collect();
        let bounds: Vec<[f64; 2]> = match has_ranges {
            true => keys.chunks_exact(2).map(|key| [key[0], key[1]]).collect(),
            false => keys.iter().map(|key| [*key; 2]).collect(),
        };
        let mut conversions = Vec::with_capacity(bounds.len());
        for index in 0..bounds.len() {
            let at = block.link(FIRST_REFERENCE + index);
            conversions.push(Self::read_reference(blocks, at, is_float, depth)?);
        }
        // Without a default, a table that only names special values leaves all others as they are. Beside conversions,
        // other values have none.
        let otherwise = match block.link(FIRST_REFERENCE + bounds.len()) {
            0 if conversions.iter().any(Option::is_some) => Self::Missing,
            0 => Self::Identity,
            at => Self::read_reference(blocks, at, is_float, depth)?.unwrap_or(Self::Missing),
        };
        Ok(Self::Partial {
            ranges: Ranges::new(block, bounds, !has_ranges || !is_float)?,
            conversions: conversions
                .into_iter()
                .map(|conversion| conversion.unwrap_or(Self::Missing))
                .collect(),
            otherwise: Box::new(otherwise),
        })
    }

    /// Reads the conversion that a link of another conversion names; `None` for a text or an empty link.
    fn read_reference(
        blocks: &mut Blocks,
        at: u64,
        is_float: bool,
        depth: usize,
    ) -> Result<Option<Self>, MdfError> {
        if !blocks.is_of_type(at, b"CC") {
            return Ok(None);
        }
        let nested = blocks.read(at, b"CC")?;
        Self::read_nested(blocks, &nested, is_float, depth + 1).map(Some)
    }

    pub(super) fn apply(&self, raw: f64) -> f64 {
        match self {
            Self::Identity => raw,
            Self::Missing => f64::NAN,
            // Adding 0 would change the sign of a negative 0.
            Self::Linear {
                offset: 0.0,
                factor,
            } => raw * factor,
            Self::Linear { offset, factor } => raw * factor + offset,
            Self::Rational([0.0, b, 0.0, 0.0, 0.0, f]) => raw * (b / f),
            Self::Rational([a, b, c, d, e, f]) => {
                (a * raw * raw + b * raw + c) / (d * raw * raw + e * raw + f)
            }
            Self::Table {
                points,
                is_interpolated,
            } => look_up(points, *is_interpolated, raw),
            Self::Ranges {
                ranges,
                values,
                otherwise,
            } => ranges
                .find(raw)
                .and_then(|index| values.get(index))
                .copied()
                .unwrap_or(*otherwise),
            Self::Partial {
                ranges,
                conversions,
                otherwise,
            } => ranges
                .find(raw)
                .and_then(|index| conversions.get(index))
                .unwrap_or(otherwise)
                .apply(raw),
        }
    }
}

fn look_up(points: &[[f64; 2]], is_interpolated: bool, raw: f64) -> f64 {
    let after = points.partition_point(|[key, _]| *key <= raw);
    let [[low, first], [high, second]] = [after.saturating_sub(1), after].map(|index| {
        let point = points.get(index).or(points.last());
        point.copied().unwrap_or([f64::NAN; 2])
    });
    match high > low {
        true if is_interpolated => first + (second - first) / (high - low) * (raw - low),
        true if raw - low > high - raw => second,
        _ => first,
    }
}

impl Ranges {
    fn new(
        block: &Block,
        bounds: impl IntoIterator<Item = [f64; 2]>,
        includes_end: bool,
    ) -> Result<Self, MdfError> {
        let unsorted: Vec<([f64; 2], usize)> = bounds.into_iter().zip(0..).collect();
        let mut sorted = unsorted.clone();
        sorted.sort_by(|([a, _], _), ([b, _], _)| a.total_cmp(b));
        let are_ranges = sorted.iter().all(|([low, high], _)| low <= high);
        let are_apart = sorted
            .windows(2)
            .all(|pair| matches!(pair, [([_, high], _), ([next_low, _], _)] if high <= next_low));
        if are_ranges && are_apart {
            return Ok(Self {
                bounds: sorted,
                includes_end,
                overlap: false,
            });
        }
        if unsorted.len() > MAX_OVERLAPPING {
            return Err(block.damaged("the ranges of the conversion overlap"));
        }
        Ok(Self {
            bounds: unsorted,
            includes_end,
            overlap: true,
        })
    }

    /// Returns the index of the first range that contains a number.
    fn find(&self, raw: f64) -> Option<usize> {
        if self.overlap {
            return self
                .bounds
                .iter()
                .find(|(bounds, _)| self.contains(*bounds, raw))
                .map(|(_, index)| *index);
        }
        let position = self
            .bounds
            .partition_point(|([_, high], _)| *high < raw || !self.includes_end && *high == raw);
        self.bounds
            .get(position)
            .filter(|(bounds, _)| self.contains(*bounds, raw))
            .map(|(_, index)| *index)
    }

    fn contains(&self, [low, high]: [f64; 2], raw: f64) -> bool {
        low <= raw && (raw < high || self.includes_end && raw == high)
    }
}
