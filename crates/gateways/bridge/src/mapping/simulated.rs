//! The simulated clock of ROS 2, which messages of `/clock` state, and its place on this host's
//! monotonic clock.
//!
//! The first message is placed at the time at which it came. From there on stamps rise by simulated
//! time: a robot that draws 1 W for a simulated second has drawn 1 J, at whatever rate the
//! simulation runs. The worker reads stamps alone for windows and energies, and times silence by
//! its own clock.

use joulebus_settings::FleetSettings;

/// Time by which a message of `/clock` may be older than the one before it: they may overtake each
/// other. A larger step back is a reset of the simulation.
const OVERTAKEN_NS: u64 = 100_000_000;
/// Time without a step after which the clock stands.
const STANDS_NS: u64 = 2_000_000_000;
/// Time after which a clock that never came is missed.
const MISSED_NS: u64 = 5_000_000_000;
const RATE_NS: u64 = 5_000_000_000;
/// Factor by which the rate differs from the reported one before it is reported again.
const OTHER_RATE: f64 = 1.5;
/// Maximum distance of a message's stamp from the clock. In a fast simulation, clock and message
/// come far apart.
const NEAR_NS: u64 = 10_000_000_000;

/// Limits of the fleet's settings on a simulated clock.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Allowed {
    /// Step ahead beyond which a robot's samples would be refused.
    jump_ns: u64,
    /// Pause of stamps at a reset: the worker does not bridge it.
    pause_ns: u64,
    /// Rates at which robots seem silent, and at which samples exceed what a tick takes.
    rates: (f64, f64),
}

impl Allowed {
    pub(crate) fn new(settings: &FleetSettings, tick_period_ns: u64) -> Self {
        let platforms = settings.platforms.iter();
        let stale_ns =
            platforms.clone().map(|platform| platform.stale_after_ns).max().unwrap_or_default();
        let least = platforms
            .clone()
            .map(|platform| platform.period_ns as f64 / platform.stale_after_ns as f64);
        let most = f64::from(settings.intake.max_samples_per_tick) / tick_period_ns as f64;
        let most = platforms.map(|platform| platform.period_ns as f64 * most);
        let jump_ns = settings.intake.max_jump_ns;
        Self {
            jump_ns,
            pause_ns: (stale_ns + 1_000_000_000).min(jump_ns),
            rates: (least.fold(0.0, f64::max), most.fold(f64::INFINITY, f64::min)),
        }
    }
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum ClockState {
    Missing,
    /// The simulation is paused, or has ended.
    Stands,
    Runs,
}

/// A clock that `/clock` sets.
#[derive(Debug, Clone)]
pub(crate) struct SimulatedClock {
    allowed: Allowed,
    began_ns: u64,
    now: Option<Now>,
    reported: Option<ClockState>,
    /// The newest step that was no running, from and to, ns.
    reset_ns: Option<(u64, u64)>,
    reported_rate: f64,
}

#[derive(Debug, Clone, Copy)]
struct Now {
    sim_ns: u64,
    /// Offset from a simulated time to its stamp, ns.
    offset_ns: i128,
    /// The host's time of the newest step.
    moved_ns: u64,
    /// The host's and the simulated time from which the rate is measured.
    since_ns: (u64, u64),
}

impl Now {
    const fn stamp_ns(&self, sim_ns: u64) -> u64 {
        (sim_ns as i128 + self.offset_ns) as u64
    }
}

impl SimulatedClock {
    /// A clock at `host_ns` (monotonic), before its first message.
    pub(crate) const fn new(allowed: Allowed, host_ns: u64) -> Self {
        Self {
            allowed,
            began_ns: host_ns,
            now: None,
            reported: None,
            reset_ns: None,
            reported_rate: 1.0,
        }
    }

    /// Takes a message of `/clock` that came at `host_ns` (monotonic). Returns whether the
    /// simulation has begun anew, so that what was observed before does not hold.
    pub(crate) fn take(&mut self, sim_ns: u64, host_ns: u64) -> bool {
        let Some(now) = &mut self.now else {
            let offset_ns = host_ns as i128 - sim_ns as i128;
            let since_ns = (host_ns, sim_ns);
            self.now = Some(Now { sim_ns, offset_ns, moved_ns: host_ns, since_ns });
            return false;
        };
        let back_ns = now.sim_ns.saturating_sub(sim_ns);
        if back_ns > 0 && back_ns < OVERTAKEN_NS || sim_ns == now.sim_ns {
            return false;
        }
        let is_reset = back_ns > 0 || sim_ns - now.sim_ns > self.allowed.jump_ns;
        if is_reset {
            self.reset_ns = Some((now.sim_ns, sim_ns));
            let next_ns = now.stamp_ns(now.sim_ns) + self.allowed.pause_ns;
            now.offset_ns = next_ns as i128 - sim_ns as i128;
        }
        if is_reset || host_ns.saturating_sub(now.moved_ns) > STANDS_NS {
            now.since_ns = (host_ns, sim_ns);
        }
        (now.sim_ns, now.moved_ns) = (sim_ns, host_ns);
        is_reset
    }

