//! The kernels: one source over a lane type, compiled for several CPUs, in two tilings.
//!
//! Robots are never combined, and the operations for each are the reference's, in its order. So
//! neither width nor tiling nor position can change a bit.

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)] // Intrinsics of a CPU feature that was detected.
mod avx2;
#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code)] // As above.
mod avx512;
mod batch;
mod engine;
#[allow(unsafe_code)] // Uninitialised scratch memory.
mod forward;
#[allow(unsafe_code)] // A trait that guarantees initialisation.
mod lanes;
#[cfg(target_arch = "aarch64")]
#[allow(unsafe_code)] // Intrinsics that every CPU of the target has.
mod neon;
mod packed;
#[allow(unsafe_code)] // A prefetch takes an address.
mod prefetch;
mod rollout;
#[allow(unsafe_code)] // Implements that guarantee.
mod scalar;
mod simd_level;

pub use batch::Tiling;
pub(crate) use engine::Engine;
pub use engine::Kernel;
pub(crate) use forward::pairwise;
pub use lanes::SimdTask;
pub(crate) use packed::{LINE, Packed, fold};
pub use prefetch::prefetch;
pub use simd_level::SimdLevel;
