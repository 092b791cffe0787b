//! Every kind of refusal: counted once, named, and shown in the robot's quality.

use joulebus_fleet::Fleet;
use joulebus_testkit_fleets::{
    MS, PERIOD_NS, SLOW_NS, Source, diagnostic, fleet, forecast, healthy, place, quality,
};
use joulebus_wire::{
    Alarm, DropReason, InvalidReason, Quality, Sample, SampleHeader, forecast_flag,
    plan_state_flag, sample_flag,
};

const ROBOT: u32 = 7;

/// A fleet of two in which robot 7 has sent eight samples, the last one stamped `NOW`.
fn warm() -> (Fleet, Source) {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 5));
    for step in 0..8 {
        let stamp_ns = NOW - (7 - step) * PERIOD_NS;
        let sample = healthy(ROBOT, step, stamp_ns, PERIOD_NS);
        source.tick(&mut fleet, &[sample], stamp_ns);
    }
    assert_eq!(quality(&fleet, ROBOT), Quality::Held);
    (fleet, source)
}

const NOW: u64 = 10_000 * MS;
const NEXT: u64 = NOW + PERIOD_NS;

fn good() -> Sample {
    healthy(ROBOT, 8, NEXT, PERIOD_NS)
}

type Spoil = fn(&mut Sample);
type Faults = (DropReason, Option<InvalidReason>, &'static [(&'static str, Spoil)]);

/// Faults of one sample of a known robot, by the reason for which it is refused and what its
/// forecast shows.
const SAMPLES: [Faults; 9] = [
    (
        DropReason::NotFinite,
        Some(InvalidReason::NotFinite),
        &[
            ("NaN power", |s| s.power_w = f32::NAN),
            ("infinite power", |s| s.power_w = f32::INFINITY),
            ("NaN velocity", |s| s.v_mps = f32::NAN),
            ("NaN turn rate", |s| s.omega_radps = f32::NAN),
            ("NaN voltage", |s| *s = s.battery(f32::NAN, 0.5)),
            ("infinite current", |s| *s = s.battery(7.4, -f32::INFINITY)),
            ("NaN state of charge", |s| *s = s.state_of_charge(f32::NAN)),
        ],
    ),
    (
        DropReason::PowerOutOfRange,
        Some(InvalidReason::PowerOutOfRange),
        &[
            ("power below the platform's", |s| s.power_w = -0.001),
            ("power above the platform's", |s| s.power_w = 20.001),
            ("huge power", |s| s.power_w = f32::MAX),
        ],
    ),
    (
        DropReason::CommandOutOfRange,
        Some(InvalidReason::CommandOutOfRange),
        &[
            ("too fast", |s| s.v_mps = 0.501),
            ("reversing too fast", |s| s.v_mps = -0.501),
            ("turning too fast", |s| s.omega_radps = -3.001),
        ],
    ),
    (
        DropReason::BadFlags,
        Some(InvalidReason::BadFlags),
        &[
            ("unknown flag", |s| s.flags |= 1 << 15),
            ("full off the charger", |s| s.flags |= sample_flag::FULL),
        ],
    ),
    (
        DropReason::BatteryOutOfRange,
        Some(InvalidReason::BatteryOutOfRange),
        &[
            ("more than full", |s| *s = s.state_of_charge(1.06)),
            ("gains by returning", |s| *s = s.return_energy(-1.0)),
        ],
    ),
    (
        DropReason::BadTime,
        Some(InvalidReason::BadTime),
        &[
            ("of the future", |s| s.measured_ns = s.stamp_ns + 1),
            ("stands still", |s| (s.stamp_ns, s.measured_ns) = (NOW, NOW)),
            ("goes back", |s| (s.stamp_ns, s.measured_ns) = (NOW - 1, 1)),
            ("stamp jumps", |s| s.stamp_ns = NOW + 5_000 * MS + 1),
        ],
    ),
    (DropReason::Duplicate, None, &[("sent twice", |s| s.seq = 7)]),
    (DropReason::OutOfOrder, None, &[("overtaken", |s| s.seq = 6)]),
    (DropReason::UnknownRobot, None, &[("of no platform", |s| s.robot = 300)]),
];

