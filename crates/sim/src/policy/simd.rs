//! Loops that are compiled for the vector registers of this machine.

use pulp::{Simd, WithSimd};

/// Work for the widest vector registers, as a closure that must be `#[inline(always)]`.
///
/// `pulp` would call a plain closure through a function that is compiled for the narrowest registers.
pub struct SimdClosure<F>(pub F);

impl<R, F: FnMut() -> R> WithSimd for SimdClosure<F> {
    type Output = R;

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, _: S) -> R {
        (self.0)()
    }
}

/// Returns the number of doubles in the widest vector register that loops use here. Affects times only, not results.
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

/// True if this machine has fused multiply-add. Software computes the same bits, many times slower.
#[must_use]
pub fn has_fused_multiply_add() -> bool {
    // On x86-64, wide registers imply the operation; every 64-bit ARM has it.
    cfg!(target_arch = "aarch64") || f64_lanes() > 1
}

/// Returns all register widths of this machine, narrowest first.
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
