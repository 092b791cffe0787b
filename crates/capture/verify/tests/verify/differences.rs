//! Verification: differences found, and conditions that are not differences.

use std::collections::HashMap;

use joulebus_capture_format::{
    Attachments, CaptureSettings, Entry, Frame, Message, MessageKind, Query, Reader, Times, Writer,
};
use joulebus_capture_verify::{Loss, Output, Verdict, Verifier, WhatIf};
use joulebus_fleet::Fleet;
use joulebus_plan::{Plan, PlanFleet, Question, Refused, RobotRows};
use joulebus_testkit_fleets::channels::{Signal, SignalHeader, Signals};
use joulebus_testkit_fleets::random::Noise;
use joulebus_testkit_fleets::{self as world, PERIOD_NS};
use joulebus_wire::{
    AnswerHeader, Budgets, Channel, Diagnostics, Forecast, ForecastHeader, Forecasts,
    MAX_QUERY_STEPS, PlanStates, QueryRecord, QueryRefusal, SCHEMA_VERSION, Sample, Samples, State,
    Statement, Ticks, answer_flag, fnv1a,
};
use proptest::prelude::*;

use crate::simulation::{
    CAPACITY, DOUBTED, EPOCH, KEYFRAME_EVERY, KEYFRAME_LATE, LOADED, NEW_NORMAL_AT, Simulation,
    entries, recorded, tick_of, verify, verify_by,
};

/// True if it is a certain frame of samples.
fn is_frame_50(message: &Message) -> bool {
    let frame = message.frame::<Samples>();
    frame.is_some_and(|frame| (frame.header.source_id, frame.header.frame_seq) == (2, 50))
}

#[test]
fn a_complete_recording_has_no_differences() {
    let report = verify(entries(recorded(1, 200)));
    assert!(report.is_clean(), "{report}");
    assert_eq!((report.ticks, report.ticks_verified, report.robots), (200, 200, CAPACITY as usize));
    assert_eq!((report.keyframes, report.untaken_frames, report.runs), (5, 0, 1), "{report:?}");
    assert!(
        report.to_string().starts_with("verified: 200 ticks, 12 robots, 0 differences\n"),
        "{report}"
    );
}

