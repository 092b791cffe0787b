//! Writes what the robots of a block have learned into the diagnostics and the plan states.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use crate::estimate::online::{Learned, Start, Weights};
use crate::layout::lanes::{Block as _, LANES, Lanes};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;

/// The weights of a block's members.
pub(crate) struct LearnedLanes {
    /// Whether the robot's platform learns online.
    learns: Lanes<bool>,
    weights: Lanes<Weights>,
}

impl LearnedLanes {
    #[inline(always)]
    pub(crate) fn of(tick: &TickContext, block: &BlockRef<'_>) -> Self {
        let mut learned = Self { learns: [false; LANES], weights: [Weights::NONE; LANES] };
        let Some(online) = block.online else {
            return learned;
        };
        let mut starts = [Start::NONE; LANES];
        for lane in 0..LANES {
            let platform = usize::from(block.admissions[lane].platform);
            let context = tick.platforms.get(platform);
            if let Some(members) = context.and_then(|context| context.members.as_ref()) {
                learned.learns[lane] = true;
                starts[lane] = members.start(online.mean_w[lane]);
            }
        }
        for lane in 0..LANES {
            learned.weights[lane] = online.get(lane).weights(starts[lane]);
        }
        learned
    }

    /// Whether the robot in a lane learns, and what it has learned. [`Learned::NONE`] if it does
    /// not.
    #[inline(always)]
    pub(crate) fn get(&self, block: &BlockRef<'_>, lane: usize) -> (bool, Learned) {
        let (learns, weights) = (self.learns[lane], &self.weights[lane]);
        let online = block.online.filter(|_| learns);
        let learned = online.map_or(Learned::NONE, |online| online.get(lane).learned(weights));
        (learns, learned)
    }
}
