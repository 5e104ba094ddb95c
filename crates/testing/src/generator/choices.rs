//! Conversion of bytes to variations of nominal values.

use arbitrary::Unstructured;

/// Source of choices from bytes. A zero byte, or a missing one, gives the nominal value; larger numbers give larger
/// deviations. Shrinking or truncating the bytes therefore leads to the nominal case.
pub struct Choices<'b>(Unstructured<'b>);

impl<'b> Choices<'b> {
    /// Reads choices from all of the bytes.
    #[must_use]
    pub fn new(bytes: &'b [u8]) -> Self {
        Self(Unstructured::new(bytes))
    }

    /// Takes the next `bytes` bytes as a block, so that later fields keep their place however many are used.
    #[must_use]
    pub fn read_block(from: &mut Unstructured<'b>, bytes: usize) -> Self {
        Self::new(from.bytes(bytes.min(from.len())).unwrap_or_default())
    }

    /// Takes the next bytes as a block, as [`Self::read_block`] does.
    #[must_use]
    pub fn read_sub_block(&mut self, bytes: usize) -> Self {
        Self::read_block(&mut self.0, bytes)
    }

    /// Returns the next byte; nominally 0.
    pub fn byte(&mut self) -> u8 {
        self.0.arbitrary().unwrap_or_default()
    }

    /// Returns a seed of a scenario; nominally 0.
    pub fn seed(&mut self) -> u64 {
        // Scenario files hold signed integers.
        self.0.arbitrary::<u64>().unwrap_or_default() >> 1
    }

    fn unit_interval(&mut self) -> f64 {
        f64::from(self.0.arbitrary::<u16>().unwrap_or_default()) / f64::from(u16::MAX)
    }

    /// Returns a number from 0, the nominal value, to `most`.
    pub fn up_to(&mut self, most: f64) -> f64 {
        most * self.unit_interval()
    }

    /// Returns a number between `nominal` and one end of a range; the lowest bit selects the end.
    pub fn around(&mut self, nominal: f64, [least, most]: [f64; 2]) -> f64 {
        let bits = self.0.arbitrary::<u16>().unwrap_or_default();
        let share = f64::from(bits >> 1) / f64::from(u16::MAX >> 1);
        let end = if bits & 1 == 0 { most } else { least };
        // Rounding could exceed the ends.
        (nominal + share * (end - nominal)).clamp(least, most)
    }

    /// True, which is not nominal, in about `times` of 256 cases.
    pub fn chance(&mut self, times: u8) -> bool {
        self.byte() > u8::MAX - times
    }

    /// Returns a value in about `times` of 256 cases; nominally `None`.
    pub fn optional(&mut self, times: u8, value: impl FnOnce(&mut Self) -> f64) -> Option<f64> {
        let happens = self.chance(times);
        let value = value(self);
        happens.then_some(value)
    }

    /// Returns one of the values, nominally the first; `None` if there are none.
    pub fn choose<T: Copy>(&mut self, all: &[T]) -> Option<T> {
        all.get(usize::from(self.byte()) % all.len().max(1))
            .copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_bytes_and_zero_bytes_are_nominal() {
        for bytes in [&[][..], &[0; 20]] {
            let mut choices = Choices::new(bytes);
            assert_eq!(choices.around(25.0, [0.0, 45.0]), 25.0);
            assert_eq!(choices.up_to(3.0), 0.0);
            assert_eq!(choices.optional(200, |choices| choices.up_to(1.0)), None);
            assert_eq!(choices.choose(&[7, 8]), Some(7));
            assert_eq!(choices.seed(), 0);
        }
    }

    #[test]
    fn small_bytes_stay_near_and_large_ones_reach_the_ends() {
        let about = |bits: u16| Choices::new(&bits.to_le_bytes()).around(25.0, [0.0, 45.0]);
        assert_eq!((about(u16::MAX), about(u16::MAX - 1)), (0.0, 45.0));
        assert!((1..100).all(|bits| (about(bits) - 25.0).abs() < 0.1));
        assert_eq!(
            Choices::new(&[255, 255, 255]).optional(1, |choices| choices.up_to(2.0)),
            Some(2.0)
        );
    }
}