/// Everything that can be learned online, and every kind of fault among the samples.
/// `tools/aarch64.sh` runs this on two kinds of processor with one `JOULEBUS_MACHINES`, a
/// directory: each verifies what both have recorded.
#[test]
fn what_one_machine_records_another_computes_to_the_bit() {
    let own = tempfile::tempdir().unwrap();
    let machines = std::env::var_os("JOULEBUS_MACHINES").map(std::path::PathBuf::from);
    let machines = machines.unwrap_or_else(|| own.path().to_owned());
    let settings = world::learning(CAPACITY);
    let fleet = Fleet::new(settings.clone(), world::fresh_models()).unwrap();
    let mut simulation = Simulation::of(5, fleet);
    simulation.run(400);
    let path = machines.join(format!("{}.mcap", std::env::consts::ARCH));
    let file = std::fs::File::create(&path).unwrap();
    let mut writer =
        Writer::new(file, CaptureSettings::default(), &Attachments::default()).unwrap();
    for entry in entries(simulation.sent) {
        let times = Times { log_ns: entry.log_time_ns, publish_ns: entry.publish_time_ns };
        writer.write("lab", times, &entry.message).unwrap();
    }
    writer.finish().unwrap();
    let mut verified = 0;
    for file in std::fs::read_dir(&machines).unwrap() {
        let path = file.unwrap().path();
        let mut reader = Reader::new(std::fs::File::open(&path).unwrap()).unwrap();
        let read = std::iter::from_fn(|| reader.next_entry().unwrap());
        let verifier = Verifier::new(settings.clone(), world::fresh_models()).unwrap();
        let report = verify_by(verifier, read);
        assert!(report.is_clean(), "{}: {report}", path.display());
        assert_eq!(report.ticks_verified, 400, "{}: {report}", path.display());
        verified += 1;
    }
    assert!(verified > 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(ProptestConfig::default().cases.min(48)))]

    /// The recorder reads one service after the other, and may be late in any of them.
    #[test]
    fn the_order_in_which_a_recorder_reads_has_no_effect(
        seed in any::<u64>(), lag in 1usize..150,
    ) {
        let mut noise = Noise(seed);
        let messages = recorded(seed % 8, 120);
        // Each kind keeps its order.
        let mut keyed: Vec<(usize, Message)> = Vec::new();
        let mut last: HashMap<MessageKind, usize> = HashMap::new();
        for (place, message) in messages.into_iter().enumerate() {
            let last = last.entry(message.kind().unwrap()).or_default();
            *last = (*last).max(place + (noise.next_u64() % lag as u64) as usize);
            keyed.push((*last, message));
        }
        keyed.sort_by_key(|(at, _)| *at);
        let report = verify(entries(keyed.into_iter().map(|(_, message)| message).collect()));
        prop_assert!(report.is_clean(), "{report}");
        prop_assert_eq!(report.ticks_verified, 120);
    }

    #[test]
    fn a_recording_may_begin_and_end_anywhere(seed in 0u64..8, from in 0.0f64..0.55, to in 0.8f64..1.0) {
        let all = entries(recorded(seed, 200));
        let (from, to) = ((from * all.len() as f64) as usize, (to * all.len() as f64) as usize);
        let before = verify(all[from..to].to_vec());
        prop_assert!(before.is_clean(), "{before}");
        prop_assert!(before.ticks_before_first_keyframe < KEYFRAME_EVERY + KEYFRAME_LATE, "{before:?}");
        prop_assert!(before.ticks_cut_off < 4, "{before:?}");
        prop_assert_eq!(
            before.ticks,
            before.ticks_verified + before.ticks_before_first_keyframe
                + before.ticks_cut_off.min(before.ticks - before.ticks_verified - before.ticks_before_first_keyframe)
        );
    }

    #[test]
    fn losses_are_reported_and_nothing_else_differs(
        seed in 0u64..8, lost in prop::collection::vec(any::<prop::sample::Index>(), 1..4),
    ) {
        let all = entries(recorded(seed, 200));
        let lost: Vec<usize> = lost.into_iter().map(|index| index.index(all.len())).collect();
        let kept = all.iter().enumerate().filter(|(place, _)| !lost.contains(place));
        let report = verify(kept.map(|(_, entry)| entry.clone()));
        prop_assert_eq!(report.differences, 0, "{}", report);
        // Losses at either end cannot be detected.
        let inside = |place: &&usize| {
            let kind = |place: usize| all[place].message.kind();
            let same = |other: &usize| kind(*other) == kind(**place) && !lost.contains(other);
            (0..**place).any(|other| same(&other)) && (**place + 1..all.len()).any(|other| same(&other))
        };
        if lost.iter().filter(inside).count() > 0 {
            prop_assert!(!report.is_clean(), "{report}");
            prop_assert!(report.messages_lost > 0, "{report}");
        }
    }
}

#[test]
fn a_lost_frame_of_samples_is_named_and_verification_resumes_at_the_next_keyframe() {
    let all = entries(recorded(3, 200));
    let is_lost = |entry: &Entry| is_frame_50(&entry.message);
    let taken_by = all.iter().find_map(|entry| {
        let Frame { header, rows } = entry.message.frame::<Ticks>()?;
        let mut taken = rows.iter();
        let is_taken = taken.any(|taken| taken.source_id == 2 && taken.frame_seq == 50);
        is_taken.then_some(header.tick)
    });
    let tick = taken_by.unwrap();
    let report = verify(all.into_iter().filter(|entry| !is_lost(entry)));
    let resumed = tick.div_ceil(KEYFRAME_EVERY) * KEYFRAME_EVERY;
    assert_eq!(report.ticks_unverified, resumed - tick + 1, "{report}");
    assert_eq!(report.ticks_verified, 200 - report.ticks_unverified);
    let frame = Loss::Samples { source_id: 2, frame_seq: 50 };
    assert_eq!(report.losses[0], (tick, frame), "{report}");
    assert_eq!((report.differences, report.is_clean()), (0, false));
}

