//! Energy states of a block.

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]

use joulebus_energy::{EnergyModel, EnergySample, EnergyState, Learned, Metered};
use serde::{Deserialize, Serialize};

use crate::layout::lanes::{self, Block, LANES, Lanes, put};

/// The energy states of a block.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct EnergyLanes {
    metered: MeteredLanes,
    learned: [Lanes<f32>; Learned::FLOATS],
}

/// The part that changes with every sample.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct MeteredLanes([Lanes<f32>; Metered::FLOATS]);

impl MeteredLanes {
    #[inline(always)]
    fn get(&self, lane: usize) -> Metered {
        Metered::from_array(&std::array::from_fn(|place| self.0[place][lane]))
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, metered: &Metered) {
        let numbers = metered.to_array();
        for place in 0..Metered::FLOATS {
            put(&mut self.0[place][lane], mask, numbers[place]);
        }
    }
}

impl Block for EnergyLanes {
    type Robot = EnergyState;

    #[inline(always)]
    fn get(&self, lane: usize) -> EnergyState {
        EnergyState {
            metered: self.metered.get(lane),
            learned: Learned::from_array(&std::array::from_fn(|place| self.learned[place][lane])),
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, robot: EnergyState) {
        self.metered.set(lane, mask, &robot.metered);
        let numbers = robot.learned.to_array();
        for place in 0..Learned::FLOATS {
            put(&mut self.learned[place][lane], mask, numbers[place]);
        }
    }
}

/// Samples of a block.
pub(crate) struct EnergySamples<'a> {
    pub power_w: &'a Lanes<f32>,
    pub elapsed_s: &'a Lanes<f32>,
    /// NaN if unknown.
    pub v_mps: &'a Lanes<f32>,
    /// NaN if unknown.
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
    /// Takes the samples of the robots in the mask. Unless they learn, no shadow forecasts are
    /// made.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        model: &EnergyModel,
        learns: bool,
        mask: &Lanes<bool>,
        samples: &EnergySamples<'_>,
    ) {
        // A copy, so that the compiler knows that it is not aliased.
        let mut copy = self.metered;
        let mut ended = [false; LANES];
        for lane in 0..LANES {
            let mut metered = copy.get(lane);
            metered.advance(model, &samples.get(lane));
            ended[lane] = learns & mask[lane] & metered.has_ended();
            copy.set(lane, mask[lane], &metered);
        }
        self.metered = copy;
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
