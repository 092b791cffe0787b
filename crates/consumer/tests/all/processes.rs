//! The worker as seen by planners, between separate processes. The worker here is a stand-in that
//! sends ticks on command.

#[path = "../../examples/planner.rs"]
#[allow(dead_code, reason = "its `main`")]
mod planner;

use std::path::Path;
use std::time::Duration;

use joulebus_bus::{Bus, WorkerLock, clock};
use joulebus_consumer::{Config, Event, Feed, Subscriber, WorkerState};
use joulebus_testkit::{
    Member, TestFleet, assert_contains, eventually, next_order, run_member, send_to_test,
};
use joulebus_wire::{
    Budget, BudgetHeader, Budgets, Diagnostic, DiagnosticHeader, Diagnostics, Forecast,
    ForecastHeader, Forecasts, PlanState, PlanStateHeader, PlanStates, SCHEMA_VERSION, WakeEvent,
    forecast_flag,
};
use rustix::event::{PollFd, PollFlags, poll};

/// Long enough that nothing becomes stale during a test.
const HOUR_NS: u64 = 3_600_000_000_000;

/// The processes that the tests start.
pub(crate) fn member() {
    run_member(|role, config| match role {
        "worker" => worker(config, true),
        "impostor" => worker(config, false),
        "planner" => plan(Subscriber::connect(config).unwrap()),
        "poller" => {
            let config = Config::load(config).unwrap();
            plan(Subscriber::polling(&config, "poller", Duration::from_millis(100)).unwrap());
        }
        "example" => {
            planner::run(config, 3).unwrap();
            send_to_test("seen");
        }
        _ => panic!("no such role: {role}"),
    });
}

/// Commands: `ticks FROM TO`, `wake`, `period NS`, `schema N`, `epoch N`, `pid N`, `update`, `end`.
/// An impostor has the worker's ports, but not its lock.
fn worker(config: &Path, is_worker: bool) {
    let config = Config::load(config).unwrap();
    let limits = config.limits();
    let _lock = is_worker.then(|| WorkerLock::acquire(&config.domain().unwrap()).unwrap());
    let bus = Bus::join(&config.domain().unwrap(), "worker").unwrap();
    let mut forecasts = bus.writer::<Forecasts>(&limits).unwrap();
    let mut diagnostics = bus.writer::<Diagnostics>(&limits).unwrap();
    let mut budgets = bus.writer::<Budgets>(&limits).unwrap();
    let mut plan_states = bus.writer::<PlanStates>(&limits).unwrap();
    let waker = bus.planner_waker(&limits).unwrap();
    let mut header = ForecastHeader {
        schema: SCHEMA_VERSION,
        pid: std::process::id(),
        worker_epoch: clock::monotonic_ns(),
        period_ns: HOUR_NS,
        ..ForecastHeader::default()
    };
    send_to_test("ready");
    while let Some(line) = next_order() {
        let mut words = line.split(' ');
        let command = words.next().unwrap();
        let numbers: Vec<u64> = words.map(|word| word.parse().unwrap()).collect();
        match (command, &numbers[..]) {
            ("period", [period_ns]) => header.period_ns = *period_ns,
            ("epoch", [epoch]) => header.worker_epoch = *epoch,
            ("pid", [pid]) => header.pid = u32::try_from(*pid).unwrap(),
            ("schema", [schema]) => header.schema = u32::try_from(*schema).unwrap(),
            ("update", []) => {
                budgets.update();
                plan_states.update();
            }
            ("wake", []) => {
                send_to_test(waker.wake(WakeEvent::Frame).unwrap().to_string());
                continue;
            }
            ("end", []) => {
                waker.wake(WakeEvent::Ended).unwrap();
            }
            ("ticks", [from, to]) => {
                for tick in *from..=*to {
                    header.tick = tick;
                    header.sent_ns = clock::monotonic_ns();
                    // Robots change positions from tick to tick.
                    forecasts.send(header, 64, |i| forecast((i as u64 + tick) % 64, tick)).unwrap();
                    let of_tick = DiagnosticHeader {
                        schema: header.schema,
                        worker_epoch: header.worker_epoch,
                        tick,
                        ..DiagnosticHeader::default()
                    };
                    let row = |i| Diagnostic { robot: i as u32, ..Diagnostic::default() };
                    diagnostics.send(of_tick, 64, row).unwrap();
                    let of_tick = BudgetHeader {
                        schema: header.schema,
                        worker_epoch: header.worker_epoch,
                        tick,
                        ..BudgetHeader::default()
                    };
                    let row =
                        |i| Budget { robot: i as u32, drawn_uj: i as i64, ..Budget::default() };
                    budgets.send(of_tick, 64, row).unwrap();
                    let of_tick = PlanStateHeader {
                        schema: header.schema,
                        worker_epoch: header.worker_epoch,
                        tick,
                        ..PlanStateHeader::default()
                    };
                    let row = |i| PlanState {
                        robot: i as u32,
                        stamp_ns: i as u64,
                        ..PlanState::default()
                    };
                    plan_states.send(of_tick, 64, row).unwrap();
                    waker.wake(WakeEvent::Frame).unwrap();
                }
            }
            _ => panic!("no such command: {line}"),
        }
        send_to_test(command);
    }
}

