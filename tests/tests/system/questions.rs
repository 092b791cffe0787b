//! Rows 29 to 32: questions about plans that the worker answers: killed clients and workers,
//! floods, hostile questions, the same bits as in the planner's process, recordings.

use std::collections::BTreeMap;
use std::fs;

use joulebus_capture_format::{Query, Reader};
use joulebus_tests::{
    Arena, AskerLine, Child, Dice, PATIENCE, Setup, Spread, alone, eventually, figure, spoilt,
};
use joulebus_wire::QueryRefusal;
use rustix::process::Signal;

const ROBOTS: u32 = 4;
const HZ: f64 = 30.0;

fn setup() -> Setup {
    Setup {
        max_planners: 12,
        more: "[platform.battery]\ncapacity_wh = 10.0\ninitial_soc_lo = 0.9\n".to_owned(),
        ..Setup::simulated()
    }
}

/// A client under test.
struct Asker {
    child: Child,
    read: usize,
}

impl Asker {
    fn new(arena: &Arena, arguments: &[&str]) -> Self {
        Self { child: arena.member(&arguments.join(" "), arguments), read: 0 }
    }

    /// The next line; `None` at the end of the output.
    fn next(&mut self) -> Option<AskerLine> {
        let line = self.child.lines(self.read, PATIENCE).into_iter().next()?;
        self.read += 1;
        Some(serde_json::from_str(&line).unwrap_or_else(|error| panic!("{error} in {line:?}")))
    }

    fn until<T>(&mut self, what: &str, wanted: impl Fn(&AskerLine) -> Option<T>) -> T {
        loop {
            let Some(line) = self.next() else {
                panic!("{what}: {}", self.child.tail());
            };
            if let Some(found) = wanted(&line) {
                return found;
            }
        }
    }

    fn is_asking(&mut self) {
        self.until("an answer", |line| (*line == AskerLine::Asking).then_some(()));
    }

    fn rest(&mut self) -> Vec<AskerLine> {
        std::iter::from_fn(|| self.next()).collect()
    }

    fn done(&mut self) -> u64 {
        self.until("its end", |line| match line {
            AskerLine::Done { answered } => Some(*answered),
            _ => None,
        })
    }
}

/// Open file descriptors of a process, and objects of the arena in shared memory.
fn held(arena: &Arena, pid: u32) -> (usize, usize) {
    let descriptors = fs::read_dir(format!("/proc/{pid}/fd")).map_or(0, Iterator::count);
    (descriptors, arena.stale_files().len())
}

/// Minimum held at any time, once all is open: some descriptors are open for moments only.
fn least(arena: &Arena, pid: u32) -> (usize, usize) {
    let mut last = (0, 0);
    eventually("as little is held as before", || {
        let looks = (0..100).map(|_| {
            std::thread::sleep(std::time::Duration::from_millis(5));
            held(arena, pid)
        });
        let now = looks
            .fold((usize::MAX, usize::MAX), |least, now| (least.0.min(now.0), least.1.min(now.1)));
        std::mem::replace(&mut last, now) == now
    });
    last
}

#[test]
fn clients_killed_in_the_middle_of_a_question_leave_nothing_behind_and_others_are_answered() {
    let rounds = Dice::rounds("JOULEBUS_ASK_KILLS", 40);
    let mut dice = Dice::roll();
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut witness = Asker::new(&arena, &["asker", "flood"]);
    witness.is_asking();
    let before = least(&arena, worker.pid());
    let mut killed = 0;
    while killed < rounds {
        let batch: Vec<Asker> = (0..5)
            .map(|_| {
                Asker::new(&arena, &["asker", if killed % 2 == 0 { "flood" } else { "heavy" }])
            })
            .collect();
        for mut asker in batch {
            // Some while they start.
            if dice.below(4) > 0 {
                asker.is_asking();
            }
            asker.child.kill();
            killed += 1;
        }
    }
    let mut now = before;
    eventually(
        &format!("what {killed} killed clients held is given back, before {before:?}"),
        || {
            let found = held(&arena, worker.pid());
            if found != now {
                println!("descriptors and objects: {found:?}");
            }
            now = found;
            now.0 <= before.0 && now.1 <= before.1
        },
    );
    witness.child.finish();
    let answered = witness.done();
    source.finish();
    let report = worker.stop().json();
    assert!(report["queries"]["answered"].as_u64().unwrap() >= answered, "{report}");
    figure("questions, clients killed", format_args!("{killed}, {answered} others answered"));
}