#[test]
fn each_bad_sample_is_counted_once_named_and_shown_and_the_next_good_one_recovers() {
    let cases = SAMPLES.iter().flat_map(|(reason, invalid, faults)| {
        faults.iter().map(move |fault| (*reason, *invalid, *fault))
    });
    for (reason, invalid, (what, spoil)) in cases {
        let (mut fleet, mut source) = warm();
        let (before, accepted) = (quality(&fleet, ROBOT), fleet.accepted());
        let mut sample = good();
        spoil(&mut sample);
        source.tick(&mut fleet, &[sample], NEXT);
        assert_refused(&fleet, what, sample.robot, reason, 1);
        assert_eq!(fleet.accepted(), accepted, "{what}");
        let expected = invalid.map_or(before, Quality::Invalid);
        assert_eq!(quality(&fleet, ROBOT), expected, "{what}");
        let shown = forecast(&fleet, ROBOT);
        assert_eq!(shown.expected_w().is_some(), invalid.is_none(), "{what}");
        assert_eq!(diagnostic(&fleet, ROBOT).refused, u64::from(invalid.is_some()), "{what}");

        let later = NEXT + PERIOD_NS;
        source.tick(&mut fleet, &[healthy(ROBOT, 9, later, PERIOD_NS)], later);
        assert_eq!(quality(&fleet, ROBOT), Quality::Fresh, "{what}: no recovery");
        assert_eq!(fleet.accepted(), accepted + 1, "{what}");
        assert_eq!(fleet.drops().total(), 1, "{what}");
    }
}

/// Checks that only this reason is counted, with robot and source named.
fn assert_refused(fleet: &Fleet, what: &str, robot: u32, reason: DropReason, count: u32) {
    let drops: Vec<_> = fleet.drops().iter().collect();
    assert_eq!(drops, [(reason, u64::from(count))], "{what}");
    let named: Vec<_> = fleet
        .refusals()
        .into_iter()
        .filter(|refusal| refusal.reason != 0)
        .map(|refusal| (refusal.robot, refusal.reason(), refusal.count))
        .collect();
    assert_eq!(named, [(robot, Some(reason), count)], "{what}");
}

