//! Ledgers, scores and alarms of the absorbed samples, a block of robots at a time.

// Indexed by lane, so that the compiler vectorises the loop.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::simd::SimdTask;

use crate::alarms::conditions::{AlarmInputLanes, judge};
use crate::alarms::detector::DetectorLanes;
use crate::alarms::level::{LevelLanes, LevelSample};
use crate::estimate::energy::EnergyLanes;
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::admission::AdmissionState;
use crate::ingest::last_sample::LastLanes;
use crate::ingest::pending::{PendingBlock, PendingState};
use crate::layout::lanes::{self, Block as _, LANES, Lanes};
use crate::layout::slots;
use crate::ledger::battery::{At, BatteryLanes, Charging};
use crate::ledger::counting::{Counting, Size};
use crate::ledger::energy::LedgerLanes;
use crate::ledger::levels;
use crate::ledger::measured::BatterySample;
use crate::ledger::remaining::{Left, LeftLanes};
use crate::state::columns::ColumnsMut;
use crate::tick::context::TickContext;
use crate::tick::platform_context::PlatformContext;

/// The absorbed and not yet scored samples of a block.
struct Absorbed {
    mask: Lanes<bool>,
    platform: Lanes<u16>,
    broken: Lanes<bool>,
    /// NaN if there is none.
    reading_w: Lanes<f32>,
    expected_w: Lanes<f32>,
    /// The reading minus the network's forecast of it, whatever was published.
    residual_w: Lanes<f32>,
    previous_w: Lanes<f32>,
    mean_power_w: Lanes<f32>,
    /// True if the robot was commanded to stand, off its charger.
    rests: Lanes<bool>,
    alarms: AlarmInputLanes,
}

impl Absorbed {
    /// Takes the absorbed samples of the robots in `lanes`, one bit each.
    #[inline(always)]
    fn take(
        lanes: u16,
        admissions: &[AdmissionState],
        lasts: &LastLanes,
        windows: &WindowLanes,
        pending: &mut PendingBlock,
    ) -> Self {
        let mut taken = Self {
            mask: [false; LANES],
            platform: [0; LANES],
            broken: [false; LANES],
            reading_w: [f32::NAN; LANES],
            expected_w: pending.expected_w,
            residual_w: lasts.residual_w,
            previous_w: [f32::NAN; LANES],
            mean_power_w: lasts.mean_power_w,
            rests: [false; LANES],
            alarms: AlarmInputLanes {
                stamp_ns: pending.samples.stamp_ns,
                measured_ns: lasts.measured_ns,
                equal_since_ns: lasts.equal_since_ns,
                ..AlarmInputLanes::default()
            },
        };
        for (lane, admission) in admissions.iter().enumerate().take(LANES) {
            taken.platform[lane] = admission.platform;
            taken.alarms.refused[lane] = admission.refused_run > 0;
            taken.alarms.outside_training[lane] = admission.outside_training;
            taken.alarms.charging[lane] = admission.charging;
        }
        for lane in 0..LANES {
            let sample = pending.samples.get(lane);
            let broken = pending.is(lane, PendingState::Broken);
            let absorbed = broken | pending.is(lane, PendingState::Absorbed);
            taken.mask[lane] = absorbed & (lanes >> lane & 1 == 1);
            taken.broken[lane] = broken;
            taken.reading_w[lane] = if sample.read() { sample.power_w } else { f32::NAN };
            taken.previous_w[lane] = windows.previous_w(lane);
            taken.rests[lane] = sample.rests() & !taken.alarms.charging[lane];
            pending.mark(lane, taken.mask[lane], PendingState::None);
        }
        taken
    }

    /// The first platform from `least` on with an absorbed sample.
    #[inline(always)]
    fn platform_from(&self, least: u16) -> Option<u16> {
        let mut first = u16::MAX;
        for lane in 0..LANES {
            let (mask, platform) = (self.mask[lane], self.platform[lane]);
            let found = mask & (platform >= least);
            first = first.min(if found { platform } else { u16::MAX });
        }
        // There are fewer platforms than that.
        (first < u16::MAX).then_some(first)
    }
}

/// Scores the absorbed samples of some robots.
pub(crate) struct Score<'a, 'b> {
    pub tick: &'a TickContext,
    pub columns: &'a mut ColumnsMut<'b>,
}

