//! What becomes of the samples that a tick has absorbed: ledgers, scores and alarms, a block of
//! robots at a time.

// Lanes are counted: that is the loop that the compiler makes vectors of.
#![allow(clippy::needless_range_loop)]

use joulebus_predictor::SimdTask;
use joulebus_wire::Alarm;

use crate::alarms::detector::{Conditions, Detector, DetectorLanes};
use crate::estimate::scores::ScoreLanes;
use crate::estimate::window::WindowLanes;
use crate::ingest::robot::{AdmissionState, Last, LastLanes, PendingBlock, PendingState};
use crate::layout::lanes::{self, Block as _, LANES, Lanes, block};
use crate::layout::slots;
use crate::ledger::energy::LedgerLanes;
use crate::state::columns::ColumnsMut;
use crate::tick::features::Rules;
use crate::tick::platform_context::PlatformContext;

/// What alarms depend on beside the residuals.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Facts {
    stamp_ns: u64,
    /// 0 where nothing was ever measured.
    measured_ns: u64,
    equal_since_ns: u64,
    refused: bool,
    outside_training: bool,
    charging: bool,
}

impl Facts {
    #[inline(always)]
    pub(crate) fn of(admission: &AdmissionState, last: &Last) -> Self {
        Self {
            stamp_ns: admission.stamp_ns,
            measured_ns: last.measured_ns,
            equal_since_ns: last.equal_since_ns,
            refused: admission.refused_run > 0,
            outside_training: admission.outside_training,
            charging: admission.charging,
        }
    }
}

block! {
    /// [`Facts`] of a block.
    #[derive(Clone, Copy, Default)]
    struct FactLanes of Facts {
        stamp_ns: u64,
        measured_ns: u64,
        equal_since_ns: u64,
        refused: bool,
        outside_training: bool,
        charging: bool,
    }
}

/// The samples of a block that wait to be accounted for.
struct Waiting {
    which: Lanes<bool>,
    platform: Lanes<u16>,
    broken: Lanes<bool>,
    /// NaN where there is none.
    reading_w: Lanes<f32>,
    expected_w: Lanes<f32>,
    previous_w: Lanes<f32>,
    facts: FactLanes,
}

impl Waiting {
    /// Takes what was absorbed of the robots in `lanes`, a bit each.
    #[inline(always)]
    fn take(
        lanes: u16,
        admissions: &[AdmissionState],
        lasts: &LastLanes,
        windows: &WindowLanes,
        pending: &mut PendingBlock,
    ) -> Self {
        let mut its = Self {
            which: [false; LANES],
            platform: [0; LANES],
            broken: [false; LANES],
            reading_w: [f32::NAN; LANES],
            expected_w: pending.expected_w,
            previous_w: [f32::NAN; LANES],
            facts: FactLanes {
                stamp_ns: pending.samples.stamp_ns,
                measured_ns: lasts.measured_ns,
                equal_since_ns: lasts.equal_since_ns,
                ..FactLanes::default()
            },
        };
        for (lane, admission) in admissions.iter().enumerate().take(LANES) {
            its.platform[lane] = admission.platform;
            its.facts.refused[lane] = admission.refused_run > 0;
            its.facts.outside_training[lane] = admission.outside_training;
            its.facts.charging[lane] = admission.charging;
        }
        for lane in 0..LANES {
            let sample = pending.samples.get(lane);
            let broken = pending.is(lane, PendingState::Broken);
            let absorbed = broken | pending.is(lane, PendingState::Absorbed);
            its.which[lane] = absorbed & (lanes >> lane & 1 == 1);
            its.broken[lane] = broken;
            its.reading_w[lane] = if sample.read() {
                sample.power_w
            } else {
                f32::NAN
            };
            its.previous_w[lane] = windows.previous_w(lane);
            pending.mark(lane, its.which[lane], PendingState::None);
        }
        its
    }

    /// The first platform from `least` on that has a sample waiting.
    #[inline(always)]
    fn platform_from(&self, least: u16) -> Option<u16> {
        let mut first = u16::MAX;
        for lane in 0..LANES {
            let (which, platform) = (self.which[lane], self.platform[lane]);
            let its = which & (platform >= least);
            first = first.min(if its { platform } else { u16::MAX });
        }
        // There are fewer platforms than that.
        (first < u16::MAX).then_some(first)
    }
}

/// Accounts for what was absorbed of some robots.
pub(crate) struct Account<'a, 'b> {
    pub rules: &'a Rules<'a>,
    pub columns: &'a mut ColumnsMut<'b>,
}

impl SimdTask for Account<'_, '_> {
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
            words,
            ..
        } = self.columns;
        for (block, lanes) in slots::blocks(words) {
            let from = block * LANES;
            lanes::prefetch_ahead(ledgers, block);
            lanes::prefetch_ahead(scores, block);
            lanes::prefetch_ahead(detectors, block);
            let admissions = &admissions[from..from + LANES];
            let waiting = Waiting::take(
                lanes,
                admissions,
                &lasts[block],
                &windows[block],
                &mut pending[block],
            );
            let mut next = waiting.platform_from(0);
            while let Some(platform) = next {
                let mut robots = Robots {
                    ledgers: &mut ledgers[block],
                    scores: &mut scores[block],
                    detectors: &mut detectors[block],
                };
                settle(self.rules, platform, &waiting, &mut robots);
                next = waiting.platform_from(platform + 1);
            }
        }
    }
}

/// What is kept of a block of robots.
struct Robots<'a> {
    ledgers: &'a mut LedgerLanes,
    scores: &'a mut ScoreLanes,
    detectors: &'a mut DetectorLanes,
}