fn forecast(robot: u64, tick: u64) -> Forecast {
    Forecast {
        robot: robot as u32,
        flags: forecast_flag::POWER | forecast_flag::INTERVAL,
        power_w: power_w(robot, tick),
        lo_w: 1.0,
        hi_w: 2.0,
        ..Forecast::default()
    }
}

fn power_w(robot: u64, tick: u64) -> f32 {
    (robot * 10_000 + tick) as f32
}

/// Commands: `next MS`, `each MS`, `readable MS`, `latest`, `worker`, `counts`, `feeds`.
fn plan(mut planner: Subscriber) {
    let mut feeds: Option<(Feed<Diagnostics>, Feed<Budgets>, Feed<PlanStates>)> = None;
    send_to_test("ready");
    while let Some(line) = next_order() {
        match line.split_once(' ').unwrap_or((&line, "")) {
            ("next", ms) => {
                let timeout = Duration::from_millis(ms.parse().unwrap());
                send_to_test(match planner.wait_next(timeout) {
                    Ok(event) => describe(&event),
                    Err(error) => error.to_string(),
                });
            }
            ("each", ms) => {
                let timeout = Duration::from_millis(ms.parse().unwrap());
                let mut ticks = Vec::new();
                let waited = planner.wait_each(timeout, |header, robots| {
                    assert_eq!(robots.len(), 64);
                    ticks.push(header.tick);
                });
                let event = describe(&waited.unwrap());
                send_to_test(format!("{ticks:?}, {event}"));
            }
            ("readable", ms) => {
                assert!(planner.look_within() <= Duration::from_millis(100));
                let readiness = planner.readiness().unwrap();
                let mut polled = [PollFd::new(&readiness, PollFlags::IN)];
                let timeout = Duration::from_millis(ms.parse().unwrap());
                let ready = poll(&mut polled, Some(&timeout.try_into().unwrap())).unwrap();
                send_to_test((ready == 1).to_string());
            }
            ("latest", _) => match planner.latest().unwrap() {
                Some(frame) => send_to_test(describe(&Event::Frame(frame))),
                None => send_to_test("none"),
            },
            ("worker", _) => send_to_test(match planner.worker() {
                WorkerState::Stale { .. } => "Stale".to_owned(),
                state => format!("{state:?}"),
            }),
            ("foreign", _) => send_to_test(planner.foreign().to_string()),
            ("counts", _) => {
                let counts = planner.counts();
                send_to_test(format!(
                    "{} frames, {} gaps, {} ticks, {} workers",
                    counts.frames, counts.gaps, counts.ticks_missed, counts.workers
                ));
            }
            ("feeds", _) => {
                let (diagnostics, budgets, plan_states) = feeds.get_or_insert_with(|| {
                    let (diagnostics, budgets) = (planner.diagnostics(), planner.budgets());
                    let plan_states = planner.plan_states().unwrap();
                    (diagnostics.unwrap(), budgets.unwrap(), plan_states)
                });
                let diagnostics = diagnostics.latest().unwrap();
                let budgets = budgets.latest().unwrap();
                let plan_states = plan_states.latest().unwrap();
                // All four are borrowed at the same time.
                let forecasts = planner.current().map(|frame| frame.header().tick);
                let diagnosed = diagnostics.map(|frame| {
                    assert_eq!(frame.robot(63).unwrap().robot, 63);
                    frame.header().tick
                });
                let budgeted = budgets.map(|frame| {
                    assert_eq!(frame.robot(63).unwrap().drawn_uj, 63);
                    frame.header().tick
                });
                let planned = plan_states.map(|frame| {
                    assert_eq!(frame.robot(63).unwrap().stamp_ns, 63);
                    frame.header().tick
                });
                send_to_test(format!("{forecasts:?} {diagnosed:?} {budgeted:?} {planned:?}"));
            }
            _ => panic!("no such command: {line}"),
        }
    }
}

