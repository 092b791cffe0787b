//! Rows 6, 7, 8, 9 and 21: an invalid sample or source does not affect other robots.

use std::collections::BTreeMap;

use joulebus_tests::{
    Answers, Arena, Dice, Forge, FrameLine, FrameRead, Planner, ReaderLine, Setup, accounted,
    drawn_exact, figure, names, sample, script,
};
use joulebus_wire::{DropReason, Forecasts, Quality, Sample};

const ROBOTS: [u32; 6] = [0, 1, 2, 3, 4, 5];

/// Plays `frames` to a separate fleet, each once the previous one is answered; returns the first
/// answers.
fn clean_run(setup: &Setup, frames: &[Vec<Sample>]) -> Answers {
    let arena = Arena::new(setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    planner.play(&mut source, frames);
    let answers = planner.answers(|_| true);
    source.leave();
    planner.leave();
    worker.stop();
    answers
}

/// Checks that every answer equals that of the clean run; returns the number of comparisons.
/// Provisional forecasts of a busy machine are not among the answers, hence the fraction.
fn assert_same(clean: &Answers, found: &Answers, of: usize) -> usize {
    let mut compared = 0;
    for (key, answer) in found {
        // Nor frames that the clean run's planner missed while it waited for a CPU.
        let Some(expected) = clean.get(key) else {
            continue;
        };
        assert_eq!(expected, answer, "robot {} sample {}", key.0, key.1);
        compared += 1;
    }
    assert!(compared * 10 >= of * 9, "{compared} answers of {of}");
    compared
}

type Spoil = fn(&mut Sample);

/// Invalid values of a sample, and the drop reason, which also names why the robot is invalid.
const POISON: [(DropReason, &str, Spoil); 16] = {
    use DropReason::{BadFlags, BadTime, CommandOutOfRange, NotFinite, PowerOutOfRange};
    [
        (NotFinite, "NaN power", |s| s.power_w = f32::NAN),
        (NotFinite, "infinite power", |s| s.power_w = f32::INFINITY),
        (NotFinite, "minus infinite", |s| s.power_w = -f32::INFINITY),
        (NotFinite, "NaN speed", |s| s.v_mps = f32::NAN),
        (NotFinite, "NaN turn", |s| s.omega_radps = f32::NAN),
        (NotFinite, "NaN voltage", |s| *s = s.battery(f32::NAN, 1.0)),
        (NotFinite, "current", |s| *s = s.battery(3.7, f32::INFINITY)),
        (PowerOutOfRange, "negative power", |s| s.power_w = -0.5),
        (PowerOutOfRange, "huge power", |s| s.power_w = 1e30),
        (CommandOutOfRange, "huge speed", |s| s.v_mps = 1e30),
        (CommandOutOfRange, "huge turn", |s| s.omega_radps = -1e30),
        (BadFlags, "unknown flag", |s| s.flags |= 1 << 31),
        (BadFlags, "reserved field", |s| s.reserved = 1),
        (BadTime, "of the future", |s| s.measured_ns = s.stamp_ns + 1),
        (BadTime, "back", |s| (s.stamp_ns, s.measured_ns) = (5, 5)),
        (BadTime, "stamp jumps ahead", |s| s.stamp_ns = u64::MAX),
    ]
};

#[test]
fn row_7_a_robot_with_invalid_samples_is_invalid_with_a_reason_and_others_keep_every_bit() {
    const VICTIM: u32 = 3;
    let setup = Setup::default();
    // Each defect twice: with a full window, and directly after a valid sample.
    let frames = script(&ROBOTS, 10 + 4 * POISON.len() as u64, setup.period_ns());
    let clean = clean_run(&setup, &frames);

    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let mut expected: BTreeMap<&str, u64> = BTreeMap::new();
    for (at, frame) in frames.iter().enumerate() {
        let poison =
            at.checked_sub(10).filter(|at| at % 2 == 0).map(|at| &POISON[at / 2 % POISON.len()]);
        let Some((reason, what, spoil)) = poison else {
            source.send(frame);
            let answered = planner.answered(frame);
            let quality = answered.robot(VICTIM).unwrap().quality();
            assert!(
                !matches!(quality, Quality::Invalid(_)),
                "recovers with a good sample: {quality:?}"
            );
            continue;
        };
        let mut spoiled = frame.clone();
        spoil(&mut spoiled[VICTIM as usize]);
        source.send(&spoiled);
        let others: Vec<Sample> =
            frame.iter().filter(|sample| sample.robot != VICTIM).copied().collect();
        let answered = planner.answered(&others);
        *expected.entry(reason.name()).or_default() += 1;
        let shown = answered.robot(VICTIM).unwrap();
        match shown.quality() {
            Quality::Invalid(invalid) => assert_eq!(invalid.name(), reason.name(), "{what}"),
            other => panic!("{what}: {other:?}"),
        }
        assert_eq!(shown.flags & 0b11, 0, "{what}: no forecast");
        assert_eq!(answered.samples_dropped.get(*reason), expected[reason.name()], "{what}");
        let alarmed = planner.until("diagnostics", |line| match line {
            ReaderLine::Diagnostics(frame) if frame.tick >= answered.tick => Some(frame.clone()),
            _ => None,
        });
        let is_named = names(&alarmed, VICTIM, *reason, source.child.pid());
        assert!(is_named, "{what}: {:?}", alarmed.refused);
    }
    let others = planner.answers(|robot| robot != VICTIM);
    let compared = assert_same(&clean, &others, frames.len() * (ROBOTS.len() - 1));
    figure(
        "row 7, contaminated rows",
        format_args!("0 of {compared} compared to the bit, {} poisons", 2 * POISON.len()),
    );
}

#[test]
fn row_8_unknown_robots_and_a_second_source_are_counted_and_reported_without_effect() {
    let setup = Setup { robots: "0-9", ..Setup::default() };
    let frames = script(&ROBOTS, 40, setup.period_ns());
    let clean = clean_run(&setup, &frames);

    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut owner = arena.source("owner");
    let mut second = arena.source("second");
    let (first, rest) = frames.split_first().unwrap();
    planner.play(&mut owner, std::slice::from_ref(first));
    let mut last = None;
    for frame in rest {
        // The second source claims owned robots, with other values and later stamps, and two
        // unknown robots.
        let mut claims: Vec<Sample> = frame
            .iter()
            .take(3)
            .map(|claim| Sample {
                seq: claim.seq + 1000,
                stamp_ns: claim.stamp_ns + 1,
                power_w: 9.0,
                ..*claim
            })
            .collect();
        claims.push(sample(10, frame[0].seq, setup.period_ns()));
        claims.push(sample(u32::MAX, frame[0].seq, setup.period_ns()));
        second.send(&claims);
        owner.send(frame);
        let answered = planner.answered(frame);
        assert_eq!(answered.robots.len(), ROBOTS.len(), "the unknown get no place");
        last = Some(answered);
    }
    let rounds = rest.len() as u64;
    let accounted = rounds * 5 + frames.len() as u64 * 6;
    let counted = await_accounted(&mut planner, last.unwrap(), accounted);
    assert_eq!(counted.samples_dropped.get(DropReason::ForeignSource), 3 * rounds);
    assert_eq!(counted.samples_dropped.get(DropReason::UnknownRobot), 2 * rounds);
    assert_eq!(counted.samples_accepted, frames.len() as u64 * 6);
    let named = planner.until("diagnostics", |line| match line {
        ReaderLine::Diagnostics(frame) if frame.tick >= counted.tick => Some(frame.clone()),
        _ => None,
    });
    let pid = second.child.pid();
    for (robot, reason) in [
        (0, DropReason::ForeignSource),
        (2, DropReason::ForeignSource),
        (10, DropReason::UnknownRobot),
    ] {
        assert!(names(&named, robot, reason, pid), "{robot} {reason:?}: {:?}", named.refused);
    }
    let answers = planner.answers(|_| true);
    let compared = assert_same(&clean, &answers, frames.len() * ROBOTS.len());
    figure("row 8, cross-talk", format_args!("0 of {compared} answers compared to the bit"));
}

/// Waits for the first frame in which `samples` samples are accounted for; `newest` has been read
/// already.
fn await_accounted(
    planner: &mut Planner,
    newest: FrameRead<Forecasts>,
    samples: u64,
) -> FrameRead<Forecasts> {
    if accounted(&newest) >= samples {
        assert_eq!(accounted(&newest), samples);
        return newest;
    }
    let what = format!("{samples} samples are accounted for");
    let frame =
        planner.forecast(&what, |frame| (accounted(frame) >= samples).then(|| frame.clone()));
    assert_eq!(accounted(&frame), samples, "sent = accepted + dropped: {frame:?}");
    frame
}

/// Expected account of one robot: a slow, direct implementation of the rules.
#[derive(Default)]
struct Oracle {
    last: Option<Sample>,
    seq: Option<u64>,
    accepted: u64,
    metered_ns: u64,
    unmetered_ns: u64,
    drawn: i128,
}

impl Oracle {
    fn take(&mut self, sample: &Sample, period_ns: u64) {
        if self.seq.is_some_and(|seq| sample.seq <= seq) {
            return;
        }
        self.seq = Some(sample.seq);
        self.accepted += 1;
        if let Some(last) = self.last.replace(*sample) {
            let elapsed_ns = sample.stamp_ns - last.stamp_ns;
            if elapsed_ns <= period_ns * 3 / 2 {
                self.metered_ns += elapsed_ns;
                let uw = |watts: f32| (f64::from(watts) * 1e6).round() as i128;
                self.drawn += (uw(last.power_w) + uw(sample.power_w)) * i128::from(elapsed_ns);
            } else {
                self.unmetered_ns += elapsed_ns;
            }
        }
    }
}

#[test]
fn row_9_reordered_duplicate_missing_and_late_samples_are_accepted_once_and_the_ledger_is_exact() {
    let mut dice = Dice::roll();
    let setup = Setup::default();
    let arena = Arena::new(&setup);
    let _worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let mut oracles: Vec<Oracle> = ROBOTS.iter().map(|_| Oracle::default()).collect();
    let (mut sent, mut tail) = (0, 0);
    let mut late: Vec<Sample> = Vec::new();
    for seq in 0..150 {
        let mut frame: Vec<Sample> = Vec::new();
        for robot in ROBOTS {
            let now = sample(robot, seq, setup.period_ns());
            match dice.below(10) {
                0 => {}
                1 => late.push(now),
                2 => frame.extend([now, now]),
                _ => frame.push(now),
            }
        }
        // Late samples arrive some frames later, in any order: out of order unless no other came
        // between.
        while !late.is_empty() && dice.chance(0.4) {
            let at = dice.below(late.len() as u64) as usize;
            let place = dice.below(frame.len() as u64 + 1) as usize;
            frame.insert(place, late.swap_remove(at));
        }
        if frame.is_empty() {
            continue;
        }
        for sample in &frame {
            oracles[sample.robot as usize].take(sample, setup.period_ns());
        }
        source.send(&frame);
        sent += frame.len() as u64;
        tail = seq;
        // One after the other, so that no sample is lost in a burst and the oracle knows all of
        // them.
        planner.forecast("the frame is accounted for", |frame| {
            (accounted(frame) >= sent).then_some(())
        });
    }
    // A duplicate frame is dropped as a whole.
    let again = script(&ROBOTS, tail + 2, setup.period_ns()).pop().unwrap();
    for _ in 0..2 {
        let forge = Forge { samples_before: Some(sent), ..Forge::default() };
        source.send_forged(&again, forge);
    }
    for sample in &again {
        oracles[sample.robot as usize].take(sample, setup.period_ns());
    }
    let total = sent + 2 * again.len() as u64;
    let frame = planner.forecast("all is accounted for", |frame| {
        (accounted(frame) >= total).then(|| frame.clone())
    });
    assert_eq!(accounted(&frame), total, "{frame:?}");
    assert_eq!(frame.samples_accepted, oracles.iter().map(|oracle| oracle.accepted).sum::<u64>());
    let refused = [DropReason::Duplicate, DropReason::OutOfOrder]
        .map(|reason| frame.samples_dropped.get(reason));
    assert!(refused[0] > 50 && refused[1] > 20, "{refused:?}");
    assert_eq!(refused[0] + refused[1] + frame.samples_accepted, total);
    let budgets = planner.until("budgets", |line| match line {
        ReaderLine::Budgets(budgets) if budgets.tick >= frame.tick => Some(budgets.clone()),
        _ => None,
    });
    for (robot, oracle) in ROBOTS.iter().zip(&oracles) {
        let found = budgets.robot(*robot).unwrap();
        let expected = (oracle.metered_ns, oracle.unmetered_ns, oracle.drawn);
        assert_eq!(
            (found.metered_ns, found.unmetered_ns, drawn_exact(found)),
            expected,
            "robot {robot}"
        );
        assert!(found.unmetered_ns > 0, "gaps become unmetered time");
    }
    figure(
        "row 9, ledger difference",
        format_args!(
            "0 µJ over {} robots, {total} samples = {} accepted + {} twice + {} out of order",
            ROBOTS.len(),
            frame.samples_accepted,
            refused[0],
            refused[1]
        ),
    );
}

#[test]
fn row_9_in_bursts_samples_sent_equal_accepted_plus_dropped_by_reason() {
    let setup = Setup {
        buffer_frames: 4,
        tick_hz: 50.0,
        // Samples lost in a burst are gaps, which the robot's rate must allow.
        rate_hz: 10.0,
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut sources = [arena.source("one"), arena.source("two")];
    let frames = script(&[0, 1, 2], 600, setup.period_ns());
    for burst in frames.chunks(150) {
        for (source, shift) in sources.iter_mut().zip([0, 10]) {
            let shifted = |sample: &Sample| Sample { robot: sample.robot + shift, ..*sample };
            let line = |frame: &Vec<Sample>| {
                let samples: Vec<Sample> = frame.iter().map(shifted).collect();
                FrameLine::new(&samples, Forge::default())
            };
            source.send_all(&burst.iter().map(line).collect::<Vec<_>>());
        }
    }
    // Losses of the last frames are known from the next frame's header.
    let last: Vec<Sample> = [0, 1, 2].map(|robot| sample(robot, 600, setup.period_ns())).to_vec();
    sources[0].send(&last);
    let other: Vec<Sample> =
        last.iter().map(|sample| Sample { robot: sample.robot + 10, ..*sample }).collect();
    sources[1].send(&other);
    let total = 2 * 3 * 601;
    let frame = planner.forecast("all is accounted for", |frame| {
        (accounted(frame) >= total).then(|| frame.clone())
    });
    assert_eq!(accounted(&frame), total, "sent = accepted + dropped: {frame:?}");
    let budgets = planner.until("budgets", |line| match line {
        ReaderLine::Budgets(budgets) if budgets.tick >= frame.tick => Some(budgets.clone()),
        _ => None,
    });
    let line = |robot| *budgets.robot(robot).unwrap();
    for robot in [0, 1, 2, 10, 11, 12].map(line) {
        let elapsed_ns = robot.metered_ns + robot.unmetered_ns;
        assert_eq!(elapsed_ns % setup.period_ns(), 0);
        assert!(elapsed_ns <= 600 * setup.period_ns());
    }
    let report = {
        for source in sources {
            source.leave();
        }
        planner.leave();
        worker.stop().json()
    };
    figure(
        "row 9, bursts",
        format_args!(
            "{total} sent = {} accepted + {:?}",
            frame.samples_accepted,
            frame.samples_dropped.iter().collect::<Vec<_>>()
        ),
    );
    assert_eq!(report["receive_errors"], 0);
}

#[test]
fn row_21_robots_beyond_the_capacity_are_refused_and_reported_and_the_first_keep_every_bit() {
    let setup = Setup { capacity: 6, ..Setup::default() };
    let frames = script(&ROBOTS, 40, setup.period_ns());
    let clean = clean_run(&setup, &frames);

    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut source = arena.source("fleet");
    let mut crowd = arena.source("crowd");
    planner.play(&mut source, &frames[..1]);
    for frame in &frames[1..] {
        let extra: Vec<Sample> =
            [20, 21, 22].map(|robot| sample(robot, frame[0].seq, setup.period_ns())).to_vec();
        crowd.send(&extra);
        source.send(frame);
        assert_eq!(planner.answered(frame).robots.len(), 6);
    }
    let total = 40 * 6 + 39 * 3;
    source.send(&[sample(0, 40, setup.period_ns())]);
    let frame = planner.forecast("all is accounted for", |frame| {
        (accounted(frame) > total).then(|| frame.clone())
    });
    assert_eq!(frame.samples_dropped.get(DropReason::OverCapacity), 39 * 3);
    let named = planner.until("diagnostics", |line| match line {
        ReaderLine::Diagnostics(found) if found.tick >= frame.tick => Some(found.clone()),
        _ => None,
    });
    for robot in [20, 21, 22] {
        let is_named = names(&named, robot, DropReason::OverCapacity, crowd.child.pid());
        assert!(is_named, "{robot}: {:?}", named.refused);
    }
    let answers = planner.answers(|_| true);
    let answers: Answers = answers.into_iter().filter(|((_, seq), _)| *seq < 40).collect();
    let compared = assert_same(&clean, &answers, 40 * 6);
    figure(
        "row 21, difference of the first robots",
        format_args!("0 of {compared} answers compared to the bit"),
    );
    source.leave();
    crowd.leave();
    planner.leave();
    let ended = worker.stop();
    assert!(
        ended.errors().contains("OverCapacity"),
        "operators read it in the log: {}",
        ended.errors()
    );
}

#[test]
fn row_6_a_forged_run_from_the_far_future_blocks_a_source_for_one_stale_period_only() {
    let setup = Setup { tick_hz: 100.0, rate_hz: 50.0, stale_after_s: 0.5, ..Setup::default() };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    let mut controller = arena.controller("fleet", 0, 4, 50.0);
    let mut other = arena.controller("other", 50, 4, 50.0);
    let epoch = planner.forecast("all robots are forecast", |frame| {
        let known = |robot: u32| {
            let line = frame.robots.iter().find(|line| line.robot == robot)?;
            (line.flags & 1 != 0).then_some(line.source_epoch)
        };
        known(50).and(known(0))
    });
    let mut impostor = arena.source("fleet");
    for far in [epoch + 3_600_000_000_000, u64::MAX] {
        let forge = Forge { source_epoch: Some(far), ..Forge::default() };
        impostor.send_forged(&[sample(0, 0, 1)], forge);
        planner.forecast("the false run is taken for the next one", |frame| {
            let line = frame.robots.iter().find(|line| line.robot == 0)?;
            (line.source_epoch == far).then_some(())
        });
        planner.forecast("the source is back", |frame| {
            let line = frame.robots.iter().find(|line| line.robot == 0)?;
            (line.source_epoch == epoch && line.flags & 1 != 0).then_some(())
        });
    }
    impostor.leave();
    // The next run is accepted at once.
    controller.kill();
    let mut controller = arena.controller("fleet", 0, 4, 50.0);
    planner.forecast("the next run is heard", |frame| {
        let line = frame.robots.iter().find(|line| line.robot == 0)?;
        (![epoch, u64::MAX].contains(&line.source_epoch)).then_some(())
    });
    controller.finish();
    other.finish();
    planner.leave();
    let report = worker.stop().json();
    assert_ne!(report["samples_dropped"]["OldEpoch"], serde_json::Value::Null);
}

#[test]
fn more_successive_sources_than_slots_are_all_accepted() {
    const PLACES: u32 = 2;
    const NAMES: u32 = 4 * PLACES + 1;
    let setup = Setup {
        tick_hz: 100.0,
        rate_hz: 50.0,
        stale_after_s: 0.5,
        leave_after_s: 1.0,
        max_sources: PLACES,
        ..Setup::default()
    };
    let arena = Arena::new(&setup);
    let mut worker = arena.worker();
    let mut planner = arena.planner();
    for name in 0..NAMES {
        let mut controller = arena.controller(&format!("source-{name}"), name, 1, 50.0);
        planner.forecast("it is heard", |frame| {
            let line = frame.robots.iter().find(|line| line.robot == name)?;
            (line.flags & 1 != 0).then_some(())
        });
        controller.finish();
    }
    planner.leave();
    let report = worker.stop().json();
    assert!(report["samples_accepted"].as_u64() > Some(5 * u64::from(NAMES)));
}