#[test]
fn frames_that_repeat_the_number_of_another_one_are_named_and_never_reported_as_differences() {
    let all = entries(recorded(3, 200));
    let at = all.iter().position(|entry| is_frame_50(&entry.message));
    let at = at.unwrap();
    let Frame { header, rows } = all[at].message.frame::<Samples>().unwrap();
    let samples = rows;
    let with = |change: &dyn Fn(&mut Entry), place: usize| {
        let mut entries = all.clone();
        let mut copy = all[at].clone();
        change(&mut copy);
        entries.insert(place, copy);
        verify(entries)
    };
    let number = Loss::Ambiguous { source_id: 2, frame_seq: 50 };
    let other_power = |entry: &mut Entry| {
        let mut samples = samples.clone();
        samples[0].power_w = f32::from_bits(samples[0].power_w.to_bits() ^ 1);
        entry.message = Message::of::<Samples>(*header, samples);
    };
    let other_header = |entry: &mut Entry| {
        let mut header = *header;
        header.sent_ns ^= 1;
        entry.message = Message::of::<Samples>(header, samples.clone());
    };
    let longer = |entry: &mut Entry| {
        entry.message = Message::of::<Samples>(*header, [&samples[..], samples].concat());
    };
    let changes: [&dyn Fn(&mut Entry); 3] = [&other_power, &other_header, &longer];
    for (number_of_change, change) in changes.into_iter().enumerate() {
        for place in [at, at + 1] {
            let report = with(change, place);
            let what = format!("change {number_of_change} at {place}: {report}");
            assert_eq!(report.differences, 0, "{what}");
            assert!(report.losses.iter().any(|(_, loss)| *loss == number), "{what}");
            assert!(!report.is_clean() && report.ticks_verified > 100, "{what}");
        }
    }
    // Only the false one was recorded.
    let mut entries = all.clone();
    longer(&mut entries[at]);
    let report = verify(entries);
    assert_eq!((report.differences, report.losses[0].1), (0, number), "{report}");
    // The same bits twice: whichever it took.
    let same = with(&|_| {}, at);
    assert_eq!((same.differences, same.ticks_unverified), (0, 0), "{same}");
}

#[test]
fn a_flipped_bit_in_a_header_is_named_where_it_follows_from_the_samples() {
    let messages = recorded(4, 90);
    let with = |change: &dyn Fn(&mut Message)| {
        let mut spoilt = messages.clone();
        let mut of_tick = spoilt.iter_mut().filter(|message| tick_of(message) == 65);
        of_tick.by_ref().for_each(change);
        let report = verify(entries(spoilt));
        report.first.map(|first| (first.tick, first.robot, first.field))
    };
    let refused = with(&|message| {
        if let Some(frame) = message.frame_mut::<Diagnostics>() {
            frame.header.refused[3].count ^= 1;
        }
    });
    let (tick, robot, field) = refused.unwrap();
    assert_eq!((tick, &*field), (65, "diagnostics.refused robots"));
    assert!(robot.is_some());
    let header = |change: &dyn Fn(&mut ForecastHeader)| {
        let found = with(&|message| {
            if let Some(frame) = message.frame_mut::<Forecasts>() {
                change(&mut frame.header);
            }
        });
        found.map(|(_, _, field)| field)
    };
    let dropped = header(&|header| header.samples_dropped.counts[7] += 1);
    assert_eq!(dropped.as_deref(), Some("forecasts.NotFinite"));
    let accepted = header(&|header| header.samples_accepted += 1);
    assert_eq!(accepted.as_deref(), Some("forecasts.samples_accepted"));
    // When it was sent does not follow from them.
    assert_eq!(header(&|header| header.sent_ns += 1), None);
    let models = with(&|message| {
        if let Some(frame) = message.frame_mut::<PlanStates>() {
            frame.header.models[0] ^= 1;
        }
    });
    assert_eq!(models.unwrap().2, "plan_states.models");
}

