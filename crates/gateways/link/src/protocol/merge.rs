//! Merges the newest frames of all shards into frames of one fleet.

use bytemuck::Zeroable as _;
use joulebus_wire::{
    Alarm, Budget, BudgetHeader, Budgets, Channel, Diagnostic, DiagnosticHeader, Diagnostics,
    Forecast, ForecastHeader, Forecasts, FrameHeader as _, FrameOrder, InvalidReason, Level,
    OUTLOOK_HORIZONS, Outlook, OutlookHeader, Outlooks, PlanState, PlanStateHeader, PlanStates,
    Quality, SCHEMA_VERSION, combine_hashes, forecast_flag, outlook_flag, plan_state_flag,
};

/// The origin that a merged frame states.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Origin {
    pub(crate) pid: u32,
    pub(crate) order: FrameOrder,
}

/// A channel whose frames of several shards can be merged.
pub(crate) trait Merged: Channel {
    /// Parts that do not agree with the first are left out. `None` where any can be merged.
    const AGREE: Option<Agree<Self>> = None;

    /// The header of a merged frame. `parts` has the header of each fresh shard, at least one. Its
    /// times are the oldest ones, so that nothing looks fresher than it is. Counts are sums over
    /// `all` shards. [`Merge::write`] sets the order and the times of sending.
    fn merged(parts: &[Self::Header], all: &[Self::Header]) -> Self::Header;

    /// Removes the parts of a robot's row that are unknown while its shard is stale.
    fn silence(row: &mut Self::Row);

    /// Adds the counters of a worker's earlier runs, because a merged fleet is one run.
    fn add_counters(_to: &mut Self::Header, _from: &Self::Header) {}
}

/// True if a part agrees with the first of a frame.
pub(crate) type Agree<C> = fn(&<C as Channel>::Header, &<C as Channel>::Header) -> bool;

/// Pause after which a service starts again, and the time that all shards then have for their first
/// frames, in periods. A request takes some periods.
const BEGIN_PERIODS: u64 = 10;

/// The newest frame of a shard.
#[derive(Debug)]
struct Part<C: Channel> {
    /// With the counters of earlier runs.
    header: C::Header,
    /// The last header of the run before.
    before: C::Header,
    rows: Vec<C::Row>,
    is_new: bool,
}

/// The newest frames of one service.
#[derive(Debug)]
pub(crate) struct Merge<C: Channel> {
    parts: Vec<Option<Part<C>>>,
    written_ns: u64,
    /// When the first part that has not been written arrived.
    since_ns: Option<u64>,
}

impl<C: Merged> Merge<C> {
    pub(crate) fn new(shards: usize) -> Self {
        Self { parts: (0..shards).map(|_| None).collect(), written_ns: 0, since_ns: None }
    }

    /// Takes a shard's frame in place of its last one.
    pub(crate) fn put(
        &mut self,
        shard: usize,
        mut header: C::Header,
        rows: impl Iterator<Item = C::Row>,
        now_ns: u64,
    ) {
        self.since_ns.get_or_insert(now_ns);
        let (before, mut kept) = match self.parts[shard].take() {
            Some(last) if last.header.order().run == header.order().run => (last.before, last.rows),
            Some(last) => (last.header, last.rows),
            None => (C::Header::zeroed(), Vec::new()),
        };
        C::add_counters(&mut header, &before);
        kept.clear();
        kept.extend(rows);
        self.parts[shard] = Some(Part { header, before, rows: kept, is_new: true });
    }

    pub(crate) fn header(&self, shard: usize) -> Option<&C::Header> {
        self.parts[shard].as_ref().map(|part| &part.header)
    }

