//! Threads that stay, each on a processor of its own, and wait without sleeping.

use std::sync::Barrier;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// The processors that this process may use, ascending; empty if the system does not tell.
pub(crate) fn processors() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else {
        return Vec::new();
    };
    (0..CpuSet::MAX_CPU)
        .filter(|processor| allowed.is_set(*processor))
        .collect()
}

/// Keeps the thread that calls on one processor; returns whether the system did so.
pub(crate) fn pin(processor: usize) -> bool {
    let mut only = CpuSet::new();
    only.set(processor);
    sched_setaffinity(None, &only).is_ok()
}

/// Runs `works` side by side, `repetitions` times, each on a thread of its own that is pinned to a
/// processor of its own as far as there are enough. Returns ns from the start of each repetition to
/// the end of its last part. The threads spin in between, as workers of a busy tick do.
pub(crate) fn side_by_side(
    works: &mut [Box<dyn FnMut() + Send + '_>],
    repetitions: usize,
) -> Vec<f64> {
    let processors = processors();
    let (round, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let ready = Barrier::new(works.len() + 1);
    let parts = works.len();
    let starter = thread::scope(|scope| {
        let mut handles = Vec::new();
        for (place, work) in works.iter_mut().enumerate() {
            let (round, done, ready) = (&round, &done, &ready);
            let processor = processors.get(place).copied();
            handles.push(scope.spawn(move || {
                processor.map(pin);
                ready.wait();
                let mut times = Vec::with_capacity(repetitions);
                for repetition in 1..=repetitions {
                    times.push(one(place, parts, repetition, (round, done), work));
                }
                times
            }));
        }
        ready.wait();
        let mut handles = handles.into_iter();
        let first = handles.next().map(thread::ScopedJoinHandle::join);
        first.and_then(Result::ok)
    });
    starter.unwrap_or_default()
}

/// The first thread starts the round and ends it; the others join in. ns that the round took.
fn one(
    place: usize,
    parts: usize,
    repetition: usize,
    (round, done): (&AtomicUsize, &AtomicUsize),
    work: &mut Box<dyn FnMut() + Send + '_>,
) -> f64 {
    let start = Instant::now();
    if place == 0 {
        round.store(repetition, Ordering::Release);
    } else {
        spin_until(|| round.load(Ordering::Acquire) >= repetition);
    }
    work();
    done.fetch_add(1, Ordering::AcqRel);
    if place == 0 {
        spin_until(|| done.load(Ordering::Acquire) == repetition * parts);
    }
    start.elapsed().as_nanos() as f64
}

/// Gives way now and then: with more threads than processors the others have to run, too.
fn spin_until(ready: impl Fn() -> bool) {
    let mut tries = 0_u32;
    while !ready() {
        tries = tries.wrapping_add(1);
        if tries.is_multiple_of(4096) {
            thread::yield_now();
        } else {
            std::hint::spin_loop();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_runs_once_in_every_round() {
        let counts: Vec<AtomicUsize> = (0..3).map(|_| AtomicUsize::new(0)).collect();
        let mut works: Vec<Box<dyn FnMut() + Send + '_>> = Vec::new();
        for count in &counts {
            works.push(Box::new(move || {
                count.fetch_add(1, Ordering::Relaxed);
            }));
        }
        let times_ns = side_by_side(&mut works, 50);
        assert_eq!(times_ns.len(), 50);
        drop(works);
        for count in counts {
            assert_eq!(count.into_inner(), 50);
        }
    }

    #[test]
    fn this_process_may_use_a_processor() {
        assert!(!processors().is_empty());
    }
}