fn describe(event: &Event<'_>) -> String {
    match event {
        Event::Frame(frame) => {
            let tick = frame.header().tick;
            assert_eq!(frame.robots().len(), 64);
            for robot in 0..64 {
                let found = frame.robot(robot).unwrap();
                assert_eq!(found.expected_w(), Some(power_w(robot.into(), tick)));
            }
            assert!(frame.robot(64).is_none());
            let arrival = frame.arrival();
            format!(
                "tick {tick}, missed {}{}",
                arrival.ticks_missed,
                if arrival.restarted { ", restarted" } else { "" }
            )
        }
        Event::Stale { age_ns } => {
            assert!(*age_ns > 0);
            "Stale".to_owned()
        }
        other => format!("{other:?}"),
    }
}

fn ready(fleet: &TestFleet, role: &str) -> Member {
    let mut member = fleet.start(role);
    assert_eq!(member.next_line(), "ready");
    member
}

#[test]
fn a_planner_may_start_before_or_after_the_worker() {
    let fleet = TestFleet::new();
    let mut early = ready(&fleet, "planner");
    assert_eq!(early.ask("next 0"), "TimedOut");
    assert_eq!(early.ask("latest"), "none");
    assert_eq!(early.ask("worker"), "Waiting");
    early.send_line("next 60000");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 1");
    assert_eq!(early.next_line(), "tick 1, missed 0");
    assert_eq!(early.ask("worker"), "Alive");

    let mut late = ready(&fleet, "planner");
    worker.ask("ticks 2 9");
    worker.ask("ticks 10 10");
    // A late planner has missed nothing, and gets the newest frame.
    assert_eq!(late.ask("next 60000"), "tick 10, missed 0");
    assert_eq!(early.ask("latest"), "tick 10, missed 8");
    assert_eq!(early.ask("latest"), "tick 10, missed 8", "the same frame");
    assert_eq!(early.ask("next 0"), "TimedOut", "it was returned before");
    assert_eq!(early.ask("counts"), "2 frames, 1 gaps, 8 ticks, 1 workers");
}

#[test]
fn a_killed_worker_is_gone_at_once_and_its_successor_takes_over() {
    killed_and_followed("planner");
}

#[test]
fn a_planner_that_polls_learns_at_once_that_the_worker_was_killed_and_follows_its_successor() {
    killed_and_followed("poller");
}

