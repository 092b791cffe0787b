//! The activations, with the arithmetic shared by all kernels.
//!
//! GELU(x) = relu(x) − p(|x|) in both forms, where p is smooth, at most 0.17 and tends to 0. p is a
//! polynomial of degree five in each of eight segments. A table that fits into registers holds −p.
//! *The table alone* decides the form: a table of zeros gives relu. (Every table gives a function f
//! with f(x) − f(−x) in proportion to x, so none gives tanh.)
//!
//! The layers before and after carry scale factors, so that finding the segment and adding relu are
//! additions, which do not compete with the multiply-adds. Remez' algorithm gave the tables: `git
//! show 5759d979:tools/fit_gelu.py`.

/// The activation of the hidden layers.
///
/// ```
/// use joulebus_predictor::Activation;
///
/// assert_eq!(Activation::from_name(Activation::Relu.name()), Some(Activation::Relu));
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Activation {
    /// x·Φ(x) with Φ by the error function: GELU in PyTorch and JAX.
    GeluErf,
    /// x·(1 + tanh(√(2/π)·(x + 0.044715·x³)))/2: the approximation of older models.
    GeluTanh,
    /// x if it is positive, else 0.
    Relu,
}

impl Activation {
    /// All of them.
    pub const ALL: [Activation; 3] = [Activation::GeluErf, Activation::GeluTanh, Activation::Relu];
    /// Their names, for messages.
    pub const NAMES: &'static str = "gelu_erf, gelu_tanh, relu";

    /// The name in model files.
    pub const fn name(self) -> &'static str {
        match self {
            Activation::GeluErf => "gelu_erf",
            Activation::GeluTanh => "gelu_tanh",
            Activation::Relu => "relu",
        }
    }

    /// The activation of this name, if there is one.
    pub fn from_name(name: &str) -> Option<Activation> {
        Activation::ALL.into_iter().find(|activation| activation.name() == name)
    }

    /// Coefficients of −p, lowest power first, each for all segments.
    pub(crate) fn table(self) -> &'static [[f32; 8]; 6] {
        match self {
            Activation::GeluErf => &ERF,
            Activation::GeluTanh => &TANH,
            Activation::Relu => &[[0.0; 8]; 6],
        }
    }

    /// The exact value in double precision, for checks.
    pub fn value_f64(self, x: f64) -> f64 {
        match self {
            Activation::GeluErf => 0.5 * x * libm::erfc(-x * std::f64::consts::FRAC_1_SQRT_2),
            Activation::GeluTanh => {
                let scale = (2.0 / std::f64::consts::PI).sqrt();
                // (1 + tanh z) / 2 = 1 / (1 + exp(−2 z)), which avoids cancellation.
                x / (1.0 + libm::exp(-2.0 * scale * (x + 0.044715 * x * x * x)))
            }
            // Halves of both: `max` would drop a NaN.
            Activation::Relu => 0.5 * x + 0.5 * x.abs(),
        }
    }

    /// 2·SCALE·f(y / SCALE) of the activation f: the definition of the bits that every kernel
    /// computes. In units of GELU the absolute error is at most 5e-7 plus half a unit in the last
    /// place of the argument.
    ///
    /// NaN and −∞ give NaN. +∞ and values that overflow when doubled give +∞. An invalid input
    /// therefore never gives a plausible number. That is why relu is computed as (y + |y|)/2: `max`
    /// would drop a NaN or an −∞.
    pub(crate) fn scaled_value(self, y: f32) -> f32 {
        let magnitude = y.abs();
        let clamped = if magnitude < LIMIT { magnitude } else { LIMIT };
        let segment = (clamped + MAGIC).to_bits() as usize % 8;
        let [first @ .., last] = self.table();
        let tail = first
            .iter()
            .rev()
            .fold(last[segment], |tail, coefficients| tail.mul_add(clamped, coefficients[segment]));
        (y + magnitude) + tail
    }
}

/// End of the last segment.
pub(crate) const LIMIT: f32 = 7.4999995e+00;
/// Segments per unit of x.
pub(crate) const SCALE: f32 = 1.4150944e+00;
/// Adding it rounds to an integer in the lowest bits.
pub(crate) const MAGIC: f32 = 8.388608e+06;

