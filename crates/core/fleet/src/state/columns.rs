//! The state of all robots, in columns indexed by slot.

use joulebus_settings::FleetSettings;
use serde::{Deserialize, Serialize};

use crate::alarms::detector::DetectorLanes;
use crate::alarms::level::LevelLanes;
use crate::estimate::energy::EnergyLanes;
use crate::estimate::interval::IntervalLanes;
use crate::estimate::online::OnlineLanes;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::admission::AdmissionState;
use crate::ingest::last_sample::LastLanes;
use crate::ingest::pending::PendingBlock;
use crate::layout::lanes::LANES;
use crate::layout::slots::{self, BLOCKS};
use crate::ledger::battery::BatteryLanes;
use crate::ledger::departed::Departed;
use crate::ledger::energy::Ledger;
use crate::ledger::energy::LedgerLanes;

/// Bytes of one robot in the columns that are always there.
const COLUMNS: usize = size_of::<AdmissionState>()
    + (size_of::<PendingBlock>()
        + size_of::<WindowLanes>()
        + size_of::<LastLanes>()
        + size_of::<IntervalLanes>()
        + size_of::<LedgerLanes>()
        + size_of::<ScoreLanes>()
        + size_of::<DetectorLanes>()
        + size_of::<EnergyLanes>()
        + size_of::<LevelLanes>())
    .div_ceil(LANES);

/// A robot that learns online and has a battery takes at most 1,000 bytes in the columns.
const _: () = assert!(
    COLUMNS + size_of::<OnlineLanes>().div_ceil(LANES) + size_of::<BatteryLanes>().div_ceil(LANES)
        <= 1_000
);

/// A robot takes at most 710 bytes, its account after departure included: the columns, that
/// account, its bit in the slot map, and one and a half entries in each of the two id tables.
const _: () =
    assert!(COLUMNS + size_of::<Ledger>() + Departed::BYTES + 1 + 3 * size_of::<u32>() <= 710);