fn killed_and_followed(role: &str) {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, role);
    for life in 0..4 {
        let mut worker = ready(&fleet, "worker");
        worker.ask("ticks 1 1");
        let expected = match life {
            0 => "tick 1, missed 0",
            _ => "tick 1, missed 0, restarted",
        };
        assert_eq!(planner.ask("next 60000"), expected, "life {life}");
        assert_eq!(planner.ask("next 0"), "TimedOut", "life {life}");
        // It sleeps, or is about to, when the worker dies; its frame is valid for another hour.
        planner.send_line("next 60000");
        worker.kill();
        assert_eq!(planner.next_line(), "Gone(Exited)", "life {life}");
        assert_eq!(planner.ask("worker"), "Gone(Exited)", "life {life}");
        assert_eq!(planner.ask("next 0"), "TimedOut", "told once");
    }
    assert_eq!(planner.ask("counts"), "4 frames, 0 gaps, 0 ticks, 4 workers");
}

/// Further ahead than any clock.
const FAR: u64 = 1 << 62;

#[test]
fn no_frame_of_another_process_blinds_a_planner_whatever_run_tick_and_pid_it_claims() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    let mut impostor = ready(&fleet, "impostor");
    impostor.ask(&format!("ticks {FAR} {FAR}"));
    assert_eq!(planner.ask("next 200"), "TimedOut", "there is no worker");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 1");
    assert_eq!(planner.ask("next 60000"), "tick 1, missed 0");
    assert_eq!(planner.ask("feeds"), "Some(1) None None None");
    impostor.ask(&format!("pid {}", worker.pid()));
    for (epoch, tick) in [(FAR, 1), (1, FAR), (FAR, FAR), (0, 2)] {
        impostor.ask(&format!("epoch {epoch}"));
        impostor.ask(&format!("ticks {tick} {tick}"));
        assert_eq!(planner.ask("next 200"), "TimedOut", "run {epoch}, tick {tick}");
    }
    worker.ask("ticks 2 2");
    assert_eq!(planner.ask("next 60000"), "tick 2, missed 0");
    assert_eq!(planner.ask("feeds"), "Some(2) Some(2) Some(2) Some(2)");
    assert_eq!(planner.ask("counts"), "2 frames, 0 gaps, 0 ticks, 1 workers");
    assert_ne!(planner.ask("foreign"), "0", "they are counted");
}

#[test]
fn row_6_a_restarted_worker_is_followed_at_once_however_the_clock_was_set_in_between() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    planner.ask("feeds");
    // Forward, back, back, forward.
    for (life, epoch) in [FAR, 2 * FAR, 5, 4, FAR].into_iter().enumerate() {
        let mut worker = ready(&fleet, "worker");
        worker.ask(&format!("epoch {epoch}"));
        worker.ask("ticks 1 1");
        let restarted = if life == 0 { "" } else { ", restarted" };
        let expected = format!("tick 1, missed 0{restarted}");
        assert_eq!(planner.ask("next 60000"), expected, "life {life}");
        assert_eq!(planner.ask("feeds"), "Some(1) Some(1) Some(1) Some(1)", "life {life}");
        worker.ask("ticks 2 3");
        assert_eq!(planner.ask("next 60000"), "tick 3, missed 1", "life {life}");
        assert_eq!(planner.ask("feeds"), "Some(3) Some(3) Some(3) Some(3)", "life {life}");
        worker.kill();
        assert_eq!(planner.ask("next 60000"), "Gone(Exited)", "life {life}");
    }
}

#[test]
fn frames_sent_before_a_workers_death_are_returned_first() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 1");
    assert_eq!(planner.ask("next 60000"), "tick 1, missed 0");
    worker.ask("ticks 2 3");
    worker.kill();
    assert_eq!(planner.ask("next 60000"), "tick 3, missed 1");
    assert_eq!(planner.ask("next 60000"), "Gone(Exited)");
}