    /// The present as a stamp and in simulated time, ns. `None` before the first message.
    pub(crate) fn now_ns(&self) -> Option<(u64, u64)> {
        self.now.map(|now| (now.stamp_ns(now.sim_ns), now.sim_ns))
    }

    /// The stamp of a message with this simulated time. `None` if it is not a time of this clock:
    /// from before a reset, or by a wall clock.
    pub(crate) fn stamp_ns(&self, sim_ns: u64) -> Option<u64> {
        let now = self.now?;
        let is_near = sim_ns.abs_diff(now.sim_ns) <= NEAR_NS;
        is_near.then(|| now.stamp_ns(sim_ns.min(now.sim_ns)))
    }

    pub(crate) fn state(&self, host_ns: u64) -> ClockState {
        match self.now {
            None => ClockState::Missing,
            Some(now) if host_ns.saturating_sub(now.moved_ns) > STANDS_NS => ClockState::Stands,
            Some(_) => ClockState::Runs,
        }
    }

    /// Describes a change of the clock since the last call, at `host_ns` (monotonic).
    pub(crate) fn news(&mut self, host_ns: u64) -> Option<String> {
        if let Some((from_ns, to_ns)) = self.reset_ns.take() {
            let (from_s, to_s) = (seconds(from_ns), seconds(to_ns));
            return Some(format!(
                "the simulated time went from {from_s} s to {to_s} s: what robots said before is dropped"
            ));
        }
        let state = self.state(host_ns);
        let is_early =
            state == ClockState::Missing && host_ns.saturating_sub(self.began_ns) < MISSED_NS;
        if self.reported != Some(state) && !is_early {
            self.reported = Some(state);
            let now_s = seconds(self.now.map_or(0, |now| now.sim_ns));
            return Some(match state {
                ClockState::Missing => format!(
                    "no message of /clock in {} s, and without simulated time no samples: start the simulation, or \
                     remove ros2.use_sim_time",
                    seconds(MISSED_NS)
                ),
                ClockState::Stands => {
                    format!("the simulated time stands at {now_s} s: no samples until it goes on")
                }
                ClockState::Runs => format!("the simulated time goes on at {now_s} s"),
            });
        }
        self.rate_news(host_ns)
    }

