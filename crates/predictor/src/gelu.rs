//! GELU in both its forms, as every kernel computes it.
//!
//! GELU(x) = relu(x) − p(|x|) in both forms, with a p that is smooth, at most 0.17 and vanishes.
//! p is a polynomial of degree five in each of eight segments of `[0, LIMIT]`; a table that fits
//! registers holds −p, and *the table alone* decides the form. `tools/fit_gelu.py` makes both and
//! explains them.

/// The activation of the hidden layers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// x·Φ(x) with Φ by the error function: what PyTorch and JAX call GELU.
    GeluErf,
    /// x·(1 + tanh(√(2/π)·(x + 0.044715·x³)))/2: the approximation of older models.
    GeluTanh,
}

impl Activation {
    /// The name used in model files.
    pub const fn name(self) -> &'static str {
        match self {
            Activation::GeluErf => "gelu_erf",
            Activation::GeluTanh => "gelu_tanh",
        }
    }

    /// The activation with this name, if there is one.
    pub fn from_name(name: &str) -> Option<Activation> {
        [Activation::GeluErf, Activation::GeluTanh]
            .into_iter()
            .find(|activation| activation.name() == name)
    }

    /// Coefficients of −p, lowest power first, each for all segments.
    pub(crate) fn table(self) -> &'static [[f32; 8]; 6] {
        match self {
            Activation::GeluErf => &ERF,
            Activation::GeluTanh => &TANH,
        }
    }

    /// One value in double precision, for checks.
    pub(crate) fn value_f64(self, x: f64) -> f64 {
        match self {
            Activation::GeluErf => 0.5 * x * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2),
            Activation::GeluTanh => {
                let scale = (2.0 / std::f64::consts::PI).sqrt();
                // (1 + tanh z) / 2 = 1 / (1 + exp(−2 z)), which does not cancel.
                x / (1.0 + libm::exp(-2.0 * scale * (x + 0.044715 * x * x * x)))
            }
        }
    }

    /// One value: the definition of the bits that every kernel gives. Absolute error at most
    /// 5e-7 plus half a unit in the last place of x.
    ///
    /// NaN and −∞ give NaN; +∞ and what overflows when doubled give +∞. So a poisoned input can
    /// never come out as a plausible number. That is why relu is written as (x + |x|)/2: `max`
    /// would drop a NaN or an −∞.
    pub(crate) fn value(self, x: f32) -> f32 {
        let magnitude = x.abs();
        let clamped = if magnitude < LIMIT { magnitude } else { LIMIT };
        let segment = clamped.mul_add(SCALE, MAGIC).to_bits() as usize % 8;
        let [first @ .., last] = self.table();
        let tail = first
            .iter()
            .rev()
            .fold(last[segment], |tail, coefficients| {
                tail.mul_add(clamped, coefficients[segment])
            });
        (x + magnitude).mul_add(0.5, tail)
    }
}

pub(crate) const LIMIT: f32 = 5.25e+00;
pub(crate) const SCALE: f32 = 1.4285713e+00;
pub(crate) const MAGIC: f32 = 8.388608e+06;

/// Largest error 4.5e-07 up to the limit, 4.0e-07 past it.
static ERF: [[f32; 8]; 6] = [
    [
        -1.0865254e-08,
        -4.2846666e-05,
        4.0784333e-02,
        1.2182852e-01,
        -5.232251e-01,
        -1.0514793e+00,
        -5.766294e-01,
        -1.3091308e-01,
    ],
    [
        -4.9999833e-01,
        -4.9930152e-01,
        -6.749232e-01,
        -9.391017e-01,
        3.5501474e-01,
        1.2329197e+00,
        6.2339693e-01,
        1.2587199e-01,
    ],
    [
        3.9888638e-01,
        3.9461926e-01,
        7.001025e-01,
        1.042329e+00,
        -3.5461748e-05,
        -5.8432436e-01,
        -2.7093202e-01,
        -4.8517782e-02,
    ],
    [
        6.892454e-04,
        1.3600512e-02,
        -2.5559473e-01,
        -4.762283e-01,
        -5.482911e-02,
        1.3982439e-01,
        5.9143238e-02,
        9.369748e-03,
    ],
    [
        -7.0346214e-02,
        -9.022952e-02,
        3.020721e-02,
        1.0108808e-01,
        1.5575181e-02,
        -1.6882613e-02,
        -6.4822254e-03,
        -9.06433e-04,
    ],
    [
        1.0023811e-02,
        2.269879e-02,
        7.7264744e-04,
        -8.313253e-03,
        -1.3446643e-03,
        8.223165e-04,
        2.8526344e-04,
        3.5135494e-05,
    ],
];