#[test]
fn connections_of_clients_that_left_while_their_questions_were_unread_are_given_back() {
    const AT_ONCE: usize = 8;
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let _source = arena.controller("source", 0, ROBOTS, HZ);
    let mut witness = Asker::new(&arena, &["asker", "flood"]);
    witness.is_asking();
    let before = least(&arena, worker.pid());
    for round in 0..3 {
        let mut askers = [(); AT_ONCE].map(|()| Asker::new(&arena, &["asker", "late"]));
        askers.iter_mut().for_each(Asker::is_asking);
        let objects = arena.stale_files().len();
        worker.signal(Signal::STOP);
        for asker in &mut askers {
            // The question that it gave up before lies in the queue, unread.
            asker.until("a full queue", |line| match line {
                AskerLine::Failed { name, .. } if name == "Full" => Some(()),
                _ => None,
            });
        }
        for asker in &mut askers {
            asker.child.kill();
        }
        // Removed by the source, while the worker does not look.
        eventually("the killed clients' objects are removed", || {
            arena.stale_files().len() + AT_ONCE <= objects
        });
        worker.signal(Signal::CONT);
        eventually(
            &format!("round {round}: the worker holds what it held before, {before:?}"),
            || {
                let now = held(&arena, worker.pid());
                now.0 <= before.0 && now.1 <= before.1
            },
        );
    }
    witness.child.finish();
    let failed = witness.rest().into_iter().find_map(|line| match line {
        AskerLine::Failed { name, .. } => Some(name),
        _ => None,
    });
    assert_eq!(failed, None, "a client that stays is answered all the time");
}

#[test]
fn a_worker_that_ends_refuses_the_questions_that_wait() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let _source = arena.controller("source", 0, ROBOTS, HZ);
    let mut askers = [(); 6].map(|()| Asker::new(&arena, &["asker", "heavy"]));
    askers.iter_mut().for_each(Asker::is_asking);
    let report = worker.stop().json();
    let mut names = BTreeMap::<String, u64>::new();
    for asker in &mut askers {
        let name = asker.until("an error", |line| match line {
            AskerLine::Failed { name, .. } => Some(name.clone()),
            _ => None,
        });
        assert_ne!(name, "TimedOut");
        *names.entry(name).or_default() += 1;
        asker.child.finish();
    }
    // One is answered at a time: the others wait.
    assert!(names.contains_key("Ending"), "{names:?}");
    let counted = report["queries"]["refused"]["Ending"].as_u64();
    assert!(counted >= names.get("Ending").copied(), "{report}");
}

#[test]
fn a_killed_worker_is_an_error_at_once_and_the_next_one_answers() {
    let rounds = Dice::rounds("JOULEBUS_ANSWERER_KILLS", 20);
    let mut dice = Dice::roll();
    let arena = Arena::new(&setup());
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut askers = [(); 2].map(|()| Asker::new(&arena, &["asker", "heavy"]));
    let mut errors = BTreeMap::<String, u64>::new();
    let mut spread = Spread::default();
    for _ in 0..rounds {
        let mut worker = arena.worker();
        askers.iter_mut().for_each(Asker::is_asking);
        std::thread::sleep(dice.time_below(std::time::Duration::from_millis(20)));
        worker.kill();
        for asker in &mut askers {
            let (name, after_ns) = asker.until("an error", |line| match line {
                AskerLine::Failed { name, after_ns } => Some((name.clone(), *after_ns)),
                _ => None,
            });
            // Never a time-out: its two minutes have not passed.
            assert!(["WorkerGone", "NoWorker"].contains(&name.as_str()), "{name}");
            spread.add_ns(after_ns);
            *errors.entry(name).or_default() += 1;
        }
    }
    let mut worker = arena.worker();
    for asker in &mut askers {
        asker.is_asking();
        asker.child.finish();
    }
    source.finish();
    worker.stop();
    figure(
        "questions, workers killed",
        format_args!("{rounds}: {errors:?}, asked before {spread}"),
    );
}

#[test]
fn a_stopped_worker_is_a_time_out_and_answers_again_when_it_continues() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let _source = arena.controller("source", 0, ROBOTS, HZ);
    let mut asker = Asker::new(&arena, &["asker", "late"]);
    asker.is_asking();
    worker.signal(Signal::STOP);
    let after_ns = asker.until("a time-out", |line| match line {
        AskerLine::Failed { name, after_ns } if name == "TimedOut" => Some(*after_ns),
        _ => None,
    });
    assert!(after_ns >= 200_000_000, "{after_ns}");
    worker.signal(Signal::CONT);
    asker.is_asking();
}

