//! State of the worker as seen by a planner, from frames, events and the time: without a clock.

use joulebus_wire::ForecastHeader;

/// State of the worker.
///
/// ```no_run
/// # use joulebus_consumer::{End, Subscriber, WorkerState};
/// # fn example(subscriber: &Subscriber) {
/// match subscriber.worker() {
///     WorkerState::Alive => println!("the forecasts are fresh"),
///     WorkerState::Gone(End::Unreachable) => println!("the other host is not reachable"),
///     other => println!("do not rely on forecasts: {other:?}"),
/// }
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum WorkerState {
    /// No frame has arrived yet.
    Waiting,
    /// The newest frame is at most two tick periods old.
    Alive,
    /// The newest frame is older than that: do not rely on it.
    Stale {
        /// Time since it was sent, ns.
        age_ns: u64,
    },
    /// The worker has ended.
    Gone(End),
}

/// Means by which the end of a worker was detected.
///
/// [`WorkerState`] has an example.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum End {
    /// The worker sent the end event.
    Ended,
    /// Its process exited without an end event: detected at once.
    Exited,
    /// Another process found it dead: where processes cannot be watched.
    FoundDead,
    /// The worker is on another host, and nothing comes from there: host or link is down. It may
    /// still run.
    Unreachable,
}

/// Gap before a frame of forecasts.
///
/// ```no_run
/// # fn example(frame: &joulebus_consumer::Frame<'_, joulebus_consumer::Forecasts>) {
/// let arrival = frame.arrival();
/// if arrival.restarted {
///     println!("ticks count from 1 again: another run of the worker");
/// }
/// println!("{} ticks were missed", arrival.ticks_missed);
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Arrival {
    /// Ticks of this worker whose frames were skipped or lost since the last frame that was
    /// returned. 0 for the very first frame.
    pub ticks_missed: u64,
    /// The frame is the first of another run of the worker than the previous frame.
    pub restarted: bool,
}

/// Numbers of frames returned so far.
///
/// ```no_run
/// # fn example(subscriber: &joulebus_consumer::Subscriber) {
/// let counts = subscriber.counts();
/// println!("{} frames, {} ticks missed", counts.frames, counts.ticks_missed);
/// # }
/// ```
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[non_exhaustive]
pub struct Counts {
    /// Frames.
    pub frames: u64,
    /// Number of gaps between frames.
    pub gaps: u64,
    /// Ticks missing in all gaps.
    pub ticks_missed: u64,
    /// Runs of the worker.
    pub workers: u64,
}

/// Total order of frames: (index of the worker's process among those seen here, run, tick). A later
/// process counts as later, whatever it states.
pub(crate) type RunOrder = (u64, u64, u64);

pub(crate) const fn order(run: u64, header: &ForecastHeader) -> RunOrder {
    (run, header.worker_epoch, header.tick)
}

#[derive(Debug, Clone, Copy)]
struct Last {
    order: RunOrder,
    sent_ns: u64,
    period_ns: u64,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Reported {
    Nothing,
    Stale,
    Gone,
}

#[derive(Debug)]
pub(crate) struct Tracker {
    last: Option<Last>,
    // How and when the end of the run of `last` was detected.
    over: Option<(End, u64)>,
    reported: Reported,
    counts: Counts,
}

impl Tracker {
    pub(crate) const fn new() -> Self {
        Self {
            last: None,
            over: None,
            reported: Reported::Nothing,
            counts: Counts { frames: 0, gaps: 0, ticks_missed: 0, workers: 0 },
        }
    }

    /// The order of the newest frame.
    pub(crate) fn order(&self) -> Option<RunOrder> {
        self.last.map(|last| last.order)
    }

