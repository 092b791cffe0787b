//! Blocks of sixteen robots in structure-of-arrays layout: each value of the sixteen is contiguous,
//! so that a loop over them compiles to a few vector instructions.
//!
//! An operation is written once, for one robot, without branches. The loop around it loads the
//! robot from its lane and stores it back, and the compiler vectorises the whole. Rare cases are
//! handled robot by robot, with the same functions.

use std::hint::select_unpredictable;
use std::slice;

use joulebus_predictor::simd::prefetch;

/// Robots per block: the f32 lanes of the widest vectors.
pub(crate) const LANES: usize = 16;

/// One value of each robot of a block.
pub(crate) type Lanes<T> = [T; LANES];

/// One kind of state of 16 robots, in columns.
pub(crate) trait Block: Copy {
    /// The same of one robot.
    type Robot: Copy;

    /// Loads the robot in a lane.
    fn get(&self, lane: usize) -> Self::Robot;

    /// Stores the robot into a lane, where the mask is set.
    fn set(&mut self, lane: usize, mask: bool, robot: Self::Robot);
}

/// Declares the block of a struct whose fields are all numbers, each a column, in this order.
macro_rules! block {
    (
        $(#[$about:meta])*
        $visible:vis struct $block:ident of $robot:ident {
            $($(#[$about_field:meta])* $field_visible:vis $field:ident: $number:ty,)*
        }
    ) => {
        $(#[$about])*
        $visible struct $block {
            $($(#[$about_field])* $field_visible $field: $crate::layout::lanes::Lanes<$number>,)*
        }

        impl $crate::layout::lanes::Block for $block {
            type Robot = $robot;

            #[inline(always)]
            fn get(&self, lane: usize) -> $robot {
                $robot {
                    $($field: self.$field[lane],)*
                }
            }

            #[inline(always)]
            fn set(&mut self, lane: usize, mask: bool, robot: $robot) {
                $($crate::layout::lanes::put(&mut self.$field[lane], mask, robot.$field);)*
            }
        }
    };
}

pub(crate) use block;

/// Stores the value where the mask is set, by a select instead of a branch.
#[inline(always)]
pub(crate) fn put<T: Copy>(place: &mut T, mask: bool, value: T) {
    // The value is loaded in either case, so that no branch takes its place.
    let kept = *place;
    *place = select_unpredictable(mask, value, kept);
}

/// Maps an array, always inlined. `values.map(to)` is not always inlined, and then the loop over
/// lanes calls it for each robot instead of becoming vectors.
#[inline(always)]
#[allow(clippy::needless_range_loop)]
pub(crate) fn each<T: Copy, U: Copy + Default, const N: usize>(
    values: [T; N],
    to: impl Fn(T) -> U,
) -> [U; N] {
    let mut mapped = [U::default(); N];
    for place in 0..N {
        mapped[place] = to(values[place]);
    }
    mapped
}

/// Loads the robot in a slot.
#[inline(always)]
pub(crate) fn get<B: Block>(blocks: &[B], slot: usize) -> B::Robot {
    blocks[slot / LANES].get(slot % LANES)
}

/// Stores the robot into a slot.
#[inline(always)]
pub(crate) fn set<B: Block>(blocks: &mut [B], slot: usize, robot: B::Robot) {
    blocks[slot / LANES].set(slot % LANES, true, robot);
}

/// True if any lane is set.
#[inline(always)]
pub(crate) fn any(mask: &Lanes<bool>) -> bool {
    let mut any = 0;
    for lane in mask {
        any |= u8::from(*lane);
    }
    any != 0
}

/// Prefetch distance in blocks: vector code finishes a block before the hardware prefetcher
/// recognises the stride.
pub(crate) const AHEAD: usize = 4;

/// Prefetches the block [`AHEAD`] blocks later, if there is one.
#[inline(always)]
pub(crate) fn prefetch_ahead<B>(blocks: &[B], block: usize) {
    if let Some(ahead) = blocks.get(block + AHEAD) {
        prefetch(slice::from_ref(ahead));
    }
}
