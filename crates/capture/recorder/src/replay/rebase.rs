//! Maps recorded times and runs to the present. Everything else is unchanged.

use std::collections::{HashMap, HashSet};

use joulebus_capture_format::Frame;
use joulebus_wire::{Channel, FrameHeader as _, Row as _, Samples, sample_flag};

/// A point in time on both clocks, ns.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Moment {
    /// Monotonic.
    pub monotonic_ns: u64,
    /// Unix.
    pub unix_ns: u64,
}

/// One pass through the capture: offset of times and runs.
#[derive(Debug)]
pub struct Rebase {
    /// Added to every recorded monotonic time, modulo 2^64.
    shift_ns: u64,
    /// The recorded time that becomes `epoch_ns`: runs that began later keep their distances. Those
    /// that began earlier had begun when the recording started, and are merged into one.
    recorded_ns: u64,
    epoch_ns: u64,
    pid: u32,
    /// First frame number and number of samples before it, by run of a source.
    first_frame: HashMap<(u64, u64), (u64, u64)>,
    /// Robots already sent in this pass. None in the first pass.
    joined: Option<HashSet<u32>>,
    /// The newest stamp and the newest run sent.
    newest_ns: u64,
    newest_epoch: u64,
}

impl Rebase {
    /// The first pass: what was recorded at `recorded` becomes `now`.
    #[must_use]
    pub fn new(recorded: Moment, now: Moment) -> Self {
        Self {
            shift_ns: now.monotonic_ns.wrapping_sub(recorded.monotonic_ns),
            recorded_ns: recorded.monotonic_ns,
            epoch_ns: now.monotonic_ns,
            pid: std::process::id(),
            first_frame: HashMap::new(),
            joined: None,
            newest_ns: now.monotonic_ns,
            newest_epoch: 0,
        }
    }

    /// Another pass, with newer runs than this one's and later stamps, even if it was played faster
    /// than recorded. The first sample of each robot is marked as a discontinuity.
    #[must_use]
    pub fn again(&self, recorded: Moment, now: Moment) -> Self {
        let mut next = Self::new(
            recorded,
            Moment { monotonic_ns: now.monotonic_ns.max(self.newest_ns + 1), ..now },
        );
        next.epoch_ns = now.monotonic_ns.max(self.newest_epoch.saturating_add(1));
        next.joined = Some(HashSet::new());
        next
    }

    /// The mapped run for comparison with present runs: all of this pass are at least as new.
    #[must_use]
    pub fn epoch(&self, recorded_epoch: u64) -> u64 {
        let since_ns = recorded_epoch.saturating_sub(self.recorded_ns);
        self.epoch_ns.saturating_add(since_ns)
    }

    /// Maps a recorded monotonic time. 0 (unknown) stays 0.
    fn ns(&self, recorded_ns: u64) -> u64 {
        if recorded_ns == 0 { 0 } else { recorded_ns.wrapping_add(self.shift_ns) }
    }

    /// Maps a recorded run. 0 (unknown) stays 0.
    fn run(&mut self, recorded_epoch: u64) -> u64 {
        if recorded_epoch == 0 {
            return 0;
        }
        let epoch = self.epoch(recorded_epoch);
        self.newest_epoch = self.newest_epoch.max(epoch);
        epoch
    }

    /// Makes of a recorded frame of samples one that is sent at `now`. Frames lost during the
    /// recording stay lost: the worker counts them.
    pub(super) fn samples(&mut self, frame: &mut Frame<Samples>, now: Moment) {
        let Frame { header, rows } = frame;
        let (frame_seq, samples_before) = *self
            .first_frame
            .entry((header.source_id, header.source_epoch))
            .or_insert((header.frame_seq, header.samples_before));
        header.frame_seq = header.frame_seq.saturating_sub(frame_seq);
        header.samples_before = header.samples_before.saturating_sub(samples_before);
        if let Some(joined) = &mut self.joined {
            for sample in rows {
                if joined.insert(sample.robot) {
                    sample.flags |= sample_flag::DISCONTINUITY;
                }
            }
        }
        self.frame(frame, now, 1.0);
        frame.header.intended_ns = now.monotonic_ns;
    }

    /// Makes of a recorded frame one that is sent at `now`. `slower`: factor by which the period is
    /// stretched, so that planners do not take a slow replay for a dead worker.
    pub fn frame<C: Channel>(&mut self, frame: &mut Frame<C>, now: Moment, slower: f64) {
        let Frame { header, rows } = frame;
        for row in rows {
            let mut stamp_ns = None;
            row.instants(|recorded_ns| {
                *recorded_ns = self.ns(*recorded_ns);
                stamp_ns.get_or_insert(*recorded_ns);
            });
            row.runs(|run| *run = self.run(*run));
            self.newest_ns = self.newest_ns.max(stamp_ns.unwrap_or_default());
        }
        let sent_ns = header.sent_ns();
        header.instants(|recorded_ns| {
            *recorded_ns = match sent_ns {
                // The worker's own times keep their distances from the time of sending.
                Some(sent_ns) if *recorded_ns != 0 => {
                    recorded_ns.wrapping_sub(sent_ns).wrapping_add(now.monotonic_ns)
                }
                _ => self.ns(*recorded_ns),
            };
        });
        header.runs(|run| *run = self.run(*run));
        header.set_order(self.pid, header.order());
        header.set_sent(now.monotonic_ns, now.unix_ns);
        if let Some(period_ns) = header.period_ns() {
            *period_ns = (*period_ns as f64 * slower) as u64;
        }
    }
}

