//! The offset between another host's monotonic clock and this host's, from round trips.
//!
//! A request leaves at `asked` (own clock), is received at `received` and answered at `sent` (their
//! clock), and the answer arrives at `now` (own clock). Nothing arrives before it was sent. The
//! offset `θ`, which turns their times into ours, therefore lies between `asked − received` and
//! `now − sent`, however long either direction took. Each round trip gives such bounds. They widen
//! with time by the possible drift between two clocks, and their intersection holds.
//!
//! Stamps are moved by an offset at or below the lower bound. A measurement of the other host is
//! then never taken for younger than it is, and never lies in the future. The offset stays the same
//! while the bounds allow, so that distances between stamps do not change.

use std::collections::VecDeque;

/// Upper bound of the drift between two clocks: Linux slews at most 500 ppm, and each crystal is
/// within 100 ppm of its frequency (`man 2 adjtimex`; usual data sheets).
const DRIFT_PPM: i128 = 1_200;
/// Number of round trips that count, and the shortest time between two.
const MAX_BOUNDS: usize = 64;
const BOUNDS_INTERVAL_NS: u64 = 100_000_000;
/// Margin of a new offset below the lower bound, so that it can stay for a while. `MAX_BELOW_NS`
/// bounds by how much an offset may make stamps older than necessary.
const MARGIN_NS: i128 = 200_000;
const MAX_BELOW_NS: i128 = 1_500_000;
/// Maximum duration of a round trip. Bounds of longer ones are too wide to help.
const MAX_TRIP_NS: u64 = 10_000_000_000;
/// Upper bound of the drift between two clocks within a time, ns.
fn max_drift_ns(time_ns: u64) -> i128 {
    i128::from(time_ns) * DRIFT_PPM / 1_000_000
}

#[derive(Debug, Clone, Copy)]
struct Bounds {
    lo_ns: i128,
    hi_ns: i128,
    /// When they were measured, monotonic ns of this host.
    at_ns: u64,
}

impl Bounds {
    fn at(self, now_ns: u64) -> Self {
        let drift_ns = max_drift_ns(now_ns.saturating_sub(self.at_ns));
        Self { lo_ns: self.lo_ns - drift_ns, hi_ns: self.hi_ns + drift_ns, at_ns: now_ns }
    }

    /// The intersection of both.
    fn and(self, other: Self) -> Self {
        Self {
            lo_ns: self.lo_ns.max(other.lo_ns),
            hi_ns: self.hi_ns.min(other.hi_ns),
            at_ns: self.at_ns,
        }
    }
}

/// The four times of a round trip. The middle ones are the other host's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Trip {
    pub(crate) asked_ns: u64,
    pub(crate) received_ns: u64,
    pub(crate) sent_ns: u64,
    pub(crate) now_ns: u64,
}

/// The estimated offset of another host's clock.
#[derive(Debug, Default)]
pub(crate) struct Offset {
    bounds: VecDeque<Bounds>,
    /// The offset in use, ns.
    used_ns: Option<i128>,
    /// Number of changes of the offset in use.
    pub(crate) refits: u64,
    /// Number of clock steps: bounds contradicted each other.
    pub(crate) steps: u64,
}

impl Trip {
    /// Bounds of the offset. `None` if the times contradict themselves or took too long to help.
    fn bounds(&self) -> Option<Bounds> {
        let took_ns = self.took_ns().filter(|took_ns| *took_ns <= MAX_TRIP_NS)?;
        // The lower bound holds for the instant at which the other host received the request. That
        // may be as early as `asked_ns`.
        Some(Bounds {
            lo_ns: i128::from(self.asked_ns) - i128::from(self.received_ns) - max_drift_ns(took_ns),
            hi_ns: i128::from(self.now_ns) - i128::from(self.sent_ns),
            at_ns: self.now_ns,
        })
    }

    /// Duration by this host's clock. `None` if an answer left before its request, or arrived so.
    fn took_ns(&self) -> Option<u64> {
        self.sent_ns.checked_sub(self.received_ns)?;
        self.now_ns.checked_sub(self.asked_ns)
    }

    /// False if more time passed there than here, or the times contradict themselves otherwise: a
    /// clock stopped or was set in between, or the message is damaged.
    pub(crate) fn is_possible(&self) -> bool {
        self.bounds().is_some_and(|bounds| bounds.lo_ns <= bounds.hi_ns)
    }
}