impl SimdTask for Score<'_, '_> {
    #[inline(always)]
    fn run(self) {
        let ColumnsMut {
            admissions,
            pending,
            lasts,
            windows,
            ledgers,
            scores,
            detectors,
            batteries,
            energy,
            levels,
            words,
            ..
        } = self.columns;
        for (block, lanes) in slots::blocks(words) {
            let from = block * LANES;
            lanes::prefetch_ahead(ledgers, block);
            lanes::prefetch_ahead(scores, block);
            lanes::prefetch_ahead(detectors, block);
            lanes::prefetch_ahead(levels, block);
            lanes::prefetch_ahead(batteries, block);
            let admissions = &admissions[from..from + LANES];
            let absorbed = Absorbed::take(
                lanes,
                admissions,
                &lasts[block],
                &windows[block],
                &mut pending[block],
            );
            let mut next = absorbed.platform_from(0);
            while let Some(platform) = next {
                let mut robots = Robots {
                    ledgers: &mut ledgers[block],
                    scores: &mut scores[block],
                    detectors: &mut detectors[block],
                    batteries: batteries.get_mut(block),
                    energy: &energy[block],
                    levels: &mut levels[block],
                };
                score_platform(self.tick, platform, &absorbed, &mut robots);
                next = absorbed.platform_from(platform + 1);
            }
        }
    }
}

/// The columns of a block that scoring writes.
struct Robots<'a> {
    ledgers: &'a mut LedgerLanes,
    scores: &'a mut ScoreLanes,
    detectors: &'a mut DetectorLanes,
    /// `None` unless a platform has a battery.
    batteries: Option<&'a mut BatteryLanes>,
    energy: &'a EnergyLanes,
    levels: &'a mut LevelLanes,
}

/// Scores the robots of one platform.
#[inline(always)]
fn score_platform(tick: &TickContext, platform: u16, absorbed: &Absorbed, robots: &mut Robots<'_>) {
    let context = &tick.platforms[usize::from(platform)];
    let (mut mask, mut scored) = ([false; LANES], [false; LANES]);
    for lane in 0..LANES {
        mask[lane] = absorbed.mask[lane] & (absorbed.platform[lane] == platform);
        let known = !absorbed.reading_w[lane].is_nan() & !absorbed.expected_w[lane].is_nan();
        scored[lane] = mask[lane] & known;
    }
    meter(robots.ledgers, absorbed, &mask, context.overdue_after_ns);
    if let Some(batteries) = &mut robots.batteries {
        follow(batteries, context, absorbed, &mask, robots.ledgers);
    }
    score(robots.scores, absorbed, &scored);
    detect(context, absorbed, &scored, robots.detectors);
    let rules = context.levels.among(&context.errors.platform().memory);
    let energy = robots.energy;
    robots.levels.observe(&rules, &mask, |lane| {
        let (command, model_w) = energy.command(lane);
        LevelSample {
            power_w: absorbed.reading_w[lane],
            command_w: rules.command_w(command, model_w),
            apart: absorbed.broken[lane] | absorbed.alarms.charging[lane],
        }
    });
    alarm(tick, context, absorbed, &mask, robots.scores, robots.detectors);
}

#[inline(always)]
fn meter(
    ledgers: &mut LedgerLanes,
    absorbed: &Absorbed,
    mask: &Lanes<bool>,
    overdue_after_ns: u64,
) {
    // The time between two recordings is not metered.
    let longest_ns = |lane: usize| {
        if absorbed.broken[lane] { 0 } else { overdue_after_ns }
    };
    let mut wide = [false; LANES];
    for lane in 0..LANES {
        let mut ledger = ledgers.get(lane);
        let (reading_w, expected_w) = (absorbed.reading_w[lane], absorbed.expected_w[lane]);
        let stamp_ns = absorbed.alarms.stamp_ns[lane];
        let narrow = ledger.meter_narrow(stamp_ns, reading_w, expected_w, longest_ns(lane));
        ledgers.set(lane, mask[lane] & narrow, ledger);
        wide[lane] = mask[lane] & !narrow;
    }
    if lanes::any(&wide) {
        for lane in (0..LANES).filter(|lane| wide[*lane]) {
            meter_wide(ledgers, absorbed, lane, longest_ns(lane));
        }
    }
}

#[cold]
#[inline(never)]
fn meter_wide(ledgers: &mut LedgerLanes, absorbed: &Absorbed, lane: usize, longest_ns: u64) {
    let known = |watts: f32| (!watts.is_nan()).then_some(watts);
    let mut ledger = ledgers.get(lane);
    ledger.meter(
        absorbed.alarms.stamp_ns[lane],
        known(absorbed.reading_w[lane]),
        known(absorbed.expected_w[lane]),
        longest_ns,
    );
    ledgers.set(lane, true, ledger);
}

