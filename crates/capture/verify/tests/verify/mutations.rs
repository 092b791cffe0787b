//! Mutations of a recording, each with its verdict. What a capture alone cannot show is among them.

use joulebus_capture_format::Query;
use joulebus_capture_format::{Frame, Message, MessageKind, RobotRow};
use joulebus_capture_verify::Verdict::{self, Different, Incomplete, NotCompared, Verified};
use joulebus_testkit_fleets::PERIOD_NS;
use joulebus_wire::{
    AcknowledgementHeader, Acknowledgements, Alarm, Budgets, Channel, Diagnostics, Forecasts,
    Outlooks, PlanStates, QueryHeader, QueryKind, QueryRefusal, Row, Samples, State, Statement,
    TakenFrame, Ticks, fnv1a, tick_flag,
};

use crate::differences::asked;
use crate::simulation::{EPOCH, KEYFRAME_EVERY, Simulation, entries, recorded, tick_of, verify};

/// Ticks of the recording, and the one that is changed.
const TICKS: u64 = 170;
const TICK: u64 = 65;

type Messages = Vec<Message>;
type Mutate = fn(&mut Messages);

/// Position of the frame of a channel in a tick.
fn at<C: Channel>(messages: &Messages, tick: u64) -> usize {
    let is_it = |message: &Message| message.frame::<C>().is_some() && tick_of(message) == tick;
    messages.iter().position(is_it).unwrap()
}

fn frame<C: Channel>(messages: &mut Messages, tick: u64) -> &mut Frame<C> {
    let place = at::<C>(messages, tick);
    messages[place].frame_mut::<C>().unwrap()
}

/// The frame of samples that the tick took first.
fn samples(messages: &mut Messages, tick: u64) -> &mut Frame<Samples> {
    let taken = frame::<Ticks>(messages, tick).rows[0];
    let frames = messages.iter_mut().filter_map(Message::frame_mut::<Samples>);
    let is_it = |frame: &&mut Frame<Samples>| {
        (frame.header.source_id, frame.header.frame_seq) == (taken.source_id, taken.frame_seq)
    };
    { frames }.find(is_it).unwrap()
}

/// Positions of the pieces of the keyframe after a tick.
fn pieces(messages: &Messages, tick: u64) -> Vec<usize> {
    let is_it = |place: &usize| {
        let piece = messages[*place].frame::<State>();
        piece.is_some_and(|piece| piece.header.tick == tick)
    };
    (0..messages.len()).filter(is_it).collect()
}

fn piece(messages: &mut Messages, tick: u64, number: usize) -> &mut Frame<State> {
    let place = pieces(messages, tick)[number];
    messages[place].frame_mut::<State>().unwrap()
}

fn remove(messages: &mut Messages, is_it: impl Fn(&Message) -> bool) {
    let count = messages.len();
    messages.retain(|message| !is_it(message));
    assert!(messages.len() < count, "nothing was removed");
}

fn remove_kind<C: Channel>(messages: &mut Messages) {
    remove(messages, |message| message.frame::<C>().is_some());
}

/// Removes all parts of the ticks, and keyframes after them.
fn remove_ticks(messages: &mut Messages, ticks: std::ops::RangeInclusive<u64>) {
    remove(messages, |message| {
        let keyframe = message.frame::<State>().map(|piece| piece.header.tick);
        let is_of_tick = message.frame::<Samples>().is_none();
        is_of_tick && ticks.contains(&keyframe.unwrap_or_else(|| tick_of(message)))
    });
}

/// Gives all later ticks lower numbers, so that the ones removed before `tick` leave no gap.
fn renumber(messages: &mut Messages, tick: u64, by: u64) {
    for message in messages {
        macro_rules! shift {
            ($($channel:ty),*) => {$(
                if let Some(frame) = message.frame_mut::<$channel>()
                    && frame.header.tick >= tick
                {
                    frame.header.tick -= by;
                }
            )*};
        }
        shift!(Forecasts, Diagnostics, Budgets, PlanStates, Outlooks, Ticks, State);
    }
}

/// Inserts a copy of the frame of a channel at another tick's place, changed or not.
fn copy<C: Channel>(messages: &mut Messages, to: u64, change: impl Fn(&mut Frame<C>)) {
    let mut copy = messages[at::<C>(messages, TICK)].clone();
    change(copy.frame_mut::<C>().unwrap());
    let place = at::<Ticks>(messages, to) + 1;
    messages.insert(place, copy);
}

/// A recording of a worker that is started again.
fn two_runs() -> Messages {
    let mut simulation = Simulation::new(4);
    simulation.run(TICKS);
    simulation.restart();
    simulation.run(100);
    simulation.sent
}

fn other_bits<C: Channel>(frame: &mut Frame<C>) {
    bytemuck::bytes_of_mut(&mut frame.rows[3])[size_of::<C::Row>() - 1] ^= 1;
}

/// Forges all outputs from a tick on.
fn forge_from(messages: &mut Messages, tick: u64) {
    for message in messages {
        macro_rules! forge {
            ($($channel:ty),*) => {$(
                if let Some(frame) = message.frame_mut::<$channel>() && frame.header.tick >= tick {
                    other_bits(frame);
                }
            )*};
        }
        forge!(Forecasts, Diagnostics, Budgets, PlanStates, Outlooks);
    }
}

/// Removes the frames of some channels from a tick on.
fn remove_from(messages: &mut Messages, tick: u64, kinds: &[MessageKind]) {
    remove(messages, |message| {
        kinds.contains(&message.kind().unwrap()) && tick_of(message) >= tick
    });
}

