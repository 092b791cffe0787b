//! Guarantees between members of a domain, tested with processes.

use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::PathBuf;
use std::process::Command;
use std::time::{Duration, Instant};

use joulebus_bus::{NodeInfo, Ports, check_capacity, inspect, sweep};
use joulebus_testkit::{Member, eventually};
use rustix::process::{Pid, Signal, kill_process};

use crate::harness::{Place, limits, must};

/// A member run by another program, such as `strace`.
fn member_under(place: &Place, program: &str, arguments: &[&str]) -> Member {
    let mine = Member::command();
    let mut command = Command::new(program);
    command.args(arguments).arg(mine.get_program()).args(mine.get_args());
    Member::spawn_to_finish(program, place.as_member(command))
}

#[test]
fn frames_of_a_process_that_is_not_the_worker_are_skipped() {
    let place = Place::new();
    let mut planner = place.joined("planner");
    let mut impostor = place.joined("impostor");
    must(&mut impostor, "tick 2");
    assert_eq!(must(&mut planner, "latest"), "[None, None, None]");
    let mut worker = place.joined("worker");
    must(&mut worker, "tick 1");
    must(&mut impostor, "tick 1");
    assert_eq!(must(&mut planner, "latest"), "[Some(1), Some(1), Some(1)]");
    must(&mut impostor, "tick 7");
    assert_eq!(must(&mut planner, "latest"), "[None, None, None]");
    // Frames that a worker sent before its death are its own.
    must(&mut worker, "tick 1");
    worker.kill();
    assert_eq!(must(&mut planner, "latest"), "[Some(2), Some(2), Some(2)]");
    must(&mut impostor, "tick 1");
    assert_eq!(must(&mut planner, "latest"), "[None, None, None]");
    // Now it is the worker.
    must(&mut impostor, "lock");
    eventually("its frames are accepted", || {
        must(&mut impostor, "tick 1");
        must(&mut planner, "latest").contains("Some")
    });
}

#[test]
fn samples_and_forecasts_cross_processes_that_join_in_any_order() {
    let roles = ["source", "worker", "planner"];
    for order in [[0, 1, 2], [0, 2, 1], [1, 0, 2], [1, 2, 0], [2, 0, 1], [2, 1, 0]] {
        let place = Place::new();
        let mut members: Vec<_> =
            order.iter().map(|role| (*role, place.joined(roles[*role]))).collect();
        members.sort_by_key(|(role, _)| *role);
        let mut members = members.into_iter().map(|(_, member)| member);
        let (mut source, mut worker, mut planner) =
            (members.next().unwrap(), members.next().unwrap(), members.next().unwrap());
        assert_eq!(must(&mut source, "send 64"), "1");
        assert!(must(&mut worker, "wait").contains("frame: true"));
        assert_eq!(must(&mut worker, "take"), "0:64", "{order:?}");
        assert_eq!(must(&mut worker, "take"), "none");
        assert!(source.ask("send 65").contains("65 elements, allowed are 64"));
        must(&mut worker, "tick 2");
        assert!(must(&mut planner, "wait").contains("frame: true"));
        assert_eq!(must(&mut planner, "latest"), "[Some(2), Some(2), Some(2)]", "{order:?}");
        assert_eq!(must(&mut planner, "latest"), "[None, None, None]");
        // The first to join is the first to leave.
        source.finish();
        worker.finish();
        planner.finish();
        place.assert_nothing_left();
    }
}

#[test]
fn many_start_and_leave_at_once() {
    let place = Place::new();
    for _ in 0..3 {
        let mut members: Vec<_> = (0..6).map(|_| place.member()).collect();
        for (i, member) in members.iter_mut().enumerate() {
            member.send_line("join");
            member.send_line(["source", "planner"][i % 2]);
        }
        for member in &mut members {
            for _ in 0..2 {
                let answer = member.next_line();
                assert!(answer.starts_with("ok"), "{answer}");
            }
        }
        for member in &mut members {
            member.send_line("quit");
        }
        for mut member in members {
            assert!(member.wait().status.success());
        }
        place.assert_nothing_left();
    }
}

