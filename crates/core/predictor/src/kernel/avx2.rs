//! Vectors of 8 lanes: AVX2 and FMA.

use super::lanes::{Job, Lanes, SimdTask};
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

/// Proof that this CPU has AVX2, FMA and BMI.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx2(());

impl Avx2 {
    pub(crate) fn detect() -> Option<Avx2> {
        let found = is_x86_feature_detected!("avx2")
            && is_x86_feature_detected!("fma")
            && is_x86_feature_detected!("bmi1")
            && is_x86_feature_detected!("bmi2")
            && is_x86_feature_detected!("lzcnt")
            && is_x86_feature_detected!("popcnt");
        found.then_some(Avx2(()))
    }
}

// SAFETY: `store_new` writes 8 places, or panics where there are fewer.
unsafe impl Lanes for Avx2 {
    type Vector = __m256;
    type Table = __m256;

    const WIDTH: usize = 8;
    const SUMS: usize = 12;

    #[inline(always)]
    fn splat(self, value: f32) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_set1_ps(value) }
    }

    #[inline(always)]
    fn load(self, values: &[f32]) -> __m256 {
        let values = &values[..8];
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        // The slice has 8 values, and the load asks for no alignment.
        unsafe { _mm256_loadu_ps(values.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, vector: __m256, places: &mut [f32]) {
        let places = &mut places[..8];
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        // The slice has 8 places, and the store asks for no alignment.
        unsafe { _mm256_storeu_ps(places.as_mut_ptr(), vector) }
    }

    #[inline(always)]
    fn store_new(self, vector: __m256, places: &mut [MaybeUninit<f32>]) {
        let places = &mut places[..8];
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        // The slice has 8 places, and the store asks for no alignment.
        unsafe { _mm256_storeu_ps(places.as_mut_ptr().cast(), vector) }
    }

    #[inline(always)]
    fn add(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_add_ps(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_sub_ps(a, b) }
    }

    #[inline(always)]
    fn mul(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_mul_ps(a, b) }
    }

    #[inline(always)]
    fn div(self, a: __m256, b: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_div_ps(a, b) }
    }

    #[inline(always)]
    fn mul_add(self, a: __m256, b: __m256, c: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_fmadd_ps(a, b, c) }
    }

    #[inline(always)]
    fn abs(self, a: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_andnot_ps(_mm256_set1_ps(-0.0), a) }
    }

    #[inline(always)]
    fn at_most(self, magnitude: __m256, limit: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe {
            let (magnitude, limit) = (_mm256_castps_si256(magnitude), _mm256_castps_si256(limit));
            _mm256_castsi256_ps(_mm256_min_epu32(magnitude, limit))
        }
    }

    #[inline(always)]
    fn table(self, values: &[f32; 8]) -> __m256 {
        self.load(values)
    }

    #[inline(always)]
    fn lookup(self, table: __m256, bits: __m256) -> __m256 {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { _mm256_permutevar8x32_ps(table, _mm256_castps_si256(bits)) }
    }

    #[inline(always)]
    fn run<J: Job<Avx2>>(self, job: J) {
        // SAFETY: a `Avx2` exists only where `detect` found the features.
        unsafe { entry(self, job) }
    }

    #[inline(always)]
    fn run_task<W: SimdTask>(self, work: W) {
        // SAFETY: an `Avx2` exists only where `detect` found the features.
        unsafe { task(work) }
    }
}

#[inline(never)]
#[target_feature(enable = "avx2,fma")]
fn entry<J: Job<Avx2>>(lanes: Avx2, job: J) {
    job.run(lanes);
}

#[inline(never)]
#[target_feature(enable = "avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn task<W: SimdTask>(work: W) {
    work.run();
}
