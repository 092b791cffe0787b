//! The vector operations that the kernels need of a CPU.

use std::mem::MaybeUninit;

/// A CPU's vectors of `f32`. A value of an implementing type proves that this CPU supports them.
///
/// Every operation acts lane by lane and rounds once, as in IEEE 754. So each gives the same bits
/// in every implementation, except for NaN payloads.
///
/// # Safety
/// The kernels read what [`store_new`](Lanes::store_new) has written as initialised memory: an
/// implementation initialises the first `WIDTH` elements, or panics.
pub(crate) unsafe trait Lanes: Copy {
    /// A vector.
    type Vector: Copy;
    /// Eight values for [`lookup`](Lanes::lookup).
    type Table: Copy;

    /// Lanes of a vector: a divisor of [`super::packed::LINE`], as the kernels assert.
    const WIDTH: usize;
    /// Number of accumulators that fit into registers in addition to the operands.
    const SUMS: usize;
    /// True if the registers hold GELU's table beside the sums of the batch-major tiling. GELU then
    /// overlaps with multiply-adds, and batch-major is the fastest tiling even for rows, which it
    /// has to transpose.
    const GELU_OVERLAPS: bool = false;

    fn splat(self, value: f32) -> Self::Vector;
    /// The first `WIDTH` values. Panics if there are fewer.
    fn load(self, values: &[f32]) -> Self::Vector;
    /// Stores into the first `WIDTH` elements. Panics if there are fewer.
    fn store(self, vector: Self::Vector, places: &mut [f32]);
    /// Same as [`store`](Lanes::store). Afterwards the first `WIDTH` elements are initialised.
    fn store_new(self, vector: Self::Vector, places: &mut [MaybeUninit<f32>]);
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`, rounded once.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    fn abs(self, a: Self::Vector) -> Self::Vector;
    /// The minimum of two non-negative values, or `limit` if `magnitude` is NaN. Such values are
    /// ordered like their bits, and an integer comparison does not compete with the multiply-adds.
    fn at_most(self, magnitude: Self::Vector, limit: Self::Vector) -> Self::Vector;

    fn table(self, values: &[f32; 8]) -> Self::Table;
    /// `table[i]`, where `i` are the lowest three bits of each lane.
    fn lookup(self, table: Self::Table, bits: Self::Vector) -> Self::Vector;

    /// Runs the job compiled for this CPU: not inlined, so that its code exists once.
    fn run<J: Job<Self>>(self, job: J);

    /// Runs the task compiled for this CPU: directly, if the target already enables all features
    /// that were detected.
    fn run_task<W: SimdTask>(self, work: W) {
        work.run();
    }
}

/// A kernel job that is compiled for one CPU.
pub(crate) trait Job<L: Lanes> {
    /// Implementations and everything they call are `#[inline(always)]`: a function that is not
    /// inlined would be compiled for the baseline CPU.
    fn run(self, lanes: L);
}

/// A loop over columns that profits from being compiled for the CPU it runs on.
///
/// [`SimdLevel`](crate::simd::SimdLevel) has an example.
pub trait SimdTask {
    /// Implementations and everything they call are `#[inline(always)]`: a function that is not
    /// inlined would be compiled for the baseline CPU.
    fn run(self);
}