#[test]
fn threads_of_one_process_and_of_several_join_and_leave_at_once() {
    let place = Place::new();
    must(&mut place.member(), "threads 60");
    place.assert_nothing_left();
    let mut members = [place.member(), place.member(), place.member()];
    for member in &mut members {
        member.send_line("threads 40");
    }
    for mut member in members {
        let answer = member.next_line();
        assert!(answer.starts_with("ok"), "{answer}");
        member.finish();
    }
}

#[test]
fn different_limits_are_reported_with_both_values() {
    let place = Place::new();
    let _source = place.joined("source");
    let mut worker = place.member();
    must(&mut worker, "join");
    must(&mut worker, "capacity 65");
    let answer = worker.ask("worker");
    assert!(answer.contains("capacity=64"), "{answer}");
    assert!(answer.contains("capacity=65"), "{answer}");
}

#[test]
fn a_stopped_planner_does_not_affect_others_and_resumes_at_the_newest() {
    let place = Place::new();
    let mut worker = place.joined("worker");
    let mut stuck = place.joined("planner");
    let mut other = place.joined("planner");
    must(&mut worker, "tick 1");
    for planner in [&mut stuck, &mut other] {
        assert_eq!(must(planner, "count"), "[1]");
    }
    stuck.stop();
    for tick in 2..=200 {
        assert_eq!(must(&mut worker, "tick 1"), tick.to_string());
        assert_eq!(must(&mut other, "count"), format!("[{tick}]"));
    }
    stuck.resume();
    // Two frames are queued, by the limits; the ones before are the gap.
    assert_eq!(must(&mut stuck, "count"), "[199, 200]");
    must(&mut worker, "tick 1");
    assert_eq!(must(&mut stuck, "count"), "[201]");
}

#[test]
fn members_clean_up_after_dead_members() {
    let place = Place::new();
    let mut planner = place.joined("planner");
    place.joined("worker").kill();
    // Notified by the member that cleans up, within about a second.
    assert!(must(&mut planner, "wait").contains("died: true"));
    let dead = |node: &NodeInfo| node.alive != Some(true);
    eventually("no dead node", || !inspect(&place.domain).unwrap().nodes.iter().any(dead));
    let nodes = inspect(&place.domain).unwrap().nodes;
    assert_eq!(nodes.len(), 1, "{nodes:?}");
    assert_eq!(nodes[0].pid, Some(planner.pid()));
    // It counts what it has removed a moment later.
    eventually("it is counted", || must(&mut planner, "housekeeping").contains("dead_nodes: 1"));
}

#[test]
fn processes_killed_faster_than_their_nodes_are_removed_leave_places_for_the_next_one() {
    let place = Place::new();
    // It alone lives, and does not clean up: as on a machine whose processors are busy.
    let mut worker = place.joined("worker");
    worker.stop();
    for role in ["source", "planner"] {
        // Four times as many as there are places, none of which lives long enough to clean up.
        for _ in 0..12 {
            place.joined(role).kill();
        }
    }
    worker.resume();
    let mut source = place.joined("source");
    must(&mut source, "send 3");
    assert_eq!(must(&mut worker, "take"), "0:3");
}

#[test]
fn places_of_processes_killed_after_a_start_are_there_for_its_ports() {
    // The process may have cleaned up by itself in one of the rounds.
    for _ in 0..5 {
        let place = Place::new();
        // As many as there are places: three, and spare ones.
        let sources = [(); 5].map(|()| place.joined("source"));
        let mut next = place.member();
        must(&mut next, "join");
        next.stop();
        for source in sources {
            source.kill();
        }
        next.resume();
        must(&mut next, "source");
        next.finish();
        place.assert_nothing_left();
    }
}