impl Offset {
    /// Adds a round trip. Returns false if its times contradict themselves.
    pub(crate) fn note(&mut self, trip: Trip) -> bool {
        let Some(found) = trip.bounds() else {
            return false;
        };
        if found.lo_ns > found.hi_ns {
            // More time passed there than here: one of the clocks stopped or was set in between.
            self.steps += u64::from(!self.bounds.is_empty());
            self.forget();
            return false;
        }
        self.take(found);
        self.fit(trip.now_ns);
        true
    }

    /// Drops all measurements, because the other host may have booted again.
    pub(crate) fn forget(&mut self) {
        self.bounds.clear();
    }

    /// True if there is a measurement since then.
    pub(crate) fn is_measured(&self) -> bool {
        !self.bounds.is_empty()
    }

    fn take(&mut self, found: Bounds) {
        let known = self.trips(found.at_ns);
        if known.is_some_and(|known| known.lo_ns > found.hi_ns || found.lo_ns > known.hi_ns) {
            self.bounds.clear();
            self.steps += 1;
        }
        // Round trips in quick succession share an entry with their intersection, so a wide newest
        // entry cannot stay for long.
        let recent = self.bounds.back().copied();
        let recent =
            recent.filter(|last| found.at_ns.saturating_sub(last.at_ns) < BOUNDS_INTERVAL_NS);
        if let Some(recent) = recent {
            self.bounds.pop_back();
            let at_ns = recent.at_ns;
            self.bounds.push_back(Bounds { at_ns, ..recent.at(found.at_ns).and(found) });
            return;
        }
        if self.bounds.len() == MAX_BOUNDS {
            self.bounds.pop_front();
        }
        self.bounds.push_back(found);
    }

    fn fit(&mut self, now_ns: u64) {
        let Some(trips) = self.trips(now_ns) else {
            return;
        };
        let holds = |used_ns: i128| used_ns <= trips.lo_ns && used_ns >= trips.lo_ns - MAX_BELOW_NS;
        if !self.used_ns.is_some_and(holds) {
            self.refits += u64::from(self.used_ns.is_some());
            self.used_ns = Some(trips.lo_ns - MARGIN_NS);
        }
    }

    /// The intersection of the bounds of all round trips.
    fn trips(&self, now_ns: u64) -> Option<Bounds> {
        let all = self.bounds.iter().map(|bounds| bounds.at(now_ns));
        all.reduce(Bounds::and)
    }

    /// The offset in use, ns. `None` before the first round trip.
    pub(crate) fn used_ns(&self) -> Option<i128> {
        self.used_ns.filter(|_| self.is_measured())
    }

    /// Upper bound of how much older stamps may look than they are, ns.
    pub(crate) fn uncertainty_ns(&self, now_ns: u64) -> Option<u64> {
        u64::try_from(self.trips(now_ns)?.hi_ns - self.used_ns?).ok()
    }
}

