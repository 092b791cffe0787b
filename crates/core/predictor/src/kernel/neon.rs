//! Vectors of 4 lanes: NEON.

use super::lanes::{Job, Lanes};
use std::arch::aarch64::*;
use std::mem::MaybeUninit;

/// NEON, which every aarch64 CPU has.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Neon;

// SAFETY: `store_new` writes 4 places, or panics where there are fewer.
unsafe impl Lanes for Neon {
    type Vector = float32x4_t;
    type Table = uint8x16x2_t;

    const WIDTH: usize = 4;
    const SUMS: usize = 16;

    #[inline(always)]
    fn splat(self, value: f32) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vdupq_n_f32(value) }
    }

    #[inline(always)]
    fn load(self, values: &[f32]) -> float32x4_t {
        let values = &values[..4];
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        // The slice has 4 values, and the load asks for no alignment beyond that of f32.
        unsafe { vld1q_f32(values.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, vector: float32x4_t, places: &mut [f32]) {
        let places = &mut places[..4];
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        // The slice has 4 places, and the store asks for no alignment beyond that of f32.
        unsafe { vst1q_f32(places.as_mut_ptr(), vector) }
    }

    #[inline(always)]
    fn store_new(self, vector: float32x4_t, places: &mut [MaybeUninit<f32>]) {
        let places = &mut places[..4];
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        // The slice has 4 places, and the store asks for no alignment beyond that of f32.
        unsafe { vst1q_f32(places.as_mut_ptr().cast(), vector) }
    }

    #[inline(always)]
    fn add(self, a: float32x4_t, b: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vaddq_f32(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: float32x4_t, b: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vsubq_f32(a, b) }
    }

    #[inline(always)]
    fn mul(self, a: float32x4_t, b: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vmulq_f32(a, b) }
    }

    #[inline(always)]
    fn div(self, a: float32x4_t, b: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vdivq_f32(a, b) }
    }

    #[inline(always)]
    fn mul_add(self, a: float32x4_t, b: float32x4_t, c: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vfmaq_f32(c, a, b) }
    }

    #[inline(always)]
    fn abs(self, a: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { vabsq_f32(a) }
    }

    #[inline(always)]
    fn at_most(self, magnitude: float32x4_t, limit: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe {
            let (magnitude, limit) =
                (vreinterpretq_u32_f32(magnitude), vreinterpretq_u32_f32(limit));
            vreinterpretq_f32_u32(vminq_u32(magnitude, limit))
        }
    }

    #[inline(always)]
    fn table(self, values: &[f32; 8]) -> uint8x16x2_t {
        let (low, high) = (self.load(&values[..4]), self.load(&values[4..]));
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe { uint8x16x2_t(vreinterpretq_u8_f32(low), vreinterpretq_u8_f32(high)) }
    }

    #[inline(always)]
    fn lookup(self, table: uint8x16x2_t, bits: float32x4_t) -> float32x4_t {
        // SAFETY: NEON is part of every aarch64 CPU that Rust's std runs on.
        unsafe {
            // Element i has the bytes 4 i to 4 i + 3.
            let index = vandq_u32(vreinterpretq_u32_f32(bits), vdupq_n_u32(7));
            let bytes = vmlaq_u32(vdupq_n_u32(0x0302_0100), index, vdupq_n_u32(0x0404_0404));
            vreinterpretq_f32_u8(vqtbl2q_u8(table, vreinterpretq_u8_u32(bytes)))
        }
    }

    #[inline(never)]
    fn run<J: Job<Neon>>(self, job: J) {
        job.run(self);
    }
}