#[test]
fn a_start_removes_all_files_only_if_no_member_is_alive() {
    let place = Place::new();
    let mut source = place.joined("source");
    let worker = place.joined("worker");
    let before = place.objects().len();
    assert!(before > 5);

    worker.kill();
    let report = must(&mut place.member(), "join");
    assert!(report.contains("cold: false"), "{report}");
    assert!(!sweep(&place.domain).unwrap().cold);
    // The source itself may be removing the dead ones' files, and not have got a processor since.
    eventually("live members are not affected", || must(&mut source, "send 1") == "0");

    source.kill();
    let mut next = place.member();
    let report = must(&mut next, "join");
    assert!(report.contains("cold: true"), "{report}");
    assert!(!report.contains("objects: 0"), "{report}");
}

#[test]
fn a_sweep_without_live_members_leaves_no_files() {
    let place = Place::new();
    let members = ["source", "worker", "planner"].map(|role| place.joined(role));
    for member in members {
        member.kill();
    }
    assert!(!place.objects().is_empty());
    // A supervisor does this in a separate process; here it is this process, once.
    let report = sweep(&place.domain).unwrap();
    assert!(report.cold && report.objects > 0 && report.bytes > 0, "{report:?}");
    place.assert_nothing_left();
    assert!(sweep(&place.domain).unwrap().is_clean());
}

#[test]
fn an_object_of_size_0_does_not_block_members() {
    let place = Place::new();
    let _source = place.joined("source");
    // Left by a process killed between creating and sizing: iceoryx2 waits for it forever. Every
    // joiner opens this object.
    drop(empty_counter(&place));
    let _worker = place.joined("worker");
}

/// Makes the node counter an object of length zero, which is not removed while the file is open.
fn empty_counter(place: &Place) -> fs::File {
    let mut objects = place.objects().into_iter();
    let is_counter = |path: &PathBuf| path.to_string_lossy().ends_with("global_mgmt");
    let counter = objects.find(is_counter).unwrap();
    let mut options = fs::OpenOptions::new();
    options.write(true).truncate(true).open(counter).unwrap()
}

#[test]
fn a_start_waits_for_an_object_of_size_0_whose_creator_lives_and_then_gives_up() {
    let place = Place::new();
    let _source = place.joined("source");
    let creator = empty_counter(&place);
    let answer = place.member().ask("join");
    assert!(answer.contains("cannot create a node"), "{answer}");
    drop(creator);
    eventually("a start works", || place.member().ask("join").starts_with("ok"));
}

#[test]
fn a_start_goes_on_when_an_object_of_size_0_is_gone_after_longer_than_iceoryx2_waits() {
    let place = Place::new();
    let mut is_ready = false;
    // On a busy machine it may be gone too late.
    for _ in 0..20 {
        let source = place.joined("source");
        let creator = empty_counter(&place);
        let mut member = place.member();
        member.send_line("join");
        std::thread::sleep(Duration::from_millis(700));
        drop(creator);
        is_ready |= member.next_line().starts_with("ok");
        source.finish();
        member.finish();
        if is_ready {
            break;
        }
    }
    assert!(is_ready);
}

#[test]
fn an_object_of_size_0_that_is_open_is_kept() {
    let place = Place::new();
    let _member = place.joined("source");
    let name = format!("{}slow.connection", place.domain.shm_prefix());
    let path = std::path::Path::new("/dev/shm").join(name);
    let creator = fs::File::create(&path).unwrap();
    std::thread::sleep(Duration::from_millis(800));
    assert!(path.exists(), "its creator may be slow");
    assert_eq!(inspect(&place.domain).unwrap().incomplete, std::slice::from_ref(&path));
    drop(creator);
    eventually("the object is removed", || !path.exists());
}

#[test]
fn killed_at_every_sizing_of_an_object_and_the_next_one_is_ready() {
    if let Some(killed) = killed_at_every(&["ftruncate"]) {
        assert!(killed >= 5, "{killed}");
    }
}

