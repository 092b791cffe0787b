//! The kernels' instructions, for other work: the tick's loops.

use super::engine::Engine;
use super::lanes::{Lanes, SimdTask};

/// What this processor can do, detected once.
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
