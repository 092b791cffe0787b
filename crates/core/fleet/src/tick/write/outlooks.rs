//! Writes the outlooks.

// Index loops: the compiler vectorises them.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::nan::canonical;
use joulebus_predictor::simd::SimdTask;
use joulebus_wire::{
    Budget, InvalidReason, OUTLOOK_HORIZONS, OUTLOOK_S, Outlook, Quality, budget_flag, outlook_flag,
};

use crate::layout::lanes::{self, Block as _, LANES, Lanes, put};
use crate::state::columns::BlockRef;
use crate::tick::context::TickContext;
use crate::tick::write::flag::flag;
use crate::tick::write::forecasts::quality_of;

const INVALID: u16 = Quality::Invalid(InvalidReason::Stale).encode().0;

/// Computes the outlooks of a block.
struct Fill<'a, 'b> {
    tick: &'a TickContext,
    all: &'a mut OutlookRows<'b>,
}

impl SimdTask for Fill<'_, '_> {
    #[inline(always)]
    fn run(self) {
        OutlookRows::fill(self.all, self.tick);
    }
}

type Joules = [Lanes<f32>; OUTLOOK_HORIZONS];

/// The outlooks of a block.
pub(crate) struct OutlookRows<'a> {
    block: BlockRef<'a>,
    energy_j: Joules,
    lo_j: Joules,
    hi_j: Joules,
}

impl<'a> OutlookRows<'a> {
    #[inline(always)]
    pub(crate) fn new(tick: &TickContext, block: BlockRef<'a>) -> Self {
        const UNKNOWN: Joules = [[f32::NAN; LANES]; OUTLOOK_HORIZONS];
        let mut all = Self { block, energy_j: UNKNOWN, lo_j: UNKNOWN, hi_j: UNKNOWN };
        // A task of its own: within that of all accounts, the compiler vectorises it or not.
        tick.simd_level.run(Fill { tick, all: &mut all });
        all
    }

    #[inline(always)]
    fn fill(all: &mut Self, tick: &TickContext) {
        let block = all.block;
        for (number, context) in tick.platforms.iter().enumerate() {
            let mut mask = [false; LANES];
            for lane in 0..LANES {
                mask[lane] = usize::from(block.admissions[lane].platform) == number;
            }
            if !lanes::any(&mask) {
                continue;
            }
            // Copies, so that the compiler knows that nothing is aliased.
            let errors = *context.errors.platform();
            for lane in 0..LANES {
                let state = block.energy.get(lane);
                let last_w = block.windows.get(lane).last_w();
                let ahead = context.outlook.of(&state, &errors, last_w);
                for place in 0..OUTLOOK_HORIZONS {
                    put(&mut all.energy_j[place][lane], mask[lane], ahead.energy_j[place]);
                    put(&mut all.lo_j[place][lane], mask[lane], ahead.lo_j[place]);
                    put(&mut all.hi_j[place][lane], mask[lane], ahead.hi_j[place]);
                }
            }
        }
    }

    /// The outlook of the robot in a lane, whose budget of the same tick is `budget`. Energy is
    /// unknown before the first metered reading, and of a robot whose forecast is invalid.
    #[inline(always)]
    pub(crate) fn get(&self, tick: &TickContext, lane: usize, budget: &Budget) -> Outlook {
        let admission = &self.block.admissions[lane];
        let shown = self.block.windows.get(lane).shown();
        let (quality, quality_detail) = quality_of(tick, &self.block, lane, shown);
        let is_metered = self.block.energy.get(lane).metered.time_s[0] > 0.0;
        let known = is_metered & (quality != INVALID);
        let context = &tick.platforms[usize::from(admission.platform)];
        let joules = |all: &Joules| -> [f32; OUTLOOK_HORIZONS] {
            std::array::from_fn(|place| canonical(if known { all[place][lane] } else { f32::NAN }))
        };
        let energy_j = joules(&self.energy_j);
        let lasts = budget.flags & budget_flag::TIME_TO_EMPTY != 0;
        Outlook {
            robot: admission.id,
            flags: flag(admission.accepted, outlook_flag::SAMPLE)
                | flag(known, outlook_flag::ENERGY)
                | flag(lasts, outlook_flag::TIME_TO_EMPTY)
                | flag(admission.outside_training, outlook_flag::OUTSIDE_TRAINING)
                | flag(known & context.outlook.is_extrapolated(), outlook_flag::EXTRAPOLATED),
            quality,
            quality_detail,
            platform: admission.platform,
            bounded: if known { context.outlook.bounded() as u16 } else { 0 },
            generation: admission.generation,
            mean_w: canonical(energy_j[3] / OUTLOOK_S[3]),
            stamp_ns: admission.stamp_ns,
            energy_j,
            energy_lo_j: joules(&self.lo_j),
            energy_hi_j: joules(&self.hi_j),
            usable_j: budget.usable_j,
            time_to_empty_s: budget.time_to_empty_s,
            time_to_empty_lo_s: budget.time_to_empty_lo_s,
            time_to_empty_hi_s: budget.time_to_empty_hi_s,
        }
    }
}