/// A channel that is declared elsewhere: half of each robot's forecast.
#[test]
fn frames_of_a_channel_that_is_declared_elsewhere_are_compared() {
    let mut messages = Vec::new();
    for message in recorded(4, 90) {
        if let Some(Frame { header, rows }) = message.frame::<Forecasts>() {
            let mut header = SignalHeader {
                worker_epoch: header.worker_epoch,
                tick: header.tick,
                ..SignalHeader::default()
            };
            header.sent_unix_ns = 7 * header.tick;
            let halves = rows.iter().map(half).collect();
            messages.push(Message::of::<Signals>(header, halves));
        }
        messages.push(message);
    }
    let verify = |messages: &[Message]| {
        let verifier = Verifier::new(world::settings(CAPACITY), world::models()).unwrap();
        let halves = Output::of::<Signals>(
            &["sent_unix_ns"],
            |tick| SignalHeader { sent_unix_ns: 7 * tick.journal.tick, ..SignalHeader::default() },
            |tick, place| half(&tick.fleet.forecast(place)),
        );
        verify_by(verifier.with_output(halves), entries(messages.to_vec()))
    };
    let report = verify(&messages);
    assert!(report.is_clean() && report.not_recorded.is_empty(), "{report}");
    let is_it = |message: &Message| message.frame::<Signals>().is_some();
    let mut places = (0..messages.len()).filter(|place| is_it(&messages[*place]));
    let place = places.nth(70).unwrap();
    let mut spoilt = messages.clone();
    spoilt[place].frame_mut::<Signals>().unwrap().rows[2].noise_dbm = 1.0;
    let first = verify(&spoilt).first.unwrap();
    assert_eq!((first.tick, &*first.field), (71, "signal.noise_dbm"));
    spoilt.remove(place);
    let report = verify(&spoilt);
    assert_eq!(report.outputs_missing["signals"], 1, "{report}");
}

fn half(forecast: &Forecast) -> Signal {
    Signal { robot: forecast.robot, level_dbm: forecast.power_w / 2.0, ..Signal::default() }
}

#[test]
fn a_flipped_bit_in_a_sample_shows_at_its_tick_and_robot() {
    let mut messages = recorded(5, 90);
    let taken_at_60 = |message: &Message| {
        let journal = message.frame::<Ticks>();
        journal.filter(|journal| journal.header.tick == 60)?.rows.first().copied()
    };
    let taken = messages.iter().find_map(taken_at_60).unwrap();
    let mut robot = 0;
    for message in &mut messages {
        if let Some(Frame { header, rows: samples }) = message.frame_mut::<Samples>()
            && (header.source_id, header.frame_seq) == (taken.source_id, taken.frame_seq)
        {
            let is_read = |sample: &&mut Sample| sample.power_w.is_finite() && sample.robot < 1_000;
            let sample = samples.iter_mut().find(is_read).unwrap();
            sample.power_w = f32::from_bits(sample.power_w.to_bits() ^ (1 << 12));
            robot = sample.robot;
        }
    }
    let report = verify(entries(messages));
    let first = report.first.clone().unwrap();
    assert_eq!((first.tick, first.robot), (60, Some(robot)), "{report}");
    assert!(report.differences > 1, "an error in a ledger persists: {report}");
}

#[test]
fn a_new_normal_that_the_journal_lacks_shows_as_the_alarm_that_it_ended() {
    let mut messages = recorded(5, NEW_NORMAL_AT + 10);
    let report = verify(entries(messages.clone()));
    assert!(report.is_clean(), "{report}");
    let row = messages.iter_mut().find_map(|message| {
        let rows = &mut message.frame_mut::<Ticks>()?.rows;
        rows.pop_if(|taken| taken.statement() == Some((LOADED, Statement::NewNormal)))
    });
    assert!(row.is_some());
    let report = verify(entries(messages));
    let first = report.first.clone().unwrap();
    assert_eq!((first.tick, first.robot), (NEW_NORMAL_AT, Some(LOADED)), "{report}");
    assert_eq!(&*first.field, "diagnostic.alarms", "{report}");
}

#[test]
fn a_comparison_of_models_takes_new_normals_and_does_not_miss_them_as_frames() {
    let mut what_if =
        WhatIf::new(world::settings(CAPACITY), world::models(), world::models()).unwrap();
    let messages = recorded(5, NEW_NORMAL_AT + 10);
    entries(messages).into_iter().for_each(|entry| what_if.push(entry));
    let found = what_if.finish();
    assert_eq!((found.ticks, found.frames_missing), (NEW_NORMAL_AT + 10, 0), "{found}");
    let loaded = found.robots.iter().find(|difference| difference.robot == LOADED).unwrap();
    assert_eq!(loaded.recorded.ticks_in_alarm, loaded.other.ticks_in_alarm, "{found}");
}

