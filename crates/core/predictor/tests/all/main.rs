//! The tests of forecasts: model files, kernels, memory and rollouts.

// These take hours under Miri; `memory` is the test for Miri.
#[cfg(not(miri))]
mod files;
#[cfg(not(miri))]
mod kernels;
mod memory;
#[cfg(not(miri))]
mod rollouts;