/// Maximum error 4.2e-07 up to the limit, 3.1e-07 beyond it.
static ERF: [[f32; 8]; 6] = [
    [
        -3.5846107e-08,
        -9.9654484e-05,
        1.2172412e-01,
        3.2986262e-01,
        -1.5793418e+00,
        -2.9605005e+00,
        -1.5333939e+00,
        -3.2699895e-01,
    ],
    [
        -9.999965e-01,
        -9.987291e-01,
        -1.3661758e+00,
        -1.8528208e+00,
        8.3471024e-01,
        2.4502788e+00,
        1.1639774e+00,
        2.2044155e-01,
    ],
    [
        5.6375647e-01,
        5.580134e-01,
        1.0063065e+00,
        1.4559518e+00,
        -6.306889e-02,
        -8.195561e-01,
        -3.5510594e-01,
        -5.9568327e-02,
    ],
    [
        7.071124e-04,
        1.3271832e-02,
        -2.6389167e-01,
        -4.698202e-01,
        -3.88597e-02,
        1.3838081e-01,
        5.4403078e-02,
        8.063912e-03,
    ],
    [
        -4.9697947e-02,
        -6.351732e-02,
        2.351087e-02,
        7.036669e-02,
        8.989772e-03,
        -1.1787516e-02,
        -4.183832e-03,
        -5.4678216e-04,
    ],
    [
        5.0428254e-03,
        1.1286987e-02,
        1.6388328e-04,
        -4.0804152e-03,
        -5.698942e-04,
        4.049773e-04,
        1.2916548e-04,
        1.4854099e-05,
    ],
];

/// Maximum error 4.5e-07 up to the limit, 2.7e-08 beyond it.
static TANH: [[f32; 8]; 6] = [
    [
        -3.225275e-08,
        -5.3770054e-05,
        1.20139405e-01,
        3.1314552e-01,
        -1.4447608e+00,
        -3.1406243e+00,
        -1.5900736e+00,
        -2.253044e-01,
    ],
    [
        -9.999964e-01,
        -9.990249e-01,
        -1.3630487e+00,
        -1.8135474e+00,
        6.531333e-01,
        2.6137965e+00,
        1.224434e+00,
        1.5409523e-01,
    ],
    [
        5.637548e-01,
        5.5875015e-01,
        1.0049844e+00,
        1.420886e+00,
        3.116023e-02,
        -8.769538e-01,
        -3.7835112e-01,
        -4.2200133e-02,
    ],
    [
        7.217539e-04,
        1.2407457e-02,
        -2.649835e-01,
        -4.5541245e-01,
        -6.2398806e-02,
        1.4821023e-01,
        5.862754e-02,
        5.7838727e-03,
    ],
    [
        -4.9988717e-02,
        -6.333004e-02,
        2.4300234e-02,
        6.7636706e-02,
        1.184265e-02,
        -1.2612786e-02,
        -4.554669e-03,
        -3.9670832e-04,
    ],
    [
        5.1524607e-03,
        1.13157835e-02,
        4.1021995e-05,
        -3.8862694e-03,
        -7.051172e-04,
        4.322147e-04,
        1.4189203e-04,
        1.0892587e-05,
    ],
];

#[cfg(test)]
mod tests {
    use super::*;

    /// Every 20,000th f32 below 16 in magnitude, and a fine grid where GELU is curved.
    fn arguments() -> impl Iterator<Item = f32> {
        let grid = (-800_000..=800_000).map(|step| step as f32 * 1e-5);
        let all = (0..16.0f32.to_bits()).step_by(20_000).map(f32::from_bits);
        grid.chain(all.flat_map(|x| [x, -x]))
    }

    #[test]
    #[cfg_attr(miri, ignore = "takes hours under Miri")]
    fn every_activation_stays_within_its_stated_error() {
        for activation in Activation::ALL {
            let mut worst = 0.0f64;
            for x in arguments() {
                let y = SCALE * x;
                let found = f64::from(activation.scaled_value(y)) / (2.0 * f64::from(SCALE));
                let error = found - activation.value_f64(f64::from(y) / f64::from(SCALE));
                let half_unit = f64::from(x.abs()) * f64::from(f32::EPSILON) / 2.0;
                worst = worst.max(error.abs() - half_unit);
            }
            println!("{activation:?}: largest error {worst:.1e} in addition to half a unit");
            assert!(worst <= 5e-7, "{activation:?}: {worst:e}");
        }
    }

    #[test]
    fn no_activation_hides_an_invalid_value() {
        for activation in Activation::ALL {
            for poison in [f32::NAN, -f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                assert!(!activation.scaled_value(poison).is_finite(), "{poison}");
            }
        }
    }

    #[test]
    fn names_are_read_back() {
        for activation in Activation::ALL {
            assert_eq!(Activation::from_name(activation.name()), Some(activation));
            assert!(Activation::NAMES.contains(activation.name()));
        }
        assert_eq!(Activation::from_name("tanh"), None);
    }

    #[test]
    fn the_limit_itself_lies_in_the_last_segment() {
        assert_eq!(LIMIT + MAGIC, MAGIC + 7.0);
        assert_eq!(0.0 + MAGIC, MAGIC);
    }
}
