//! The pass over one tile: every waiting sample is one step of its robot, and all steps of a
//! platform share one batch. Robots do not see each other.

use joulebus_predictor::Features;
use joulebus_wire::{Alarm, Freshness, InvalidReason, Quality, sample_flag};

use crate::Settings;
use crate::batch::Batch;
use crate::columns::Part;
use crate::detector::Detector;
use crate::kind::Kind;
use crate::robot::{Absorbed, Gate, Last, News, Pending};
use crate::slots::slots;
use crate::window::{Gap, Window, missing_steps};

/// What a pass reads and never writes.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Rules<'a> {
    pub settings: &'a Settings,
    pub kinds: &'a [Kind],
    pub now_ns: u64,
    pub deadline_missed: bool,
}

/// What a look at a tile has found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) struct Found {
    /// The next platform that has robots in the tile, if any.
    pub next: Option<u16>,
    /// When the sample that is longest ago was taken, monotonic ns.
    pub oldest_ns: u64,
}

/// Takes the waiting samples of a platform's robots and collects the rows for their forecasts.
/// `ticking`: also ends the robots' tick and notes whose next sample is overdue.
pub(crate) fn absorb(
    rules: &Rules<'_>,
    kind: u16,
    columns: &mut Part<'_>,
    batch: &mut Batch,
    ticking: bool,
) -> Found {
    let mut found = Found {
        next: None,
        oldest_ns: u64::MAX,
    };
    let its = &rules.kinds[usize::from(kind)];
    batch.begin(its);
    for slot in slots(columns.words) {
        let gate = &mut columns.gates[slot];
        if gate.platform != kind {
            let later = gate.platform > kind && found.next.is_none_or(|next| gate.platform < next);
            found.next = if later {
                Some(gate.platform)
            } else {
                found.next
            };
            continue;
        }
        if ticking {
            (gate.taken, gate.heard) = (0, false);
            found.oldest_ns = found.oldest_ns.min(gate.taken_ns);
            if rules.now_ns.saturating_sub(gate.taken_ns) > its.overdue_after_ns {
                batch.overdue.push(slot as u32);
            }
        }
        let News::Waiting(pending) = columns.news[slot] else {
            continue;
        };
        let gap = gap(its, gate, &columns.windows[slot], &pending);
        if columns.windows[slot].can_close(gap) {
            step(its, columns, slot, &pending, gap, batch);
        } else {
            batch.gaps.push(slot as u32);
        }
    }
    if !batch.gaps.is_empty() {
        bridge(its, columns, batch);
    }
    found
}

/// Runs the collected rows through the model.
pub(crate) fn infer(kind: &Kind, columns: &mut Part<'_>, batch: &mut Batch) {
    if batch.is_empty() {
        return;
    }
    batch.infer(&kind.model);
    if let Some(blending) = &kind.blending {
        batch.blend(blending, columns, false);
    }
    for (slot, forecast_w) in batch.forecasts() {
        if forecast_w.is_finite() {
            columns.windows[slot].forecast(forecast_w);
        } else {
            columns.lasts[slot].quality = Quality::Invalid(InvalidReason::ModelOutput);
        }
    }
    batch.mark_outside(kind);
    for (slot, outside) in batch.outside() {
        columns.gates[slot].outside_training = outside;
    }
}

/// Runs robots with a gap before their waiting sample open loop up to it, a step per round, and
/// then takes the samples. The rows collected so far are run as well: they are in the way.
#[cold]
fn bridge(kind: &Kind, columns: &mut Part<'_>, batch: &mut Batch) {
    infer(kind, columns, batch);
    let late = std::mem::take(&mut batch.gaps);
    loop {
        batch.clear();
        for slot in late.iter().map(|slot| *slot as usize) {
            if let News::Waiting(pending) = columns.news[slot]
                && let Gap::Bridge(steps) =
                    gap(kind, &columns.gates[slot], &columns.windows[slot], &pending)
                && let Some(row) = columns.windows[slot].open_towards(steps)
            {
                batch.push(slot, &row);
            }
        }
        if !infer_open(kind, columns, batch) {
            break;
        }
    }
    for slot in late.iter().map(|slot| *slot as usize) {
        if let News::Waiting(pending) = columns.news[slot] {
            let gap = gap(kind, &columns.gates[slot], &columns.windows[slot], &pending);
            step(kind, columns, slot, &pending, gap, batch);
        }
    }
    batch.gaps = late;
}