#[test]
fn the_errors_of_recorded_models_are_those_that_the_worker_has_sent() {
    let mut what_if =
        WhatIf::new(world::settings(CAPACITY), world::models(), world::fresh_models()).unwrap();
    let messages = recorded(1, 200);
    let frames = messages.iter().filter_map(|message| message.frame::<Diagnostics>());
    let sent: HashMap<u32, _> =
        frames.flat_map(|frame| frame.rows.iter().map(|row| (row.robot, *row))).collect();
    entries(messages).into_iter().for_each(|entry| what_if.push(entry));
    let found = what_if.finish();
    let fleet = Fleet::new(world::settings(CAPACITY), world::models()).unwrap();
    assert_eq!(found.recorded_model_hash, fleet.model_hash());
    assert_ne!(found.recorded_model_hash, found.other_model_hash);
    assert!(!found.robots.is_empty());
    let mut others = 0;
    for robot in &found.robots {
        let last = sent[&robot.robot];
        assert_eq!(robot.recorded.scored, last.scored, "{robot:?}");
        assert_eq!(robot.recorded.mae_w.to_bits(), last.mae_w.to_bits(), "{robot:?}");
        others += usize::from(robot.recorded.mae_w != robot.other.mae_w);
    }
    assert!(others > 0, "{found}");
}

#[test]
fn a_killed_worker_and_its_successor_are_both_verified() {
    let mut simulation = Simulation::new(6);
    simulation.run(100);
    // Killed after it had sent its forecasts.
    let mut sent = std::mem::take(&mut simulation.sent);
    let is_forecasts = |message: &Message| message.frame::<Forecasts>().is_some();
    let half = sent.iter().rposition(is_forecasts).unwrap();
    sent.truncate(half + 1);
    simulation.sent = sent;
    simulation.restart();
    simulation.run(150);
    let report = verify(entries(simulation.sent));
    assert!(report.is_clean(), "{report}");
    assert_eq!(
        (report.runs, report.ticks_verified, report.ticks_cut_off),
        (2, 99 + 150, 1),
        "{report}"
    );
}

#[test]
fn without_a_keyframe_or_with_another_model_nothing_is_verified() {
    let messages = recorded(7, 60);
    let without =
        messages.iter().filter(|message| message.kind() != Some(MessageKind::of::<State>()));
    let report = verify(entries(without.cloned().collect()));
    assert_eq!((report.ticks_verified, report.ticks_unverified, report.is_clean()), (0, 60, false));
    assert!(report.to_string().contains("no keyframe"), "{report}");

    let mut models = world::models();
    models.swap(0, 2);
    let mut verifier = Verifier::new(world::settings(CAPACITY), models).unwrap();
    entries(messages).into_iter().for_each(|entry| verifier.push(entry));
    let report = verifier.finish();
    assert_eq!((report.ticks_verified, report.ticks_unverified), (0, 60));
    assert_eq!(report.refused_keyframes, report.keyframes, "{report}");
    assert!(report.to_string().contains("Use the same models"), "{report}");
}

#[test]
fn excluded_topics_are_recomputed_and_not_compared_which_is_a_verdict_of_its_own() {
    let messages = recorded(8, 60).into_iter();
    let kept = messages.filter(|message| message.kind() != Some(MessageKind::of::<Diagnostics>()));
    let report = verify(entries(kept.collect()));
    assert_eq!(report.verdict, Verdict::NotCompared, "{report}");
    assert_eq!(report.not_recorded, ["diagnostics"]);
    let channels = &report.coverage[0].channels;
    let (kept, left_out) = (&channels["forecasts"], &channels["diagnostics"]);
    assert_eq!((kept.sent, kept.recomputed, kept.compared), (60, 60, 60), "{report}");
    assert_eq!((left_out.sent, left_out.recomputed, left_out.compared), (60, 60, 0), "{report}");
    assert_eq!(left_out.missing["not recorded"], 60, "{report}");
}

/// By rules 8 every output may depend on what other robots of the platform have shown.
#[test]
fn outputs_of_older_rules_are_excused_by_name() {
    let mut messages = recorded(8, 60);
    let of_tick = messages.iter_mut().filter(|message| tick_of(message) == 50);
    for message in of_tick {
        if let Some(frame) = message.frame_mut::<Budgets>() {
            frame.rows[0].left_j += 1.0;
        }
        if let Some(frame) = message.frame_mut::<Forecasts>() {
            frame.rows[0].power_w += 1.0;
        }
    }
    let verifier = Verifier::new(world::settings(CAPACITY), world::models());
    let report = verify_by(verifier.unwrap().with_tick_rules(7), entries(messages));
    // The simulated worker encodes its keyframes like this version, which denies the older rules.
    assert_eq!(report.verdict, Verdict::Incomplete, "{report}");
    assert_eq!((report.rules_denied, report.keyframes), (2, 2), "{report}");
    assert_eq!((report.differences, report.ticks_verified), (0, 60), "{report}");
    for (channel, of) in &report.coverage[0].channels {
        let excused = of.excused.get("computed by older rules (7)").copied().unwrap_or(0);
        // The first keyframe is where the recomputation begins.
        let given = of.excused.get("taken as given").copied().unwrap_or(0);
        assert_eq!((excused, of.compared), (of.sent - given, 0), "{channel}: {report}");
    }
    assert!(report.to_string().contains("computed by older rules (7)"), "{report}");
}