#[test]
fn a_calm_client_is_served_next_whatever_others_ask() {
    const ASKED: u64 = 100;
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut floods = [(); 3].map(|()| Asker::new(&arena, &["asker", "heavy"]));
    floods.iter_mut().for_each(Asker::is_asking);
    let file = arena.files().join("fair.mcap");
    let mut recorder = arena.recording(&file, &["--topics", "queries"]);
    let mut calm = Asker::new(&arena, &["asker", "calm", &ASKED.to_string()]);
    let calm_pid = calm.child.pid();
    assert_eq!(calm.next(), Some(AskerLine::Done { answered: ASKED }));
    for flood in &mut floods {
        flood.child.finish();
    }
    recorder.end();
    source.finish();
    worker.stop();
    let queries = queries(&file);
    let (own, others): (Vec<&Query>, Vec<&Query>) =
        queries.iter().partition(|query| query.record.client == calm_pid);
    // Each of the others has had an answer, if only its last one.
    assert!(own.len() as u64 > ASKED / 2 && others.len() >= 3, "{} {}", own.len(), others.len());
    for query in own {
        let answer = &query.record.answer;
        assert_eq!(answer.refusal, 0);
        let overtook = others.iter().filter(|other| {
            let other = &other.record.answer;
            answer.taken_ns < other.taken_ns && other.sent_ns < answer.sent_ns
        });
        // They have used more time by then: a question of several robots that comes later waits.
        assert_eq!(overtook.count(), 0, "{:?}", query.record);
    }
}

fn queries(file: &std::path::Path) -> Vec<Query> {
    let mut reader = Reader::open(file).unwrap();
    let mut found = Vec::new();
    while let Some(entry) = reader.next_entry().unwrap() {
        found.extend(entry.message.take::<Query>());
    }
    found
}

#[test]
fn hostile_questions_are_refused_by_reason_and_counted_and_harm_nobody() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut witness = Asker::new(&arena, &["asker", "flood"]);
    witness.is_asking();
    let mut hostile = Asker::new(&arena, &["asker", "hostile"]);
    let mut reasons = BTreeMap::<String, u64>::new();
    while let Some(line) = hostile.next() {
        let AskerLine::Refused { expected, found } = line else {
            break;
        };
        assert_eq!(found, expected);
        *reasons.entry(found).or_default() += 1;
    }
    hostile.child.finish();
    witness.child.finish();
    let answered = witness.done();
    source.finish();
    let report = worker.stop().json();
    let counted = &report["queries"]["refused"];
    for (reason, count) in &reasons {
        // Longer ones are not even sent.
        let sent = count - u64::from(reason == "TooLarge");
        assert!(counted[reason].as_u64().unwrap_or(0) >= sent, "{reason}: {report}");
    }
    assert_eq!(reasons.len(), 8, "{reasons:?}");
    assert!(answered > 0);
    assert_eq!(report["frames_unsent"], 0, "{report}");
}

#[test]
fn the_worker_answers_with_the_bits_that_a_planner_computes_itself() {
    let arena = Arena::new(&setup());
    let _worker = arena.worker();
    let _source = arena.controller("source", 0, ROBOTS, HZ);
    let mut asker = Asker::new(&arena, &["asker", "bits", "60"]);
    assert_eq!(asker.next(), Some(AskerLine::Done { answered: 60 }), "{}", asker.child.tail());
}

#[test]
fn a_question_that_takes_longer_than_two_ticks_is_a_yes_about_a_state_that_is_not_stale() {
    let arena = Arena::new(&setup());
    let _worker = arena.worker();
    let _source = arena.controller("source", 0, ROBOTS, HZ);
    let mut asker = Asker::new(&arena, &["asker", "far", "3"]);
    assert_eq!(asker.next(), Some(AskerLine::Done { answered: 3 }), "{}", asker.child.tail());
}

