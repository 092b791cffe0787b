//! Learned state of the robots of a block, for the diagnostics and the plan states.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use crate::estimate::online::{Learned, LearnedColumns, StartLanes};
use crate::layout::lanes::{Block as _, LANES, Lanes};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;

/// Learned state of the robots of a block.
pub(crate) struct LearnedLanes {
    /// True if the robot's platform learns online.
    learns: Lanes<bool>,
    learned: LearnedColumns,
}

impl LearnedLanes {
    #[inline(always)]
    pub(crate) fn new(tick: &TickContext, block: &BlockRef<'_>) -> Self {
        let mut all = Self { learns: [false; LANES], learned: LearnedColumns::NONE };
        let Some(online) = block.online else {
            return all;
        };
        let mut starts = StartLanes::NONE;
        for lane in 0..LANES {
            let platform = usize::from(block.admissions[lane].platform);
            let context = tick.platforms.get(platform);
            if let Some(members) = context.and_then(|context| context.members.as_ref()) {
                all.learns[lane] = true;
                starts.set(lane, members);
            }
        }
        for lane in 0..LANES {
            let robot = online.get(lane);
            let learned = robot.learned(&robot.weights(starts.of(lane, robot.mean_w)));
            all.learned.set(lane, all.learns[lane], &learned);
        }
        all
    }

    /// True if the robot in a lane learns, and what it has learned: all NaN if it does not.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> (bool, Learned) {
        (self.learns[lane], self.learned.get(lane))
    }
}
