//! The kernels' instruction sets for loops beside the network, such as the fleet's tick: the same
//! bits on each processor.
//!
//! A [`SimdTask`] is compiled once for each instruction set. [`SimdLevel::run`] runs it with that
//! of this processor, and [`prefetch`] fetches what the next one reads.

pub use crate::kernel::{SimdLevel, SimdTask, prefetch};
