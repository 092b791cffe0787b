//! The processor's peak: fused multiply-adds on registers only.
//!
//! Measured in the same run as the kernels, because the clock of a processor depends on the load of
//! its neighbours.

use std::hint::black_box;
use std::time::Instant;

use fearless_simd::prelude::*;
use fearless_simd::{Level, Simd};

/// Independent accumulators: latency (4) times units (2) of current cores is 8, and two more
/// registers hold the factors, so that sixteen registers suffice.
const SUMS: usize = 12;
/// Steps of one repetition: about 30 µs.
const STEPS: usize = 10_000;

/// Vector instruction sets with a peak.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Isa {
    Avx2,
    Avx512,
    /// Four lanes, on aarch64.
    Neon,
}

impl Isa {
    /// Fused multiply-adds per second on the calling thread, in 10⁹. `None` if this processor does
    /// not support the instructions. Takes about 30 µs.
    pub(crate) fn peak_gmac_per_s(self) -> Option<f64> {
        let level = Level::new();
        match self {
            #[cfg(target_arch = "x86_64")]
            Isa::Avx2 => level.as_avx2().map(timed),
            #[cfg(target_arch = "x86_64")]
            Isa::Avx512 => level.as_avx512().map(timed),
            #[cfg(target_arch = "aarch64")]
            Isa::Neon => level.as_neon().map(timed),
            #[allow(unreachable_patterns, reason = "not every processor family has all")]
            _ => {
                let _ = level;
                None
            }
        }
    }
}

fn timed<S: Simd>(simd: S) -> f64 {
    let (factor, summand) = black_box((0.999_f32, 0.001_f32));
    let start = Instant::now();
    let sums = simd.vectorize(
        #[inline(always)]
        || multiply_add(simd, factor, summand),
    );
    let elapsed_ns = start.elapsed().as_nanos() as f64;
    black_box(sums);
    (STEPS * SUMS * S::f32s::LEN) as f64 / elapsed_ns
}

/// Every sum tends to 1: no denormals, no infinities.
#[inline(always)]
fn multiply_add<S: Simd>(simd: S, factor: f32, summand: f32) -> f32 {
    let (factor, summand) = (S::f32s::splat(simd, factor), S::f32s::splat(simd, summand));
    let mut sums: [S::f32s; SUMS] = std::array::from_fn(
        #[inline(always)]
        |sum| S::f32s::splat(simd, sum as f32),
    );
    for _ in 0..STEPS {
        for sum in &mut sums {
            *sum = sum.mul_add(factor, summand);
        }
    }
    let mut total = S::f32s::splat(simd, 0.0);
    for sum in sums {
        total += sum;
    }
    total[0]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_peak_is_a_number_wherever_the_instructions_exist() {
        for isa in [Isa::Avx2, Isa::Avx512, Isa::Neon] {
            let peak = isa.peak_gmac_per_s();
            assert!(peak.is_none_or(|peak| peak > 0.0 && peak.is_finite()), "{isa:?}: {peak:?}");
        }
    }

    #[test]
    fn the_sums_equal_plain_multiply_adds() {
        let mut expected = 0.0_f64;
        for sum in 0..SUMS {
            let mut value = sum as f32;
            for _ in 0..STEPS {
                value = value.mul_add(0.5, 0.25);
            }
            expected += f64::from(value);
        }
        let found = fearless_simd::dispatch!(Level::new(), simd => multiply_add(simd, 0.5, 0.25));
        assert!((f64::from(found) - expected).abs() < 1e-4, "{found} instead of {expected}");
    }
}