    /// A frame later than all before, of the `run`-th process that is the worker, read at `now_ns`.
    /// If this process's clock is behind the worker's, the frame's age is taken to be 0 then, so
    /// that a silent worker is noticed all the same.
    pub(crate) fn frame(&mut self, run: u64, header: &ForecastHeader, now_ns: u64) -> Arrival {
        let (_, epoch, tick) = order(run, header);
        let arrival = match self.order() {
            None => Arrival::default(),
            Some((ran, before, last)) if (ran, before) == (run, epoch) => Arrival {
                ticks_missed: tick.saturating_sub(last).saturating_sub(1),
                restarted: false,
            },
            // Ticks count from 1.
            Some(_) => Arrival { ticks_missed: tick.saturating_sub(1), restarted: true },
        };
        self.counts.frames += 1;
        self.counts.workers += u64::from(self.last.is_none() || arrival.restarted);
        self.counts.gaps += u64::from(arrival.ticks_missed > 0);
        self.counts.ticks_missed = self.counts.ticks_missed.saturating_add(arrival.ticks_missed);
        // Frames sent before the detected end do not revive a run. Frames sent after it show that
        // the run had not ended, despite the detection (possibly of a process in another
        // container).
        let lives = |(_, over_ns): (End, u64)| arrival.restarted || header.sent_ns > over_ns;
        if self.over.is_none_or(lives) {
            self.over = None;
            self.reported = Reported::Nothing;
        }
        self.last = Some(Last {
            order: (run, epoch, tick),
            sent_ns: header.sent_ns.min(now_ns),
            period_ns: header.period_ns,
        });
        arrival
    }

    /// The run of the newest frame has ended. The first reason is kept.
    pub(crate) fn over(&mut self, end: End, now_ns: u64) {
        if self.last.is_some() {
            self.over.get_or_insert((end, now_ns));
        }
    }

    pub(crate) fn state(&self, now_ns: u64) -> WorkerState {
        match (&self.last, self.over) {
            (None, _) => WorkerState::Waiting,
            (Some(_), Some((end, _))) => WorkerState::Gone(end),
            (Some(last), None) if now_ns >= stale_ns(last) => {
                WorkerState::Stale { age_ns: now_ns - last.sent_ns }
            }
            (Some(_), None) => WorkerState::Alive,
        }
    }

    /// The state, if it has become worse since it was last returned.
    pub(crate) fn change(&mut self, now_ns: u64) -> Option<WorkerState> {
        let state = self.state(now_ns);
        let worse = match state {
            WorkerState::Waiting | WorkerState::Alive => return None,
            WorkerState::Stale { .. } => Reported::Stale,
            WorkerState::Gone(_) => Reported::Gone,
        };
        let changed = worse != self.reported;
        self.reported = worse;
        changed.then_some(state)
    }

    /// True if the worker's end is known, and [`Tracker::change`] has not returned it.
    pub(crate) fn is_end_unreported(&self) -> bool {
        self.over.is_some() && self.reported != Reported::Gone
    }

    /// When the state will change without frames, monotonic ns.
    pub(crate) fn change_due_ns(&self) -> Option<u64> {
        let last = self.last.as_ref()?;
        (self.over.is_none() && self.reported == Reported::Nothing).then_some(stale_ns(last))
    }

    pub(crate) const fn counts(&self) -> Counts {
        self.counts
    }
}

/// The first time at which the frame is older than two periods.
const fn stale_ns(last: &Last) -> u64 {
    last.sent_ns.saturating_add(last.period_ns.saturating_mul(2)).saturating_add(1)
}

/// Decides when people are warned that the worker is late: later than planners, who may not rely on
/// an old forecast, and until frames have come for as long. A host that is busy for two ticks is
/// nobody's alarm.
#[derive(Debug)]
pub(crate) struct Lateness {
    after_ns: u64,
    is_late: bool,
    /// Since when nothing was late, while it counts as late.
    calm_from_ns: Option<u64>,
}

impl Lateness {
    pub(crate) const fn new(after_ns: u64) -> Self {
        Self { after_ns, is_late: false, calm_from_ns: None }
    }

