//! Time measurements that a busy machine affects little: the minimum processor time of many repetitions.

use std::time::Instant;

/// Returns the processor time of this thread in seconds, or wall-clock time if the system has no such clock.
pub fn cpu_time_s() -> f64 {
    #[cfg(unix)]
    {
        let now = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        now.tv_sec as f64 + now.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    wall_time_s()
}

pub fn wall_time_s() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

fn measure_s(clock: fn() -> f64, work: &mut dyn FnMut()) -> f64 {
    let start = clock();
    work();
    clock() - start
}

/// Returns the minimum processor time of each piece of work in seconds. The pieces alternate, so that disturbances
/// affect all.
pub fn min_cpu_time_s<const N: usize>(rounds: usize, work: [&mut dyn FnMut(); N]) -> [f64; N] {
    min_time_by(cpu_time_s, rounds, work)
}

/// Returns the minimum wall-clock times, for work on several threads.
pub fn min_wall_time_s<const N: usize>(rounds: usize, work: [&mut dyn FnMut(); N]) -> [f64; N] {
    min_time_by(wall_time_s, rounds, work)
}

fn min_time_by<const N: usize>(
    clock: fn() -> f64,
    rounds: usize,
    mut work: [&mut dyn FnMut(); N],
) -> [f64; N] {
    work.iter_mut().for_each(|work| work());
    let mut least = [f64::INFINITY; N];
    for _ in 0..rounds {
        for (least, work) in least.iter_mut().zip(&mut work) {
            *least = least.min(measure_s(clock, *work));
        }
    }
    least
}