#[test]
#[ignore = "1,165 starts take three minutes: CONTRIBUTING.md has the command"]
fn killed_at_every_call_of_a_start_and_the_next_one_is_ready() {
    let calls = [
        "openat",
        "ftruncate",
        "fchmod",
        "chmod",
        "fcntl",
        "flock",
        "write",
        "rename",
        "unlink",
        "rmdir",
        "mkdir",
        "socket",
        "bind",
        "mmap",
        "munmap",
        "close",
        "fallocate",
        "madvise",
        "clone3",
        "newfstatat",
        "fstat",
        "lseek",
        "getdents64",
        "sendto",
        "futex",
    ];
    if let Some(killed) = killed_at_every(&calls) {
        assert!(killed >= 200, "{killed}");
    }
}

/// A member whose threads get `signal` at their system call `call` number `number`; what the tracer
/// sees is written to the file `seen`.
fn signalled(place: &Place, signal: &str, call: &str, number: u32, seen: &str) -> Member {
    let trace = format!("trace={call}");
    let inject = format!("inject={call}:signal={signal}:when={number}");
    let options = ["-f", "-qq", "-e", &trace, "-e", &inject, "-o", seen];
    member_under(place, "strace", &options)
}

/// The answer of a traced member, which goes on where it was stopped, if for a moment by the
/// tracer.
fn answer_of(traced: &mut Member) -> String {
    let mut answer = None;
    eventually("it answers", || {
        if let Some(child) = child_of(traced.pid()) {
            let _ = kill_process(child, Signal::CONT);
        }
        answer = traced.try_next_line(Duration::from_millis(5));
        answer.is_some()
    });
    answer.unwrap()
}

fn can_trace() -> bool {
    let works = Command::new("strace").args(["-qq", "-e", "trace=none", "true"]).output();
    let works = works.is_ok_and(|output| output.status.success());
    if !works {
        println!("skipped: needs strace with the right to trace");
        assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "no strace");
    }
    works
}

#[test]
fn memory_that_cannot_be_allocated_is_written_or_the_cause_is_named() {
    if !can_trace() {
        return;
    }
    let seen = format!("/dev/shm/joulebus-test-{}.injected", std::process::id());
    for (error, expected) in [
        ("ENOSYS", None),
        ("EPERM", None),
        ("EIO", Some("cannot be allocated: Input/output error")),
        ("EDQUOT", Some("cannot be allocated: Disk quota exceeded")),
    ] {
        let inject = format!("inject=fallocate:error={error}");
        let options = ["-f", "-qq", "-e", "trace=fallocate", "-e", &inject, "-o", &seen];
        let joined = || {
            let place = Place::new();
            let mut member = member_under(&place, "strace", &options);
            member.send_line("join");
            let answer = answer_of(&mut member);
            let ended = member.close();
            assert!(ended.text().contains("test result: ok"), "{ended:?}");
            place.assert_nothing_left();
            // strace may fail ("Unexpected wait status") while what it ran goes on without it.
            fs::read_to_string(&seen).unwrap().contains("(INJECTED)").then_some(answer)
        };
        let answer = (0..10).find_map(|_| joined()).expect("strace injects an error");
        let is_named =
            expected.map_or(answer.starts_with("ok"), |expected| answer.contains(expected));
        assert!(is_named && !answer.contains(" free"), "{error}: {answer}");
    }
    let _ = fs::remove_file(seen);
}

/// Kills a worker at the first, second, … of each of `calls`, until its start succeeds, with a
/// source alive. Returns the number of kills; `None` if tracing is not possible.
fn killed_at_every(calls: &[&str]) -> Option<u32> {
    if !can_trace() {
        return None;
    }
    let place = Place::new();
    let mut source = place.joined("source");
    let mut killed = 0;
    let mut slowest = Duration::ZERO;
    for call in calls {
        for number in 1.. {
            let mut victim = signalled(&place, "SIGKILL", call, number, "/dev/null");
            for command in ["join", "worker", "quit"] {
                victim.send_line(command);
            }
            if victim.wait().status.success() {
                break;
            }
            killed += 1;
            assert!(number < 300, "each death makes the next start longer");
            // Live members must not be blocked either: the next send connects to the new worker.
            let begin = Instant::now();
            let mut next = place.joined("worker");
            must(&mut source, "send 2");
            slowest = slowest.max(begin.elapsed());
            assert!(must(&mut next, "take").ends_with(":2"), "killed at {call} {number}");
            next.finish();
        }
    }
    println!("killed at {killed} calls, the next one ready after at most {slowest:?}");
    source.finish();
    place.assert_nothing_left();
    Some(killed)
}

