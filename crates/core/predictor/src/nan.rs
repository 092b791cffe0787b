//! Canonical NaN.

/// Maps every NaN to one bit pattern, positive and without a payload. CPUs and compilers disagree
/// on sign and payload (0/0 is negative on x86-64, positive on ARM), and other machines recompute a
/// capture.
#[inline(always)]
#[must_use]
pub const fn canonical(value: f32) -> f32 {
    if value.is_nan() { f32::NAN } else { value }
}

/// Same as [`canonical`], in double precision.
#[inline(always)]
#[must_use]
pub const fn canonical_f64(value: f64) -> f64 {
    if value.is_nan() { f64::NAN } else { value }
}
