//! Writes what the robots of a block have learned into the diagnostics and the plan states.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use crate::estimate::online::Learned;
use crate::layout::lanes::{Block as _, LANES, Lanes};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;

/// The weights of a block's members.
pub(crate) struct LearnedLanes {
    /// Whether the robot's platform learns online.
    learns: Lanes<bool>,
    weights: [Lanes<f32>; 3],
    held_weights: [Lanes<f32>; 2],
}

impl LearnedLanes {
    #[inline(always)]
    pub(crate) fn of(tick: &TickContext, block: &BlockRef<'_>) -> Self {
        let mut learned = Self {
            learns: [false; LANES],
            weights: [[f32::NAN; LANES]; 3],
            held_weights: [[f32::NAN; LANES]; 2],
        };
        let Some(online) = block.online else {
            return learned;
        };
        let mut unlike = [false; LANES];
        for lane in 0..LANES {
            let platform = usize::from(block.admissions[lane].platform);
            let members = tick
                .platforms
                .get(platform)
                .and_then(|context| context.members.as_ref());
            learned.learns[lane] = members.is_some();
            unlike[lane] = members.is_some_and(|members| members.is_unlike(online.mean_w[lane]));
        }
        for lane in 0..LANES {
            let (weights, held_weights) = online.get(lane).weights(unlike[lane]);
            for (place, weight) in weights.into_iter().enumerate() {
                learned.weights[place][lane] = weight;
            }
            for (place, weight) in held_weights.into_iter().enumerate() {
                learned.held_weights[place][lane] = weight;
            }
        }
        learned
    }

    /// Whether the robot in a lane learns, and what it has learned. [`Learned::NONE`] if it does
    /// not.
    #[inline(always)]
    pub(crate) fn get(&self, block: &BlockRef<'_>, lane: usize) -> (bool, Learned) {
        let [last, network, stack] = &self.weights;
        let [held_last, held_stack] = &self.held_weights;
        let weights = (
            [last[lane], network[lane], stack[lane]],
            [held_last[lane], held_stack[lane]],
        );
        let online = block.online.filter(|_| self.learns[lane]);
        let learned = online.map_or(Learned::NONE, |online| online.get(lane).learned(weights));
        (self.learns[lane], learned)
    }
}