/// Shows robots whose sample is overdue what the model expects: provisional, undone by the sample
/// if it says otherwise.
pub(crate) fn run_open(rules: &Rules<'_>, kind: &Kind, columns: &mut Part<'_>, batch: &mut Batch) {
    let overdue = std::mem::take(&mut batch.overdue);
    while !overdue.is_empty() {
        batch.clear();
        for slot in overdue.iter().map(|slot| *slot as usize) {
            let silent_ns = rules.now_ns.saturating_sub(columns.gates[slot].taken_ns);
            let steps = missing_steps(silent_ns, kind.platform.period_ns);
            let window = &mut columns.windows[slot];
            let longest = kind.longest_steps.saturating_sub(window.unread_steps);
            let steps = steps.min(longest.into()) as u16;
            if steps > 0
                && let Some(row) = window.open_towards(steps)
            {
                batch.push(slot, &row);
            }
        }
        if !infer_open(kind, columns, batch) {
            break;
        }
    }
    batch.overdue = overdue;
}

fn infer_open(kind: &Kind, columns: &mut Part<'_>, batch: &mut Batch) -> bool {
    if batch.is_empty() {
        return false;
    }
    batch.infer(&kind.model);
    if let Some(blending) = &kind.blending {
        batch.blend(blending, columns, true);
    }
    for (slot, forecast_w) in batch.forecasts() {
        columns.windows[slot].opened(forecast_w);
    }
    true
}

#[inline]
fn gap(kind: &Kind, gate: &Gate, window: &Window, pending: &Pending) -> Gap {
    if pending.broken {
        return Gap::Break;
    }
    let elapsed_ns = pending.stamp_ns.saturating_sub(gate.stamp_ns);
    if elapsed_ns <= kind.overdue_after_ns {
        return Gap::None;
    }
    window.gap_before(elapsed_ns, kind.platform.period_ns, kind.longest_steps)
}

/// Takes the waiting sample of a slot, and adds the row for its next forecast, if it gets one.
#[inline]
fn step(
    kind: &Kind,
    columns: &mut Part<'_>,
    slot: usize,
    pending: &Pending,
    gap: Gap,
    batch: &mut Batch,
) {
    let (gate, window) = (&mut columns.gates[slot], &mut columns.windows[slot]);
    let last = &mut columns.lasts[slot];
    let elapsed_ns = pending.stamp_ns.saturating_sub(gate.stamp_ns);
    if pending.broken {
        window.forget_freshness();
    } else if elapsed_ns > kind.overdue_after_ns {
        window.pass(missing_steps(elapsed_ns, kind.platform.period_ns));
    }
    let forecast_w = window.close(gap);
    let reading_w = pending.reading_w();
    // Only forecasts one step ahead are scored: the ones over a gap are of another kind.
    let one_step = gap == Gap::None && window.unread_steps == 0 && forecast_w.is_finite();
    let absorbed = Absorbed {
        stamp_ns: pending.stamp_ns,
        reading_w: reading_w.unwrap_or(f32::NAN),
        expected_w: if one_step { forecast_w } else { f32::NAN },
        previous_w: window.last_w(),
        broken: gap == Gap::Break,
    };
    if let (Some(reading_w), true) = (reading_w, one_step) {
        let (residual_w, floor_w) = (reading_w - forecast_w, kind.platform.power_resolution_w);
        columns.intervals[slot].observe(residual_w, window.due(false), floor_w, kind.moves);
        if let Some(blending) = &kind.blending {
            columns.blends[slot].learn(blending, reading_w);
        }
    }
    columns.news[slot] = News::Absorbed(absorbed);
    last.residual_w = reading_w.map_or(f32::NAN, |reading_w| reading_w - forecast_w);
    let elapsed_s = (elapsed_ns as f64 * 1e-9) as f32;
    last.accept(pending, elapsed_s);
    gate.accept(pending);
    match reading_w {
        Some(reading_w) => window.read(reading_w, !pending.has(sample_flag::HELD)),
        None => window.miss(kind.longest_steps),
    }
    let row = window.next_row(elapsed_s, pending.command(), kind.reads);
    last.quality = quality(kind, pending, window, row.as_ref());
    if let Some(row) = &row {
        batch.push(slot, row);
    }
}