/// Inserts diagnostics of a later run, renumbered, after a tick.
fn future_run(messages: &mut Messages, after: u64, tick: u64) {
    let mut frame = messages[at::<Diagnostics>(messages, TICK)].clone();
    let header = &mut frame.frame_mut::<Diagnostics>().unwrap().header;
    (header.worker_epoch, header.tick) = (EPOCH + 5, tick);
    let place = at::<Ticks>(messages, after) + 1;
    messages.insert(place, frame);
}

fn remove_keyframes(messages: &mut Messages, is_it: impl Fn(u64) -> bool) {
    remove(messages, |message| {
        message.frame::<State>().is_some_and(|piece| is_it(piece.header.tick))
    });
}

/// Adds the answers to six questions, of which one is changed.
fn ask(messages: &mut Messages, change: impl Fn(&mut Query)) {
    for number in 0..6 {
        let mut query = asked(messages, TICK - number, 1 + number, 0.1);
        if number == 3 {
            change(&mut query);
        }
        messages.push(query.into());
    }
}

fn forged(query: &mut Query) {
    let value = &mut query.rows[0].mean_j;
    *value = f32::from_bits(value.to_bits() ^ 1);
}

/// The answer turned into a refusal.
fn refused(query: &mut Query, code: u32) {
    query.record.answer.refusal = code;
    *query = query.clone().counted();
}

/// Adds the answers to questions of some clients, in the order of sending: one for each of the ticks
/// in which they were sent, each taken a tick earlier. The change gets the position of each.
fn ask_at(messages: &mut Messages, asked_in: &[(u64, u32)], change: impl Fn(&mut Query, usize)) {
    for (place, (tick, client)) in asked_in.iter().enumerate() {
        // Plan states are recorded in the first thirty of forty ticks.
        let mut query = asked(messages, TICK, 1 + place as u64, 0.1);
        let start_ns = |tick: u64| messages[at::<Ticks>(messages, tick)].frame::<Ticks>();
        let sent_ns = start_ns(*tick).unwrap().header.start_ns + 1;
        query.record.client = *client;
        query.record.query.asked_ns = sent_ns - PERIOD_NS - 1;
        query.record.query.deadline_ns = sent_ns + 60 * PERIOD_NS;
        query.record.answer.taken_ns = sent_ns - PERIOD_NS;
        query.record.answer.sent_ns = sent_ns;
        change(&mut query, place);
        messages.push(query.into());
    }
}

/// The answer turned into the refusal of a question that waits.
fn refused_unseen(query: &mut Query, reason: QueryRefusal) {
    query.record.answer.tick = 0;
    refused(query, reason.code());
}

/// What a worker records of a client that is gone: it sends nothing.
fn gone(query: &mut Query) {
    (query.record.answer.taken_ns, query.record.answer.sent_ns) = (0, 0);
    refused_unseen(query, QueryRefusal::ClientGone);
}

/// An acknowledgement of an alarm, accepted.
fn acknowledgement(query: &mut Query) {
    let (alarm, fleet) = (Alarm::OutOfRange, fnv1a("lab".bytes()));
    by_a_person(
        query,
        joulebus_plan::acknowledgement::encode(3, alarm, "ann", false, fleet).unwrap(),
    );
}

/// A statement of a battery, accepted.
fn statement(query: &mut Query) {
    let fleet = fnv1a("lab".bytes());
    by_a_person(query, joulebus_plan::statement::encode(3, Statement::Full, "ann", fleet).unwrap());
}

fn by_a_person(query: &mut Query, (header, values): (QueryHeader, Vec<f64>)) {
    let times = query.record.query;
    query.record.query =
        QueryHeader { asked_ns: times.asked_ns, deadline_ns: times.deadline_ns, ..header };
    query.values = values;
    (query.rows, query.power_w) = (Vec::new(), Vec::new());
    query.record.answer.tick = 0;
    refused(query, 0);
}

/// Waits of a process: four questions wait, and the fifth is refused at once.
fn four_wait(messages: &mut Messages, open: usize, change: impl Fn(&mut Query)) {
    let asked = [(65, 7), (66, 7), (66, 7), (66, 7), (66, 7), (66, 8)];
    wait(messages, &asked, open, |query, place| {
        if place == 0 {
            change(query);
        }
    });
}

/// Statements of many processes wait for a tick, and another one is refused at once.
fn statements_wait(messages: &mut Messages, open: usize, change: impl Fn(&mut Query, usize)) {
    let others = (0..64).map(|number| (66, 8 + number / 4));
    let asked: Vec<(u64, u32)> = std::iter::once((65, 7)).chain(others).collect();
    wait(messages, &asked, open, change);
}

/// The first is refused while `open` of the others wait.
fn wait(
    messages: &mut Messages,
    asked: &[(u64, u32)],
    open: usize,
    change: impl Fn(&mut Query, usize),
) {
    ask_at(messages, asked, |query, place| {
        change(query, place);
        let answer = &mut query.record.answer;
        match place {
            0 => {
                answer.taken_ns = answer.sent_ns;
                query.record.query.asked_ns = answer.taken_ns;
                refused_unseen(query, QueryRefusal::Busy);
            }
            // Taken after the refusal: it did not wait then.
            place if place > open => answer.taken_ns = answer.sent_ns,
            _ => {
                answer.taken_ns -= PERIOD_NS;
                query.record.query.asked_ns = answer.taken_ns;
            }
        }
    });
}

fn forged_keyframe(messages: &mut Messages, tick: u64) {
    let bytes = &mut piece(messages, tick, 0).rows;
    let last = bytes.len() - 1;
    bytes[last] ^= 1;
}