    /// True if a frame has to be written: each fresh shard has a new one, or one has waited for a
    /// tick's period. A frame comes every n-th tick.
    ///
    /// The first frame waits, for some periods, for all shards whose worker is alive, because
    /// planners take a robot without a row for unknown.
    pub(crate) fn is_due(
        &self,
        (has_worker, is_live): (&[bool], &[bool]),
        (now_ns, period_ns, every): (u64, u64, u32),
    ) -> bool {
        let is_new = |part: &Option<Part<C>>| part.as_ref().is_some_and(|part| part.is_new);
        let frames_ns = period_ns.saturating_mul(u64::from(every));
        let begin_ns = frames_ns.saturating_mul(BEGIN_PERIODS);
        let begins = now_ns.saturating_sub(self.written_ns) > begin_ns;
        let (awaited, patience_ns) =
            if begins { (has_worker, begin_ns) } else { (is_live, period_ns) };
        let waited_ns = self.since_ns.map(|since_ns| now_ns.saturating_sub(since_ns));
        let is_over = waited_ns.is_some_and(|waited_ns| waited_ns >= patience_ns);
        let mut awaited = self.parts.iter().zip(awaited).filter(|(_, is_awaited)| **is_awaited);
        let mut live = self.parts.iter().zip(is_live).filter(|(_, is_live)| **is_live);
        live.any(|(part, _)| is_new(part)) && (is_over || awaited.all(|(part, _)| is_new(part)))
    }

    /// Maximum number of rows of a frame.
    pub(crate) fn len(&self) -> usize {
        self.parts.iter().flatten().map(|part| part.rows.len()).sum()
    }

    /// Passes all rows, at most [`Merge::len`], to `each`, those of stale shards as silent, and
    /// returns the header. `None` if no fresh shard has sent a frame.
    pub(crate) fn write(
        &mut self,
        is_live: &[bool],
        own: Origin,
        now_ns: u64,
        mut each: impl FnMut(C::Row),
    ) -> Option<C::Header> {
        let headers = |(part, live): (&Option<Part<C>>, &bool)| {
            part.as_ref().map(|part| (part.header, *live))
        };
        let all: Vec<(C::Header, bool)> =
            self.parts.iter().zip(is_live).filter_map(headers).collect();
        let live = all.iter().filter(|(_, live)| *live);
        let live: Vec<C::Header> = live.map(|(header, _)| *header).collect();
        if live.is_empty() {
            return None;
        }
        let all: Vec<C::Header> = all.into_iter().map(|(header, _)| header).collect();
        for (part, live) in self.parts.iter_mut().zip(is_live) {
            let Some(part) = part else { continue };
            part.is_new = false;
            for row in &part.rows {
                let mut row = *row;
                if !live {
                    C::silence(&mut row);
                }
                each(row);
            }
        }
        (self.written_ns, self.since_ns) = (now_ns, None);
        let mut header = C::merged(&live, &all);
        header.set_order(own.pid, own.order);
        // Over the headers that state it, on the monotonic clock and on the wall clock.
        let sent_ns = earliest(live.iter().filter_map(C::Header::sent_ns));
        let sent_unix_ns = earliest(live.iter().filter_map(C::Header::sent_unix_ns));
        header.set_sent(sent_ns, sent_unix_ns);
        Some(header)
    }
}

/// The common value of all, if they agree.
fn common(mut values: impl Iterator<Item = u64>) -> Option<u64> {
    let first = values.next()?;
    values.all(|value| value == first).then_some(first)
}

/// The minimum of the known values. 0 if none is known.
fn earliest(values: impl Iterator<Item = u64>) -> u64 {
    values.filter(|value| *value != 0).min().unwrap_or_default()
}