/// State and parent of a process, by the list of them.
fn state_of(process: i32) -> Option<(char, u32)> {
    let text = fs::read_to_string(format!("/proc/{process}/stat")).ok()?;
    let (_, rest) = text.rsplit_once(") ")?;
    let mut fields = rest.split(' ');
    Some((fields.next()?.chars().next()?, fields.next()?.parse().ok()?))
}

/// The process that `strace` runs; at first one by which it tries out what it can trace.
fn child_of(tracer: u32) -> Option<Pid> {
    let entries = fs::read_dir("/proc").unwrap().flatten();
    let mut all = entries.filter_map(|entry| entry.file_name().to_str()?.parse().ok());
    let is_child = |process: &i32| state_of(*process).is_some_and(|(_, parent)| parent == tracer);
    all.find(is_child).and_then(Pid::from_raw)
}

fn is_stopped(process: Pid) -> bool {
    state_of(process.as_raw_pid()).is_some_and(|(state, _)| matches!(state, 't' | 'T'))
}

/// #1880 of iceoryx2: a node that starts while others clean up must not be taken for a dead one.
#[test]
fn nodes_that_start_while_others_clean_up_are_ready_and_nobody_ends() {
    if !can_trace() {
        return;
    }
    let place = Place::new();
    let _source = place.joined("source");
    let mut stopped = 0;
    // A node becomes visible by its files' permissions and the lock of a live one.
    for call in ["fchmod", "fcntl"] {
        for number in 1.. {
            let mut starting = signalled(&place, "SIGSTOP", call, number, "/dev/null");
            starting.send_line("join");
            let mut answer = None;
            eventually("it is stopped, or has joined", || {
                answer = starting.try_next_line(Duration::from_millis(1));
                answer.is_some() || child_of(starting.pid()).is_some_and(is_stopped)
            });
            let was_stopped = answer.is_none();
            if was_stopped {
                stopped += 1;
                // Also where it is so slow that what it makes is old by now.
                std::thread::sleep(Duration::from_millis(300));
                assert!(!sweep(&place.domain).unwrap().cold, "{call} {number}");
            }
            let answer = answer.unwrap_or_else(|| answer_of(&mut starting));
            let traced = child_of(starting.pid()).unwrap();
            assert!(answer.starts_with("ok"), "{call} {number}");
            let nodes = inspect(&place.domain).unwrap().nodes;
            let is_it = |node: &NodeInfo| node.pid == Some(traced.as_raw_pid().cast_unsigned());
            let node = nodes.iter().find(|node| is_it(node)).unwrap();
            assert_eq!(node.alive, Some(true), "{call} {number}");
            // Its files are cleaned up beside the next one's start.
            kill_process(traced, Signal::KILL).unwrap();
            starting.wait();
            if !was_stopped {
                break;
            }
        }
    }
    println!("stopped at {stopped} calls");
    assert!(stopped >= 5, "{stopped}");
}