type FrameCase = (&'static str, fn(&mut SampleHeader), DropReason, bool);

/// Faults of a whole frame; the last column: whether its robot ids are reliable.
const FRAMES: [FrameCase; 5] = [
    ("schema", |h| h.schema += 1, DropReason::Schema, false),
    ("old run", |h| h.source_epoch = 4, DropReason::OldEpoch, true),
    ("again", |h| h.samples_before = 0, DropReason::Duplicate, true),
    ("other", |h| h.source_id = 2, DropReason::ForeignSource, true),
    (
        "a newer run of another source",
        |h| (h.source_id, h.source_epoch) = (2, 99),
        DropReason::ForeignSource,
        true,
    ),
];

#[test]
fn each_bad_frame_is_counted_and_affects_no_robot() {
    for (what, spoil, reason, named) in FRAMES {
        let (mut fleet, mut source) = warm();
        let mut header = source.frame(1);
        spoil(&mut header);
        if header.source_id == 2 {
            header.samples_before = 0;
        }
        fleet.take(&header, &[good()], NOW + MS);
        fleet.tick(NOW + MS, false);
        assert_eq!(quality(&fleet, ROBOT), Quality::Held, "{what}");
        if named {
            assert_refused(&fleet, what, ROBOT, reason, 1);
            assert_eq!(fleet.refusals()[0].pid, header.pid, "{what}");
        } else {
            assert_eq!(fleet.drops().get(reason), 1, "{what}");
            assert_eq!(fleet.drops().total(), 1, "{what}");
        }
    }
}

#[test]
fn a_robot_whose_source_has_ended_goes_to_the_first_that_publishes_for_it() {
    let (mut fleet, mut source) = warm();
    let mut heir = Source::new(2, 1);
    let sample = |at: u64| healthy(ROBOT, at, NOW + at * PERIOD_NS, PERIOD_NS);
    heir.tick(&mut fleet, &[sample(1)], NOW + PERIOD_NS);
    assert_eq!(fleet.drops().get(DropReason::ForeignSource), 1);
    // Neither an earlier run's end nor another source's frees it.
    let run = source.header.source_epoch;
    for (id, epoch) in [(1, run - 1), (1, run + 1), (2, 1), (9, run)] {
        fleet.end_source(id, epoch);
        heir.tick(&mut fleet, &[sample(2)], NOW + 2 * PERIOD_NS);
    }
    assert_eq!(fleet.drops().get(DropReason::ForeignSource), 5);
    let accepted = fleet.accepted();
    fleet.end_source(1, run);
    heir.tick(&mut fleet, &[sample(3)], NOW + 3 * PERIOD_NS);
    assert_eq!(fleet.accepted(), accepted + 1);
    // The first comes too late, and its return takes nothing back.
    source.tick(&mut fleet, &[sample(4)], NOW + 4 * PERIOD_NS);
    assert_eq!(fleet.drops().get(DropReason::ForeignSource), 6);
    heir.tick(&mut fleet, &[sample(5)], NOW + 5 * PERIOD_NS);
    assert_eq!((fleet.accepted(), fleet.drops().total()), (accepted + 2, 6));
}

#[test]
fn lost_samples_are_counted_from_the_headers() {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 5));
    source.frame(30);
    source.send(&mut fleet, &[good()], NEXT);
    assert_eq!(fleet.drops().iter().collect::<Vec<_>>(), [(DropReason::BeforeJoin, 30)]);
    source.frame(4);
    let later = NEXT + PERIOD_NS;
    source.send(&mut fleet, &[healthy(ROBOT, 9, later, PERIOD_NS)], later);
    let drops: Vec<_> = fleet.drops().iter().collect();
    assert_eq!(drops, [(DropReason::Overflow, 4), (DropReason::BeforeJoin, 30)]);
    assert_eq!(fleet.accepted(), 2);
}

#[test]
fn a_source_beyond_the_maximum_is_counted_and_named() {
    let (mut fleet, _) = warm();
    for id in 2..5 {
        Source::new(id, 1).send(&mut fleet, &[], NEXT);
    }
    let mut extra = Source::new(5, 1);
    extra.send(&mut fleet, &[healthy(8, 0, NEXT, PERIOD_NS)], NEXT);
    assert_refused(&fleet, "a source beyond the maximum", 8, DropReason::TooManySources, 1);
    assert_eq!(fleet.refusals()[0].pid, extra.header.pid);
    assert!(place(&fleet, 8).is_none());
}

#[test]
fn a_robot_beyond_the_capacity_is_counted_and_named() {
    let (mut fleet, mut source) = warm();
    let robots = [8, 9, 9].map(|robot| healthy(robot, 0, NEXT, PERIOD_NS));
    source.send(&mut fleet, &robots, NEXT);
    assert_refused(&fleet, "beyond the capacity", 9, DropReason::OverCapacity, 2);
    assert_eq!(fleet.len(), 2);
}

#[test]
fn a_tick_takes_a_limited_number_of_samples_per_robot_and_the_next_tick_continues() {
    let (mut fleet, mut source) = warm();
    let burst: Vec<Sample> =
        (8..14).map(|step| healthy(ROBOT, step, NOW + (step - 7) * PERIOD_NS, PERIOD_NS)).collect();
    let now_ns = NOW + 6 * PERIOD_NS;
    source.tick(&mut fleet, &burst, now_ns);
    assert_refused(&fleet, "a burst", ROBOT, DropReason::Backlog, 2);
    assert_eq!(forecast(&fleet, ROBOT).sample_seq, 11);
    let later = NOW + 7 * PERIOD_NS;
    source.tick(&mut fleet, &[healthy(ROBOT, 14, later, PERIOD_NS)], later);
    assert_eq!(forecast(&fleet, ROBOT).sample_seq, 14);
    assert_eq!(fleet.drops().total(), 2);
}

