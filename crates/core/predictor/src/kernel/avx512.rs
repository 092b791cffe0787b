//! Vectors of 16 lanes: AVX-512.

use super::lanes::{Job, Lanes, SimdTask};
use std::arch::x86_64::*;
use std::mem::MaybeUninit;

/// Proof that this CPU has AVX-512 F, BW, DQ and VL, and all of [`super::avx2::Avx2`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Avx512(());

impl Avx512 {
    pub(crate) fn detect() -> Option<Avx512> {
        let found = is_x86_feature_detected!("avx512f")
            && is_x86_feature_detected!("avx512bw")
            && is_x86_feature_detected!("avx512dq")
            && is_x86_feature_detected!("avx512vl")
            && super::avx2::Avx2::detect().is_some();
        found.then_some(Avx512(()))
    }
}

// SAFETY: `store_new` writes 16 places, or panics where there are fewer.
unsafe impl Lanes for Avx512 {
    type Vector = __m512;
    type Table = __m512;

    const WIDTH: usize = 16;
    const SUMS: usize = 16;
    const GELU_OVERLAPS: bool = true;

    #[inline(always)]
    fn splat(self, value: f32) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_set1_ps(value) }
    }

    #[inline(always)]
    fn load(self, values: &[f32]) -> __m512 {
        let values = &values[..16];
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        // The slice has 16 values, and the load asks for no alignment.
        unsafe { _mm512_loadu_ps(values.as_ptr()) }
    }

    #[inline(always)]
    fn store(self, vector: __m512, places: &mut [f32]) {
        let places = &mut places[..16];
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        // The slice has 16 places, and the store asks for no alignment.
        unsafe { _mm512_storeu_ps(places.as_mut_ptr(), vector) }
    }

    #[inline(always)]
    fn store_new(self, vector: __m512, places: &mut [MaybeUninit<f32>]) {
        let places = &mut places[..16];
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        // The slice has 16 places, and the store asks for no alignment.
        unsafe { _mm512_storeu_ps(places.as_mut_ptr().cast(), vector) }
    }

    #[inline(always)]
    fn add(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_add_ps(a, b) }
    }

    #[inline(always)]
    fn sub(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_sub_ps(a, b) }
    }

    #[inline(always)]
    fn mul(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_mul_ps(a, b) }
    }

    #[inline(always)]
    fn div(self, a: __m512, b: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_div_ps(a, b) }
    }

    #[inline(always)]
    fn mul_add(self, a: __m512, b: __m512, c: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_fmadd_ps(a, b, c) }
    }

    #[inline(always)]
    fn abs(self, a: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_abs_ps(a) }
    }

    #[inline(always)]
    fn at_most(self, magnitude: __m512, limit: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe {
            let (magnitude, limit) = (_mm512_castps_si512(magnitude), _mm512_castps_si512(limit));
            _mm512_castsi512_ps(_mm512_min_epu32(magnitude, limit))
        }
    }

    #[inline(always)]
    fn table(self, values: &[f32; 8]) -> __m512 {
        // Twice, since the permutation looks at four bits of the index.
        // SAFETY: an `Avx512` exists only where `detect` found the features. The array has 8
        // values, and the load asks for no alignment.
        unsafe {
            let once = _mm256_loadu_pd(values.as_ptr().cast());
            _mm512_castpd_ps(_mm512_broadcast_f64x4(once))
        }
    }

    #[inline(always)]
    fn lookup(self, table: __m512, bits: __m512) -> __m512 {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { _mm512_permutexvar_ps(_mm512_castps_si512(bits), table) }
    }

    #[inline(always)]
    fn run<J: Job<Avx512>>(self, job: J) {
        // SAFETY: a `Avx512` exists only where `detect` found the features.
        unsafe { entry(self, job) }
    }

    #[inline(always)]
    fn run_task<W: SimdTask>(self, work: W) {
        // SAFETY: an `Avx512` exists only where `detect` found the features.
        unsafe { task(work) }
    }
}

#[inline(never)]
#[target_feature(enable = "avx512f,avx2,fma")]
fn entry<J: Job<Avx512>>(lanes: Avx512, job: J) {
    job.run(lanes);
}

#[inline(never)]
#[target_feature(enable = "avx512f,avx512bw,avx512dq,avx512vl,avx2,fma,bmi1,bmi2,lzcnt,popcnt")]
fn task<W: SimdTask>(work: W) {
    work.run();
}
