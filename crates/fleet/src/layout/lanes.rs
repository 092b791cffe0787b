//! Blocks of sixteen robots in structure-of-arrays layout: each value of the sixteen is contiguous, so
//! that a loop over them compiles to a handful of vector instructions.
//!
//! What is done to one robot is written once, for one robot, without branches; the loop around it
//! takes the robot out of its lane and puts it back, and the compiler makes vectors of the whole.
//! Rare cases are handled robot by robot, with the same functions.

use std::slice;

use joulebus_predictor::prefetch;

/// Robots in a block: as many `f32` as the widest vectors hold.
pub(crate) const LANES: usize = 16;

/// One value of each robot of a block.
pub(crate) type Lanes<T> = [T; LANES];

/// One subject of 16 robots, in columns.
pub(crate) trait Block: Copy {
    /// The same of one robot.
    type Robot: Copy;

    /// The robot in a lane.
    fn get(&self, lane: usize) -> Self::Robot;

    /// Puts the robot into a lane, where the mask is set.
    fn set(&mut self, lane: usize, mask: bool, robot: Self::Robot);
}

/// Declares the block of a struct whose fields are all numbers: each of them by itself, in this order.
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

/// Stores the value where the mask is set: a select and no branch.
#[inline(always)]
pub(crate) fn put<T: Copy>(place: &mut T, mask: bool, value: T) {
    *place = if mask { value } else { *place };
}

/// The robot in a slot.
#[inline(always)]
pub(crate) fn get<B: Block>(blocks: &[B], slot: usize) -> B::Robot {
    blocks[slot / LANES].get(slot % LANES)
}

/// Puts the robot into a slot.
#[inline(always)]
pub(crate) fn set<B: Block>(blocks: &mut [B], slot: usize, robot: B::Robot) {
    blocks[slot / LANES].set(slot % LANES, true, robot);
}

/// Whether one of them is.
#[inline(always)]
pub(crate) fn any(mask: &Lanes<bool>) -> bool {
    let mut any = 0;
    for lane in mask {
        any |= u8::from(*lane);
    }
    any != 0
}

/// Distance, in blocks, between the block being prefetched and the one being worked on: vector code
/// finishes a block before the hardware prefetcher has recognised the stride.
pub(crate) const AHEAD: usize = 4;

/// Prefetches the block that will be worked on [`AHEAD`] blocks later, if there is one.
#[inline(always)]
pub(crate) fn prefetch_ahead<B>(blocks: &[B], block: usize) {
    if let Some(ahead) = blocks.get(block + AHEAD) {
        prefetch(slice::from_ref(ahead));
    }
}