impl Merged for Forecasts {
    fn merged(parts: &[ForecastHeader], all: &[ForecastHeader]) -> ForecastHeader {
        let of = |field: fn(&ForecastHeader) -> u64| parts.iter().map(field);
        let total =
            |field: fn(&ForecastHeader) -> u64| all.iter().map(field).fold(0, u64::saturating_add);
        let hashes = parts.iter().map(|part| part.model_hash);
        let mut dropped = joulebus_wire::DropCounts::default();
        for part in all {
            for (total, count) in dropped.counts.iter_mut().zip(part.samples_dropped.counts) {
                *total = total.saturating_add(count);
            }
        }
        let taken = parts.iter().map(|part| part.frames_taken);
        ForecastHeader {
            schema: SCHEMA_VERSION,
            period_ns: of(|header| header.period_ns).max().unwrap_or_default(),
            model_hash: common(hashes.clone()).unwrap_or_else(|| combine_hashes(hashes)),
            capacity: parts.iter().map(|part| part.capacity).max().unwrap_or_default(),
            frames_taken: taken.fold(0, u32::saturating_add),
            first_intended_ns: earliest(of(|header| header.first_intended_ns)),
            first_sent_ns: earliest(of(|header| header.first_sent_ns)),
            first_taken_ns: earliest(of(|header| header.first_taken_ns)),
            compute_start_ns: earliest(of(|header| header.compute_start_ns)),
            compute_end_ns: earliest(of(|header| header.compute_end_ns)),
            ticks_skipped: total(|header| header.ticks_skipped),
            ticks_late: total(|header| header.ticks_late),
            samples_accepted: total(|header| header.samples_accepted),
            samples_dropped: dropped,
            ..ForecastHeader::default()
        }
    }

    fn silence(row: &mut Forecast) {
        row.flags &= !(forecast_flag::POWER | forecast_flag::INTERVAL);
        (row.power_w, row.lo_w, row.hi_w) = (f32::NAN, f32::NAN, f32::NAN);
        (row.quality, row.quality_detail) = STALE.encode();
    }

    fn add_counters(to: &mut ForecastHeader, from: &ForecastHeader) {
        for (to, from) in [
            (&mut to.ticks_skipped, from.ticks_skipped),
            (&mut to.ticks_late, from.ticks_late),
            (&mut to.samples_accepted, from.samples_accepted),
        ] {
            *to = to.saturating_add(from);
        }
        let counts = to.samples_dropped.counts.iter_mut();
        for (to, from) in counts.zip(from.samples_dropped.counts) {
            *to = to.saturating_add(from);
        }
    }
}

impl Merged for Diagnostics {
    fn merged(parts: &[DiagnosticHeader], _: &[DiagnosticHeader]) -> DiagnosticHeader {
        let mut merged = DiagnosticHeader { schema: SCHEMA_VERSION, ..DiagnosticHeader::default() };
        // The first entry of each shard comes before the second of any.
        let most = merged.refused.len();
        let refused = (0..most).flat_map(|at| parts.iter().map(move |part| part.refused[at]));
        let refused = refused.filter(|refusal| refusal.reason != 0);
        for (to, refusal) in merged.refused.iter_mut().zip(refused) {
            *to = refusal;
        }
        merged
    }

    /// Raised alarms stay raised.
    fn silence(row: &mut Diagnostic) {
        let alarms = row.alarms().with(Alarm::NoData);
        (row.alarms, row.alarm) = (alarms.0, alarms.first().code());
        row.level = alarms.level().max(Level::Stale).code();
    }
}

impl Merged for Budgets {
    fn merged(_: &[BudgetHeader], _: &[BudgetHeader]) -> BudgetHeader {
        BudgetHeader { schema: SCHEMA_VERSION, ..BudgetHeader::default() }
    }

    /// A budget states itself until when it is valid.
    fn silence(_: &mut Budget) {}
}

impl Merged for PlanStates {
    /// In settings and models, because a planner computes with one set.
    const AGREE: Option<Agree<Self>> = Some(|part, first| {
        let by =
            |header: &PlanStateHeader| (header.settings_hash, header.model_hash, header.models);
        by(part) == by(first)
    });