#[test]
fn recorded_answers_are_computed_again_and_a_changed_one_is_found() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let file = arena.files().join("asked.mcap");
    let mut recorder = arena.recording(&file, &[]);
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut askers = ["flood", "heavy"].map(|kind| Asker::new(&arena, &["asker", kind]));
    askers.iter_mut().for_each(Asker::is_asking);
    let mut hostile = Asker::new(&arena, &["asker", "hostile"]);
    hostile.done();
    hostile.child.finish();
    let mut calm = Asker::new(&arena, &["asker", "calm", "300"]);
    calm.done();
    calm.child.finish();
    for asker in &mut askers {
        asker.child.finish();
    }
    source.finish();
    // Messages that it lost on a busy machine are counted.
    assert!(matches!(recorder.end().code(), Some(0 | 3)));
    worker.stop();
    let name = file.to_str().unwrap();
    let verified = alone(&["replay", "--verify", name]);
    assert!(matches!(verified.code(), Some(0 | 3)), "{verified:?}");
    let report = verified.json();
    let count = |name: &str| report[name].as_u64().unwrap();
    assert_eq!(count("differences"), 0, "{report}");
    assert!(count("queries_verified") > 60, "{report}");

    type Spoil = fn(&mut Query);
    // Changes of the answer, and of its question.
    let changes: [(&str, Spoil); 3] = [
        ("query.hi_j", |query| {
            query.rows[0].hi_j = f32::from_bits(query.rows[0].hi_j.to_bits() ^ 1);
        }),
        ("query.verdict", |query| query.rows[0].verdict ^= 1),
        ("query.mean_j", |query| {
            *query.values.last_mut().unwrap() -= 0.05;
        }),
    ];
    for (at, (field, spoil)) in changes.into_iter().enumerate() {
        let to = arena.files().join(format!("spoilt-{at}.mcap"));
        // The first ones may be about ticks before the first keyframe.
        let passed = std::cell::Cell::new(0);
        let place = std::cell::Cell::new(0);
        spoilt(&file, &to, |message| {
            // Candidates, whose last command counts, for a robot that has been read: not a path,
            // nor one whose answer is always unknown.
            let query = message.get_mut::<Query>();
            let is_known =
                |query: &&mut Query| query.rows.len() > 4 && query.rows[15].mean_j.is_finite();
            let Some(query) = query.filter(is_known) else {
                return false;
            };
            passed.set(passed.get() + 1);
            let is_it = passed.get() > count("queries_outside") + 20;
            if is_it {
                spoil(query);
                place.set(query.record.answer.tick);
            }
            is_it
        });
        let ended = alone(&["replay", "--verify", to.to_str().unwrap()]);
        let report = ended.json();
        assert_eq!(ended.code(), Some(3), "{field}: {report}");
        let by_field = &report["differences_by_field"];
        assert!(by_field[field].as_u64() > Some(0), "{field}: {report}");
        assert_eq!(report["first"]["tick"], place.get(), "{field}: {report}");
    }
    figure(
        "questions, computed again",
        format_args!("{} of {}", count("queries_verified"), count("queries")),
    );
}

#[test]
fn a_recording_bears_out_refusals_of_a_worker_and_no_answer_that_is_altered_to_one() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let file = arena.files().join("refused.mcap");
    let mut recorder = arena.recording(&file, &[]);
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut witness = Asker::new(&arena, &["asker", "flood"]);
    witness.is_asking();
    let mut crowd = Asker::new(&arena, &["asker", "crowd"]);
    crowd.until("more questions of a process than may wait", |line| match line {
        AskerLine::Failed { name, .. } if name == "Busy" => Some(()),
        _ => None,
    });
    let mut hostile = Asker::new(&arena, &["asker", "hostile"]);
    hostile.done();
    hostile.child.finish();
    for _ in 0..5 {
        let mut killed = Asker::new(&arena, &["asker", "heavy"]);
        killed.is_asking();
        killed.child.kill();
    }
    // The crowd still waits then.
    worker.stop();
    source.finish();
    witness.child.finish();
    crowd.child.finish();
    let recorded = recorder.end();
    assert!(matches!(recorded.code(), Some(0 | 3)));
    let verify = |file: &std::path::Path| alone(&["replay", "--verify", file.to_str().unwrap()]);
    let verified = verify(&file);
    let report = verified.json();
    let count = |name: &str| report[name].as_u64().unwrap();
    let reasons = queries(&file).into_iter().fold(BTreeMap::new(), |mut counts, query| {
        let reason = QueryRefusal::decode(query.record.answer.refusal);
        *counts.entry(reason).or_insert(0) += 1;
        counts
    });
    figure("questions, by the reason of their refusal", format_args!("{reasons:?}"));
    assert_eq!(count("differences"), 0, "{report}");
    // On a busy machine a recorder may lose what bears a refusal out, and states that.
    if recorded.code() == Some(0) {
        assert_eq!((verified.code(), count("refusals_unproven")), (Some(0), 0), "{report}");
        assert!(count("queries_by_time") > 1, "{report}");
    }

    use QueryRefusal as Reason;
    for reason in [Reason::Busy, Reason::Ending, Reason::ClientGone, Reason::Unsent] {
        let to = arena.files().join(format!("{}.mcap", reason.name()));
        let passed = std::cell::Cell::new(0);
        spoilt(&file, &to, |message| {
            let witness = |query: &&mut Query| query.rows.len() > 4;
            let Some(query) = message.get_mut::<Query>().filter(witness) else {
                return false;
            };
            passed.set(passed.get() + 1);
            let is_it = passed.get() > count("queries_outside") + 20;
            if is_it {
                let answer = &mut query.record.answer;
                (answer.refusal, answer.tick, answer.budget_tick) = (reason.code(), 0, 0);
                let refused = query.clone().counted();
                *query = Query { rows: Vec::new(), power_w: Vec::new(), ..refused }.counted();
            }
            is_it
        });
        let ended = verify(&to);
        let altered = ended.json();
        let unproven = altered["refusals_unproven"].as_u64().unwrap();
        assert_eq!(ended.code(), Some(3), "{reason:?}: {altered}");
        assert_eq!(unproven, count("refusals_unproven") + 1, "{reason:?}: {altered}");
    }
}
