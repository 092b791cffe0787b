//! The kernels' instruction sets, for other loops such as the tick's.

use super::engine::Engine;
use super::lanes::{Lanes, SimdTask};

/// The instruction set of this processor, detected once.
///
/// ```
/// use joulebus_predictor::simd::{SimdLevel, SimdTask};
///
/// struct Double<'a>(&'a mut [f32]);
///
/// impl SimdTask for Double<'_> {
///     #[inline(always)]
///     fn run(self) {
///         self.0.iter_mut().for_each(|value| *value *= 2.0);
///     }
/// }
///
/// let mut values = [1.0, 2.0];
/// SimdLevel::best().run(Double(&mut values));
/// assert_eq!(values, [2.0, 4.0]);
/// ```
#[derive(Clone, Copy, Debug)]
pub struct SimdLevel(pub(crate) Engine);

impl SimdLevel {
    /// The best supported one.
    pub fn best() -> SimdLevel {
        SimdLevel(Engine::best())
    }

    /// Runs `work` compiled for the processor. The results have the same bits on each, except for
    /// NaN payloads: the compiler vectorises loops without changing operations.
    pub fn run<W: SimdTask>(self, work: W) {
        match self.0 {
            Engine::Scalar(lanes) => lanes.run_task(work),
            #[cfg(target_arch = "aarch64")]
            Engine::Neon(lanes) => lanes.run_task(work),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx2(lanes) => lanes.run_task(work),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx512(lanes) => lanes.run_task(work),
        }
    }
}