    fn merged(parts: &[PlanStateHeader], _: &[PlanStateHeader]) -> PlanStateHeader {
        let of = |field: fn(&PlanStateHeader) -> u64| parts.iter().map(field);
        PlanStateHeader {
            period_ns: of(|header| header.period_ns).max().unwrap_or_default(),
            compute_start_ns: earliest(of(|header| header.compute_start_ns)),
            ..parts[0]
        }
    }

    fn silence(row: &mut PlanState) {
        row.flags = (row.flags & !plan_state_flag::LAGS) | plan_state_flag::ALARM_NO_DATA;
        (row.quality, row.quality_detail) = STALE.encode();
    }
}

impl Merged for Outlooks {
    fn merged(parts: &[OutlookHeader], _: &[OutlookHeader]) -> OutlookHeader {
        let of = |field: fn(&OutlookHeader) -> u64| parts.iter().map(field);
        let hashes = of(|header| header.model_hash);
        OutlookHeader {
            schema: SCHEMA_VERSION,
            period_ns: of(|header| header.period_ns).max().unwrap_or_default(),
            model_hash: common(hashes.clone()).unwrap_or_else(|| combine_hashes(hashes)),
            compute_start_ns: earliest(of(|header| header.compute_start_ns)),
            ..OutlookHeader::default()
        }
    }

    fn silence(row: &mut Outlook) {
        row.flags &= !(outlook_flag::ENERGY | outlook_flag::TIME_TO_EMPTY);
        let unknown = [f32::NAN; OUTLOOK_HORIZONS];
        (row.energy_j, row.energy_lo_j, row.energy_hi_j) = (unknown, unknown, unknown);
        (row.mean_w, row.bounded, row.usable_j) = (f32::NAN, 0, f32::NAN);
        row.time_to_empty_s = f32::NAN;
        (row.time_to_empty_lo_s, row.time_to_empty_hi_s) = (f32::NAN, f32::NAN);
        (row.quality, row.quality_detail) = STALE.encode();
    }
}

const STALE: Quality = Quality::Invalid(InvalidReason::Stale);

#[cfg(test)]
mod tests {
    use joulebus_wire::AlarmSet;
    use proptest::prelude::*;

    use super::*;

    const OWN: Origin = Origin { pid: 7, order: FrameOrder { run: 90, number: 4 } };

    fn header(sent_ns: u64, accepted: u64) -> ForecastHeader {
        ForecastHeader {
            sent_ns,
            samples_accepted: accepted,
            period_ns: 33,
            model_hash: 5,
            ..ForecastHeader::default()
        }
    }

    fn row(robot: u32) -> Forecast {
        Forecast {
            robot,
            flags: forecast_flag::POWER | forecast_flag::SAMPLE,
            power_w: 3.0,
            quality: Quality::Fresh.encode().0,
            stamp_ns: 11,
            ..Forecast::default()
        }
    }

    fn written(
        merge: &mut Merge<Forecasts>,
        is_live: &[bool],
    ) -> Option<(ForecastHeader, Vec<Forecast>)> {
        let mut rows = Vec::new();
        let header = merge.write(is_live, OWN, 1_000, |row| rows.push(row));
        header.map(|header| (header, rows))
    }

    #[test]
    fn a_frame_is_as_old_as_its_oldest_part_and_counts_what_all_have_counted() {
        let mut merge = Merge::<Forecasts>::new(3);
        merge.put(0, header(900, 10), [row(1), row(2)].into_iter(), 0);
        merge.put(1, header(880, 20), [row(3)].into_iter(), 0);
        merge.put(2, header(500, 40), [row(4)].into_iter(), 0);
        let (header, rows) = written(&mut merge, &[true, true, false]).unwrap();
        assert_eq!((header.sent_ns, header.samples_accepted), (880, 70));
        assert_eq!((header.pid, header.worker_epoch, header.tick), (7, 90, 4));
        assert_eq!((header.model_hash, header.period_ns), (5, 33));
        let known: Vec<_> =
            rows.iter().map(|row| (row.robot, row.expected_w().is_some())).collect();
        assert_eq!(known, [(1, true), (2, true), (3, true), (4, false)]);
        // The last known values of a robot stay, but its forecast does not.
        let stale = Quality::Invalid(InvalidReason::Stale);
        assert_eq!((rows[3].quality(), rows[3].stamp_ns), (stale, 11));
        assert!(written(&mut merge, &[false; 3]).is_none());
    }

