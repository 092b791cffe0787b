//! Energy states of a block.

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]

use joulebus_energy::{EnergyModel, EnergySample, EnergyState, LEVELS, SHADOWS};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{self, Block, LANES, Lanes, put};

/// Numbers of a robot's levels, command and shadow forecasts: parts of its state that `serde` knows
/// arrays of the length of.
const PARTS: [usize; 3] = [3 * LEVELS, 3, 6 * SHADOWS];
const _: () = assert!(PARTS[0] + PARTS[1] + PARTS[2] == EnergyState::FLOATS);

/// The energy states of a block.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct EnergyLanes {
    levels: [Lanes<f32>; PARTS[0]],
    command: [Lanes<f32>; PARTS[1]],
    shadows: [Lanes<f32>; PARTS[2]],
}

impl Block for EnergyLanes {
    type Robot = EnergyState;

    #[inline(always)]
    fn get(&self, lane: usize) -> EnergyState {
        let mut numbers = [0.0; EnergyState::FLOATS];
        for place in 0..PARTS[0] {
            numbers[place] = self.levels[place][lane];
        }
        for place in 0..PARTS[1] {
            numbers[PARTS[0] + place] = self.command[place][lane];
        }
        for place in 0..PARTS[2] {
            numbers[PARTS[0] + PARTS[1] + place] = self.shadows[place][lane];
        }
        EnergyState::from_array(&numbers)
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, robot: EnergyState) {
        let numbers = robot.to_array();
        for place in 0..PARTS[0] {
            put(&mut self.levels[place][lane], mask, numbers[place]);
        }
        for place in 0..PARTS[1] {
            put(
                &mut self.command[place][lane],
                mask,
                numbers[PARTS[0] + place],
            );
        }
        for place in 0..PARTS[2] {
            let number = numbers[PARTS[0] + PARTS[1] + place];
            put(&mut self.shadows[place][lane], mask, number);
        }
    }
}

/// Samples of a block.
pub(crate) struct EnergySamples<'a> {
    pub power_w: &'a Lanes<f32>,
    pub elapsed_s: &'a Lanes<f32>,
    /// NaN where unknown.
    pub v_mps: &'a Lanes<f32>,
    /// NaN where unknown.
    pub omega_radps: &'a Lanes<f32>,
}

impl EnergySamples<'_> {
    #[inline(always)]
    fn get(&self, lane: usize) -> EnergySample {
        EnergySample {
            power_w: self.power_w[lane],
            elapsed_s: self.elapsed_s[lane],
            v_mps: self.v_mps[lane],
            omega_radps: self.omega_radps[lane],
        }
    }
}

impl EnergyLanes {
    /// Takes the samples of the robots in the mask.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        model: &EnergyModel,
        mask: &Lanes<bool>,
        samples: &EnergySamples<'_>,
    ) {
        // A copy, so that the compiler knows that it is not aliased.
        let mut copy = *self;
        let mut ended = [false; LANES];
        for lane in 0..LANES {
            let mut robot = copy.get(lane);
            robot.advance(model, &samples.get(lane));
            ended[lane] = mask[lane] & robot.has_ended();
            copy.set(lane, mask[lane], robot);
        }
        *self = copy;
        if lanes::any(&ended) {
            self.compare(model, &ended);
        }
    }

    #[cold]
    #[inline(never)]
    fn compare(&mut self, model: &EnergyModel, ended: &Lanes<bool>) {
        for lane in (0..LANES).filter(|lane| ended[*lane]) {
            let mut robot = self.get(lane);
            robot.compare(model);
            self.set(lane, true, robot);
        }
    }
}