/// As far as it depends on the sample.
fn quality(kind: &Kind, pending: &Pending, window: &Window, row: Option<&Features>) -> Quality {
    match (pending.freshness(), window.is_full()) {
        (Freshness::Missing, false) => Quality::Invalid(InvalidReason::NoReading),
        (_, false) => Quality::Warmup {
            have: window.have().into(),
        },
        (_, true) if row.is_none() => Quality::Invalid(missing(kind, pending)),
        (Freshness::Missing, true) => Quality::OpenLoop {
            steps: window.unread_steps,
        },
        (Freshness::Held, true) => Quality::Held,
        (Freshness::Fresh, true) => Quality::Fresh,
    }
}

/// What keeps a full window from leading to a row.
#[cold]
fn missing(kind: &Kind, pending: &Pending) -> InvalidReason {
    if kind.reads.needs_command() && pending.command().is_none() {
        return InvalidReason::NoCommand;
    }
    InvalidReason::NoFreshness
}

/// Accounts for what was absorbed: ledger, scores, residuals, alarms.
pub(crate) fn account(rules: &Rules<'_>, columns: &mut Part<'_>) {
    for slot in slots(columns.words) {
        if let News::Absorbed(absorbed) = columns.news[slot] {
            columns.news[slot] = News::None;
            settle(rules, columns, slot, &absorbed);
        }
    }
}

#[inline]
fn settle(rules: &Rules<'_>, columns: &mut Part<'_>, slot: usize, absorbed: &Absorbed) {
    let gate = &columns.gates[slot];
    let kind = &rules.kinds[usize::from(gate.platform)];
    let alarms = &rules.settings.alarms;
    let known = |watts: f32| (!watts.is_nan()).then_some(watts);
    let (reading_w, expected_w) = (known(absorbed.reading_w), known(absorbed.expected_w));
    // What lies between two recordings was never drawn.
    let longest_ns = if absorbed.broken {
        0
    } else {
        kind.overdue_after_ns
    };
    columns.ledgers[slot].meter(absorbed.stamp_ns, reading_w, expected_w, longest_ns);
    let (scores, detector) = (&mut columns.scores[slot], &mut columns.detectors[slot]);
    if let (Some(reading_w), Some(expected_w)) = (reading_w, expected_w) {
        let residual_w = reading_w - expected_w;
        scores.observe(reading_w, residual_w, absorbed.previous_w);
        let change_w = reading_w - absorbed.previous_w;
        detector.observe(residual_w, change_w, kind.sigma_w, alarms);
    }
    judge(rules, gate, &columns.lasts[slot], scores.count, detector);
}

/// Raises and clears a robot's alarms; `scored` residuals have been observed.
#[inline]
pub(crate) fn judge(
    rules: &Rules<'_>,
    gate: &Gate,
    last: &Last,
    scored: u64,
    detector: &mut Detector,
) {
    let (alarms, kind) = (
        &rules.settings.alarms,
        &rules.kinds[usize::from(gate.platform)],
    );
    let mut conditions = detector.conditions(scored, alarms);
    let age_ns = gate.stamp_ns.saturating_sub(last.measured_ns);
    let equal_ns = last.measured_ns.saturating_sub(last.equal_since_ns);
    let read = last.measured_ns > 0;
    conditions.when(gate.refused_run > 0, Alarm::OutOfRange);
    conditions.when(
        read && age_ns > kind.platform.hold_max_ns,
        Alarm::HeldTooLong,
    );
    conditions.when(
        read && equal_ns > kind.platform.stuck_after_ns,
        Alarm::StuckSensor,
    );
    conditions.when(gate.outside_training, Alarm::OutOfTraining);
    conditions.when(gate.charging, Alarm::OfflineCharging);
    conditions.when(rules.deadline_missed, Alarm::DeadlineMissed);
    detector.decide(conditions, alarms);
}