    #[test]
    fn alarms_of_a_shard_that_is_silent_stay_and_no_data_is_one_of_them() {
        let raised = AlarmSet::default().with(Alarm::BatteryLow);
        let mut row = Diagnostic {
            alarms: raised.0,
            alarm: raised.first().code(),
            level: raised.level().code(),
            ..Diagnostic::default()
        };
        Diagnostics::silence(&mut row);
        assert!(row.alarms().has(Alarm::BatteryLow) && row.alarms().has(Alarm::NoData));
        assert_eq!((row.level(), row.alarm()), (Level::Stale, row.alarms().first()));
    }

    #[test]
    fn counters_go_on_over_the_runs_of_a_worker_and_never_fall() {
        let mut merge = Merge::<Forecasts>::new(1);
        for (run, accepted, sum) in [(1, 5, 5), (1, 9, 9), (2, 0, 9), (2, 3, 12), (7, 1, 13)] {
            let header = ForecastHeader { worker_epoch: run, ..header(0, accepted) };
            merge.put(0, header, [].into_iter(), 0);
            assert_eq!(merge.header(0).unwrap().samples_accepted, sum);
        }
    }

    proptest! {
        /// Compares with the rows and freshness of each shard kept separately.
        #[test]
        fn each_frame_has_the_newest_rows_of_every_shard_and_waits_for_no_shard_longer_than_its_patience(
            steps in prop::collection::vec((0_usize..3, 0_u32..4, 1_u64..20), 1..60),
            live in prop::collection::vec(any::<bool>(), 3),
            every in 1_u32..4,
        ) {
            let mut merge = Merge::<Forecasts>::new(3);
            let (mut newest, mut is_new) = (vec![None; 3], [false; 3]);
            let (mut now_ns, mut written_ns, mut since_ns) = (0, 0, None);
            for (shard, rows, later) in steps {
                now_ns += later;
                let ids = (0..rows).map(|at| 10 * shard as u32 + at);
                newest[shard] = Some(ids.clone().collect::<Vec<u32>>());
                is_new[shard] = true;
                merge.put(shard, header(now_ns, 0), ids.map(row), now_ns);
                since_ns = since_ns.or(Some(now_ns));
                let waits = live.iter().zip(is_new).any(|(live, is_new)| *live && !is_new);
                let any = live.iter().zip(is_new).any(|(live, is_new)| *live && is_new);
                let begin_ns = 330 * u64::from(every);
                let patience = if now_ns - written_ns > begin_ns { begin_ns } else { 33 };
                let due = any && (!waits || now_ns - since_ns.unwrap() >= patience);
                prop_assert_eq!(merge.is_due((&live, &live), (now_ns, 33, every)), due);
                if !due {
                    continue;
                }
                let mut rows = Vec::new();
                prop_assert_eq!(merge.len(), newest.iter().flatten().map(Vec::len).sum::<usize>());
                let header = merge.write(&live, OWN, now_ns, |row: Forecast| {
                    rows.push((row.robot, row.expected_w().is_some()));
                });
                prop_assert!(header.is_some());
                let kept = newest.iter().zip(&live).filter_map(|(ids, live)| Some((ids.as_ref()?, *live)));
                let expected: Vec<(u32, bool)> =
                    kept.flat_map(|(ids, live)| ids.iter().map(move |id| (*id, live))).collect();
                prop_assert_eq!(rows, expected);
                (is_new, written_ns, since_ns) = ([false; 3], now_ns, None);
            }
        }
    }
}
