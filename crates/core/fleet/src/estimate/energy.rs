//! Energy states of a block.

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]

use std::slice;

use joulebus_energy::{
    EnergyModel, EnergySample, EnergyState, ErrorBounds, LEVELS, Learned, Metered, SHADOWS,
};
use joulebus_predictor::simd::prefetch;
use serde::{Deserialize, Deserializer, Serialize};

use crate::estimate::calibration::SharedErrors;
use crate::layout::lanes::{self, Block, LANES, Lanes, put};
use crate::layout::versions::{NARROW, READ, is_before};

/// The energy states of a block.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[repr(align(64))]
pub(crate) struct EnergyLanes {
    metered: MeteredLanes,
    learned: LearnedLanes,
}

/// [`Learned`] of a block.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
#[serde(from = "LearnedOfAnyVersion")]
struct LearnedLanes {
    /// The shadow forecasts' groups, before [`TRUST`] and after it: the upper halves of the bits.
    shadows: [[Lanes<u16>; SHADOWS]; Learned::GROUPS - 1],
    trust: [Lanes<f32>; SHADOWS],
}

/// The group of [`Learned::to_groups`] that is not of shadow forecasts.
const TRUST: usize = 3;

impl LearnedLanes {
    #[inline(always)]
    fn get(&self, lane: usize) -> Learned {
        // Loops, because calls of `map` are not always inlined.
        let mut groups = [[0.0; SHADOWS]; Learned::GROUPS];
        for group in 0..Learned::GROUPS - 1 {
            for shadow in 0..SHADOWS {
                let upper = u32::from(self.shadows[group][shadow][lane]);
                groups[group + usize::from(group >= TRUST)][shadow] = f32::from_bits(upper << 16);
            }
        }
        for number in 0..SHADOWS {
            groups[TRUST][number] = self.trust[number][lane];
        }
        Learned::from_groups(&groups)
    }

    /// Stores it. The lower halves of the shadow forecasts are 0.
    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, learned: &Learned) {
        let groups = learned.to_groups();
        for group in 0..Learned::GROUPS - 1 {
            for shadow in 0..SHADOWS {
                let bits = groups[group + usize::from(group >= TRUST)][shadow].to_bits();
                put(&mut self.shadows[group][shadow][lane], mask, (bits >> 16) as u16);
            }
        }
        for number in 0..SHADOWS {
            put(&mut self.trust[number][lane], mask, groups[TRUST][number]);
        }
    }
}

/// The part that changes with every sample.
#[derive(Debug, Clone, Copy, Default, Serialize, Deserialize)]
struct MeteredLanes([Lanes<f32>; Metered::FLOATS]);

impl MeteredLanes {
    #[inline(always)]
    fn get(&self, lane: usize) -> Metered {
        // A loop, because calls of `from_fn` are not always inlined.
        let mut numbers = [0.0; Metered::FLOATS];
        for place in 0..Metered::FLOATS {
            numbers[place] = self.0[place][lane];
        }
        Metered::from_array(&numbers)
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
            learned: self.learned.get(lane),
            bounds: ErrorBounds::TRAINED,
        }
    }

    #[inline(always)]
    fn set(&mut self, lane: usize, mask: bool, robot: EnergyState) {
        self.metered.set(lane, mask, &robot.metered);
        self.learned.set(lane, mask, &robot.learned);
    }
}

/// [`LearnedLanes`] in the encoding of any version. Versions before 0x13 have 32 bits for each number,
/// and versions before 0x12 two groups of factors more.
struct LearnedOfAnyVersion(LearnedLanes);

impl<'de> Deserialize<'de> for LearnedOfAnyVersion {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        type Group<T> = [Lanes<T>; SHADOWS];
        if !is_before(NARROW) {
            type Fields = ([Group<u16>; Learned::GROUPS - 1], Group<f32>);
            let (shadows, trust) = Fields::deserialize(from)?;
            return Ok(Self(LearnedLanes { shadows, trust }));
        }
        let groups = if !is_before(READ) {
            <[Group<f32>; Learned::GROUPS]>::deserialize(from)?
        } else {
            let [factor, added, mean, _, trust, last, own, _, of, outlook] =
                <[Group<f32>; 10]>::deserialize(from)?;
            [factor, added, mean, trust, last, own, of, outlook]
        };
        let mut lanes = LearnedLanes::default();
        for lane in 0..LANES {
            let numbers = groups.map(|group| group.map(|lanes| lanes[lane]));
            lanes.set(lane, true, &Learned::from_groups(&numbers).rounded());
        }
        Ok(Self(lanes))
    }
}