/// A cleanup removes a service's list of ports, then its description, by a name that others use.
#[test]
fn a_start_beside_a_cleanup_that_is_stopped_between_its_removals_keeps_its_files() {
    if !can_trace() {
        return;
    }
    let mut stopped_between = 0;
    let mut number = 0;
    let seen = format!("/dev/shm/joulebus-test-{}.trace", std::process::id());
    // Only the tracer's word distinguishes this stop from those of its own, which last moments.
    let was_stopped = || fs::read_to_string(&seen).unwrap().contains("stopped by SIGSTOP");
    for _ in 0..200 {
        number += 1;
        let place = Place::new();
        let mut cleaner = signalled(&place, "SIGSTOP", "unlink", number, &seen);
        cleaner.send_line("join");
        assert!(answer_of(&mut cleaner).starts_with("ok"));
        if was_stopped() {
            // At a file of its own start.
            kill_process(child_of(cleaner.pid()).unwrap(), Signal::KILL).unwrap();
            cleaner.wait();
            continue;
        }
        // Its two services have no other users.
        place.joined("source").kill();
        let traced = child_of(cleaner.pid()).unwrap();
        let ended_at = |end: &str, files: Vec<PathBuf>| {
            let is_one = |path: &&PathBuf| path.to_string_lossy().ends_with(end);
            files.iter().filter(is_one).count()
        };
        let services = || {
            let directory = fs::read_dir(place.domain.directory().join("services")).unwrap();
            let files = directory.map(|entry| entry.unwrap().path()).collect();
            ended_at(".service", files)
        };
        eventually("it is stopped, or has cleaned up", || was_stopped() || services() == 0);
        if !was_stopped() {
            // The calls before differ from start to start: what was passed over comes again.
            number = 0;
        } else if services() > ended_at(".dynamic", place.objects()) {
            stopped_between += 1;
            let mut next = place.joined("source");
            eventually("it has cleaned up", || {
                cleaner.send_line("housekeeping");
                !answer_of(&mut cleaner).contains("dead_nodes: 0, failed_nodes: 0")
            });
            let mut worker = place.joined("worker");
            must(&mut next, "send 2");
            assert_eq!(must(&mut worker, "take"), "0:2", "unlink {number}");
            next.finish();
            worker.finish();
        }
        // It would stop when it leaves, too.
        kill_process(traced, Signal::KILL).unwrap();
        cleaner.wait();
        assert!(sweep(&place.domain).unwrap().cold);
        place.assert_nothing_left();
        if stopped_between == 2 {
            let _ = fs::remove_file(seen);
            return;
        }
    }
    panic!("stopped between {stopped_between} times");
}

#[test]
fn one_worker_per_fleet_and_the_second_gets_the_pid() {
    let place = Place::new();
    let mut first = place.member();
    let mut second = place.member();
    must(&mut first, "lock");
    let answer = second.ask("lock");
    assert!(answer.contains(&format!("pid {}", first.pid())), "{answer}");
    assert_eq!(
        inspect(&place.domain).unwrap().worker.and_then(|owner| owner.pid),
        Some(first.pid())
    );
    first.kill();
    must(&mut second, "lock");
    must(&mut second, "unlock");
    must(&mut second, "lock");
}

#[test]
fn other_users_cannot_access_the_objects_of_members() {
    let place = Place::new();
    let _source = place.joined("source");
    let _worker = place.joined("worker");
    for object in place.objects() {
        let mode = fs::metadata(&object).unwrap().permissions().mode();
        assert_eq!(mode & 0o077, 0, "{object:?} has mode {mode:o}");
    }
    let root = inspect(&place.domain).unwrap().root.unwrap();
    assert_eq!(root.mode, 0o700);
    assert!(root.in_memory);
}

#[test]
fn the_preflight_check_covers_the_shared_memory_used() {
    use std::os::unix::fs::MetadataExt;
    let place = Place::new();
    let ports = Ports { sources: 2, workers: 1, planners: 3 };
    let needed = check_capacity(&limits(), ports).unwrap().needed_bytes;
    let roles = ["source", "source", "worker", "planner", "planner", "planner"];
    let mut members = roles.map(|role| place.joined(role));
    must(&mut members[0], "send 64");
    must(&mut members[2], "tick 10");
    let taken: u64 =
        place.objects().iter().map(|object| fs::metadata(object).unwrap().blocks() * 512).sum();
    println!("needed {needed}, taken {taken} bytes");
    assert!(taken <= needed, "{taken} {needed}");
    assert!(needed < 4 * taken, "{taken} {needed}");
}
