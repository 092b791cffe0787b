//! GELU by the error function, as every kernel computes it.
//!
//! GELU(x) = relu(x) − p(|x|) with p(a) = a·Φ(−a): p is smooth, at most 0.17 and vanishes, so one
//! polynomial on `[0, GELU_LIMIT]` is enough. The coefficients come from `tools/fit_gelu.py`.

// limit 5.5, degree 17: error 5.40e-08 inside, 1.04e-07 past the limit, sum |c| 3.64
const GELU_LIMIT: f32 = 5.5e+00;
const GELU_SCALE: f32 = 3.6363637e-01;
const GELU_COEFFICIENTS: [f32; 18] = [
    8.19437e-03,
    -6.0575765e-02,
    1.9126354e-01,
    -3.087875e-01,
    1.789443e-01,
    2.6190865e-01,
    -6.2829816e-01,
    4.503405e-01,
    1.5128997e-01,
    -5.141174e-01,
    2.7240747e-01,
    1.735312e-01,
    -2.5713134e-01,
    2.5895122e-02,
    9.906015e-02,
    -3.67036e-02,
    -1.5730273e-02,
    8.50888e-03,
];

/// GELU of one value: branch-free, fused multiply-adds in one fixed order, absolute error at most
/// 3e-7 for |x| < 16 and half a unit in the last place of x beyond.
///
/// NaN and −∞ give NaN and +∞ gives +∞ (relu is written as (x + |x|)/2 for that, since `max` would
/// drop a NaN), so a poisoned input can never come out as a plausible number.
#[inline(always)]
pub(crate) fn gelu(x: f32) -> f32 {
    let magnitude = x.abs();
    let clamped = if magnitude < GELU_LIMIT {
        magnitude
    } else {
        GELU_LIMIT
    };
    let t = clamped.mul_add(GELU_SCALE, -1.0);
    let mut tail = GELU_COEFFICIENTS[GELU_COEFFICIENTS.len() - 1];
    for &coefficient in GELU_COEFFICIENTS.iter().rev().skip(1) {
        tail = tail.mul_add(t, coefficient);
    }
    x.mul_add(0.5, 0.5 * magnitude) - tail
}

/// GELU with a true error function, for checks.
pub(crate) fn gelu_f64(x: f64) -> f64 {
    0.5 * x * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gelu_stays_within_its_stated_error_of_the_error_function() {
        let mut worst = 0.0f64;
        for step in -1_600_000..=1_600_000 {
            let x = step as f32 * 1e-5;
            worst = worst.max((f64::from(gelu(x)) - gelu_f64(f64::from(x))).abs());
        }
        assert!(
            worst <= 3e-7 + 16.0 * f64::from(f32::EPSILON) / 4.0,
            "{worst:e}"
        );
        let mut inner = 0.0f64;
        for step in -300_000..=300_000 {
            let x = step as f32 * 1e-5;
            inner = inner.max((f64::from(gelu(x)) - gelu_f64(f64::from(x))).abs());
        }
        assert!(inner <= 3e-7, "{inner:e}");
        println!("largest error for |x| < 16: {worst:e}, for |x| < 3: {inner:e}");
    }

    #[test]
    fn gelu_never_hides_a_poisoned_value() {
        for poison in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(!gelu(poison).is_finite(), "{poison}");
        }
    }
}
