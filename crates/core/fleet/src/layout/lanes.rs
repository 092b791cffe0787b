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

/// An instant, ns. Another clock moves it: see [`crate::FleetState::shifted`].
pub(crate) type InstantNs = u64;
/// A duration, ns.
pub(crate) type DurationNs = u64;
/// A number that is no time.
pub(crate) type Count = u64;

/// Declares the state of a robot, and the block that has a column for each of its numbers, in the
/// order in which both are stored:
///
/// ```text
/// block! {
///     struct Robot: NONE;            // `: NONE` declares that constant, from the `= …` below
///     struct RobotLanes {            // left out: such a state is stored robot by robot
///         stamp_ns: InstantNs = 0,   // never `u64`, so that its author decides what it is
///         lag_w: [f32; LAGS] = [f32::NAN; LAGS],    // a column each
///         bias: f64 as f32 = 0.0,    // computed in f64, stored in f32
///     }
/// }
/// ```
///
/// Attributes of fields are those of both.
macro_rules! block {
    (
        $(#[$about_robot:meta])* $seen:vis struct $robot:ident $(: $none:ident)?;
        $(#[$about:meta])* $visible:vis struct $block:ident $fields:tt
    ) => {
        $crate::layout::lanes::block! { @robot $(#[$about_robot])* $seen $robot $fields }
        $($crate::layout::lanes::block! { @none $robot $none $fields })?
        $crate::layout::lanes::block! { @block $robot $(#[$about])* $visible $block $fields }
    };
    ($(#[$about:meta])* $visible:vis struct $robot:ident: $none:ident $fields:tt) => {
        $crate::layout::lanes::block! { @robot $(#[$about])* $visible $robot $fields }
        $crate::layout::lanes::block! { @none $robot $none $fields }
    };
    (@robot $(#[$about:meta])* $visible:vis $robot:ident {
        $($(#[$field_about:meta])* $field_visible:vis $field:ident: $number:tt $(as $stored:tt)? $(= $start:expr)?,)*
    }) => {
        $(#[$about])*
        $visible struct $robot {
            $($(#[$field_about])* $field_visible $field: $number,)*
        }

        impl $robot {
            /// Moves the instants to another clock. Returns by how much they would be before its
            /// start, ns.
            #[allow(dead_code, unused_mut, unused_variables)]
            pub(crate) fn shift_instants(&mut self, shift: $crate::layout::shift::Shift) -> u64 {
                let mut before_ns = 0u64;
                $($crate::layout::lanes::column!(shift before_ns, self.$field, shift, $number);)*
                before_ns
            }
        }
    };
    (@none $robot:ident $none:ident {
        $($(#[$about:meta])* $visible:vis $field:ident: $number:tt $(as $stored:tt)? = $start:expr,)*
    }) => {
        impl $robot {
            /// Before the first sample.
            pub(crate) const $none: Self = Self { $($field: $start,)* };
        }
    };
    (@block $robot:ident $(#[$about:meta])* $visible:vis $block:ident {
        $($(#[$field_about:meta])* $field_visible:vis $field:ident:
            $number:tt $(as $stored:tt)? $(= $start:expr)?,)*
    }) => {
        $(#[$about])*
        $visible struct $block {
            $($(#[$field_about])* $field_visible $field:
                $crate::layout::lanes::column!(type $number $(as $stored)?),)*
        }

        impl $block {
            /// The same robot in each lane.
            #[allow(dead_code)]
            pub(crate) const fn all(robot: &$robot) -> Self {
                Self { $($field: $crate::layout::lanes::column!(all robot.$field, $number $(as $stored)?),)* }
            }
        }

        impl $crate::layout::lanes::Block for $block {
            type Robot = $robot;

            #[inline(always)]
            #[allow(clippy::needless_range_loop)]
            fn get(&self, lane: usize) -> $robot {
                $robot { $($field: $crate::layout::lanes::column!(get self.$field, lane, $number $(as $stored)?),)* }
            }

            #[inline(always)]
            #[allow(clippy::needless_range_loop)]
            fn set(&mut self, lane: usize, mask: bool, robot: $robot) {
                $($crate::layout::lanes::column!(set self.$field, lane, mask, robot.$field, $number $(as $stored)?);)*
            }
        }
    };
}

/// What [`block`] does with the column of a number, or with the columns of an array of numbers.
/// Arrays need loops, because calls of `map` and `from_fn` are not always inlined.
macro_rules! column {
    (type [[$number:ty; $inner:expr]; $outer:expr]) => {
        [[$crate::layout::lanes::Lanes<$number>; $inner]; $outer]
    };
    (type [$number:ty; $count:expr]) => { [$crate::layout::lanes::Lanes<$number>; $count] };
    (type $number:ty) => { $crate::layout::lanes::Lanes<$number> };
    (type $number:tt as $stored:ty) => { $crate::layout::lanes::Lanes<$stored> };
    (all $value:expr, [[$number:ty; $inner:expr]; $outer:expr]) => {{
        let (mut all, mut place) = ([[[$value[0][0]; $crate::layout::lanes::LANES]; $inner]; $outer], 0);
        while place < $inner * $outer {
            let value = $value[place / $inner][place % $inner];
            all[place / $inner][place % $inner] = [value; $crate::layout::lanes::LANES];
            place += 1;
        }
        all
    }};
    (all $value:expr, [$number:ty; $count:expr]) => {{
        let (mut all, mut place) = ([[$value[0]; $crate::layout::lanes::LANES]; $count], 1);
        while place < $count {
            all[place] = [$value[place]; $crate::layout::lanes::LANES];
            place += 1;
        }
        all
    }};
    (all $value:expr, $number:ty) => { [$value; $crate::layout::lanes::LANES] };
    (all $value:expr, $number:tt as $stored:ty) => { [$value as $stored; $crate::layout::lanes::LANES] };
    (get $columns:expr, $lane:ident, [[$number:ty; $inner:expr]; $outer:expr]) => {{
        let mut numbers = [[<$number>::default(); $inner]; $outer];
        for outer in 0..$outer {
            for inner in 0..$inner {
                numbers[outer][inner] = $columns[outer][inner][$lane];
            }
        }
        numbers
    }};
    (get $columns:expr, $lane:ident, [$number:ty; $count:expr]) => {{
        let mut numbers = [<$number>::default(); $count];
        for place in 0..$count {
            numbers[place] = $columns[place][$lane];
        }
        numbers
    }};
    (get $column:expr, $lane:ident, $number:ty) => { $column[$lane] };
    (get $column:expr, $lane:ident, $number:tt as $stored:ty) => { $number::from($column[$lane]) };
    (set $columns:expr, $lane:ident, $mask:ident, $value:expr, [[$number:ty; $inner:expr]; $outer:expr]) => {
        for outer in 0..$outer {
            for inner in 0..$inner {
                $crate::layout::lanes::put(&mut $columns[outer][inner][$lane], $mask, $value[outer][inner]);
            }
        }
    };
    (set $columns:expr, $lane:ident, $mask:ident, $value:expr, [$number:ty; $count:expr]) => {
        for place in 0..$count {
            $crate::layout::lanes::put(&mut $columns[place][$lane], $mask, $value[place]);
        }
    };
    (set $column:expr, $lane:ident, $mask:ident, $value:expr, $number:ty) => {
        $crate::layout::lanes::put(&mut $column[$lane], $mask, $value);
    };
    (set $column:expr, $lane:ident, $mask:ident, $value:expr, $number:tt as $stored:ty) => {
        $crate::layout::lanes::put(&mut $column[$lane], $mask, $value as $stored);
    };
    (shift $before_ns:ident, $instant:expr, $shift:ident, InstantNs) => {
        $before_ns = $before_ns.saturating_add($shift.instant(&mut $instant));
    };
    (shift $before_ns:ident, $number:expr, $shift:ident, u64) => {
        compile_error!("a state's u64 is an InstantNs, a DurationNs or a Count");
    };
    (shift $before_ns:ident, $number:expr, $shift:ident, $other:tt) => {};
}

pub(crate) use {block, column};

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

/// Changes each robot of the blocks.
pub(crate) fn for_each<B: Block>(blocks: &mut [B], mut change: impl FnMut(&mut B::Robot)) {
    for block in blocks {
        for lane in 0..LANES {
            let mut robot = block.get(lane);
            change(&mut robot);
            block.set(lane, true, robot);
        }
    }
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