#[test]
fn rules_that_keyframes_or_the_rules_of_answers_deny_excuse_nothing() {
    let messages = recorded(8, 60);
    for (tick_rules, answer_rules, denied) in
        [(11, 6, 0), (10, 6, 2), (7, 4, 2), (6, 3, 2), (11, 3, 1), (6, 4, 3)]
    {
        let verifier = Verifier::new(world::settings(CAPACITY), world::models()).unwrap();
        let verifier = verifier.with_tick_rules(tick_rules).with_answer_rules(Some(answer_rules));
        let report = verify_by(verifier, entries(messages.clone()));
        assert_eq!((report.rules_denied, report.is_clean()), (denied, denied == 0), "{report}");
    }
}

/// Through the files of a split recording, bit for bit.
#[test]
fn split_files_are_verified_as_one_and_each_from_its_keyframe() {
    let all = entries(recorded(9, 200));
    let mut files = Vec::new();
    let mut sequences = joulebus_capture_format::Sequences::default();
    for part in all.chunks(all.len() / 3 + 1) {
        let attachments = Attachments::default();
        let settings = CaptureSettings::default();
        let mut writer = Writer::resume(Vec::new(), settings, &attachments, sequences).unwrap();
        for entry in part {
            let times = Times { log_ns: entry.log_time_ns, publish_ns: entry.publish_time_ns };
            writer.write("lab", times, &entry.message).unwrap();
        }
        let (_, next, bytes) = writer.finish().unwrap();
        sequences = next;
        files.push(bytes);
    }
    let read = |bytes: &[u8]| -> Vec<Entry> {
        Reader::new(bytes).unwrap().map(|entry| entry.unwrap()).collect()
    };
    let report = verify(files.iter().flat_map(|bytes| read(bytes)));
    assert!(report.is_clean(), "{report}");
    assert_eq!(report.ticks_verified, 200);
    for bytes in &files {
        let report = verify(read(bytes));
        assert!(report.is_clean() && report.ticks_verified > 20, "{report}");
    }
}

fn rows_of<C: Channel>(messages: &[Message], tick: u64) -> &[C::Row] {
    let of_tick = messages.iter().filter(|message| tick_of(message) == tick);
    &of_tick.filter_map(Message::frame::<C>).next().unwrap().rows
}

/// A question about [`DOUBTED`], and what the worker answers as of a tick.
pub(crate) fn asked(messages: &[Message], tick: u64, number: u64, v_mps: f32) -> Query {
    let states = rows_of::<PlanStates>(messages, tick);
    let budgets = rows_of::<Budgets>(messages, tick);
    let question = Question {
        plan: Plan::WhatIf {
            robot: DOUBTED,
            candidates: 3,
            period_s: 1.0 / 30.0,
            v_mps: vec![v_mps; 30],
            omega_radps: vec![0.1; 30],
        },
        coverage: 0.9,
        power: true,
        moments: 0,
    };
    let fleet = fnv1a("lab".bytes());
    let (query, values) = question.encode(fleet).unwrap();
    let mut answer = AnswerHeader {
        schema: SCHEMA_VERSION,
        worker_epoch: EPOCH,
        tick,
        period_ns: PERIOD_NS,
        sent_state_ns: 70,
        budget_epoch: EPOCH,
        budget_tick: tick,
        sent_budget_ns: 60,
        now_ns: 90,
        ..AnswerHeader::default()
    };
    let find = |robot| {
        let state = states.iter().find(|row| row.robot == robot)?;
        let budget = budgets.iter().find(|row| row.robot == robot);
        Some(RobotRows::recorded(&answer, *state, budget.copied()))
    };
    let plans = PlanFleet::new(&world::settings(CAPACITY), &world::models());
    let reply = question.answer(&plans, find, MAX_QUERY_STEPS);
    let mut words = Vec::new();
    match &reply {
        Ok(reply) => reply.encode(&mut answer, &mut words),
        Err(error) => Refused::from(error).encode(&mut answer, &mut words),
    }
    let record = QueryRecord { begun_ns: 1, number, query, answer, ..QueryRecord::default() };
    Query::of_record((record, &values, &words))
}