/// Declares the columns once: name, type of a block of robots, and what a check of a saved state
/// calls it. `apart` are not read where the output of a block is computed. `optional` are empty
/// unless a platform needs them.
macro_rules! columns {
    (
        apart { $($apart:ident: $apart_type:ty, $apart_name:literal;)* }
        always { $($always:ident: $always_type:ty, $always_name:literal;)* }
        optional { $($(#[doc = $doc:literal])* $optional:ident: $optional_type:ty, $optional_name:literal;)* }
    ) => {
        /// The state of a block of robots.
        #[derive(Debug, Clone, Copy)]
        pub(crate) struct BlockRef<'a> {
            pub admissions: &'a [AdmissionState; LANES],
            $(pub $always: &'a $always_type,)*
            $($(#[doc = $doc])* pub $optional: Option<&'a $optional_type>,)*
        }

        /// The columns, for the capacity rounded up to a whole block. Of a saved state, for the
        /// slots ever used.
        #[derive(Debug, Clone, Default, Serialize, Deserialize)]
        pub(crate) struct Columns {
            pub admissions: Vec<AdmissionState>,
            $(pub $apart: Vec<$apart_type>,)*
            $(pub $always: Vec<$always_type>,)*
            $($(#[doc = $doc])* pub $optional: Vec<$optional_type>,)*
        }

        impl Columns {
            /// For so many robots, all of it touched. `needed`: which of the optional ones.
            pub(crate) fn new(robots: usize, needed: Needed) -> Self {
                let blocks = robots.div_ceil(LANES);
                Self {
                    admissions: vec![AdmissionState::FREE; robots],
                    $($apart: vec![<$apart_type>::default(); blocks],)*
                    $($always: vec![<$always_type>::default(); blocks],)*
                    $($optional: vec![
                        <$optional_type>::default();
                        if needed.$optional { blocks } else { 0 }
                    ],)*
                }
            }

            /// Empties them, and keeps their memory.
            pub(crate) fn clear(&mut self) {
                self.admissions.clear();
                $(self.$apart.clear();)*
                $(self.$always.clear();)*
                $(self.$optional.clear();)*
            }

            /// Becomes a copy of the first `robots` of `from`, without allocating where there is
            /// room.
            pub(crate) fn copy(&mut self, from: &Self, robots: usize) {
                let blocks = robots.div_ceil(LANES);
                self.clear();
                self.admissions.extend_from_slice(&from.admissions[..robots]);
                $(self.$apart.extend_from_slice(&from.$apart[..blocks]);)*
                $(self.$always.extend_from_slice(&from.$always[..blocks]);)*
                $(self.$optional
                    .extend_from_slice(&from.$optional[..blocks.min(from.$optional.len())]);)*
            }

            /// Takes the blocks of a saved state, which is [`Columns::check`]ed. All other slots are
            /// free, and empty: what was in them before would be in later states.
            pub(crate) fn restore(&mut self, from: &Self) {
                let robots = from.admissions.len();
                self.admissions[..robots].copy_from_slice(&from.admissions);
                self.admissions[robots..].fill(AdmissionState::FREE);
                $(
                    self.$apart[..from.$apart.len()].copy_from_slice(&from.$apart);
                    self.$apart[from.$apart.len()..].fill(<$apart_type>::default());
                )*
                $(
                    self.$always[..from.$always.len()].copy_from_slice(&from.$always);
                    self.$always[from.$always.len()..].fill(<$always_type>::default());
                )*
                $(
                    self.$optional[..from.$optional.len()].copy_from_slice(&from.$optional);
                    self.$optional[from.$optional.len()..].fill(<$optional_type>::default());
                )*
            }

            /// Name, length and expected length of each column of a saved state of this fleet.
            pub(crate) fn lengths(
                &self,
                saved: &Self,
            ) -> impl Iterator<Item = (&'static str, usize, usize)> {
                let blocks = saved.admissions.len().div_ceil(LANES);
                [
                    $(($apart_name, saved.$apart.len(), blocks),)*
                    $(($always_name, saved.$always.len(), blocks),)*
                    $((
                        $optional_name,
                        saved.$optional.len(),
                        blocks.min(self.$optional.len()),
                    ),)*
                ]
                .into_iter()
            }

            /// State from which the output of a block is computed.
            pub(crate) fn block(&self, block: usize) -> BlockRef<'_> {
                BlockRef {
                    admissions: &self.admissions.as_chunks().0[block],
                    $($always: &self.$always[block],)*
                    $($optional: self.$optional.get(block),)*
                }
            }

            /// All of them. `words` has a bit for each slot in use.
            pub(crate) fn view_mut<'a>(&'a mut self, words: &'a [u64]) -> ColumnsMut<'a> {
                ColumnsMut {
                    admissions: &mut self.admissions,
                    $($apart: &mut self.$apart,)*
                    $($always: &mut self.$always,)*
                    $($optional: &mut self.$optional,)*
                    words,
                }
            }
        }

        /// Columns of a contiguous range of slots, all of one length, and a bit for each slot in
        /// use. Ranges of different shards are disjoint.
        #[derive(Debug)]
        pub(crate) struct ColumnsMut<'a> {
            pub admissions: &'a mut [AdmissionState],
            $(pub $apart: &'a mut [$apart_type],)*
            $(pub $always: &'a mut [$always_type],)*
            $($(#[doc = $doc])* pub $optional: &'a mut [$optional_type],)*
            pub words: &'a [u64],
        }

        impl<'a> ColumnsMut<'a> {
            /// The slots of the first `words` words, and the rest.
            pub(crate) fn split(self, words: usize) -> (Self, Self) {
                let words = words.min(self.words.len());
                let block = (words * BLOCKS).min(self.intervals.len());
                let admissions = self.admissions.split_at_mut(block * LANES);
                $(let $apart = self.$apart.split_at_mut(block);)*
                $(let $always = self.$always.split_at_mut(block);)*
                $(let $optional = self.$optional.split_at_mut(block.min(self.$optional.len()));)*
                let words = self.words.split_at(words);
                (
                    Self {
                        admissions: admissions.0,
                        $($apart: $apart.0,)*
                        $($always: $always.0,)*
                        $($optional: $optional.0,)*
                        words: words.0,
                    },
                    Self {
                        admissions: admissions.1,
                        $($apart: $apart.1,)*
                        $($always: $always.1,)*
                        $($optional: $optional.1,)*
                        words: words.1,
                    },
                )
            }

            pub(crate) fn reborrow(&mut self) -> ColumnsMut<'_> {
                ColumnsMut {
                    admissions: self.admissions,
                    $($apart: self.$apart,)*
                    $($always: self.$always,)*
                    $($optional: self.$optional,)*
                    words: self.words,
                }
            }

            /// Same as [`Columns::block`].
            #[inline(always)]
            pub(crate) fn block(&self, block: usize) -> BlockRef<'_> {
                BlockRef {
                    admissions: &self.admissions.as_chunks().0[block],
                    $($always: &self.$always[block],)*
                    $($optional: self.$optional.get(block),)*
                }
            }
        }
    };
}

columns! {
    apart {
        pending: PendingBlock, "blocks of pending";
    }
    always {
        windows: WindowLanes, "blocks of windows";
        lasts: LastLanes, "blocks of last samples";
        intervals: IntervalLanes, "blocks of intervals";
        ledgers: LedgerLanes, "blocks of ledgers";
        scores: ScoreLanes, "blocks of scores";
        detectors: DetectorLanes, "blocks of detectors";
        energy: EnergyLanes, "blocks of energy states";
    }
    optional {
        /// Empty unless a platform learns online.
        online: OnlineLanes, "blocks of what is learned online";
        /// Empty unless a platform has a battery.
        batteries: BatteryLanes, "blocks of batteries";
        levels: LevelLanes, "blocks of levels";
    }
}

/// The optional columns that a fleet needs.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Needed {
    /// A platform learns online.
    pub online: bool,
    /// A platform has a battery.
    pub batteries: bool,
    /// They always are.
    pub levels: bool,
}

impl Needed {
    pub(crate) fn by(settings: &FleetSettings) -> Self {
        Self {
            online: settings.platforms.iter().any(|platform| platform.online),
            batteries: settings.has_batteries(),
            levels: true,
        }
    }
}

impl ColumnsMut<'_> {
    /// Number of robots in these slots.
    pub(crate) fn robots(&self) -> usize {
        slots::count(self.words)
    }
}
