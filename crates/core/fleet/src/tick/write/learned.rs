//! Learned state of the robots of a block, for the diagnostics and the plan states.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use crate::estimate::online::{Learned, LearnedColumns, SCEPTIC_LOSSES};
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
        let mut sceptic_loss = SCEPTIC_LOSSES;
        for lane in 0..LANES {
            let platform = usize::from(block.admissions[lane].platform);
            let context = tick.platforms.get(platform);
            if let Some(members) = context.and_then(|context| context.members.as_ref()) {
                all.learns[lane] = true;
                sceptic_loss[lane] = members.sceptic_loss;
            }
        }
        for lane in 0..LANES {
            let robot = online.get(lane);
            let learned = robot.learned(&robot.weights(sceptic_loss[lane]));
            all.learned.set(lane, all.learns[lane], learned);
        }
        all
    }

    /// True if the robot in a lane learns, and what it has learned: all NaN if it does not.
    #[inline(always)]
    pub(crate) fn get(&self, lane: usize) -> (bool, Learned) {
        (self.learns[lane], self.learned.get(lane))
    }
}