impl From<LearnedOfAnyVersion> for LearnedLanes {
    fn from(LearnedOfAnyVersion(lanes): LearnedOfAnyVersion) -> Self {
        lanes
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
    /// On its charger, where a robot shows nothing of its work.
    pub charging: &'a Lanes<bool>,
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
    /// The command in force, m/s and rad/s, NaN if unknown, and its power by the platform's model, W.
    #[inline(always)]
    pub(crate) fn command(&self, lane: usize) -> ((f32, f32), f32) {
        let [v_mps, omega_radps, command_w] = Metered::COMMAND;
        let number = |place: usize| self.metered.0[place][lane];
        ((number(v_mps), number(omega_radps)), number(command_w))
    }

    /// The energy state of the robot in a lane, with the bounds of its intervals.
    #[inline(always)]
    pub(crate) fn state(&self, lane: usize, errors: &SharedErrors) -> EnergyState {
        EnergyState { bounds: errors.platform().plans, ..self.get(lane) }
    }

    /// Prefetches what each sample changes of the block some blocks later.
    #[inline(always)]
    pub(crate) fn prefetch_ahead(all: &[Self], block: usize) {
        if let Some(ahead) = all.get(block + lanes::AHEAD) {
            prefetch(slice::from_ref(&ahead.metered));
        }
    }

    /// Energy and time of the longest level of the robot in a lane, J and s.
    #[inline(always)]
    pub(crate) fn longest_level(&self, lane: usize) -> (f32, f32) {
        let [energy_j, time_s] = Metered::LONGEST;
        (self.metered.0[energy_j][lane], self.metered.0[time_s][lane])
    }

    /// True if the levels of the robot in a lane are known well enough to stay while it is on its
    /// charger, where it draws what it does not draw at work.
    #[inline(always)]
    pub(crate) fn is_settled(&self, lane: usize) -> bool {
        /// Time of readings, s.
        const SETTLED_S: f32 = 30.0;
        self.metered.get(lane).time_s[LEVELS - 1] >= SETTLED_S
    }

    /// Takes the samples of the robots in the mask, whose ids and known levels `robot` gives.
    /// Without shared errors they do not learn, and no shadow forecasts are made.
    #[inline(always)]
    pub(crate) fn observe(
        &mut self,
        model: &EnergyModel,
        errors: Option<&SharedErrors>,
        mask: &Lanes<bool>,
        samples: &EnergySamples<'_>,
        robot: impl Fn(usize) -> (u32, Option<f32>),
    ) {
        let (command, learns) = (model.command, errors.is_some());
        let mut ended = [false; LANES];
        for lane in 0..LANES {
            let mut metered = self.metered.get(lane);
            metered.advance(&command, &samples.get(lane));
            ended[lane] = learns & mask[lane] & metered.has_ended();
            self.metered.set(lane, mask[lane], &metered);
        }
        if let Some(errors) = errors.filter(|_| lanes::any(&ended)) {
            self.compare(model, errors, &ended, samples, robot);
        }
    }

    #[cold]
    #[inline(never)]
    fn compare(
        &mut self,
        model: &EnergyModel,
        errors: &SharedErrors,
        ended: &Lanes<bool>,
        samples: &EnergySamples<'_>,
        robot: impl Fn(usize) -> (u32, Option<f32>),
    ) {
        for lane in (0..LANES).filter(|lane| ended[*lane]) {
            let mut state = self.get(lane);
            let new = state.compare(model, errors.platform(), samples.power_w[lane]);
            errors.count(robot(lane), &new, samples.charging[lane]);
            self.set(lane, true, state);
        }
    }
}
