//! The kernels' instructions, for code of others.

use super::Engine;
use super::lanes::Lanes;

/// Work over columns of numbers that is worth compiling for the processor that it runs on.
pub trait SimdTask {
    /// Implementations are `#[inline(always)]`, and so is all that they call: a function that is
    /// not inlined is compiled for the baseline processor.
    fn run(self);
}

/// What this processor can do, asked once.
#[derive(Clone, Copy, Debug)]
pub struct SimdLevel(pub(crate) Engine);

impl SimdLevel {
    /// With all that it can do.
    pub fn best() -> SimdLevel {
        SimdLevel(Engine::best())
    }

    /// Runs `work` compiled for the processor. What it computes has the same bits on each, NaN
    /// payloads apart: the compiler turns loops into vectors, but never changes an operation.
    pub fn run<W: SimdTask>(self, work: W) {
        match self.0 {
            Engine::Scalar(lanes) => lanes.run_wide(work),
            #[cfg(target_arch = "aarch64")]
            Engine::Neon(lanes) => lanes.run_wide(work),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx2(lanes) => lanes.run_wide(work),
            #[cfg(target_arch = "x86_64")]
            Engine::Avx512(lanes) => lanes.run_wide(work),
        }
    }
}