    /// Measures the rate, and reports what is new about it.
    fn rate_news(&mut self, host_ns: u64) -> Option<String> {
        let now = self.now.as_mut()?;
        let (host_since_ns, sim_since_ns) = now.since_ns;
        // Until the newest step: a clock that stands has no rate.
        let passed_ns = now.moved_ns.saturating_sub(host_since_ns);
        if passed_ns < RATE_NS || host_ns.saturating_sub(now.moved_ns) > STANDS_NS {
            return None;
        }
        let rate = (now.sim_ns - sim_since_ns) as f64 / passed_ns as f64;
        now.since_ns = (now.moved_ns, now.sim_ns);
        let change = rate / self.reported_rate;
        if (OTHER_RATE.recip()..=OTHER_RATE).contains(&change) {
            return None;
        }
        self.reported_rate = rate;
        let (least, most) = self.allowed.rates;
        let remedy = if rate > most {
            format!(
                ". Above {most:.3} a tick of the worker does not take all samples: raise intake.max_samples_per_tick"
            )
        } else if rate < least {
            format!(". Below {least:.3} robots seem silent: raise platform.stale_after_s")
        } else {
            String::new()
        };
        Some(format!("the simulated time runs at {rate:.3} times this host's{remedy}"))
    }
}

fn seconds(ns: u64) -> f64 {
    (ns / 1_000_000) as f64 * 1e-3
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const S: u64 = 1_000_000_000;
    const ALLOWED: Allowed = Allowed { jump_ns: 60 * S, pause_ns: 3 * S, rates: (0.05, 8.0) };

    fn clock() -> SimulatedClock {
        SimulatedClock::new(ALLOWED, 100 * S)
    }

    /// Runs for `host_s` at `rate`, by 50 messages a second, and returns the reports.
    fn run(clock: &mut SimulatedClock, host_ns: &mut u64, host_s: u64, rate: f64) -> Vec<String> {
        let from_ns = clock.now_ns().map_or(0, |(_, sim_ns)| sim_ns);
        let mut reports = Vec::new();
        for step in 1..=50 * host_s {
            *host_ns += S / 50;
            clock.take(from_ns + (step as f64 * 2e7 * rate) as u64, *host_ns);
            reports.extend(clock.news(*host_ns));
        }
        reports
    }

    #[test]
    fn stamps_pass_as_the_simulation_does_at_any_rate() {
        for (rate, expected) in [
            (1.0, vec![]),
            (0.1, vec!["runs at 0.100 times this host's"]),
            (10.0, vec!["runs at 10.000 times this host's. Above 8.000 a tick"]),
            (0.01, vec!["runs at 0.010 times this host's. Below 0.050 robots seem silent"]),
        ] {
            let (mut clock, mut host_ns) = (clock(), 100 * S);
            clock.take(0, host_ns);
            let reports = run(&mut clock, &mut host_ns, 20, rate);
            let (stamp_ns, sim_ns) = clock.now_ns().unwrap();
            assert_eq!(stamp_ns, 100 * S + sim_ns, "{rate}");
            assert_eq!(sim_ns, (20.0 * rate * 1e9) as u64);
            assert!(reports[0].contains("goes on at 0"), "{reports:?}");
            assert_eq!(reports.len(), 1 + expected.len(), "{reports:?}");
            assert!(
                reports[1..].iter().zip(expected).all(|(line, part)| line.contains(part)),
                "{reports:?}"
            );
        }
    }

    #[test]
    fn a_pause_passes_no_time_and_each_change_is_reported_once() {
        let (mut clock, mut host_ns) = (clock(), 100 * S);
        assert_eq!((clock.news(102 * S), clock.now_ns()), (None, None));
        assert!(clock.news(105 * S).unwrap().contains("no message of /clock in 5 s"));
        assert_eq!((clock.news(200 * S), clock.state(200 * S)), (None, ClockState::Missing));
        clock.take(7 * S, host_ns);
        run(&mut clock, &mut host_ns, 1, 1.0);
        // A paused simulation may repeat its time.
        let paused_ns = host_ns;
        for step in 1..=100 {
            host_ns = paused_ns + step * S;
            assert!(!clock.take(8 * S, host_ns));
            let reports = clock.news(host_ns);
            assert_eq!(reports.is_some(), step == 3, "{step} {reports:?}");
        }
        assert_eq!(clock.state(host_ns), ClockState::Stands);
        assert_eq!(clock.now_ns(), Some((101 * S, 8 * S)));
        let reports = run(&mut clock, &mut host_ns, 10, 1.0);
        assert_eq!(reports.len(), 1, "{reports:?}");
        assert_eq!(clock.now_ns(), Some((111 * S, 18 * S)), "no time has passed in the pause");
    }

    #[test]
    fn a_reset_leaves_a_pause_that_the_worker_does_not_bridge() {
        for (to_ns, is_reset, stamp_ns) in [
            (0, true, 153 * S),
            (49 * S, true, 153 * S),
            (50 * S - 1, false, 150 * S),
            (50 * S, false, 150 * S),
            (110 * S, false, 210 * S),
            (110 * S + 1, true, 153 * S),
            (u64::MAX, true, 153 * S),
        ] {
            let mut clock = clock();
            clock.take(0, 100 * S);
            clock.take(50 * S, 150 * S);
            clock.news(150 * S);
            assert_eq!(clock.take(to_ns, 151 * S), is_reset, "{to_ns}");
            assert_eq!(clock.now_ns().unwrap().0, stamp_ns, "{to_ns}");
            let reports = clock.news(151 * S).unwrap_or_default();
            assert_eq!(reports.contains("went from 50 s to"), is_reset, "{reports}");
        }
    }

    #[test]
    fn stamps_of_messages_are_times_of_the_clock() {
        let mut clock = clock();
        assert_eq!(clock.stamp_ns(50 * S), None, "no clock yet");
        clock.take(50 * S, 100 * S);
        for (sim_ns, stamp_ns) in [
            (50 * S, Some(100 * S)),
            (49 * S, Some(99 * S)),
            (40 * S, Some(90 * S)),
            (40 * S - 1, None),
            (60 * S, Some(100 * S)),
            (60 * S + 1, None),
            (1_700_000_000 * S, None),
            (u64::MAX, None),
        ] {
            assert_eq!(clock.stamp_ns(sim_ns), stamp_ns, "{sim_ns}");
        }
    }

    proptest! {
        #[test]
        fn stamps_never_fall_and_no_step_exceeds_what_the_worker_takes(
            steps in proptest::collection::vec((0_u64..200 * S, 0_u64..5 * S), 1..50),
        ) {
            let (mut clock, mut host_ns, mut last_ns) = (clock(), 100 * S, None);
            for (sim_ns, passed_ns) in steps {
                host_ns += passed_ns;
                clock.take(sim_ns, host_ns);
                clock.news(host_ns);
                let (stamp_ns, _) = clock.now_ns().unwrap();
                if let Some(last_ns) = last_ns {
                    prop_assert!((last_ns..=last_ns + ALLOWED.jump_ns).contains(&stamp_ns));
                }
                last_ns = Some(stamp_ns);
            }
        }
    }
}