/// Fails if a reason is added that no test here produces.
#[test]
fn every_reason_is_tested() {
    let elsewhere = [
        DropReason::Overflow,
        DropReason::BeforeJoin,
        DropReason::TooManySources,
        DropReason::OverCapacity,
        DropReason::Backlog,
    ];
    for reason in DropReason::ALL {
        let in_tables = SAMPLES.iter().any(|case| case.0 == reason)
            || FRAMES.iter().any(|case| case.2 == reason);
        assert!(in_tables != elsewhere.contains(&reason), "{reason:?}");
    }
}

#[test]
fn a_new_run_of_the_source_takes_over_even_when_its_first_sample_is_refused() {
    for (what, stamp_ns) in [("clock continues", NOW + 2 * PERIOD_NS), ("clock restarts", 40 * MS)]
    {
        let (mut fleet, _) = warm();
        let mut source = Source::new(1, 6);
        let mut first = healthy(ROBOT, 0, stamp_ns, PERIOD_NS);
        first.power_w = f32::NAN;
        source.tick(&mut fleet, &[first], NEXT);
        let invalid = Quality::Invalid(InvalidReason::NotFinite);
        assert_eq!(quality(&fleet, ROBOT), invalid, "{what}");
        for step in 1..6 {
            let sample = healthy(ROBOT, step, stamp_ns + step * PERIOD_NS, PERIOD_NS);
            source.tick(&mut fleet, &[sample], NEXT + step * PERIOD_NS);
        }
        assert_eq!(fleet.drops().total(), 1, "{what}: {:?}", fleet.drops());
        assert!(forecast(&fleet, ROBOT).expected_w().is_some(), "{what}");
        assert_eq!(forecast(&fleet, ROBOT).source_epoch, 6, "{what}");
    }
}

#[test]
fn missing_columns_are_missing_and_not_zero() {
    let cases = [
        (ROBOT, PERIOD_NS, false, "the model needs velocities"),
        (107, SLOW_NS, true, "the model reads powers alone"),
        (207, PERIOD_NS, true, "persistence"),
    ];
    for (robot, period_ns, forecasts, what) in cases {
        let (mut fleet, mut source) = (fleet(2), Source::new(1, 1));
        for step in 0..12 {
            let now_ns = NOW + step * period_ns;
            let full = healthy(robot, step, now_ns, period_ns);
            let bare = Sample::new(robot, step, now_ns)
                .reading(full.power_w, full.measured_ns)
                .with(full.flags & sample_flag::HELD);
            source.tick(&mut fleet, &[bare], now_ns);
            let shown = forecast(&fleet, robot);
            let expected = match (step, forecasts) {
                (0..4, _) => Quality::Warmup { have: step as u16 + 1 },
                (_, false) => Quality::Invalid(InvalidReason::NoCommand),
                (_, true) if step % 3 == 0 => Quality::Fresh,
                (_, true) => Quality::Held,
            };
            assert_eq!(shown.quality(), expected, "{what}, step {step}");
            let known = forecasts && step >= 4;
            assert_eq!(shown.expected_w().is_some(), known, "{what}, step {step}");
            assert_eq!(shown.power_w.is_nan(), !known, "{what}, step {step}");
            assert_ne!(shown.flags & forecast_flag::READING, 0, "{what}, step {step}");
        }
        let scored = diagnostic(&fleet, robot).scored;
        assert_eq!(scored, if forecasts { 7 } else { 0 }, "{what}");
        assert_eq!(fleet.drops().total(), 0, "{what}");
    }
}

#[test]
fn without_readings_there_is_no_forecast_and_the_reason_is_shown() {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 1));
    for step in 0..12 {
        let now_ns = NOW + step * PERIOD_NS;
        let sample = Sample::new(ROBOT, step, now_ns).command(0.1, 0.0);
        source.tick(&mut fleet, &[sample], now_ns);
        assert_eq!(quality(&fleet, ROBOT), Quality::Invalid(InvalidReason::NoReading));
        assert_eq!(forecast(&fleet, ROBOT).flags & forecast_flag::READING, 0);
    }
}