/// Largest error 4.9e-07 up to the limit, 4.0e-08 past it.
static TANH: [[f32; 8]; 6] = [
    [
        -8.0513765e-09,
        -2.7755446e-05,
        4.033227e-02,
        1.15204886e-01,
        -4.756619e-01,
        -1.1098772e+00,
        -6.037643e-01,
        -9.405291e-02,
    ],
    [
        -4.999983e-01,
        -4.9944013e-01,
        -6.7375547e-01,
        -9.177403e-01,
        2.6420376e-01,
        1.30717e+00,
        6.62076e-01,
        9.1753736e-02,
    ],
    [
        3.9888522e-01,
        3.951109e-01,
        6.997444e-01,
        1.0158635e+00,
        6.665386e-02,
        -6.206414e-01,
        -2.9139513e-01,
        -3.58442e-02,
    ],
    [
        7.0354587e-04,
        1.2780771e-02,
        -2.571064e-01,
        -4.610111e-01,
        -7.8404486e-02,
        1.4843917e-01,
        6.432657e-02,
        7.008583e-03,
    ],
    [
        -7.0756875e-02,
        -8.999838e-02,
        3.147632e-02,
        9.703133e-02,
        1.9618643e-02,
        -1.7876826e-02,
        -7.1207862e-03,
        -6.8583986e-04,
    ],
    [
        1.02419555e-02,
        2.2766491e-02,
        5.04743e-04,
        -7.906038e-03,
        -1.6158872e-03,
        8.669437e-04,
        3.1614545e-04,
        2.6869133e-05,
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    const BOTH: [Activation; 2] = [Activation::GeluErf, Activation::GeluTanh];

    /// Every 20,000th f32 below 16 in magnitude and a fine grid where GELU bends.
    fn arguments() -> impl Iterator<Item = f32> {
        let grid = (-800_000..=800_000).map(|step| step as f32 * 1e-5);
        let all = (0..16.0f32.to_bits()).step_by(20_000).map(f32::from_bits);
        grid.chain(all.flat_map(|x| [x, -x]))
    }

    #[test]
    #[cfg_attr(miri, ignore = "takes hours there")]
    fn gelu_stays_within_its_stated_error_of_both_forms() {
        for activation in BOTH {
            let mut worst = 0.0f64;
            for x in arguments() {
                let error = f64::from(activation.value(x)) - activation.value_f64(f64::from(x));
                let half_unit = f64::from(x.abs()) * f64::from(f32::EPSILON) / 2.0;
                worst = worst.max(error.abs() - half_unit);
            }
            println!("{activation:?}: largest error {worst:.1e} beside half a unit");
            assert!(worst <= 5e-7, "{activation:?}: {worst:e}");
        }
    }

    #[test]
    fn gelu_never_hides_a_poisoned_value() {
        for activation in BOTH {
            for poison in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                assert!(!activation.value(poison).is_finite(), "{poison}");
            }
        }
    }

    #[test]
    fn the_limit_itself_lies_in_the_last_segment() {
        assert_eq!(LIMIT.mul_add(SCALE, MAGIC), MAGIC + 7.0);
        assert_eq!(0.0f32.mul_add(SCALE, MAGIC), MAGIC);
    }
}