#[test]
fn a_normal_end_of_the_worker_is_reported() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 1");
    assert_eq!(planner.ask("next 60000"), "tick 1, missed 0");
    // Its last tick and its end event arrive together.
    worker.ask("ticks 2 2");
    worker.ask("end");
    assert_eq!(planner.ask("next 60000"), "tick 2, missed 0");
    assert_eq!(planner.ask("next 60000"), "Gone(Ended)");
    worker.finish();
    assert_eq!(planner.ask("next 200"), "TimedOut", "told once");
    assert_eq!(planner.ask("worker"), "Gone(Ended)");
}

#[test]
fn a_planner_that_polls_distinguishes_a_shutdown_from_a_death_and_returns_the_last_frames_first() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "poller");
    for first in ["tick 1, missed 0", "tick 1, missed 0, restarted"] {
        let mut worker = ready(&fleet, "worker");
        worker.ask("ticks 1 1");
        assert_eq!(planner.ask("next 60000"), first);
        worker.ask("ticks 2 4");
        // No event reports it.
        worker.finish();
        assert_eq!(planner.ask("each 60000"), "[2, 3, 4], tick 4, missed 0");
        assert_eq!(planner.ask("next 60000"), "Gone(Ended)");
        assert_eq!(planner.ask("worker"), "Gone(Ended)");
        assert_eq!(planner.ask("next 200"), "TimedOut", "told once");
    }
}

#[test]
fn a_planner_that_polls_gets_every_frame_in_order_and_none_twice() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "poller");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 3");
    assert_eq!(planner.ask("each 60000"), "[1, 2, 3], tick 3, missed 0");
    assert_eq!(planner.ask("each 200"), "[], TimedOut");
    worker.ask("ticks 4 4");
    worker.ask("ticks 6 7");
    assert_eq!(planner.ask("each 60000"), "[4, 6, 7], tick 7, missed 0");
    assert_eq!(planner.ask("counts"), "6 frames, 1 gaps, 1 ticks, 1 workers");
    // A call for the newest returns it alone.
    worker.ask("ticks 8 9");
    assert_eq!(planner.ask("next 60000"), "tick 9, missed 1");
}

#[test]
fn a_tick_wakes_planners_that_listen_and_none_that_polls() {
    let fleet = TestFleet::new();
    let mut worker = ready(&fleet, "worker");
    for (role, woken) in [("poller", 0), ("planner", 1), ("poller", 0)] {
        let planner = ready(&fleet, role);
        assert_eq!(worker.ask("wake"), format!("{woken}"), "{role}");
        planner.finish();
    }
}

#[test]
fn a_descriptor_is_readable_for_a_frame_and_the_exit_of_each_worker() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    assert_eq!(planner.ask("readable 0"), "false");
    for frame in ["tick 1, missed 0", "tick 1, missed 0, restarted"] {
        let mut worker = ready(&fleet, "worker");
        worker.ask("ticks 1 1");
        assert_eq!(planner.ask("readable 60000"), "true");
        assert_eq!(planner.ask("next 0"), frame);
        // The cleanup after the one before may report it late.
        eventually("all has been read", || {
            assert_eq!(planner.ask("next 0"), "TimedOut");
            planner.ask("readable 0") == "false"
        });
        worker.kill();
        assert_eq!(planner.ask("readable 60000"), "true");
        assert_eq!(planner.ask("next 60000"), "Gone(Exited)");
    }
}

#[test]
fn the_descriptor_of_a_planner_that_polls_is_readable_for_the_workers_exit_alone() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "poller");
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 1");
    assert_eq!(planner.ask("readable 0"), "false");
    assert_eq!(planner.ask("next 60000"), "tick 1, missed 0");
    assert_eq!(planner.ask("readable 0"), "false");
    worker.kill();
    assert_eq!(planner.ask("readable 60000"), "true");
    assert_eq!(planner.ask("next 60000"), "Gone(Exited)");
}

#[test]
fn a_silent_worker_is_stale_until_it_continues() {
    silent_and_back("planner");
}

#[test]
fn a_silent_worker_is_stale_for_a_planner_that_polls() {
    silent_and_back("poller");
}

