//! Persistent spinning threads, each pinned to a processor.

use std::sync::Barrier;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::Instant;

use crate::Distribution;
use crate::arguments::BenchOptions;
use joulebus_bus::Scheduling;
use rustix::thread::{CpuSet, sched_getaffinity, sched_setaffinity};

/// The processors available to this process, ascending. Empty if unknown.
pub(crate) fn processors() -> Vec<usize> {
    let Ok(allowed) = sched_getaffinity(None) else {
        return Vec::new();
    };
    (0..CpuSet::MAX_CPU).filter(|processor| allowed.is_set(*processor)).collect()
}

/// Scheduling of the measured thread, which must be granted.
pub(crate) fn scheduling(options: &BenchOptions) -> Scheduling {
    Scheduling {
        cpus: options.worker_cpus.clone(),
        priority: options.worker_priority,
        lock_memory: options.worker_locked,
        required: true,
    }
}

/// Pins the calling thread to one processor. Returns whether the system accepted it.
pub(crate) fn pin(processor: usize) -> bool {
    let mut only = CpuSet::new();
    only.set(processor);
    sched_setaffinity(None, &only).is_ok()
}

/// Runs all `works` in parallel, `repetitions` times, each on a thread pinned to its own processor
/// as far as there are enough. Returns µs from the start of each repetition to the end of its last
/// part. The threads spin in between, like those of a busy tick.
fn side_by_side<W: Send>(
    works: &mut [W],
    call: impl Fn(&mut W) + Copy + Send,
    repetitions: usize,
) -> Vec<f64> {
    let processors = processors();
    let (round, done) = (AtomicUsize::new(0), AtomicUsize::new(0));
    let parts = works.len();
    let ready = Barrier::new(parts);
    thread::scope(|scope| {
        let handles: Vec<_> = works
            .iter_mut()
            .enumerate()
            .map(|(place, work)| {
                let (round, done, ready) = (&round, &done, &ready);
                let processor = processors.get(place).copied();
                scope.spawn(move || {
                    processor.map(pin);
                    ready.wait();
                    let run = |repetition| {
                        let start = Instant::now();
                        begin(place, repetition, round);
                        call(work);
                        end(place, repetition * parts, done);
                        start.elapsed().as_nanos() as f64 * 1e-3
                    };
                    (1..=repetitions).map(run).collect::<Vec<f64>>()
                })
            })
            .collect();
        let times = handles.into_iter().map(thread::ScopedJoinHandle::join);
        // The first thread measures the time. A panic of any part ends the measurement.
        let times: Result<Vec<_>, _> = times.collect();
        match times {
            Ok(times) => times.into_iter().next().unwrap_or_default(),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// The first thread starts the round. The others follow.
fn begin(place: usize, repetition: usize, round: &AtomicUsize) {
    if place == 0 {
        round.store(repetition, Ordering::Release);
    } else {
        spin_until(|| round.load(Ordering::Acquire) >= repetition);
    }
}

/// The first thread waits for the others, which wait for the next round.
fn end(place: usize, all: usize, done: &AtomicUsize) {
    done.fetch_add(1, Ordering::AcqRel);
    if place == 0 {
        spin_until(|| done.load(Ordering::Acquire) == all);
    }
}

/// One thread and several on the same work.
pub(crate) struct Compared {
    /// Each repetition on one pinned thread, µs.
    pub(crate) one_us: Vec<f64>,
    /// Each repetition on several, µs.
    pub(crate) several_us: Vec<f64>,
    /// Median of one thread over that of several, for each alternation.
    pub(crate) speed_up: Vec<f64>,
}

/// Alternates between one pinned thread with all of the work and several with a part each.
pub(crate) fn compare<W: Send>(
    whole: &mut [W; 1],
    parts: &mut [W],
    call: impl Fn(&mut W) + Copy + Send,
    options: &BenchOptions,
) -> Compared {
    const TURNS: usize = 20;
    let turns = options.repetitions().clamp(1, TURNS);
    let start = Instant::now();
    call(&mut whole[0]);
    let each_s = options.each().as_secs_f64() / turns as f64;
    let repetitions = (each_s / start.elapsed().as_secs_f64().max(1e-9)).clamp(1.0, 100.0) as usize;
    let mut compared =
        Compared { one_us: Vec::new(), several_us: Vec::new(), speed_up: Vec::new() };
    for _ in 0..turns {
        let one_us = side_by_side(whole, call, repetitions);
        let several_us = side_by_side(parts, call, repetitions);
        let median = |values: &[f64]| Distribution::new(values).map_or(f64::NAN, |all| all.p50);
        let speed_up = median(&one_us) / median(&several_us);
        compared.one_us.extend(one_us);
        compared.several_us.extend(several_us);
        compared.speed_up.push(speed_up);
    }
    compared
}

/// Yields occasionally, so that other threads can run if there are more threads than processors.
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
        let mut counts = [0, 0, 0];
        let times_us = side_by_side(&mut counts, |count| *count += 1, 50);
        assert_eq!(times_us.len(), 50);
        assert_eq!(counts, [50; 3]);
    }

    #[test]
    fn this_process_may_use_a_processor() {
        assert!(!processors().is_empty());
    }
}
