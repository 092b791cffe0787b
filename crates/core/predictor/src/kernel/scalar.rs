//! One lane, for every CPU and for Miri.

use super::lanes::{Job, Lanes};
use std::mem::MaybeUninit;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Scalar;

// SAFETY: `store_new` writes the one place.
unsafe impl Lanes for Scalar {
    type Vector = f32;
    type Table = [f32; 8];

    const WIDTH: usize = 1;
    const SUMS: usize = 8;

    #[inline(always)]
    fn splat(self, value: f32) -> f32 {
        value
    }

    #[inline(always)]
    fn load(self, values: &[f32]) -> f32 {
        values[0]
    }

    #[inline(always)]
    fn store(self, vector: f32, places: &mut [f32]) {
        places[0] = vector;
    }

    #[inline(always)]
    fn store_new(self, vector: f32, places: &mut [MaybeUninit<f32>]) {
        places[0].write(vector);
    }

    #[inline(always)]
    fn add(self, a: f32, b: f32) -> f32 {
        a + b
    }

    #[inline(always)]
    fn sub(self, a: f32, b: f32) -> f32 {
        a - b
    }

    #[inline(always)]
    fn mul(self, a: f32, b: f32) -> f32 {
        a * b
    }

    #[inline(always)]
    fn div(self, a: f32, b: f32) -> f32 {
        a / b
    }

    #[inline(always)]
    fn mul_add(self, a: f32, b: f32, c: f32) -> f32 {
        a.mul_add(b, c)
    }

    #[inline(always)]
    fn abs(self, a: f32) -> f32 {
        a.abs()
    }

    #[inline(always)]
    fn at_most(self, magnitude: f32, limit: f32) -> f32 {
        if magnitude < limit { magnitude } else { limit }
    }

    #[inline(always)]
    fn table(self, values: &[f32; 8]) -> [f32; 8] {
        *values
    }

    #[inline(always)]
    fn lookup(self, table: [f32; 8], bits: f32) -> f32 {
        table[bits.to_bits() as usize % 8]
    }

    #[inline(never)]
    fn run<J: Job<Scalar>>(self, job: J) {
        job.run(self);
    }
}
