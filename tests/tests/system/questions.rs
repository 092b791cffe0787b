//! Rows 29 to 32: questions about plans that the worker answers: killed clients and workers,
//! floods, hostile questions, the same bits as in the planner's process, recordings.

use std::collections::BTreeMap;
use std::fs;

use joulebus_capture_format::{Query, Reader};
use joulebus_tests::{
    Arena, AskerLine, Child, Dice, PATIENCE, Setup, Spread, alone, eventually, figure,
};
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
    let rounds = Dice::rounds("JOULEBUS_ASK_KILLS", 20);
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
    let rounds = Dice::rounds("JOULEBUS_ANSWERER_KILLS", 10);
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
            // Never a time-out: its two minutes have not passed. Full: the worker was killed after an
            // answer, before it made room for the next question.
            assert!(["WorkerGone", "NoWorker", "Full"].contains(&name.as_str()), "{name}");
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

/// Changes of recorded answers and refusals are `capture-verify`'s tests.
#[test]
fn recorded_answers_are_computed_again_and_refusals_borne_out() {
    let arena = Arena::new(&setup());
    let mut worker = arena.worker();
    let file = arena.files().join("asked.mcap");
    let mut recorder = arena.recording(&file, &[]);
    let mut source = arena.controller("source", 0, ROBOTS, HZ);
    let mut askers = ["flood", "heavy"].map(|kind| Asker::new(&arena, &["asker", kind]));
    askers.iter_mut().for_each(Asker::is_asking);
    let mut crowd = Asker::new(&arena, &["asker", "crowd"]);
    crowd.until("more questions of a process than may wait", |line| match line {
        AskerLine::Failed { name, .. } if name == "Busy" => Some(()),
        _ => None,
    });
    for arguments in [&["asker", "hostile"][..], &["asker", "calm", "300"]] {
        let mut asker = Asker::new(&arena, arguments);
        asker.done();
        asker.child.finish();
    }
    for _ in 0..5 {
        let mut killed = Asker::new(&arena, &["asker", "heavy"]);
        killed.is_asking();
        killed.child.kill();
    }
    // The crowd still waits then.
    worker.stop();
    source.finish();
    for mut asker in askers.into_iter().chain([crowd]) {
        asker.child.finish();
    }
    let recorded = recorder.end();
    assert!(matches!(recorded.code(), Some(0 | 3)));
    let verified = alone(&["replay", "--verify", file.to_str().unwrap()]);
    let report = verified.json();
    let count = |name: &str| report[name].as_u64().unwrap();
    assert_eq!(count("differences"), 0, "{report}");
    assert!(count("queries_verified") > 60, "{report}");
    // On a busy machine a recorder may lose what bears a refusal out, and states that.
    if recorded.code() == Some(0) {
        assert_eq!((verified.code(), count("refusals_unproven")), (Some(0), 0), "{report}");
        assert!(count("queries_by_time") > 1, "{report}");
    }
    figure(
        "questions, computed again",
        format_args!("{} of {}", count("queries_verified"), count("queries")),
    );
}
