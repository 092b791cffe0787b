//! The offset between another host's monotonic clock and this one, from round trips.
//!
//! A request leaves at `asked` (own clock), is taken at `heard`, answered at `sent` (their clock), and the answer
//! arrives at `now` (own clock). Nothing arrives before it was sent, so the offset `θ`, which is added to their
//! times to get ours, lies between `asked − heard` and `now − sent`, however long either way took. Each round trip
//! gives such bounds; they widen with time by what two clocks may drift apart, and their intersection holds.
//!
//! Stamps are moved by an offset that is not above the lower bound: what was measured there is never taken for
//! younger than it is, and never lies in the future. It stays the same while the bounds allow, so that distances
//! between stamps stay as they are.

use std::collections::VecDeque;

/// Maximum by which two clocks drift apart: Linux slews at most 500 ppm, and each crystal is within 100 ppm of its
/// frequency (`man 2 adjtimex`; usual data sheets).
const DRIFT_PPM: i128 = 1_200;
/// Number of round trips that count, and the shortest time between two.
const MOST_BOUNDS: usize = 64;
const BOUNDS_EVERY_NS: u64 = 100_000_000;
/// Room below the lower bound that a new offset gets, so that it can stay for a while, and the most by which an
/// offset may make stamps older than they are known to be.
const ROOM_NS: i128 = 200_000;
const MOST_BELOW_NS: i128 = 1_500_000;
/// Bounds of a round trip that took longer say too little.
const LONGEST_TRIP_NS: u64 = 10_000_000_000;

#[derive(Debug, Clone, Copy)]
struct Bounds {
    lo_ns: i128,
    hi_ns: i128,
    /// When they were found, monotonic ns of this host.
    at_ns: u64,
}

impl Bounds {
    fn at(self, now_ns: u64) -> Self {
        let age_ns = i128::from(now_ns.saturating_sub(self.at_ns));
        let drift_ns = age_ns * DRIFT_PPM / 1_000_000;
        Self {
            lo_ns: self.lo_ns - drift_ns,
            hi_ns: self.hi_ns + drift_ns,
            at_ns: now_ns,
        }
    }
}

/// The four times of a round trip; the middle ones are the other host's.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Trip {
    pub(crate) asked_ns: u64,
    pub(crate) heard_ns: u64,
    pub(crate) sent_ns: u64,
    pub(crate) now_ns: u64,
}

/// What is known of another host's clock.
#[derive(Debug, Default)]
pub(crate) struct Offset {
    bounds: VecDeque<Bounds>,
    /// The offset in use, ns.
    used_ns: Option<i128>,
    /// Times that the offset in use was replaced.
    pub(crate) refits: u64,
    /// Times that a clock has stepped: bounds contradicted each other.
    pub(crate) steps: u64,
}

impl Offset {
    /// Takes note of a round trip; false if its times contradict themselves.
    pub(crate) fn note(&mut self, trip: Trip) -> bool {
        let took_ns = trip.now_ns.checked_sub(trip.asked_ns);
        let there_ns = trip.sent_ns.checked_sub(trip.heard_ns);
        let (Some(took_ns), Some(_)) = (took_ns, there_ns) else {
            return false;
        };
        let found = Bounds {
            lo_ns: i128::from(trip.asked_ns) - i128::from(trip.heard_ns),
            hi_ns: i128::from(trip.now_ns) - i128::from(trip.sent_ns),
            at_ns: trip.now_ns,
        };
        if took_ns > LONGEST_TRIP_NS || found.lo_ns > found.hi_ns {
            return false;
        }
        self.take(found);
        self.fit(trip.now_ns);
        true
    }

    fn take(&mut self, found: Bounds) {
        let known = self.intersection(found.at_ns);
        if known.is_some_and(|known| known.lo_ns > found.hi_ns || found.lo_ns > known.hi_ns) {
            self.bounds.clear();
            self.steps += 1;
        }
        // Of those that come faster, the better one is kept: the newest cannot be the worse of two for long.
        let recent = self.bounds.back().copied();
        let recent = recent.filter(|last| found.at_ns.saturating_sub(last.at_ns) < BOUNDS_EVERY_NS);
        if let Some(recent) = recent {
            self.bounds.pop_back();
            let recent = Bounds {
                at_ns: recent.at_ns,
                ..recent.at(found.at_ns)
            };
            self.bounds.push_back(Bounds {
                lo_ns: recent.lo_ns.max(found.lo_ns),
                hi_ns: recent.hi_ns.min(found.hi_ns),
                at_ns: recent.at_ns,
            });
            return;
        }
        if self.bounds.len() == MOST_BOUNDS {
            self.bounds.pop_front();
        }
        self.bounds.push_back(found);
    }