const TABLE: &[(&str, Verdict, Mutate)] = &[
    ("nothing", Verified, |_| {}),
    // Whole channels.
    ("all forecasts removed", NotCompared, remove_kind::<Forecasts>),
    ("all diagnostics removed", NotCompared, remove_kind::<Diagnostics>),
    ("all budgets removed", NotCompared, remove_kind::<Budgets>),
    ("all plan states removed", NotCompared, remove_kind::<PlanStates>),
    ("all outlooks removed", NotCompared, remove_kind::<Outlooks>),
    ("all outputs removed", NotCompared, |messages| {
        let kept =
            [MessageKind::of::<Samples>(), MessageKind::of::<Ticks>(), MessageKind::of::<State>()];
        remove(messages, |message| !kept.contains(&message.kind().unwrap()));
    }),
    ("all journals removed", Incomplete, remove_kind::<Ticks>),
    ("all keyframes removed", Incomplete, remove_kind::<State>),
    ("all samples removed", Incomplete, remove_kind::<Samples>),
    // Single frames and ticks.
    ("a frame of forecasts removed", Incomplete, |messages| {
        messages.remove(at::<Forecasts>(messages, TICK));
    }),
    ("a frame of budgets removed", Incomplete, |messages| {
        messages.remove(at::<Budgets>(messages, TICK));
    }),
    ("a frame of plan states removed", Incomplete, |messages| {
        messages.remove(at::<PlanStates>(messages, TICK));
    }),
    ("a journal removed", Incomplete, |messages| {
        messages.remove(at::<Ticks>(messages, TICK));
    }),
    ("a frame of samples removed", Incomplete, |messages| {
        let header = samples(messages, TICK).header;
        remove(messages, |message| {
            message.frame::<Samples>().is_some_and(|frame| frame.header == header)
        });
    }),
    ("a tick removed", Incomplete, |messages| remove_ticks(messages, TICK..=TICK)),
    ("ticks removed up to a keyframe", Incomplete, |messages| remove_ticks(messages, 41..=79)),
    ("ticks removed up to a keyframe, the others renumbered", Different, |messages| {
        remove_ticks(messages, 41..=79);
        renumber(messages, 80, 39);
    }),
    ("the first ticks removed, the keyframe before them kept", Incomplete, |messages| {
        remove(messages, |message| (1..=10).contains(&tick_of(message)));
    }),
    ("the first ticks and their keyframe removed", Verified, |messages| {
        remove_ticks(messages, 0..=10);
    }),
    (
        "a recording from the middle, with an old frame that a new reader receives",
        Verified,
        |messages| {
            let old = messages[at::<PlanStates>(messages, 5)].clone();
            remove_ticks(messages, 0..=60);
            messages.insert(0, old);
        },
    ),
    ("the last tick removed", Verified, |messages| remove_ticks(messages, TICKS..=TICKS)),
    ("the last frame of forecasts removed", Verified, |messages| {
        messages.remove(at::<Forecasts>(messages, TICKS));
    }),
    ("the last two frames of diagnostics removed", Verified, |messages| {
        messages.remove(at::<Diagnostics>(messages, TICKS));
        messages.remove(at::<Diagnostics>(messages, TICKS - 1));
    }),
    ("the last three frames of forecasts removed", Incomplete, |messages| {
        remove(messages, |message| {
            message.frame::<Forecasts>().is_some_and(|frame| frame.header.tick > TICKS - 3)
        });
    }),
    ("the last 63 frames of budgets removed", Incomplete, |messages| {
        remove(messages, |message| {
            message.frame::<Budgets>().is_some_and(|frame| frame.header.tick > TICKS - 63)
        });
    }),
    // Ends of runs that are none.
    ("a frame of a later run, and from there no journals and forecasts", Incomplete, |messages| {
        forge_from(messages, 41);
        remove_from(messages, 41, &[MessageKind::of::<Ticks>(), MessageKind::of::<Forecasts>()]);
        future_run(messages, 40, 1);
    }),
    ("a late frame of a later run, and from there budgets alone", Incomplete, |messages| {
        forge_from(messages, 41);
        let kinds = [
            MessageKind::of::<Ticks>(),
            MessageKind::of::<Forecasts>(),
            MessageKind::of::<Diagnostics>(),
            MessageKind::of::<PlanStates>(),
            MessageKind::of::<Outlooks>(),
        ];
        let samples = messages[at::<Diagnostics>(messages, TICK)].clone();
        remove_from(messages, 41, &kinds);
        messages.push(samples);
        future_run(messages, 40, 200);
        messages.retain(|message| {
            let order = message.order().filter(|_| message.frame::<Diagnostics>().is_some());
            order.is_none_or(|order| order.run != EPOCH || order.number <= 40)
        });
    }),
    ("the last 63 journals and forecasts removed, the others forged", Incomplete, |messages| {
        forge_from(messages, TICKS - 62);
        remove_from(
            messages,
            TICKS - 62,
            &[MessageKind::of::<Ticks>(), MessageKind::of::<Forecasts>()],
        );
    }),
    ("the last three journals and forecasts removed", Incomplete, |messages| {
        remove_from(
            messages,
            TICKS - 2,
            &[MessageKind::of::<Ticks>(), MessageKind::of::<Forecasts>()],
        );
    }),
    // Copies.
    ("a copy of forecasts in their tick", Verified, |messages| {
        copy::<Forecasts>(messages, TICK, |_| {});
    }),
    ("a copy of budgets four ticks later", Verified, |messages| {
        copy::<Budgets>(messages, TICK + 4, |_| {});
    }),
    ("a copy of a journal a hundred ticks later", Verified, |messages| {
        copy::<Ticks>(messages, TICK + 100, |_| {});
    }),
    ("other forecasts of the same tick", Incomplete, |messages| {
        copy::<Forecasts>(messages, TICK, other_bits);
    }),
    ("other forecasts of the same tick before the true ones", Incomplete, |messages| {
        let mut copy = messages[at::<Forecasts>(messages, TICK)].clone();
        other_bits(copy.frame_mut::<Forecasts>().unwrap());
        let place = at::<Forecasts>(messages, TICK);
        messages.insert(place, copy);
    }),
    ("other budgets of the tick four ticks later", Incomplete, |messages| {
        copy::<Budgets>(messages, TICK + 4, other_bits);
    }),
    ("another journal of the same tick", Incomplete, |messages| {
        copy::<Ticks>(messages, TICK, |frame| frame.header.start_ns += 1);
    }),
    ("another journal of the tick a hundred ticks later", Incomplete, |messages| {
        copy::<Ticks>(messages, TICK + 100, |frame| frame.header.start_ns += 1);
    }),
    ("a copy of samples", Verified, |messages| {
        let frame = samples(messages, TICK).clone();
        let place = at::<Ticks>(messages, TICK);
        messages.insert(place, frame.into());
    }),
    ("other samples of the same number", Incomplete, |messages| {
        let mut frame = samples(messages, TICK).clone();
        frame.rows[0].v_mps += 0.25;
        let place = at::<Ticks>(messages, TICK);
        messages.insert(place, frame.into());
    }),
    ("other samples of the same number, later", Incomplete, |messages| {
        let mut frame = samples(messages, TICK).clone();
        frame.rows[0].v_mps += 0.25;
        let place = at::<Ticks>(messages, TICK + 30);
        messages.insert(place, frame.into());
    }),
    ("samples that no tick took", Verified, |messages| {
        let mut frame = samples(messages, TICK).clone();
        frame.header.source_id = 77;
        let place = at::<Ticks>(messages, TICK);
        messages.insert(place, frame.into());
    }),
    // Order.
    ("two ticks in another order", Verified, |messages| {
        let (one, two) = (at::<Forecasts>(messages, TICK), at::<Forecasts>(messages, TICK + 1));
        messages.swap(one, two);
    }),
    ("a journal before its samples", Verified, |messages| {
        let journal = messages.remove(at::<Ticks>(messages, TICK));
        let place = at::<Ticks>(messages, TICK - 1);
        messages.insert(place, journal);
    }),
    ("forecasts a hundred ticks late", Incomplete, |messages| {
        let late = messages.remove(at::<Forecasts>(messages, TICK));
        let place = at::<Ticks>(messages, TICK + 100);
        messages.insert(place, late);
    }),
    // The journal.
    ("a taken frame left out", Different, |messages| {
        frame::<Ticks>(messages, TICK).rows.remove(0);
    }),
    ("taken frames in another order", Different, |messages| {
        frame::<Ticks>(messages, TICK).rows.swap(0, 1);
    }),
    ("a new normal added", Different, |messages| {
        let start_ns = frame::<Ticks>(messages, TICK).header.start_ns;
        frame::<Ticks>(messages, TICK).rows.push(TakenFrame::stated(
            2,
            Statement::NewNormal,
            start_ns,
        ));
    }),
    ("the time of a taken frame", Different, |messages| {
        frame::<Ticks>(messages, TICK).rows[0].taken_ns += 1;
    }),
    ("the number of samples of a taken frame", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).rows[0].samples -= 1;
    }),
    ("the number of a taken frame", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).rows[0].frame_seq += 1_000;
    }),
    ("a tick that denies its diagnostics", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).header.flags |= tick_flag::NO_DIAGNOSTICS;
    }),
    ("a tick that denies its plan states", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).header.flags &= !tick_flag::PLAN_STATES;
    }),
    ("a tick that claims outlooks", Incomplete, |messages| {
        // In ticks 70 to 79 nobody reads them.
        frame::<Ticks>(messages, 75).header.flags |= tick_flag::OUTLOOKS;
    }),
    // Numbers that are as large as they can be.
    ("the first journal with the last number of all", Incomplete, |messages| {
        frame::<Ticks>(messages, 1).header.tick = u64::MAX;
    }),
    ("a journal with the last number of all", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).header.tick = u64::MAX;
    }),
    ("forecasts of the last run and tick of all", Incomplete, |messages| {
        let header = &mut frame::<Forecasts>(messages, TICK).header;
        (header.worker_epoch, header.tick) = (u64::MAX, u64::MAX - 1);
    }),
    ("the first keyframe with the last number of all", Incomplete, |messages| {
        for place in pieces(messages, 0) {
            messages[place].frame_mut::<State>().unwrap().header.tick = u64::MAX;
        }
    }),
    ("an answer with the last number of all", Incomplete, |messages| {
        ask(messages, |query| query.record.number = u64::MAX);
    }),
    ("a frame of samples with the last number of all", Incomplete, |messages| {
        samples(messages, TICK).header.frame_seq = u64::MAX;
    }),
    // Rows of single robots.
    ("a robot's row of a frame that no rows follow", Incomplete, |messages| {
        let place = at::<Forecasts>(messages, TICK);
        let mut rows = Messages::new();
        messages[place].each_robot(|row| rows.push(row));
        let mut row = rows.swap_remove(3);
        row.get_mut::<RobotRow<Forecasts>>().unwrap().0.stamp_ns ^= 1;
        messages.insert(place + 1, row);
    }),
    // Runs.
    ("a frame of another run", Incomplete, |messages| {
        frame::<Forecasts>(messages, TICK).header.worker_epoch += 1;
    }),
    ("a journal of another run", Incomplete, |messages| {
        frame::<Ticks>(messages, TICK).header.worker_epoch += 1;
    }),
    ("a frame of another tick", Incomplete, |messages| {
        frame::<Forecasts>(messages, TICK).header.tick += 1_000;
    }),
    ("a second run", Verified, |messages| *messages = two_runs()),
    ("a second run without its first ticks", Incomplete, |messages| {
        let second =
            |message: &Message| message.order().is_some_and(|order| order.run == EPOCH + 1);
        *messages = two_runs();
        remove(messages, |message| second(message) && (1..=20).contains(&tick_of(message)));
    }),
    ("a second run without its first keyframe", Incomplete, |messages| {
        *messages = two_runs();
        remove(messages, |message| {
            let piece = message.frame::<State>().map(|piece| piece.header);
            piece.is_some_and(|header| (header.worker_epoch, header.tick) == (EPOCH + 1, 0))
        });
    }),
    ("the first of two runs removed", Verified, |messages| {
        *messages = two_runs();
        remove(messages, |message| message.order().is_some_and(|order| order.run == EPOCH));
    }),
    ("a run between two others removed", Verified, |messages| {
        // What was sent between them is not known: a worker may have been down.
        let mut simulation = Simulation::new(4);
        for _ in 0..3 {
            simulation.run(90);
            simulation.restart();
        }
        *messages = simulation.sent;
        remove(messages, |message| message.order().is_some_and(|order| order.run == EPOCH + 1));
    }),
    ("the recording twice", Verified, |messages| messages.extend(messages.clone())),
    // Keyframes. What a platform remembers goes on from there, so the next ones differ.
    ("a bit of the first keyframe", Different, |messages| forged_keyframe(messages, 0)),
    ("a bit of a keyframe", Different, |messages| forged_keyframe(messages, KEYFRAME_EVERY)),
    ("a bit of the last keyframe", Different, |messages| forged_keyframe(messages, 160)),
    ("a keyframe of garbage", Different, |messages| {
        let pieces = pieces(messages, 80);
        for place in pieces {
            messages[place].frame_mut::<State>().unwrap().rows.fill(7);
        }
    }),
    ("a first keyframe of garbage", Incomplete, |messages| {
        let pieces = pieces(messages, 0);
        for place in pieces {
            messages[place].frame_mut::<State>().unwrap().rows.fill(7);
        }
    }),
    ("a piece of the first keyframe removed", Incomplete, |messages| {
        messages.remove(pieces(messages, 0)[1]);
    }),
    ("a piece of a keyframe removed", Incomplete, |messages| {
        messages.remove(pieces(messages, 80)[1]);
    }),
    ("the first piece of a keyframe removed", Incomplete, |messages| {
        messages.remove(pieces(messages, 80)[0]);
    }),
    ("the last piece of the last keyframe removed", Verified, |messages| {
        messages.remove(*pieces(messages, 160).last().unwrap());
    }),
    ("a copy of a piece of a keyframe", Verified, |messages| {
        let place = pieces(messages, 80)[1];
        messages.insert(place, messages[place].clone());
    }),
    ("a copy of a keyframe, later", Verified, |messages| {
        let copy: Messages =
            pieces(messages, 40).into_iter().map(|place| messages[place].clone()).collect();
        let place = at::<Ticks>(messages, 120);
        messages.splice(place..place, copy);
    }),
    ("another piece of a keyframe", Incomplete, |messages| {
        let place = pieces(messages, 80)[1];
        let mut copy = messages[place].clone();
        copy.frame_mut::<State>().unwrap().rows[5] ^= 1;
        messages.insert(place + 1, copy);
    }),
    ("a keyframe removed", Incomplete, |messages| {
        remove(messages, |message| {
            message.frame::<State>().is_some_and(|piece| piece.header.tick == 80)
        });
    }),
    ("the last keyframe removed", Verified, |messages| {
        remove(messages, |message| {
            message.frame::<State>().is_some_and(|piece| piece.header.tick == 160)
        });
    }),
    ("the keyframe before the first tick removed", Incomplete, |messages| {
        remove_keyframes(messages, |tick| tick == 0);
    }),
    ("the samples of the first ticks removed", Incomplete, |messages| {
        let mut left = 60;
        messages.retain(|message| {
            left -= i32::from(message.frame::<Samples>().is_some());
            left < 0 || message.frame::<Samples>().is_none()
        });
    }),
    ("the samples of the first ticks removed, from the middle", Incomplete, |messages| {
        remove_ticks(messages, 0..=36);
        let first = at::<Ticks>(messages, 37);
        let last = at::<Ticks>(messages, 60);
        let mut place = 0;
        messages.retain(|message| {
            place += 1;
            (place > first + 1 && place <= last + 1 && message.frame::<Samples>().is_some())
                .eq(&false)
        });
    }),
    ("all keyframes after the first removed", Incomplete, |messages| {
        *messages = recorded(4, 700);
        remove_keyframes(messages, |tick| tick > 0);
    }),
    ("keyframes in the middle removed, the others name none", Incomplete, |messages| {
        remove_keyframes(messages, |tick| (40..=120).contains(&tick));
        for message in messages {
            if let Some(piece) = message.frame_mut::<State>() {
                piece.header.before_hash = 0;
            }
        }
    }),
    ("a keyframe that names none", Incomplete, |messages| {
        for place in pieces(messages, 80) {
            messages[place].frame_mut::<State>().unwrap().header.before_hash = 0;
        }
    }),
    (
        "a forged keyframe after the next one, and each names the one before it",
        Incomplete,
        |messages| {
            forged_keyframe(messages, 80);
            let moved: Messages =
                pieces(messages, 80).into_iter().map(|at| messages[at].clone()).collect();
            remove_keyframes(messages, |tick| tick == 80);
            let place = pieces(messages, 120).last().unwrap() + 1;
            messages.splice(place..place, moved);
            for (tick, before) in [(120, 40), (80, 120), (160, 80)] {
                let bytes: Vec<u8> = pieces(messages, before)
                    .into_iter()
                    .flat_map(|at| messages[at].frame::<State>().unwrap().rows.clone())
                    .collect();
                let before_hash = fnv1a(bytes);
                for at in pieces(messages, tick) {
                    messages[at].frame_mut::<State>().unwrap().header.before_hash = before_hash;
                }
            }
        },
    ),
    // Questions.
    ("six answers", Verified, |messages| ask(messages, |_| {})),
    ("an answer forged", Different, |messages| ask(messages, forged)),
    ("the period in an answer", Different, |messages| {
        ask(messages, |query| query.record.answer.period_ns ^= 1);
    }),
    ("the number in an answer", Different, |messages| {
        ask(messages, |query| query.record.answer.number ^= 1);
    }),
    ("an answer forged, of a tick that is not there", Incomplete, |messages| {
        ask(messages, |query| {
            forged(query);
            query.record.answer.tick = 999_999;
        });
    }),
    ("an answer forged, of a tick before the recording", Incomplete, |messages| {
        remove_ticks(messages, 0..=20);
        ask(messages, |query| {
            forged(query);
            (query.record.answer.tick, query.record.answer.budget_tick) = (1, 1);
        });
    }),
    ("an answer forged, of another run", Incomplete, |messages| {
        ask(messages, |query| {
            forged(query);
            let answer = &mut query.record.answer;
            (answer.worker_epoch, answer.budget_epoch) = (EPOCH + 1, EPOCH + 1);
        });
    }),
    ("an answer forged, as an acknowledgement", Different, |messages| {
        ask(messages, |query| {
            forged(query);
            query.record.query.kind = QueryKind::Acknowledge.code();
        });
    }),
    ("an answer refused for a reason that is not defined", Incomplete, |messages| {
        ask(messages, |query| refused(query, 15));
    }),
    ("a plan refused as an alarm that is not raised", Incomplete, |messages| {
        ask(messages, |query| refused(query, QueryRefusal::NotRaised.code()));
    }),
    ("an answer refused as too late, before its deadline", Incomplete, |messages| {
        ask(messages, |query| {
            query.record.query.deadline_ns = 1_000;
            query.record.answer.sent_ns = 999;
            refused(query, QueryRefusal::Deadline.code());
        });
    }),
    ("an answer of a tick refused as if there was none", Incomplete, |messages| {
        ask(messages, |query| refused(query, QueryRefusal::NoFrame.code()));
    }),
    // Refusals for reasons of time.
    ("answers of a whole recording", Verified, |messages| {
        ask_at(messages, &[(60, 7), (65, 7), (100, 8), (170, 7)], |_, _| {});
    }),
    ("an answer refused as if the worker ended, in the middle", Incomplete, |messages| {
        ask_at(messages, &[(60, 7), (65, 7)], |query, place| {
            if place == 1 {
                refused_unseen(query, QueryRefusal::Ending);
            }
        });
    }),
    ("questions refused because the worker ends", Verified, |messages| {
        ask_at(messages, &[(65, 7), (TICKS, 7), (TICKS, 8)], |query, place| {
            if place > 0 {
                refused_unseen(query, QueryRefusal::Ending);
            }
        });
    }),
    ("questions refused because the first of two workers ends", Verified, |messages| {
        *messages = two_runs();
        ask_at(messages, &[(65, 7), (TICKS, 7), (TICKS, 8)], |query, place| {
            if place > 0 {
                refused_unseen(query, QueryRefusal::Ending);
            }
        });
    }),
    ("an answer refused as if the worker ended, and another follows", Incomplete, |messages| {
        ask_at(messages, &[(TICKS, 7), (TICKS, 8)], |query, place| {
            if place == 0 {
                refused_unseen(query, QueryRefusal::Ending);
            }
        });
    }),
    ("an answer refused as if the worker ended, without times", Incomplete, |messages| {
        ask(messages, |query| refused_unseen(query, QueryRefusal::Ending));
    }),
    ("an answer refused as if its client was gone, with times", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (66, 8)], |query, place| {
            if place == 0 {
                refused_unseen(query, QueryRefusal::ClientGone);
            }
        });
    }),
    ("an answer refused as if its client was gone, which asks again", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (66, 8), (67, 7)], |query, place| {
            if place == 0 {
                gone(query);
            }
        });
    }),
    ("an answer refused as if its client was gone, which acknowledges", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (67, 7)], |query, place| match place {
            0 => gone(query),
            _ => acknowledgement(query),
        });
    }),
    ("a client that is gone with two questions", Verified, |messages| {
        ask_at(messages, &[(65, 7), (66, 8), (67, 8), (70, 9)], |query, place| {
            if (1..3).contains(&place) {
                gone(query);
            }
        });
    }),
    ("an answer refused as if it could not be sent", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (66, 8)], |query, place| {
            if place == 0 {
                refused(query, QueryRefusal::Unsent.code());
            }
        });
    }),
    ("the last answer refused as if it could not be sent", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (TICKS, 8)], |query, place| {
            if place == 1 {
                refused(query, QueryRefusal::Unsent.code());
            }
        });
    }),
    ("a question refused while four of its process wait", Verified, |messages| {
        four_wait(messages, 4, |_| {});
    }),
    ("an answer refused as if four waited, of which one was taken later", Incomplete, |messages| {
        four_wait(messages, 3, |_| {});
    }),
    ("an answer refused as if four of its process waited, of others", Incomplete, |messages| {
        four_wait(messages, 4, |query| query.record.client = 8);
    }),
    ("an answer refused as if four waited, with copies of one", Incomplete, |messages| {
        four_wait(messages, 1, |_| {});
        let copy = messages[messages.len() - 5].clone();
        messages.extend([copy.clone(), copy.clone(), copy]);
    }),
    ("a statement refused while 64 of other processes wait for a tick", Verified, |messages| {
        statements_wait(messages, 64, |query, _| statement(query));
    }),
    ("a statement refused as if 64 waited, of which one came later", Incomplete, |messages| {
        statements_wait(messages, 63, |query, _| statement(query));
    }),
    ("a statement refused as if 64 waited, of which one is a question", Incomplete, |messages| {
        statements_wait(messages, 64, |query, place| {
            if place != 9 {
                statement(query);
            }
        });
    }),
    ("a question refused as if 64 statements were its own", Incomplete, |messages| {
        statements_wait(messages, 64, |query, place| {
            if place > 0 {
                statement(query);
            }
        });
    }),
    ("an answer refused as if others waited, alone", Incomplete, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| refused_unseen(query, QueryRefusal::Busy));
    }),
    ("an answer refused as if there was no frame, at once", Incomplete, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| refused_unseen(query, QueryRefusal::NoFrame));
    }),
    ("an answer refused as too late, and a later one was sent before", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (66, 8)], |query, place| {
            if place == 0 {
                query.record.answer.sent_ns = query.record.query.deadline_ns;
                refused_unseen(query, QueryRefusal::Deadline);
            }
        });
    }),
    ("a question that was too late", Verified, |messages| {
        ask_at(messages, &[(65, 7), (66, 8)], |query, place| {
            if place == 0 {
                query.record.query.deadline_ns = query.record.answer.sent_ns;
                refused_unseen(query, QueryRefusal::Deadline);
            }
        });
    }),
    ("an acknowledgement", Verified, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| acknowledgement(query));
    }),
    ("an acknowledgement refused as if the worker ended", Incomplete, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| {
            acknowledgement(query);
            refused_unseen(query, QueryRefusal::Ending);
        });
    }),
    ("an acknowledgement refused as if too many were kept", Incomplete, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| {
            acknowledgement(query);
            refused_unseen(query, QueryRefusal::Busy);
        });
    }),
    ("an acknowledgement refused as a kind that is not known", Different, |messages| {
        ask_at(messages, &[(65, 7)], |query, _| {
            acknowledgement(query);
            refused_unseen(query, QueryRefusal::Kind);
        });
    }),
    ("refusals as they are sent, twice", Verified, |messages| {
        four_wait(messages, 4, |_| {});
        messages.extend(messages.clone());
    }),
    ("another answer of the same number, refused", Incomplete, |messages| {
        ask_at(messages, &[(65, 7), (66, 8)], |_, _| {});
        let mut copy = messages[messages.len() - 2].clone();
        gone(copy.get_mut::<Query>().unwrap());
        messages.push(copy);
    }),
    ("one of six answers removed", Incomplete, |messages| {
        ask(messages, |_| {});
        messages.remove(messages.len() - 3);
    }),
    ("a frame of acknowledgements removed", Incomplete, |messages| {
        for number in [1, 3] {
            let header = AcknowledgementHeader { server_epoch: 1, number, ..Default::default() };
            messages.push(Message::of::<Acknowledgements>(header, Vec::new()));
        }
    }),
    ("the hash of the keyframe before", Incomplete, |messages| {
        for place in pieces(messages, 80) {
            messages[place].frame_mut::<State>().unwrap().header.before_hash ^= 1;
        }
    }),
    ("a keyframe of another tick", Different, |messages| {
        for place in pieces(messages, 80) {
            messages[place].frame_mut::<State>().unwrap().header.tick += 1;
        }
    }),
    ("a keyframe of a tick that is not there", Incomplete, |messages| {
        for place in pieces(messages, 160) {
            messages[place].frame_mut::<State>().unwrap().header.tick += 1_000;
        }
    }),
    ("a keyframe of another run", Incomplete, |messages| {
        for place in pieces(messages, 80) {
            messages[place].frame_mut::<State>().unwrap().header.worker_epoch += 1;
        }
    }),
    // What a capture alone cannot show: what a worker that sends this would have recorded.
    ("diagnostics that the journal denies removed", Verified, |messages| {
        frame::<Ticks>(messages, TICK).header.flags |= tick_flag::NO_DIAGNOSTICS;
        messages.remove(at::<Diagnostics>(messages, TICK));
    }),
    ("a forged recording that is consistent", Verified, |messages| {
        let mut simulation = Simulation::new(7);
        simulation.run(TICKS);
        *messages = simulation.sent;
    }),
];