#[test]
fn silence_is_open_loop_then_stale_and_the_robot_recovers() {
    let (mut fleet, mut source) = warm();
    for missing in 1..30u16 {
        let now_ns = NOW + (u64::from(missing) + 1) * PERIOD_NS;
        fleet.tick(now_ns, false);
        let stale = now_ns - NOW > 30 * PERIOD_NS;
        let expected = if stale {
            Quality::Invalid(InvalidReason::Stale)
        } else {
            Quality::OpenLoop { steps: missing }
        };
        assert_eq!(quality(&fleet, ROBOT), expected);
        assert_eq!(forecast(&fleet, ROBOT).expected_w().is_some(), !stale);
    }
    let stale = NOW + 31 * PERIOD_NS + 1;
    fleet.tick(stale, false);
    assert_eq!(quality(&fleet, ROBOT), Quality::Invalid(InvalidReason::Stale));
    assert!(diagnostic(&fleet, ROBOT).alarms().has(Alarm::NoData));
    let back = NOW + 40 * PERIOD_NS;
    source.tick(&mut fleet, &[healthy(ROBOT, 9, back, PERIOD_NS)], back);
    assert_eq!(quality(&fleet, ROBOT), Quality::Warmup { have: 1 });
    assert!(!diagnostic(&fleet, ROBOT).alarms().has(Alarm::NoData));
}

/// What a planner learns of alarms is what operators see, in the same tick.
#[test]
fn alarms_on_the_readings_are_in_the_plan_state_of_the_same_tick() {
    const OF_TICK: [(Alarm, u32); 5] = [
        (Alarm::NoData, plan_state_flag::ALARM_NO_DATA),
        (Alarm::OutOfRange, plan_state_flag::ALARM_OUT_OF_RANGE),
        (Alarm::StuckSensor, plan_state_flag::ALARM_STUCK_SENSOR),
        (Alarm::HeldTooLong, plan_state_flag::ALARM_HELD_TOO_LONG),
        (Alarm::SocImplausible, plan_state_flag::ALARM_SOC_IMPLAUSIBLE),
    ];
    type Send = fn(u64, u64) -> Option<Sample>;
    let sources: [(Alarm, Send); 5] = [
        (Alarm::NoData, |_, _| None),
        (Alarm::OutOfRange, |step, now_ns| {
            Some(Sample { power_w: f32::NAN, ..healthy(ROBOT, step, now_ns, PERIOD_NS) })
        }),
        (Alarm::StuckSensor, |step, now_ns| {
            Some(Sample::new(ROBOT, step, now_ns).command(0.1, 0.0).reading(3.6, now_ns))
        }),
        (Alarm::HeldTooLong, |step, now_ns| {
            let held = Sample::new(ROBOT, step, now_ns).command(0.1, 0.0).reading(3.6, NOW);
            Some(held.with(sample_flag::HELD))
        }),
        (Alarm::SocImplausible, |step, now_ns| {
            let soc = if step.is_multiple_of(2) { 0.9 } else { 0.2 };
            Some(healthy(ROBOT, step, now_ns, PERIOD_NS).state_of_charge(soc))
        }),
    ];
    for (alarm, send) in sources {
        let (mut fleet, mut source) = warm();
        let (mut raised, mut cleared) = (false, false);
        for step in 8..2_000 {
            let now_ns = NOW + (step - 7) * PERIOD_NS;
            // Healthy again at last.
            let again = healthy(ROBOT, step, now_ns, PERIOD_NS).state_of_charge(0.5);
            let sample = if raised { Some(again) } else { send(step, now_ns) };
            source.tick(&mut fleet, sample.as_slice(), now_ns);
            let alarms = diagnostic(&fleet, ROBOT).alarms();
            let flags = fleet.plan_state(place(&fleet, ROBOT).expect("it is there")).flags;
            for (of_tick, bit) in OF_TICK {
                assert_eq!(flags & bit != 0, alarms.has(of_tick), "{of_tick:?}, step {step}");
            }
            raised |= alarms.has(alarm);
            cleared = raised && !alarms.has(alarm);
        }
        assert!(raised, "{alarm:?} was never raised");
        assert!(cleared || alarm == Alarm::SocImplausible, "{alarm:?} stays");
    }
}