#[cfg(test)]
mod tests {
    use joulebus_wire::{Forecast, ForecastHeader, Forecasts, Sample, SampleHeader};

    use super::*;

    const RECORDED: Moment = Moment { monotonic_ns: 5_000, unix_ns: 1_000_000 };

    fn frame(
        rebase: &mut Rebase,
        epoch: u64,
        frame_seq: u64,
        stamp_ns: u64,
    ) -> (SampleHeader, Sample) {
        let header = SampleHeader {
            source_id: 7,
            source_epoch: epoch,
            frame_seq,
            samples_before: 10 * frame_seq,
            ..SampleHeader::default()
        };
        let rows = vec![Sample::new(3, frame_seq, stamp_ns).reading(3.5, stamp_ns - 10)];
        let now = Moment { monotonic_ns: 90_000, unix_ns: 2_000_000 };
        let mut frame = Frame { header, rows };
        rebase.samples(&mut frame, now);
        (frame.header, frame.rows[0])
    }

    #[test]
    fn times_keep_their_intervals_and_frames_their_gaps() {
        let now = Moment { monotonic_ns: 90_000, unix_ns: 2_000_000 };
        let mut rebase = Rebase::new(RECORDED, now);
        let (first, one) = frame(&mut rebase, 999_000, 40, 5_100);
        let (second, other) = frame(&mut rebase, 999_000, 43, 5_500);
        assert_eq!((one.stamp_ns, one.measured_ns), (90_100, 90_090));
        assert_eq!(other.stamp_ns - one.stamp_ns, 400);
        assert_eq!((first.frame_seq, first.samples_before), (0, 0));
        assert_eq!((second.frame_seq, second.samples_before), (3, 30));
        assert_eq!((first.source_id, first.source_epoch), (7, 1_084_000));
        assert_eq!(one.flags, other.flags, "nothing is marked in the first pass");
        let (unknown, nothing) = (Sample::new(1, 0, 6_000), rebase.ns(0));
        let mut frame = Frame { header: SampleHeader::default(), rows: vec![unknown] };
        rebase.samples(&mut frame, now);
        assert_eq!((frame.rows[0].measured_ns, nothing), (0, 0));
    }

    #[test]
    fn runs_stay_in_order_and_are_never_older_than_the_replay_at_any_uptime() {
        for (recorded_ns, now_ns) in [(1 << 50, 5), (5, 1 << 50), (1 << 50, 1 << 50)] {
            let at = |monotonic_ns| Moment { monotonic_ns, unix_ns: 1 };
            let rebase = Rebase::new(at(recorded_ns), at(now_ns));
            let runs = [1, recorded_ns - 1, recorded_ns, recorded_ns + 1, u64::MAX];
            let runs = runs.map(|run| rebase.epoch(run));
            assert!(runs.is_sorted() && runs[0] == now_ns, "{runs:?}");
            assert!(runs[2] < runs[3] && runs[3] < runs[4], "{runs:?}");
        }
    }

    #[test]
    fn another_pass_is_newer_at_any_rate() {
        let now = Moment { monotonic_ns: 90_000, unix_ns: 2_000_000 };
        let mut rebase = Rebase::new(RECORDED, now);
        let (_, early) = frame(&mut rebase, 999_000, 0, 5_100);
        // The source was restarted late in the recording, which is played at maximum rate.
        let (before, late) = frame(&mut rebase, 1_500_000, 0, 600_000);
        let soon = Moment { monotonic_ns: 90_001, unix_ns: 2_000_001 };
        let mut again = rebase.again(RECORDED, soon);
        let (after, first) = frame(&mut again, 999_000, 0, 5_100);
        assert!(after.source_epoch > before.source_epoch, "{after:?} {before:?}");
        assert!(first.stamp_ns > late.stamp_ns, "{first:?} {late:?}");
        assert!(first.has(sample_flag::DISCONTINUITY) && !early.has(sample_flag::DISCONTINUITY));
        let (_, second) = frame(&mut again, 999_000, 1, 5_200);
        assert!(!second.has(sample_flag::DISCONTINUITY));
    }

    #[test]
    fn a_workers_own_times_keep_their_distances_from_the_time_of_sending() {
        let now = Moment { monotonic_ns: 90_000, unix_ns: 2_000_000 };
        let header = ForecastHeader {
            worker_epoch: 999_000,
            tick: 7,
            period_ns: 30,
            first_sent_ns: 0,
            compute_start_ns: 5_080,
            sent_ns: 5_100,
            ..ForecastHeader::default()
        };
        let row = Forecast {
            stamp_ns: 5_050,
            target_ns: 5_083,
            reading_age_ns: 4,
            source_epoch: 999_000,
            ..Forecast::default()
        };
        let mut frame = Frame::<Forecasts> { header, rows: vec![row] };
        let mut rebase = Rebase::new(RECORDED, now);
        rebase.frame(&mut frame, now, 2.5);
        let Frame { header: sent, rows } = frame;
        let expected = ForecastHeader {
            pid: std::process::id(),
            worker_epoch: 1_084_000,
            period_ns: 75,
            compute_start_ns: 89_980,
            sent_ns: 90_000,
            sent_unix_ns: 2_000_000,
            ..header
        };
        assert_eq!(sent, expected);
        let expected =
            Forecast { stamp_ns: 90_050, target_ns: 90_083, source_epoch: 1_084_000, ..row };
        assert_eq!(rows, [expected]);
        assert_eq!(rebase.newest_ns, 90_050);
    }
}