/// Accounts for the robots of one platform.
#[inline(always)]
fn settle(rules: &Rules<'_>, platform: u16, waiting: &Waiting, robots: &mut Robots<'_>) {
    let context = &rules.contexts[usize::from(platform)];
    let (mut which, mut scored) = ([false; LANES], [false; LANES]);
    for lane in 0..LANES {
        which[lane] = waiting.which[lane] & (waiting.platform[lane] == platform);
        let known = !waiting.reading_w[lane].is_nan() & !waiting.expected_w[lane].is_nan();
        scored[lane] = which[lane] & known;
    }
    meter(robots.ledgers, waiting, &which, context.overdue_after_ns);
    score(robots.scores, waiting, &scored);
    detect(rules, context, waiting, &scored, robots.detectors);
    alarm(
        rules,
        context,
        waiting,
        &which,
        robots.scores,
        robots.detectors,
    );
}

#[inline(always)]
fn meter(ledgers: &mut LedgerLanes, waiting: &Waiting, which: &Lanes<bool>, overdue_after_ns: u64) {
    // What lies between two recordings was never drawn.
    let longest_ns = |lane: usize| {
        if waiting.broken[lane] {
            0
        } else {
            overdue_after_ns
        }
    };
    let mut wide = [false; LANES];
    for lane in 0..LANES {
        let mut ledger = ledgers.get(lane);
        let (reading_w, expected_w) = (waiting.reading_w[lane], waiting.expected_w[lane]);
        let stamp_ns = waiting.facts.stamp_ns[lane];
        let narrow = ledger.meter_narrow(stamp_ns, reading_w, expected_w, longest_ns(lane));
        ledgers.set(lane, which[lane] & narrow, ledger);
        wide[lane] = which[lane] & !narrow;
    }
    if lanes::any(&wide) {
        for lane in (0..LANES).filter(|lane| wide[*lane]) {
            meter_wide(ledgers, waiting, lane, longest_ns(lane));
        }
    }
}

#[cold]
#[inline(never)]
fn meter_wide(ledgers: &mut LedgerLanes, waiting: &Waiting, lane: usize, longest_ns: u64) {
    let known = |watts: f32| (!watts.is_nan()).then_some(watts);
    let mut ledger = ledgers.get(lane);
    ledger.meter(
        waiting.facts.stamp_ns[lane],
        known(waiting.reading_w[lane]),
        known(waiting.expected_w[lane]),
        longest_ns,
    );
    ledgers.set(lane, true, ledger);
}

#[inline(always)]
fn score(scores: &mut ScoreLanes, waiting: &Waiting, scored: &Lanes<bool>) {
    for lane in 0..LANES {
        let mut its = scores.get(lane);
        let reading_w = waiting.reading_w[lane];
        let residual_w = reading_w - waiting.expected_w[lane];
        its.observe(reading_w, residual_w, waiting.previous_w[lane]);
        scores.set(lane, scored[lane], its);
    }
}

#[inline(always)]
fn detect(
    rules: &Rules<'_>,
    context: &PlatformContext,
    waiting: &Waiting,
    scored: &Lanes<bool>,
    detectors: &mut DetectorLanes,
) {
    let (alarms, sigma_w) = (rules.settings.alarms, context.sigma_w);
    for lane in 0..LANES {
        let mut detector = detectors.get(lane);
        let reading_w = waiting.reading_w[lane];
        let residual_w = reading_w - waiting.expected_w[lane];
        let change_w = reading_w - waiting.previous_w[lane];
        detector.observe(residual_w, change_w, sigma_w, &alarms);
        detectors.set_observed(lane, scored[lane], &detector);
    }
}

/// Raises and clears the alarms.
#[inline(always)]
fn alarm(
    rules: &Rules<'_>,
    context: &PlatformContext,
    waiting: &Waiting,
    which: &Lanes<bool>,
    scores: &ScoreLanes,
    detectors: &mut DetectorLanes,
) {
    let mut moved = [false; LANES];
    for lane in 0..LANES {
        let detector = detectors.get(lane);
        let scored = scores.count[lane];
        let conditions = judge(rules, context, &waiting.facts.get(lane), scored, &detector);
        moved[lane] = which[lane] & detector.is_moved_by(conditions);
    }
    if lanes::any(&moved) {
        for lane in (0..LANES).filter(|lane| moved[*lane]) {
            let mut detector = detectors.get(lane);
            let scored = scores.count[lane];
            let conditions = judge(rules, context, &waiting.facts.get(lane), scored, &detector);
            detector.decide(conditions, &rules.settings.alarms);
            detectors.set(lane, true, detector);
        }
    }
}

/// The conditions of a robot's alarms; `scored` residuals have been observed.
#[inline(always)]
pub(crate) fn judge(
    rules: &Rules<'_>,
    context: &PlatformContext,
    facts: &Facts,
    scored: u64,
    detector: &Detector,
) -> Conditions {
    let mut conditions = detector.conditions(scored, &rules.settings.alarms);
    let age_ns = facts.stamp_ns.saturating_sub(facts.measured_ns);
    let equal_ns = facts.measured_ns.saturating_sub(facts.equal_since_ns);
    let read = facts.measured_ns > 0;
    let (held, stuck) = (
        read & (age_ns > context.platform.hold_max_ns),
        read & (equal_ns > context.platform.stuck_after_ns),
    );
    conditions.when(facts.refused, Alarm::OutOfRange);
    conditions.when(held, Alarm::HeldTooLong);
    conditions.when(stuck, Alarm::StuckSensor);
    conditions.when(facts.outside_training, Alarm::OutOfTraining);
    conditions.when(facts.charging, Alarm::OfflineCharging);
    conditions.when(rules.deadline_missed, Alarm::DeadlineMissed);
    conditions
}