#[test]
fn what_its_source_finds_implausible_is_in_the_robots_plan_state_until_the_source_does_not() {
    let (mut fleet, mut source) = warm();
    for (step, doubted) in (8..).zip([true, true, false, true, false]) {
        let now_ns = NOW + (step - 7) * PERIOD_NS;
        let mut sample = healthy(ROBOT, step, now_ns, PERIOD_NS);
        sample.flags |= if doubted { sample_flag::IMPLAUSIBLE } else { 0 };
        source.tick(&mut fleet, &[sample], now_ns);
        let found = fleet.plan_state(place(&fleet, ROBOT).expect("it is there")).flags;
        assert_eq!(found & plan_state_flag::ALARM_IMPLAUSIBLE != 0, doubted, "step {step}");
    }
}

#[test]
fn a_robot_that_joins_with_a_held_reading_is_not_stuck() {
    let (mut fleet, mut source) = (fleet(2), Source::new(1, 1));
    for step in 0..25 {
        let now_ns = NOW + step * PERIOD_NS;
        let sample = Sample::new(ROBOT, step, now_ns)
            .command(0.1, 0.0)
            .reading(3.6, NOW.max(now_ns - 300 * MS))
            .with(sample_flag::HELD);
        source.tick(&mut fleet, &[sample], now_ns);
        let alarms = diagnostic(&fleet, ROBOT).alarms();
        assert!(!alarms.has(Alarm::StuckSensor), "step {step}");
    }
}

/// The open-loop limit counts from the last reading, not from the last sample.
#[test]
fn missing_readings_and_silence_are_bridged_for_at_most_stale_after() {
    for (missing, expected) in
        [(25, Quality::Fresh), (26, Quality::Warmup { have: 1 }), (29, Quality::Warmup { have: 1 })]
    {
        let (mut fleet, mut source) = warm();
        for step in 8..13 {
            let now_ns = NOW + (step - 7) * PERIOD_NS;
            let mut sample = healthy(ROBOT, step, now_ns, PERIOD_NS);
            sample.flags &= !(sample_flag::POWER | sample_flag::HELD);
            source.tick(&mut fleet, &[sample], now_ns);
            let steps = step as u16 - 7;
            assert_eq!(quality(&fleet, ROBOT), Quality::OpenLoop { steps });
        }
        let now_ns = NOW + (5 + missing + 1) * PERIOD_NS;
        let sample = healthy(ROBOT, 15, now_ns, PERIOD_NS);
        source.tick(&mut fleet, &[sample], now_ns);
        assert_eq!(quality(&fleet, ROBOT), expected, "{missing} missing");
    }
}

#[test]
fn a_refused_sample_does_not_delay_the_others_to_the_deadline() {
    let (mut fleet, mut source) = warm();
    assert!(!fleet.complete(NEXT), "robot 7 is due and has not reported");
    let mut poisoned = good();
    poisoned.power_w = f32::NAN;
    source.send(&mut fleet, &[poisoned], NEXT);
    assert!(fleet.complete(NEXT));
    fleet.tick(NEXT, false);
    assert!(!fleet.complete(NEXT + PERIOD_NS), "the next tick waits for it again");
}

#[test]
fn the_time_between_two_recordings_is_not_metered() {
    let (mut fleet, mut source) = warm();
    let before = fleet.ledger(ROBOT).unwrap();
    source.tick(&mut fleet, &[good().with(sample_flag::DISCONTINUITY)], NEXT);
    let after = fleet.ledger(ROBOT).unwrap();
    assert_eq!(after.drawn_uj, before.drawn_uj);
    assert_eq!(after.unmetered_ns, before.unmetered_ns + PERIOD_NS);
}