    fn fit(&mut self, now_ns: u64) {
        let Some(known) = self.intersection(now_ns) else {
            return;
        };
        let holds =
            |used_ns: i128| used_ns <= known.lo_ns && used_ns >= known.lo_ns - MOST_BELOW_NS;
        if !self.used_ns.is_some_and(holds) {
            self.refits += u64::from(self.used_ns.is_some());
            self.used_ns = Some(known.lo_ns - ROOM_NS);
        }
    }

    fn intersection(&self, now_ns: u64) -> Option<Bounds> {
        let all = self.bounds.iter().map(|bounds| bounds.at(now_ns));
        all.reduce(|one, other| Bounds {
            lo_ns: one.lo_ns.max(other.lo_ns),
            hi_ns: one.hi_ns.min(other.hi_ns),
            at_ns: now_ns,
        })
    }

    /// The offset in use, ns; `None` before the first round trip.
    pub(crate) const fn used_ns(&self) -> Option<i128> {
        self.used_ns
    }

    /// The most by which stamps may be made older than they are, ns.
    pub(crate) fn uncertainty_ns(&self, now_ns: u64) -> Option<u64> {
        let known = self.intersection(now_ns)?;
        u64::try_from(known.hi_ns - self.used_ns?).ok()
    }
}

/// A time of the other host as one of this host; 0 means that it is not known, and stays.
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

    /// Two clocks: ours is their time plus an offset that drifts.
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
        let heard_ns = asked_ns + there_ns;
        Trip {
            asked_ns,
            heard_ns: clocks.theirs(heard_ns),
            sent_ns: clocks.theirs(heard_ns + 50_000),
            now_ns: heard_ns + 50_000 + back_ns,
        }
    }

    proptest! {
        /// Whatever the ways take, and however asymmetric they are.
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
                prop_assert!(i128::from(uncertain_ns) <= i128::from(there_ns + back_ns) + 50_000 + MOST_BELOW_NS);
                now_ns += 40_000_000;
            }
            prop_assert_eq!(offset.steps, 0);
        }
    }

    #[test]
    fn distances_between_stamps_stay_while_the_bounds_allow_it() {
        let clocks = Clocks {
            offset_ns: 7_000_000,
            drift_ppm: 1,
        };
        let mut offset = Offset::default();
        for at in 0..3_000_u64 {
            // One way in ten is slow.
            let slow_ns = if at % 10 == 9 { 3_000_000 } else { 0 };
            let asked_ns = 1_000_000_000 + at * 100_000_000;
            offset.note(trip(
                &clocks,
                asked_ns,
                150_000 + slow_ns,
                120_000 + slow_ns,
            ));
        }
        assert_eq!((offset.refits, offset.steps), (0, 0), "in five minutes");
    }

    #[test]
    fn a_step_of_either_clock_is_noticed_and_measured_anew() {
        for step_ns in [-5_000_000_000_i128, -1_000_000, 1_000_000, 5_000_000_000] {
            let mut clocks = Clocks {
                offset_ns: 0,
                drift_ppm: 0,
            };
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
            assert!(
                (0..MOST_BELOW_NS + 300_000).contains(&late_ns),
                "{step_ns}: {late_ns}"
            );
        }
    }

    #[test]
    fn times_that_contradict_themselves_are_not_taken() {
        let mut offset = Offset::default();
        for (asked_ns, heard_ns, sent_ns, now_ns) in [
            // Answered before it was asked, or sent before it was taken.
            (9, 1, 1, 8),
            (1, 9, 8, 9),
            // The other host held it longer than it took.
            (10, 0, 100, 20),
            (1, 0, 0, 20_000_000_000),
        ] {
            let trip = Trip {
                asked_ns,
                heard_ns,
                sent_ns,
                now_ns,
            };
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