/// Batteries, and their levels.
#[inline(always)]
fn follow(
    batteries: &mut BatteryLanes,
    context: &PlatformContext,
    absorbed: &Absorbed,
    mask: &Lanes<bool>,
    ledgers: &LedgerLanes,
) {
    let platform = &context.platform;
    let Some(battery) = &platform.battery else {
        return;
    };
    let mut eventful = [false; LANES];
    let seen = |lane: usize| BatterySample {
        stamp_ns: absorbed.alarms.stamp_ns[lane],
        reading_w: absorbed.reading_w[lane],
        charging: absorbed.alarms.charging[lane],
        broken: absorbed.broken[lane],
    };
    for lane in 0..LANES {
        let needs = batteries.get(lane).needs(&seen(lane), ledgers.unmetered_ns[lane]);
        eventful[lane] = mask[lane] & needs;
    }
    if lanes::any(&eventful) {
        for lane in (0..LANES).filter(|lane| eventful[*lane]) {
            let mut robot = batteries.get(lane);
            let at = At::new(&ledgers.get(lane));
            robot.take((battery, platform), at, absorbed.mean_power_w[lane], &seen(lane));
            batteries.set(lane, true, robot);
        }
    }
    for lane in 0..LANES {
        let reading_w = absorbed.reading_w[lane];
        lanes::put(&mut batteries.mean_w[lane], mask[lane], absorbed.mean_power_w[lane]);
        lanes::put(&mut batteries.reading_w[lane], mask[lane] & !reading_w.is_nan(), reading_w);
        let rests = mask[lane] & absorbed.rests[lane];
        batteries.rest(lane, rests, reading_w, platform.period_ns as f32 * 1e-9);
    }
    let (counting, battery) = (Counting::new(battery, platform), *battery);
    // A loop for each result, in memory of its own: the compiler knows that none changes what is
    // read.
    let (mut left, mut raised) = (LeftLanes::UNKNOWN, [0; LANES]);
    for lane in 0..LANES {
        let (robot, at) = (batteries.get(lane), At::new(&ledgers.get(lane)));
        // On a charger the anchor is at the last sample with a reading.
        let charging = Charging { metered: false, unmetered: robot.charging };
        left.set(lane, true, Left::from(robot.now(&counting, at, charging)));
    }
    for lane in 0..LANES {
        let robot = batteries.get(lane);
        let size = Size::new(&battery, robot.size());
        let now = left.get(lane).into();
        raised[lane] = levels::judge(robot.raised, (&battery, &size), &now, robot.return_j);
    }
    for lane in 0..LANES {
        lanes::put(&mut batteries.raised[lane], mask[lane], raised[lane]);
    }
}

#[inline(always)]
fn score(scores: &mut ScoreLanes, absorbed: &Absorbed, scored: &Lanes<bool>) {
    for lane in 0..LANES {
        let mut robot = scores.get(lane);
        let reading_w = absorbed.reading_w[lane];
        let residual_w = reading_w - absorbed.expected_w[lane];
        robot.observe(reading_w, residual_w, absorbed.previous_w[lane]);
        scores.set(lane, scored[lane], robot);
    }
}

#[inline(always)]
fn detect(
    context: &PlatformContext,
    absorbed: &Absorbed,
    scored: &Lanes<bool>,
    detectors: &mut DetectorLanes,
) {
    let (alarms, per_sigma) = (context.alarms, context.per_sigma);
    for lane in 0..LANES {
        let mut detector = detectors.get(lane);
        let reading_w = absorbed.reading_w[lane];
        let residual_w = absorbed.residual_w[lane];
        let change_w = reading_w - absorbed.previous_w[lane];
        detector.observe(residual_w, change_w, per_sigma, &alarms);
        detectors.set_observed(lane, scored[lane], &detector);
    }
}

/// Raises and clears the alarms.
#[inline(always)]
fn alarm(
    tick: &TickContext,
    context: &PlatformContext,
    absorbed: &Absorbed,
    mask: &Lanes<bool>,
    scores: &ScoreLanes,
    detectors: &mut DetectorLanes,
) {
    let (alarms, platform) = (&context.alarms, &context.platform);
    let missed = tick.deadline_missed;
    let mut moved = [false; LANES];
    for lane in 0..LANES {
        let (detector, inputs) = (detectors.get(lane), absorbed.alarms.get(lane));
        let scored = scores.count[lane];
        let conditions = judge(alarms, platform, &inputs, scored, &detector, missed);
        moved[lane] = mask[lane] & detector.is_moved_by(conditions);
    }
    if lanes::any(&moved) {
        for lane in (0..LANES).filter(|lane| moved[*lane]) {
            let (mut detector, inputs) = (detectors.get(lane), absorbed.alarms.get(lane));
            let scored = scores.count[lane];
            let conditions = judge(alarms, platform, &inputs, scored, &detector, missed);
            detector.decide(conditions, alarms);
            detectors.set(lane, true, detector);
        }
    }
}