/// Converts a time of the other host to this host's clock. 0 means unknown and stays 0.
pub(crate) fn shifted(stamp_ns: u64, offset_ns: i128) -> u64 {
    if stamp_ns == 0 {
        return 0;
    }
    let here = i128::from(stamp_ns) + offset_ns;
    u64::try_from(here.max(1)).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Two clocks. Ours is theirs plus an offset that drifts.
    struct Clocks {
        offset_ns: i128,
        drift_ppm: i128,
    }

    impl Clocks {
        fn true_ns(&self, now_ns: u64) -> i128 {
            self.offset_ns + i128::from(now_ns) * self.drift_ppm / 1_000_000
        }

        fn theirs(&self, now_ns: u64) -> u64 {
            u64::try_from(i128::from(now_ns) - self.true_ns(now_ns)).unwrap()
        }
    }

    fn trip(clocks: &Clocks, asked_ns: u64, there_ns: u64, back_ns: u64) -> Trip {
        let received_ns = asked_ns + there_ns;
        Trip {
            asked_ns,
            received_ns: clocks.theirs(received_ns),
            sent_ns: clocks.theirs(received_ns + 50_000),
            now_ns: received_ns + 50_000 + back_ns,
        }
    }

    proptest! {
        /// Holds for any path delays, however asymmetric.
        #[test]
        fn a_stamp_is_never_moved_past_its_true_time_and_is_late_by_no_more_than_the_uncertainty(
            offset_ns in -1_000_000_000_000_i64..1_000_000_000_000,
            drift_ppm in -500_i128..500,
            ways in prop::collection::vec((20_000_u64..50_000_000, 20_000_u64..50_000_000), 1..150),
        ) {
            let clocks = Clocks { offset_ns: i128::from(offset_ns), drift_ppm };
            let mut offset = Offset::default();
            let mut now_ns = 2_000_000_000_000;
            for (there_ns, back_ns) in ways {
                let trip = trip(&clocks, now_ns, there_ns, back_ns);
                now_ns = trip.now_ns;
                prop_assert!(offset.note(trip));
                let true_ns = clocks.true_ns(now_ns);
                let used_ns = offset.used_ns().unwrap();
                let uncertain_ns = offset.uncertainty_ns(now_ns).unwrap();
                prop_assert!(used_ns <= true_ns + 1, "{used_ns} {true_ns}");
                prop_assert!(true_ns - used_ns <= i128::from(uncertain_ns) + 1);
                let took_ns = there_ns + back_ns + 50_000;
                // Bounds that follow others closely widen with them.
                let widened_ns = max_drift_ns(took_ns) + 2 * max_drift_ns(BOUNDS_INTERVAL_NS);
                let most_ns = i128::from(took_ns) + widened_ns + MAX_BELOW_NS;
                prop_assert!(i128::from(uncertain_ns) <= most_ns, "{uncertain_ns} of {most_ns}");
                now_ns += 40_000_000;
            }
            prop_assert_eq!(offset.steps, 0);
        }
    }

    #[test]
    fn an_answer_that_took_longer_there_than_here_is_a_step_and_nothing_is_moved_until_the_next() {
        let clocks = Clocks { offset_ns: 0, drift_ppm: 0 };
        let mut offset = Offset::default();
        assert!(offset.note(trip(&clocks, 5_000_000_000, 100_000, 100_000)));
        // This host was suspended for half a millisecond while the answer was in flight.
        let suspended =
            Trip { now_ns: 6_000_050_000, ..trip(&clocks, 6_000_000_000, 300_000, 100_000) };
        let suspended = Trip { sent_ns: suspended.received_ns + 1_000_000, ..suspended };
        assert!(!offset.note(suspended));
        assert_eq!((offset.used_ns(), offset.steps), (None, 1));
    }

    #[test]
    fn distances_between_stamps_stay_while_the_bounds_allow_it() {
        let clocks = Clocks { offset_ns: 7_000_000, drift_ppm: 1 };
        let mut offset = Offset::default();
        for at in 0..3_000_u64 {
            // One path in ten is slow.
            let slow_ns = if at % 10 == 9 { 3_000_000 } else { 0 };
            let asked_ns = 1_000_000_000 + at * 100_000_000;
            let trip = trip(&clocks, asked_ns, 150_000 + slow_ns, 120_000 + slow_ns);
            offset.note(trip);
        }
        assert_eq!((offset.refits, offset.steps), (0, 0), "in five minutes");
    }

    #[test]
    fn a_step_of_either_clock_is_noticed_and_measured_anew() {
        for step_ns in [-5_000_000_000_i128, -1_000_000, 1_000_000, 5_000_000_000] {
            let mut clocks = Clocks { offset_ns: 0, drift_ppm: 0 };
            let mut offset = Offset::default();
            let mut asked_ns = 100_000_000_000;
            for at in 0..40 {
                if at == 20 {
                    clocks.offset_ns += step_ns;
                }
                offset.note(trip(&clocks, asked_ns, 100_000, 100_000));
                asked_ns += 100_000_000;
            }
            assert_eq!(offset.steps, 1, "{step_ns}");
            let late_ns = clocks.offset_ns - offset.used_ns().unwrap();
            assert!((0..MAX_BELOW_NS + 300_000).contains(&late_ns), "{step_ns}: {late_ns}");
        }
    }

    #[test]
    fn times_that_contradict_themselves_are_not_taken() {
        let mut offset = Offset::default();
        for (asked_ns, received_ns, sent_ns, now_ns) in [
            // Answered before the request, or sent before it was received.
            (9, 1, 1, 8),
            (1, 9, 8, 9),
            // The other host held it longer than the round trip took.
            (10, 0, 100, 20),
            (1, 0, 0, 20_000_000_000),
        ] {
            let trip = Trip { asked_ns, received_ns, sent_ns, now_ns };
            assert!(!offset.note(trip), "{trip:?}");
        }
        assert_eq!((offset.used_ns(), offset.uncertainty_ns(5)), (None, None));
    }

    #[test]
    fn an_unknown_time_stays_unknown_and_nothing_wraps() {
        assert_eq!(shifted(0, 5), 0);
        assert_eq!(shifted(5, -10), 1);
        assert_eq!(shifted(u64::MAX, 10), u64::MAX);
        assert_eq!(shifted(100, -10), 90);
    }
}
