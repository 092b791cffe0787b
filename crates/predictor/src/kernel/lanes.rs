//! What the kernels ask of a CPU.

use std::mem::MaybeUninit;

/// A CPU's vectors of `f32`. A value of an implementing type proves that this CPU has them.
///
/// Every operation is done lane by lane and rounded once, as IEEE 754 says; so each gives the same
/// bits on every implementation, NaN payloads apart.
///
/// # Safety
/// The kernels read what [`store_new`](Lanes::store_new) has written without looking at it again:
/// an implementation initialises the first `WIDTH` places, or panics.
pub(crate) unsafe trait Lanes: Copy {
    /// A vector.
    type Vector: Copy;
    /// Eight values that [`lookup`](Lanes::lookup) picks from.
    type Table: Copy;

    /// Lanes of a vector: a divisor of [`super::packed::LINE`], which the kernels assert.
    const WIDTH: usize;
    /// Sums that stay in registers beside what is multiplied.
    const SUMS: usize;

    fn splat(self, value: f32) -> Self::Vector;
    /// The first `WIDTH` values; panics if there are fewer.
    fn load(self, values: &[f32]) -> Self::Vector;
    /// Into the first `WIDTH` places; panics if there are fewer.
    fn store(self, vector: Self::Vector, places: &mut [f32]);
    /// As [`store`](Lanes::store): afterwards the first `WIDTH` places are initialised.
    fn store_new(self, vector: Self::Vector, places: &mut [MaybeUninit<f32>]);
    fn add(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn sub(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn mul(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    fn div(self, a: Self::Vector, b: Self::Vector) -> Self::Vector;
    /// `a * b + c`, rounded once.
    fn mul_add(self, a: Self::Vector, b: Self::Vector, c: Self::Vector) -> Self::Vector;
    fn abs(self, a: Self::Vector) -> Self::Vector;
    /// The smaller of two values that are not negative, `limit` where `magnitude` is NaN. Such
    /// values are ordered like their bits, whose comparison is not in a multiply-add's way.
    fn at_most(self, magnitude: Self::Vector, limit: Self::Vector) -> Self::Vector;

    fn table(self, values: &[f32; 8]) -> Self::Table;
    /// `table[i]`, where `i` are the lowest three bits of each lane.
    fn lookup(self, table: Self::Table, bits: Self::Vector) -> Self::Vector;

    /// Runs the job compiled for this CPU: not inlined, so that its code exists once.
    fn run<J: Job<Self>>(self, job: J);

    /// Runs work without vectors of its own compiled for this CPU: as it is, where the target already
    /// stands for all that the CPU is known to do.
    fn run_task<W: SimdTask>(self, work: W) {
        work.run();
    }
}

/// Work that is compiled for one CPU.
pub(crate) trait Job<L: Lanes> {
    /// Implementations are `#[inline(always)]`, and so is all that they call: a function that is
    /// not inlined would be compiled for the baseline CPU.
    fn run(self, lanes: L);
}

/// Work over columns of numbers that is worth compiling for the processor that it runs on.
pub trait SimdTask {
    /// Implementations are `#[inline(always)]`, and so is all that they call: a function that is
    /// not inlined is compiled for the baseline processor.
    fn run(self);
}
