//! CPU and priority apply to the requesting thread, and refusals state a remedy.
#![allow(clippy::unwrap_used, reason = "a test that cannot continue ends")]

use std::thread;

use joulebus_bus::{
    Rights, Scheduling, SchedulingError, page_faults, schedule_process, schedule_thread,
    try_scheduling,
};
use rustix::process::{Resource, Rlimit, getrlimit, setrlimit};
use rustix::thread::set_capabilities;
use rustix::thread::{CapabilitySet, CapabilitySets, capabilities, sched_getaffinity};

/// Policy (1 is SCHED_FIFO) and priority of the calling thread.
fn policy() -> (u32, u32) {
    let text = std::fs::read_to_string("/proc/thread-self/stat").unwrap();
    let fields: Vec<&str> = text.rsplit(')').next().unwrap().split_whitespace().collect();
    (fields[38].parse().unwrap(), fields[37].parse().unwrap())
}

/// Drops the calling thread's privileges. Capabilities are per thread, the limit is per process: no
/// other test here depends on it.
fn without_rights() {
    let held = capabilities(None).unwrap();
    let taken = CapabilitySet::SYS_NICE | CapabilitySet::IPC_LOCK | CapabilitySet::SYS_RESOURCE;
    let limits = getrlimit(Resource::Memlock);
    for (resource, current) in [(Resource::Rtprio, Some(0)), (Resource::Memlock, Some(65_536))] {
        let maximum = getrlimit(resource).maximum;
        setrlimit(resource, Rlimit { current, maximum }).unwrap();
    }
    assert!(limits.maximum.is_none_or(|most| most >= 65_536), "{limits:?}");
    let sets = CapabilitySets {
        effective: held.effective - taken,
        permitted: held.permitted - taken,
        inheritable: held.inheritable - taken,
    };
    set_capabilities(None, sets).unwrap();
}

#[test]
fn affinity_applies_to_the_requesting_thread() {
    let allowed = Rights::of_this_process().cpus;
    let cpu = *allowed.last().unwrap();
    let asked = Scheduling { cpus: vec![cpu], ..Scheduling::default() };
    thread::spawn(move || {
        let before = thread::spawn(|| {
            thread::park();
            sched_getaffinity(None).unwrap().count()
        });
        assert_eq!(schedule_process(&asked).unwrap().len(), 0);
        let set = sched_getaffinity(None).unwrap();
        assert!(set.is_set(cpu) && set.count() == 1, "{set:?}");
        // Beyond the end of the list no CPU is requested.
        schedule_thread(&asked, 7).unwrap();
        before.thread().unpark();
        assert_eq!(before.join().unwrap() as usize, allowed.len());
    })
    .join()
    .unwrap();
    assert_ne!(sched_getaffinity(None).unwrap().count(), 0);
}

#[test]
fn threads_of_a_real_time_thread_are_scheduled_normally() {
    let asked = Scheduling { priority: 3, required: true, ..Scheduling::default() };
    thread::spawn(move || {
        if let Err(error) = schedule_process(&asked) {
            println!("skipped: {error}");
            return;
        }
        assert_eq!(policy(), (1, 3));
        assert_eq!(thread::spawn(policy).join().unwrap(), (0, 0));
    })
    .join()
    .unwrap();
    assert_eq!(policy(), (0, 0));
}

#[test]
fn a_refusal_states_the_limit_the_capability_and_the_key() {
    thread::spawn(|| {
        without_rights();
        let wanted =
            Scheduling { cpus: vec![1023], priority: 20, lock_memory: true, required: false };
        let refused = schedule_process(&wanted).unwrap();
        let [memory, cpu, priority] = &refused[..] else {
            panic!("{refused:?}");
        };
        let assert_parts = |error: &SchedulingError, parts: &[&str]| {
            let text = error.to_string();
            for part in parts {
                assert!(text.contains(part), "no {part:?} in: {text}");
            }
        };
        assert_parts(
            memory,
            &["RLIMIT_MEMLOCK is 64 kB", "CAP_IPC_LOCK is missing", "`worker.memory"],
        );
        assert_parts(cpu, &["CPU 1023", "`worker.cpus`"]);
        assert_parts(
            priority,
            &["RLIMIT_RTPRIO is 0", "CAP_SYS_NICE is missing", "LimitRTPRIO=20"],
        );
        assert_eq!(try_scheduling(&wanted).unwrap().len(), 3);
        let required = Scheduling { required: true, ..wanted };
        assert!(matches!(schedule_process(&required), Err(SchedulingError::Memory { .. })));
        assert_eq!(policy(), (0, 0), "scheduling unchanged");
    })
    .join()
    .unwrap();
}

#[test]
fn page_faults_are_counted_for_the_calling_thread() {
    const PAGES: u64 = 4096;
    let touch = || {
        let (before, _) = page_faults().unwrap();
        let mut memory = vec![0_u8; PAGES as usize * 4096];
        for page in memory.chunks_mut(4096) {
            page[0] = std::hint::black_box(1);
        }
        std::hint::black_box(&memory);
        page_faults().unwrap().0 - before
    };
    // Huge pages of 2 MiB map 512 pages at once.
    assert!(touch() >= PAGES / 512);
    let (before, _) = page_faults().unwrap();
    let elsewhere = thread::spawn(touch).join().unwrap();
    let (after, _) = page_faults().unwrap();
    if elsewhere == PAGES {
        assert!(after - before < PAGES, "{before} {after}");
    }
}
