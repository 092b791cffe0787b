//! Threads that keep off the CPU of the thread that they share work with.

use std::sync::atomic::{AtomicI32, AtomicUsize, Ordering};

use rustix::process::Pid;
use rustix::thread::{CpuSet, gettid, sched_getaffinity, sched_getcpu, sched_setaffinity};

/// No CPU has this number.
const NOWHERE: usize = usize::MAX;

/// Threads that may use every CPU of the process but that of their *leader*, a thread that wakes
/// them to share its work. While the other CPUs are busy for a moment, Linux queues a thread behind
/// the one that wakes it, and leaves it there for milliseconds.
#[derive(Debug)]
pub struct ThreadsApart {
    /// Kernel's id of each, 0 until it has begun.
    ids: Box<[AtomicI32]>,
    /// CPUs of the process when this was created.
    allowed: CpuSet,
    /// The leader's CPU that they were kept off last.
    kept_off: AtomicUsize,
}

impl ThreadsApart {
    /// For `count` threads, which [join](ThreadsApart::join) as they begin. None is kept off
    /// anything if the process has a single CPU, or if its CPUs are unknown.
    #[must_use]
    pub fn new(count: usize) -> Self {
        let allowed = sched_getaffinity(None).unwrap_or_default();
        let count = if allowed.count() < 2 { 0 } else { count };
        let ids = (0..count).map(|_| AtomicI32::new(0)).collect();
        Self { ids, allowed, kept_off: AtomicUsize::new(NOWHERE) }
    }

    /// Adds the calling thread as number `place`.
    pub fn join(&self, place: usize) {
        if let Some(id) = self.ids.get(place) {
            id.store(gettid().as_raw_nonzero().get(), Ordering::Relaxed);
            self.kept_off.store(NOWHERE, Ordering::Relaxed);
        }
    }

    /// Keeps all off the CPU of the calling thread, their leader. Costs nothing where it is still
    /// on the same one. Does not allocate.
    pub fn keep_off(&self) {
        if self.ids.is_empty() {
            return;
        }
        let cpu = sched_getcpu();
        if self.kept_off.swap(cpu, Ordering::Relaxed) == cpu {
            return;
        }
        let mut others = self.allowed;
        others.unset(cpu);
        for id in &self.ids {
            // It is an optimisation: a thread that has ended or a refusal changes nothing.
            let _ = Pid::from_raw(id.load(Ordering::Relaxed))
                .map(|thread| sched_setaffinity(Some(thread), &others));
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::thread;

    use super::*;

    fn cpus(set: &CpuSet) -> Vec<usize> {
        (0..CpuSet::MAX_CPU).filter(|cpu| set.is_set(*cpu)).collect()
    }

    #[test]
    fn a_thread_may_use_every_cpu_but_that_of_its_leader() {
        let all = sched_getaffinity(None).unwrap();
        let apart = ThreadsApart::new(1);
        let ((begun, is_begun), (go, is_over)) = (channel(), channel());
        let joined = &apart;
        thread::scope(|scope| {
            let other = scope.spawn(move || {
                joined.join(0);
                joined.join(1);
                begun.send(()).unwrap();
                is_over.recv().unwrap();
                sched_getaffinity(None).unwrap()
            });
            is_begun.recv().unwrap();
            // The leader itself stays where it is, so that its CPU is known.
            let mut only = CpuSet::new();
            let cpu = *cpus(&all).last().unwrap();
            only.set(cpu);
            sched_setaffinity(None, &only).unwrap();
            apart.keep_off();
            go.send(()).unwrap();
            let mut expected = cpus(&all);
            expected.retain(|other| *other != cpu || all.count() < 2);
            assert_eq!(cpus(&other.join().unwrap()), expected);
        });
    }

    #[test]
    fn threads_that_have_not_begun_or_have_ended_are_passed_over() {
        let apart = ThreadsApart::new(2);
        apart.keep_off();
        thread::scope(|scope| scope.spawn(|| apart.join(1)).join()).unwrap();
        apart.keep_off();
    }
}
