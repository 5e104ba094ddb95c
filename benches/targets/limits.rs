//! Limits of this machine, measured in the same run, so that ratios to them are comparable between processors.

use std::hint::black_box;

use crumple_sim::random::{NormalSampler, Purpose, stream};
use pulp::{Arch, Simd, WithSimd};

use crate::clock::min_cpu_time_s;
use crate::table::format_three_digits;

/// Measures single-precision operations per second in registers; a fused multiply-add counts as two.
///
/// Twelve independent sums: about four cycles of latency at two multiply-adds per cycle need at least eight, and twelve
/// sums fit in sixteen registers with their factors.
pub fn register_operations_per_second() -> f64 {
    const ROUNDS: usize = 20_000;
    const SUMS: usize = 12;
    struct Peak;
    impl WithSimd for Peak {
        type Output = usize;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> usize {
            let [left, right] = black_box([0.999_f32, 1e-3]).map(|factor| simd.splat_f32s(factor));
            let mut sums = [right; SUMS];
            for _ in 0..ROUNDS {
                for sum in &mut sums {
                    *sum = simd.mul_add_f32s(*sum, left, right);
                }
            }
            black_box(sums);
            2 * ROUNDS * SUMS * S::F32_LANES
        }
    }
    let operations = Arch::new().dispatch(Peak);
    let [seconds] = min_cpu_time_s(100, [&mut || _ = Arch::new().dispatch(Peak)]);
    operations as f64 / seconds
}

pub fn normals_per_second() -> f64 {
    const COUNT: usize = 100_000;
    let (normals, mut stream) = (NormalSampler::new(), stream(1, Purpose::ReplaySampling, 0));
    let [seconds] = min_cpu_time_s(
        40,
        [&mut || _ = black_box((0..COUNT).map(|_| normals.sample(&mut stream)).sum::<f64>())],
    );
    COUNT as f64 / seconds
}

fn bytes_per_second(bytes: usize) -> f64 {
    struct Sum<'a>(&'a [f32], usize);
    impl WithSimd for Sum<'_> {
        type Output = f32;

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> f32 {
            let mut sums = [simd.splat_f32s(0.0); 8];
            for _ in 0..self.1 {
                let (vectors, _) = S::as_simd_f32s(black_box(self.0));
                for eight in vectors.chunks_exact(8) {
                    for (sum, &vector) in sums.iter_mut().zip(eight) {
                        *sum = simd.add_f32s(*sum, vector);
                    }
                }
            }
            sums.iter().map(|&sum| simd.reduce_sum_f32s(sum)).sum()
        }
    }
    // Align to a cache line: a vector across two lines costs two reads.
    let array = vec![1.0_f32; bytes / 4 + 16];
    let begin = array.as_ptr().align_offset(64).min(16);
    let array = &array[begin..begin + bytes / 4];
    // Read 32 MiB in total, so that the clock's overhead is negligible.
    let passes = (1_usize << 25).div_ceil(bytes);
    let [seconds] = min_cpu_time_s(
        20,
        [&mut || _ = black_box(Arch::new().dispatch(Sum(array, passes)))],
    );
    (passes * bytes) as f64 / seconds
}

pub fn processor_model() -> String {
    let text = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let value_of = |field: &str| {
        let line = text.lines().find(|line| {
            line.split(':')
                .next()
                .is_some_and(|name| name.trim() == field)
        });
        line.and_then(|line| line.split(':').nth(1))
            .map_or("?", str::trim)
    };
    let (name, family, model) = (
        value_of("model name"),
        value_of("cpu family"),
        value_of("model"),
    );
    let lanes = crumple_sim::policy::f64_lanes();
    format!("{name}, family {family}, model {model}, registers of {lanes} doubles")
}

/// Passes the rows of the table.
pub fn measure(say: &mut dyn FnMut(String)) {
    let mut limit = |name: &str, value: f64, unit: &str| {
        say(format!(
            "| {name} | {} {unit} |",
            format_three_digits(value)
        ))
    };
    let operations = register_operations_per_second() / 1e9;
    limit(
        "fused multiply-adds in registers, single precision",
        operations,
        "billion operations a second",
    );
    limit(
        "normal numbers from one stream",
        1e9 / normals_per_second(),
        "ns each",
    );
    for (name, bytes) in [
        ("read from the first-level cache (16 KiB)", 1 << 14),
        ("read from the second-level cache (256 KiB)", 1 << 18),
        ("read from main memory (256 MiB)", 1 << 28),
    ] {
        limit(name, bytes_per_second(bytes) / 1e9, "GB/s");
    }
}