fn silent_and_back(role: &str) {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, role);
    let mut worker = ready(&fleet, "worker");
    worker.ask("period 50000000");
    worker.ask("ticks 1 1");
    assert_eq!(planner.ask("next 60000"), "tick 1, missed 0");
    worker.stop();
    assert_eq!(planner.ask("next 60000"), "Stale");
    assert_eq!(planner.ask("worker"), "Stale");
    assert_eq!(planner.ask("next 200"), "TimedOut", "told once");
    worker.resume();
    worker.ask(&format!("period {HOUR_NS}"));
    worker.ask("ticks 2 2");
    assert_eq!(planner.ask("next 60000"), "tick 2, missed 0");
    assert_eq!(planner.ask("worker"), "Alive");
}

#[test]
fn the_frames_of_a_killed_planner_are_released() {
    let fleet = TestFleet::new();
    let mut witness = ready(&fleet, "planner");
    let mut worker = ready(&fleet, "worker");
    let mut tick = 0;
    // More runs than the capacity for planners, each holding a frame of each kind.
    for life in 0..8 {
        let mut planner = ready(&fleet, "planner");
        planner.ask("feeds");
        for _ in 0..3 {
            tick += 1;
            worker.ask(&format!("ticks {tick} {tick}"));
            let held = planner.ask("next 60000");
            assert!(held.starts_with(&format!("tick {tick},")), "life {life}: {held}");
            assert_eq!(
                planner.ask("feeds"),
                format!("Some({tick}) Some({tick}) Some({tick}) Some({tick})"),
                "life {life}"
            );
        }
        planner.kill();
        // The worker panics when it gets no memory.
        worker.ask(&format!("ticks {} {}", tick + 1, tick + 50));
        tick += 50;
        let newest = witness.ask("next 60000");
        assert!(newest.starts_with(&format!("tick {tick},")), "life {life}: {newest}");
    }
}

#[test]
fn a_new_planner_gets_budgets_without_a_new_tick() {
    let fleet = TestFleet::new();
    let mut worker = ready(&fleet, "worker");
    worker.ask("ticks 1 3");
    let mut planner = ready(&fleet, "planner");
    assert_eq!(planner.ask("feeds"), "None None None None");
    worker.ask("update");
    assert_eq!(planner.ask("feeds"), "None None Some(3) Some(3)");
    worker.ask("ticks 4 4");
    assert_eq!(planner.ask("feeds"), "None Some(4) Some(4) Some(4)");
    assert_eq!(planner.ask("next 60000"), "tick 4, missed 0");
    assert_eq!(planner.ask("feeds"), "Some(4) Some(4) Some(4) Some(4)");
}

#[test]
fn a_worker_of_another_version_is_refused_with_both_numbers() {
    let fleet = TestFleet::new();
    let mut planner = ready(&fleet, "planner");
    let mut worker = ready(&fleet, "worker");
    worker.ask("schema 99");
    worker.ask("ticks 1 1");
    let refused = planner.ask("next 60000");
    assert_contains(&refused, ["99", &*format!("allowed is {SCHEMA_VERSION}")]);
    worker.ask(&format!("schema {SCHEMA_VERSION}"));
    worker.ask("ticks 2 2");
    assert_eq!(planner.ask("next 60000"), "tick 2, missed 0");
}

#[test]
fn the_example_prints_the_forecasts() {
    let fleet = TestFleet::new();
    let mut worker = ready(&fleet, "worker");
    let mut example = fleet.start("example");
    let (send, ended) = std::sync::mpsc::channel();
    let listener = std::thread::spawn(move || {
        send.send(example.next_line()).unwrap();
        example.finish();
    });
    let seen = (1..).find_map(|tick| {
        worker.ask(&format!("ticks {tick} {tick}"));
        ended.recv_timeout(Duration::from_millis(20)).ok()
    });
    assert_eq!(seen.as_deref(), Some("seen"));
    listener.join().unwrap();
}