#[test]
fn answers_about_plans_are_computed_again_wherever_they_lie_and_a_flipped_bit_is_named() {
    let messages = recorded(4, 90);
    let queries = [asked(&messages, 65, 1, 0.1), asked(&messages, 66, 2, 0.1)];
    let refused = asked(&messages, 66, 3, 99.0);
    assert!(queries.iter().all(|query| query.rows.len() == 3 && query.power_w.len() == 30));
    // An answer that an alarm weakens follows from the recorded samples too.
    let rows = queries.iter().flat_map(|query| &query.rows);
    assert!(rows.clone().all(|row| row.flags & answer_flag::ALARM_IMPLAUSIBLE != 0));
    assert!(refused.rows.is_empty() && refused.text.contains("99"), "{refused:?}");
    let with = |queries: &[Query], place: usize| {
        let mut messages = messages.clone();
        let queries = queries.iter().cloned().map(Message::from);
        messages.splice(place..place, queries);
        verify(entries(messages))
    };
    let all = [queries[0].clone(), queries[1].clone(), refused.clone()];
    // Before, beside and long after their ticks.
    let beside = messages.iter().position(|message| tick_of(message) == 66).unwrap();
    for place in [0, beside, messages.len()] {
        let report = with(&all, place);
        assert!(report.is_clean(), "{place}: {report}");
        assert_eq!((report.queries, report.queries_verified), (3, 3), "{place}");
    }
    type Spoil = fn(&mut Query);
    let flips: [(&str, Spoil); 6] = [
        ("query.mean_j", |query| {
            let value = &mut query.rows[1].mean_j;
            *value = f32::from_bits(value.to_bits() ^ 1);
        }),
        ("query.verdict", |query| query.rows[0].verdict ^= 1),
        ("query.flags", |query| query.rows[2].flags ^= 1),
        ("query.power_w", |query| query.power_w[7] += 1.0),
        ("query.rows", |query| {
            query.rows.pop();
            *query = query.clone().counted();
        }),
        ("query.refusal", |query| {
            query.record.answer.refusal = QueryRefusal::Question.code();
            *query = query.clone().counted();
        }),
    ];
    for (name, spoil) in flips {
        let mut spoilt = queries[0].clone();
        spoil(&mut spoilt);
        let report = with(&[spoilt], beside);
        let first = report.first.clone().unwrap_or_else(|| panic!("{name} was not found"));
        assert_eq!((first.tick, &*first.field), (65, name), "{report}");
    }
    let mut changed = refused;
    changed.text = changed.text.replace("99", "98");
    assert_eq!(&*with(&[changed], beside).first.unwrap().field, "query.text");
}

#[test]
fn answers_about_ticks_that_could_not_be_computed_are_counted() {
    let messages = recorded(4, 90);
    let query = asked(&messages, 65, 1, 0.1);
    let with = |change: &dyn Fn(&mut Query)| {
        let mut changed = query.clone();
        change(&mut changed);
        let all = messages.iter().cloned().chain([changed.into()]);
        verify(entries(all.collect()))
    };
    // In tick 35 nobody read plan states, and tick 1,000 is not in the recording.
    let lost = with(&|query| query.record.answer.tick = 35);
    assert_eq!((lost.queries_unverified, lost.is_clean()), (1, false), "{lost}");
    let absent = with(&|query| query.record.answer.tick = 1_000);
    assert_eq!((absent.queries_unverified, absent.is_clean()), (1, false), "{absent}");
    // A recorder may end between an answer and its tick.
    let cut_off = with(&|query| query.record.answer.tick = 91);
    assert_eq!((cut_off.queries_outside, cut_off.is_clean()), (1, true), "{cut_off}");
    let late = with(&|query| {
        query.record.answer.refusal = QueryRefusal::Deadline.code();
        *query = query.clone().counted();
    });
    assert_eq!((late.queries_by_time, late.is_clean()), (1, true), "{late}");
}