#[test]
fn each_mutation_of_a_recording_has_its_verdict() {
    let messages = recorded(4, TICKS);
    let mut wrong = Vec::new();
    for (name, verdict, mutate) in TABLE {
        let mut mutated = messages.clone();
        mutate(&mut mutated);
        let report = verify(entries(mutated));
        if report.verdict != *verdict {
            wrong.push(format!("{name}: expected {verdict}, found {report}"));
        }
    }
    assert!(TABLE.len() >= 60, "{}", TABLE.len());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn copies_of_samples_are_not_samples_that_no_tick_took() {
    let messages = recorded(4, TICKS);
    let untaken = |messages: Messages| verify(entries(messages)).untaken_frames;
    let twice = messages.iter().flat_map(|message| [message.clone(), message.clone()]).collect();
    assert_eq!(untaken(messages.clone()), 0);
    assert_eq!(untaken(twice), 0);
    let mut other = messages;
    let mut frame = samples(&mut other, TICK).clone();
    frame.header.source_id = 77;
    other.push(frame.into());
    assert_eq!(untaken(other), 1);
}

#[test]
fn the_beginning_of_a_recording_excuses_ten_seconds_without_a_keyframe() {
    let messages = recorded(4, 400);
    // The next keyframes follow after 8 s, and after 11 s.
    for (last, verdict) in [(200, Verified), (320, Incomplete)] {
        let mut mutated = messages.clone();
        remove_ticks(&mut mutated, 0..=2);
        remove(&mut mutated, |message| {
            message.frame::<State>().is_some_and(|piece| piece.header.tick <= last)
        });
        let report = verify(entries(mutated));
        assert_eq!(report.verdict, verdict, "{report}");
        assert_eq!(report.coverage[0].recomputed, [(last + KEYFRAME_EVERY + 1, 400)], "{report}");
    }
}

/// What `record --per-robot` adds: each frame's rows again, one message for each robot.
#[test]
fn rows_of_single_robots_are_compared_with_their_frames() {
    let mut messages = Messages::new();
    for message in recorded(4, 90) {
        let mut rows = Messages::new();
        if message.kind().unwrap().has_robots() {
            message.each_robot(|row| rows.push(row));
        }
        messages.push(message);
        messages.extend(rows);
    }
    assert!(verify(entries(messages.clone())).is_clean());
    let is_row = |place: &usize| messages[*place].get::<RobotRow<Forecasts>>().is_some();
    let places: Vec<usize> = (0..messages.len()).filter(is_row).collect();
    for place in [places[0], places[places.len() / 2]] {
        let mut mutated = messages.clone();
        mutated[place].get_mut::<RobotRow<Forecasts>>().unwrap().0.stamp_ns ^= 1;
        let report = verify(entries(mutated));
        assert_eq!((report.verdict, report.frames_ambiguous), (Incomplete, 1), "{report}");
    }
}

/// Fields of headers that do not follow from samples: times of sending, the process, its schedule.
const FREE: &[&str] = &[
    "schema",
    "pid",
    "compute_end_ns",
    "sent_ns",
    "sent_unix_ns",
    "taken_ns",
    // A missed deadline raises an alarm only if others were missed before.
    "flags",
    "ticks_skipped",
    "ticks_late",
    "reserved",
];
/// Fields that place a frame: it is missing at one place, and too much at another.
const PLACES: &[&str] = &[
    "worker_epoch",
    "tick",
    "source_id",
    "source_epoch",
    "frame_seq",
    "unlisted",
    "truncated",
    "samples",
    "total_bytes",
    "offset",
    "before_hash",
];

fn expected(field: &str) -> Verdict {
    if FREE.contains(&field) {
        Verified
    } else if PLACES.contains(&field) {
        Incomplete
    } else {
        Different
    }
}

/// Flips a bit in each field of a channel's header, and of one of its rows.
fn flip_fields<C: Channel>(messages: &Messages, place: usize, row: usize, wrong: &mut Vec<String>) {
    let mut check = |what: &str, expected: Verdict, mutated: Messages| {
        let report = verify(entries(mutated));
        if report.verdict != expected {
            wrong.push(format!("{}.{what}: expected {expected}, found {report}", C::MESSAGE));
        }
        report
    };
    for field in C::Header::LAYOUT.fields {
        let mut mutated = messages.clone();
        let header = &mut mutated[place].frame_mut::<C>().unwrap().header;
        bytemuck::bytes_of_mut(header)[field.offset] ^= 1;
        check(field.name, expected(field.name), mutated);
    }
    for field in C::Row::LAYOUT.fields {
        let mut mutated = messages.clone();
        let row = &mut mutated[place].frame_mut::<C>().unwrap().rows[row];
        let robot = C::robot(row);
        bytemuck::bytes_of_mut(row)[field.offset] ^= 1;
        let of_journal = C::MESSAGE == Ticks::MESSAGE && field.name != "taken_ns";
        let expected = if of_journal { expected(field.name) } else { Different };
        let report = check(&format!("rows.{}", field.name), expected, mutated);
        // A bit of an output is one difference, named with its tick, robot and field.
        if robot.is_some() {
            let first = report.first.clone().unwrap();
            assert_eq!((first.tick, first.robot), (TICK, robot), "{report}");
            assert!(first.field.ends_with(&format!(".{}", field.name)), "{report}");
            assert_ne!(first.recorded, first.computed, "{report}");
            assert_eq!((report.differences, report.ticks_verified), (1, 90), "{report}");
        }
    }
}

#[test]
fn each_field_of_each_channel_is_compared_and_named_or_does_not_follow_from_samples() {
    let messages = recorded(4, 90);
    let mut wrong = Vec::new();
    flip_fields::<Forecasts>(&messages, at::<Forecasts>(&messages, TICK), 5, &mut wrong);
    flip_fields::<Diagnostics>(&messages, at::<Diagnostics>(&messages, TICK), 5, &mut wrong);
    flip_fields::<Budgets>(&messages, at::<Budgets>(&messages, TICK), 5, &mut wrong);
    flip_fields::<PlanStates>(&messages, at::<PlanStates>(&messages, TICK), 5, &mut wrong);
    flip_fields::<Outlooks>(&messages, at::<Outlooks>(&messages, TICK), 5, &mut wrong);
    flip_fields::<Ticks>(&messages, at::<Ticks>(&messages, TICK), 0, &mut wrong);
    flip_fields::<State>(&messages, pieces(&messages, 40)[1], 0, &mut wrong);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}
