//! A message names a process to kill only if that process holds the lock.

use std::fs;
use std::process::{Command, Stdio};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use joulebus_tests::{Arena, PATIENCE, Setup, eventually, figure};
use rustix::fs::{FlockOperation, flock};

fn to_kill(message: &str) -> Vec<i64> {
    let proposed = message.split("`kill ").skip(1);
    proposed
        .map(|rest| {
            let number = rest.split('`').next().unwrap_or_default();
            number.trim().parse().unwrap_or_else(|_| panic!("{message}"))
        })
        .collect()
}

#[test]
fn a_second_worker_names_the_holder_of_the_lock_at_any_contents_of_its_file() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    let (pid, mine) = (i64::from(worker.pid()), std::process::id());
    let lock = arena.domain().root().join("worker-t.lock");
    let texts: Vec<Vec<u8>> = [
        "",
        "0 0\n",
        "1 1\n",
        "-9 9\n",
        "4294967295 1\n",
        "99999999999999999999 1\n",
        "kill -9 -1\n",
        "\u{1b}[2J 1\n",
    ]
    .iter()
    .map(|text| text.as_bytes().to_vec())
    .chain([
        format!("{mine} 1700000000000000000\n").into_bytes(),
        vec![0; 40],
        vec![0xff; 40],
        b"7 ".repeat(100_000),
    ])
    .collect();
    for text in &texts {
        fs::write(&lock, text).unwrap();
        let shown = String::from_utf8_lossy(&text[..text.len().min(40)]).into_owned();
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{shown:?}: {ended:?}");
        assert_eq!(to_kill(&ended.errors()), [pid], "{shown:?}: {ended:?}");
        let doctor = arena.run(&["doctor"]);
        let named = format!("pid {pid}");
        assert!(doctor.text().contains(&named), "{shown:?}: {doctor:?}");
    }
    worker.stop();
    figure("lock files that lie", format_args!("{}: 0 believed", texts.len()));
}

#[test]
fn an_invisible_holder_is_not_named() {
    let arena = Arena::new(&Setup::default());
    let mut worker = arena.worker();
    let lock = arena.domain().root().join("worker-t.lock");
    worker.stop();
    // The process that took the lock has exited, and another one holds it open: the kernel reports
    // the former.
    let script = "mkdir -m 700 -p $0 && exec 9>$1 && flock -x 9 && exec sleep 600";
    let holder = Command::new("sh")
        .args(["-c", script])
        .args([arena.domain().root(), &lock])
        .stdin(Stdio::null())
        .spawn();
    let mut holder = holder.unwrap();
    eventually("the lock is held", || {
        let taken = Command::new("flock").args(["-n", "-x"]).arg(&lock).arg("true").status();
        lock.exists() && !taken.unwrap().success()
    });
    for text in ["", "0 0\n", "1 1\n", "garbage\n"] {
        fs::write(&lock, text).unwrap();
        let ended = arena.run(&["run"]);
        assert_eq!(ended.code(), Some(1), "{text:?}: {ended:?}");
        assert!(ended.errors().contains("not visible"), "{text:?}: {ended:?}");
        assert_eq!(to_kill(&ended.errors()), Vec::<i64>::new(), "{ended:?}");
        let doctor = arena.run(&["doctor"]);
        assert!(doctor.text().contains("unseen from here"), "{doctor:?}");
    }
    holder.kill().unwrap();
    holder.wait().unwrap();
    fs::remove_dir_all(arena.domain().root()).unwrap();
}

#[test]
fn looking_whether_there_is_a_worker_keeps_none_from_starting() {
    let arena = Arena::new(&Setup::default());
    let lock = arena.domain().root().join("worker-t.lock");
    arena.worker().kill();
    let stop = Arc::new(AtomicBool::new(false));
    // A planner or a client that looks has the lock, shared, for some microseconds.
    let looking = std::thread::spawn({
        let stop = Arc::clone(&stop);
        move || {
            while !stop.load(Ordering::Relaxed) {
                if let Ok(file) = fs::File::open(&lock) {
                    let _ = flock(&file, FlockOperation::NonBlockingLockShared);
                    std::thread::sleep(Duration::from_millis(1));
                }
                std::thread::sleep(Duration::from_millis(1));
            }
        }
    });
    for _ in 0..6 {
        arena.worker().kill();
    }
    arena.worker().stop();
    stop.store(true, Ordering::Relaxed);
    looking.join().unwrap();
}

#[test]
fn a_reader_that_is_stopped_while_it_looks_is_waited_for_and_then_reported() {
    let arena = Arena::new(&Setup::default());
    let lock = arena.domain().root().join("worker-t.lock");
    arena.worker().kill();
    let held = |operation| {
        let file = fs::File::open(&lock).unwrap();
        flock(&file, operation).unwrap();
        file
    };
    // A holder that removes a killed worker's file, one that looks, and the minimum wait for each.
    // One without a processor lets go later, and the start is refused as promised: try again.
    for (operation, held_ms, waited_ms) in [
        (FlockOperation::NonBlockingLockExclusive, 300, 1_000),
        (FlockOperation::NonBlockingLockShared, 1_000, 5_000),
    ] {
        eventually("a start waits until the lock is let go", || {
            let (begin, file) = (Instant::now(), held(operation));
            let releasing = std::thread::spawn(move || {
                std::thread::sleep(Duration::from_millis(held_ms));
                drop(file);
                begin.elapsed()
            });
            let mut worker = arena.spawn_worker();
            let is_ready = worker.try_wait_for_line("ready:", PATIENCE).is_some();
            let errors = worker.kill().errors();
            let held_for = releasing.join().unwrap();
            if !is_ready {
                let is_late = held_for >= Duration::from_millis(waited_ms);
                assert!(is_late, "given up after {held_for:?}: {errors}");
                // It may have removed the file.
                arena.worker().kill();
            }
            is_ready
        });
    }
    let file = held(FlockOperation::NonBlockingLockShared);
    let ended = arena.run(&["run"]);
    assert_eq!(ended.code(), Some(1), "{ended:?}");
    assert!(ended.errors().contains("`lslocks` names it"), "{ended:?}");
    drop(file);
    arena.worker().stop();
}
