//! Loops compiled for the vector registers of the machine at hand.

use pulp::{Simd, WithSimd};

/// Work to be dispatched to the widest registers there are, as a closure that must be `#[inline(always)]`.
///
/// A closure that is given to `pulp` as it is, is called once and for that through a function of its own, which is compiled
/// for the narrowest registers.
pub struct SimdClosure<F>(pub F);

impl<R, F: FnMut() -> R> WithSimd for SimdClosure<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

/// Doubles in the widest vector register that the loops use on this machine. It changes times, and no bit of a result.
#[must_use]
pub fn f64_lanes() -> usize {
    struct Width;
    impl WithSimd for Width {
        type Output = usize;

        fn with_simd<S: Simd>(self, _: S) -> usize {
            S::F64_LANES
        }
    }
    pulp::Arch::new().dispatch(Width)
}

/// Whether this machine multiplies and adds in one operation, rounding once. Without it the same is computed in software: equal to the bit,
/// and networks act and learn many times as slowly.
#[must_use]
pub fn has_fused_multiply_add() -> bool {
    // The loops' wide registers of x86-64 come with the operation; every 64-bit ARM has it.
    cfg!(target_arch = "aarch64") || f64_lanes() > 1
}

/// All widths of registers that this machine has, the narrowest first.
#[cfg(test)]
pub(crate) fn available_archs() -> Vec<pulp::Arch> {
    let mut paths = vec![pulp::Arch::Scalar];
    #[cfg(target_arch = "x86_64")]
    {
        paths.extend(pulp::x86::V3::try_new().map(pulp::Arch::V3));
        paths.extend(pulp::x86::V4::try_new().map(pulp::Arch::V4));
    }
    paths
}