    /// The state for people, of a worker whose state for planners is `state`.
    pub(crate) fn look(&mut self, state: WorkerState, now_ns: u64) -> WorkerState {
        let age_ns = match state {
            WorkerState::Alive => 0,
            WorkerState::Stale { age_ns } => age_ns,
            WorkerState::Waiting | WorkerState::Gone(_) => {
                (self.is_late, self.calm_from_ns) = (false, None);
                return state;
            }
        };
        if age_ns >= self.after_ns {
            (self.is_late, self.calm_from_ns) = (true, None);
        } else if self.is_late {
            let calm_from_ns = *self.calm_from_ns.get_or_insert(now_ns);
            self.is_late = now_ns.saturating_sub(calm_from_ns) < self.after_ns;
        }
        match self.is_late {
            true => WorkerState::Stale { age_ns },
            false => WorkerState::Alive,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 100;

    fn header(epoch: u64, tick: u64, sent_ns: u64) -> ForecastHeader {
        ForecastHeader {
            worker_epoch: epoch,
            tick,
            sent_ns,
            period_ns: PERIOD_NS,
            ..ForecastHeader::default()
        }
    }

    #[test]
    fn gaps_and_missed_ticks_are_counted() {
        let mut tracker = Tracker::new();
        for (epoch, tick, missed, restarted, gaps) in [
            // A late planner has missed nothing.
            (7, 40, 0, false, 0),
            (7, 41, 0, false, 0),
            (7, 45, 3, false, 1),
            (7, 46, 0, false, 1),
            // A new run counts its ticks from 1.
            (8, 1, 0, true, 1),
            (8, 2, 0, false, 1),
            (9, 3, 2, true, 2),
            (9, u64::MAX, u64::MAX - 4, false, 3),
        ] {
            let arrival = tracker.frame(1, &header(epoch, tick, 1_000), u64::MAX);
            assert_eq!(
                (arrival.ticks_missed, arrival.restarted),
                (missed, restarted),
                "{epoch}:{tick}"
            );
            assert_eq!(tracker.counts().gaps, gaps, "{epoch}:{tick}");
        }
        let expected = Counts { frames: 8, gaps: 3, ticks_missed: u64::MAX, workers: 3 };
        assert_eq!(tracker.counts(), expected);
    }

    #[test]
    fn a_frame_older_than_two_periods_is_stale_and_reported_once() {
        let mut tracker = Tracker::new();
        assert_eq!(tracker.state(5_000), WorkerState::Waiting);
        assert_eq!(tracker.change(5_000), None);
        assert_eq!(tracker.change_due_ns(), None);
        tracker.frame(1, &header(1, 1, 1_000), u64::MAX);
        assert_eq!(tracker.change_due_ns(), Some(1_201));
        let stale = |age_ns| WorkerState::Stale { age_ns };
        for (now_ns, state, change) in [
            // Sent by a clock slightly ahead of ours.
            (999, WorkerState::Alive, false),
            (1_200, WorkerState::Alive, false),
            (1_201, stale(201), true),
            (1_300, stale(300), false),
            (9_000, stale(8_000), false),
        ] {
            assert_eq!(tracker.state(now_ns), state, "{now_ns}");
            assert_eq!(tracker.change(now_ns), change.then_some(state), "{now_ns}");
        }
        assert_eq!(tracker.change_due_ns(), None, "reported already");
        tracker.frame(1, &header(1, 2, 9_100), u64::MAX);
        assert_eq!(tracker.state(9_100), WorkerState::Alive);
        assert_eq!(tracker.change(9_301), Some(stale(201)), "reported again");
    }

    #[test]
    fn an_end_is_reported_once_and_not_undone_by_frames_sent_before() {
        for end in [End::Ended, End::Exited, End::FoundDead, End::Unreachable] {
            let mut tracker = Tracker::new();
            // An end before the first frame is ignored.
            tracker.over(end, 900);
            assert_eq!(tracker.state(900), WorkerState::Waiting);
            tracker.frame(1, &header(1, 1, 1_000), u64::MAX);
            tracker.over(end, 1_050);
            let gone = WorkerState::Gone(end);
            assert_eq!(tracker.state(1_050), gone);
            // The last frame is read after the end was seen.
            tracker.frame(1, &header(1, 2, 1_040), u64::MAX);
            assert_eq!(tracker.change(1_060), Some(gone));
            assert_eq!(tracker.change(1_060), None);
            assert_eq!(tracker.change(9_999), None, "gone, therefore not stale");
            assert_eq!(tracker.change_due_ns(), None);
        }
    }

    #[test]
    fn the_first_reason_of_an_end_is_kept() {
        let mut tracker = Tracker::new();
        tracker.frame(1, &header(1, 1, 1_000), u64::MAX);
        tracker.over(End::Ended, 1_010);
        tracker.over(End::Exited, 1_020);
        assert_eq!(tracker.state(1_020), WorkerState::Gone(End::Ended));
    }

    #[test]
    fn a_new_run_or_a_later_frame_revives_the_worker() {
        for (epoch, tick, sent_ns, back) in [
            // A new run, even if its first frame was sent before the old one's end was detected.
            (2, 1, 1_020, true),
            (2, 1, 1_090, true),
            (1, 2, 1_051, true),
            (1, 2, 1_050, false),
        ] {
            let mut tracker = Tracker::new();
            tracker.frame(1, &header(1, 1, 1_000), u64::MAX);
            tracker.over(End::Exited, 1_050);
            assert!(tracker.change(1_060).is_some());
            tracker.frame(1, &header(epoch, tick, sent_ns), u64::MAX);
            let alive = tracker.state(1_100) == WorkerState::Alive;
            assert_eq!(alive, back, "{epoch}:{tick} {sent_ns}");
            tracker.over(End::Exited, 1_110);
            assert_eq!(tracker.change(1_120).is_some(), back, "reported again");
        }
    }

    #[test]
    fn the_end_of_a_stale_worker_is_reported() {
        let mut tracker = Tracker::new();
        tracker.frame(1, &header(1, 1, 1_000), u64::MAX);
        assert!(matches!(tracker.change(1_500), Some(WorkerState::Stale { age_ns: 500 })));
        tracker.over(End::Exited, 1_600);
        assert_eq!(tracker.change(1_600), Some(WorkerState::Gone(End::Exited)));
    }

    #[test]
    fn a_worker_whose_clock_is_ahead_falls_silent_two_periods_after_its_frame_was_read() {
        let mut tracker = Tracker::new();
        tracker.frame(1, &header(1, 1, 1_000_000), 1_000);
        assert_eq!(tracker.state(1_200), WorkerState::Alive);
        assert_eq!(tracker.state(1_201), WorkerState::Stale { age_ns: 201 });
    }

    #[test]
    fn invalid_headers_do_not_panic() {
        let mut tracker = Tracker::new();
        let mut wild = header(1, 0, u64::MAX);
        wild.period_ns = u64::MAX;
        tracker.frame(1, &wild, u64::MAX);
        assert_eq!(tracker.state(0), WorkerState::Alive);
        // At the maximum time everything is stale.
        assert!(matches!(tracker.state(u64::MAX), WorkerState::Stale { age_ns: 0 }));
        wild.period_ns = 0;
        wild.sent_ns = 10;
        tracker.frame(1, &wild, u64::MAX);
        assert_eq!(tracker.state(11), WorkerState::Stale { age_ns: 1 });
    }

    #[test]
    fn people_are_warned_of_a_late_worker_once_until_it_has_been_on_time_for_as_long() {
        let (stale, alive) = (|age_ns| WorkerState::Stale { age_ns }, WorkerState::Alive);
        let mut lateness = Lateness::new(100);
        for (now_ns, state, shown) in [
            (0, WorkerState::Waiting, WorkerState::Waiting),
            (10, alive, alive),
            // Two ticks missed: nothing for people, again and again.
            (20, stale(70), alive),
            (30, alive, alive),
            (40, stale(99), alive),
            (50, stale(100), stale(100)),
            // A frame now and then is not the end of it.
            (60, alive, stale(0)),
            (150, stale(70), stale(70)),
            (155, stale(101), stale(101)),
            (160, alive, stale(0)),
            (259, alive, stale(0)),
            (260, alive, alive),
            (300, stale(100), stale(100)),
            (310, WorkerState::Gone(End::Exited), WorkerState::Gone(End::Exited)),
            // The next run begins anew.
            (320, alive, alive),
        ] {
            assert_eq!(lateness.look(state, now_ns), shown, "at {now_ns}");
        }
    }
}
