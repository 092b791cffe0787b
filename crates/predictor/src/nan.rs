//! Canonical NaN.

/// Maps every NaN to one bit pattern: CPUs and compilers disagree on sign and payload.
#[inline(always)]
pub(crate) fn canonical(value: f32) -> f32 {
    if value.is_nan() { f32::NAN } else { value }
}
