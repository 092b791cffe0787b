//! Processes and their threads: who runs, who dies, who is woken.

use std::cell::{Cell, RefCell};
use std::panic::resume_unwind;
use std::thread::LocalKey;
use std::time::Duration;

use joulebus_statistics::noise::Noise;

use crate::current::{current, set_current};
use crate::{memory, time};

/// Panic payload that unwinds the code of a killed process.
#[derive(Debug, Clone, Copy)]
pub struct Killed;

/// Work that a process repeats beside its main loop; see `Background` of the simulated bus.
pub type Work = Box<dyn FnMut(bool) -> Option<Duration>>;

struct Thread {
    pid: u32,
    number: u64,
    due_ns: u64,
    /// Woken since its last step began.
    is_woken: bool,
    work: Option<Work>,
}

thread_local! {
    static IS_DEAD: Cell<bool> = const { Cell::new(false) };
    /// Process to be killed, and the operations left to it.
    static VICTIM: Cell<(u32, u64)> = const { Cell::new((0, 0)) };
    /// The same, and accesses to the disk.
    static VICTIM_AT_DISK: Cell<(u32, u64)> = const { Cell::new((0, 0)) };
    /// Duration of an operation, ns.
    static COST_NS: Cell<u64> = const { Cell::new(USUAL_COST_NS) };
    static DEADLINE_NS: Cell<Option<u64>> = const { Cell::new(None) };
    static NUMBER: Cell<u64> = const { Cell::new(0) };
    static THREADS: RefCell<Vec<Thread>> = const { RefCell::new(Vec::new()) };
    static NOISE: RefCell<Noise> = RefCell::new(Noise::new(0, 0));
    static WITHOUT_DESCRIPTORS: RefCell<Vec<u32>> = const { RefCell::new(Vec::new()) };
    static MEMORY_IS_FULL: Cell<bool> = const { Cell::new(false) };
    /// Processes that live: their pid, and a number that no other process has.
    static LIVES: RefCell<Vec<(u32, u64)>> = const { RefCell::new(Vec::new()) };
    /// The thread that runs, 0: the main one of its process.
    static THREAD: Cell<u64> = const { Cell::new(0) };
    /// Processes that an event has woken.
    static WOKEN: RefCell<Vec<u32>> = const { RefCell::new(Vec::new()) };
}

/// Usual duration of an operation, ns.
pub const USUAL_COST_NS: u64 = 100;

pub(crate) fn begin(seed: u64) {
    THREADS.with_borrow_mut(Vec::clear);
    WITHOUT_DESCRIPTORS.with_borrow_mut(Vec::clear);
    LIVES.with_borrow_mut(Vec::clear);
    WOKEN.with_borrow_mut(Vec::clear);
    MEMORY_IS_FULL.set(false);
    spare_all();
    COST_NS.set(USUAL_COST_NS);
    IS_DEAD.set(false);
    set_current(0);
    NUMBER.set(0);
    NOISE.set(Noise::new(seed, 1));
}

/// A number that no other thing of this host has.
pub fn number() -> u64 {
    NUMBER.set(NUMBER.get() + 1);
    NUMBER.get()
}

/// Uniform on 0..`bound`.
pub fn below(bound: usize) -> usize {
    NOISE.with_borrow_mut(|noise| noise.below(bound))
}

/// True once in `times` calls.
pub fn once_in(times: usize) -> bool {
    below(times) == 0
}

/// True while the destructors of a killed process run.
pub fn is_dead() -> bool {
    IS_DEAD.get()
}

/// From here on process `pid` runs; its operations take `cost_ns` each.
pub fn enter(pid: u32, cost_ns: u64) {
    set_current(pid);
    THREAD.set(0);
    COST_NS.set(cost_ns);
    DEADLINE_NS.set(None);
    IS_DEAD.set(false);
}

/// From here on the remains of a killed process are dropped, without effect.
pub fn bury(pid: u32) {
    set_current(pid);
    IS_DEAD.set(true);
}

/// The process stops running. Returns until when it sleeps, monotonic ns, if it stated that.
pub fn leave() -> Option<u64> {
    set_current(0);
    IS_DEAD.set(false);
    THREAD.set(0);
    COST_NS.set(USUAL_COST_NS);
    DEADLINE_NS.take()
}

/// The process sleeps until `deadline_ns` (monotonic).
pub fn sleep_until(deadline_ns: u64) {
    DEADLINE_NS.set(Some(deadline_ns));
}

/// From here on there is a process `pid`.
pub fn begin_life(pid: u32) {
    let number = number();
    memory::outside(|| LIVES.with_borrow_mut(|lives| lives.push((pid, number))));
}

/// From here on there is no process `pid`.
pub fn end_life(pid: u32) {
    LIVES.with_borrow_mut(|lives| lives.retain(|(other, _)| *other != pid));
    take_descriptors(pid, false);
    for victim in [&VICTIM, &VICTIM_AT_DISK] {
        if victim.get().0 == pid {
            victim.set((0, 0));
        }
    }
}

/// The number of the process `pid`, if it lives.
pub fn life(pid: u32) -> Option<u64> {
    LIVES.with_borrow(|lives| {
        let found = lives.iter().find(|(other, _)| *other == pid);
        found.map(|(_, number)| *number)
    })
}

/// The thread that runs: 0, the main one of its process, or that of [`start_thread`].
pub fn thread() -> u64 {
    THREAD.get()
}

/// An event wakes process `pid`, or one of its threads.
pub fn wake(pid: u32, thread: u64) {
    if thread == 0 {
        memory::outside(|| WOKEN.with_borrow_mut(|woken| woken.push(pid)));
    } else {
        wake_thread(thread);
    }
}

/// Ends the pause of a thread.
pub fn wake_thread(number: u64) {
    let now_ns = time::now_ns();
    THREADS.with_borrow_mut(|threads| {
        for thread in threads.iter_mut().filter(|thread| thread.number == number) {
            thread.due_ns = thread.due_ns.min(now_ns);
            thread.is_woken = true;
        }
    });
}

/// Takes the processes that events have woken since the last call.
pub fn take_woken(into: &mut Vec<u32>) {
    WOKEN.with_borrow_mut(|woken| into.append(woken));
}

/// Process `pid` dies in its `operations`-th operation from now.
pub fn kill_in(pid: u32, operations: u64) {
    VICTIM.set((pid, operations.max(1)));
}

/// Process `pid` dies in its `accesses`-th access to the disk from now.
pub fn kill_at_disk(pid: u32, accesses: u64) {
    VICTIM_AT_DISK.set((pid, accesses.max(1)));
}

/// Nobody is to be killed any more.
pub fn spare_all() {
    VICTIM.set((0, 0));
    VICTIM_AT_DISK.set((0, 0));
}

/// A call that reaches the host: takes time, and is where a process may be killed.
pub fn operation() {
    if IS_DEAD.get() {
        return;
    }
    time::pass(COST_NS.get());
    strike(&VICTIM);
}

pub(crate) fn disk_access() {
    operation();
    if !IS_DEAD.get() {
        strike(&VICTIM_AT_DISK);
    }
}

/// Kills the process that runs if it is the `victim`, and this is its last call.
fn strike(victim: &'static LocalKey<Cell<(u32, u64)>>) {
    let (pid, left) = victim.get();
    if pid == 0 || pid != current() {
        return;
    }
    victim.set((pid, left - 1));
    if left == 1 {
        victim.set((0, 0));
        IS_DEAD.set(true);
        resume_unwind(Box::new(Killed));
    }
}

/// Sets whether shared memory is full.
pub fn fill_memory(is_full: bool) {
    MEMORY_IS_FULL.set(is_full);
}

/// True if shared memory is full.
pub fn memory_is_full() -> bool {
    MEMORY_IS_FULL.get()
}

/// Sets whether process `pid` has no file descriptors left.
pub fn take_descriptors(pid: u32, are_gone: bool) {
    WITHOUT_DESCRIPTORS.with_borrow_mut(|pids| {
        pids.retain(|other| *other != pid);
        if are_gone {
            pids.push(pid);
        }
    });
}

/// True if process `pid` has file descriptors left.
pub fn has_descriptors(pid: u32) -> bool {
    WITHOUT_DESCRIPTORS.with_borrow(|pids| !pids.contains(&pid))
}

/// Runs `work` as the thread `number`, which begins with it.
pub fn as_thread<T>(number: u64, work: impl FnOnce() -> T) -> T {
    let before = THREAD.replace(number);
    let done = work();
    THREAD.set(before);
    done
}

/// Starts a thread of the current process; returns its number.
pub fn start_thread(work: Work) -> u64 {
    let number = number();
    start_numbered(number, work);
    number
}

/// Starts the thread `number` of the current process.
pub fn start_numbered(number: u64, work: Work) {
    let thread = Thread {
        pid: current(),
        number,
        due_ns: time::now_ns(),
        is_woken: false,
        work: Some(work),
    };
    memory::outside(|| THREADS.with_borrow_mut(|threads| threads.push(thread)));
}

/// Removes a thread, and returns its work unless that has ended.
pub fn take_thread(number: u64) -> Option<Work> {
    THREADS.with_borrow_mut(|threads| {
        let at = threads.iter().position(|thread| thread.number == number)?;
        threads.remove(at).work
    })
}

/// The thread of process `pid` that is due first: its number, and when (simulated ns).
pub fn next_thread(pid: u32) -> Option<(u64, u64)> {
    THREADS.with_borrow(|threads| {
        let of_process = threads.iter().filter(|thread| thread.pid == pid);
        let due = of_process.map(|thread| (thread.number, thread.due_ns));
        due.min_by_key(|(_, due_ns)| *due_ns)
    })
}

/// Lets a thread do its next step. The caller has entered its process.
pub fn run_thread(number: u64) {
    let place = |threads: &[Thread]| threads.iter().position(|thread| thread.number == number);
    let work = THREADS.with_borrow_mut(|threads| {
        let at = place(threads)?;
        threads[at].is_woken = false;
        threads[at].work.take()
    });
    let Some(mut work) = work else {
        return;
    };
    THREAD.set(number);
    let pause = work(false);
    THREAD.set(0);
    let until_ns = DEADLINE_NS.take().map_or(0, time::simulated_ns);
    THREADS.with_borrow_mut(|threads| {
        let Some(at) = place(threads) else {
            return;
        };
        match pause {
            Some(pause) => {
                let pause_ns = u64::try_from(pause.as_nanos()).unwrap_or(u64::MAX);
                let paused_ns = time::now_ns().saturating_add(pause_ns);
                threads[at].due_ns = match threads[at].is_woken {
                    true => time::now_ns(),
                    false => paused_ns.max(until_ns),
                };
                threads[at].work = Some(work);
            }
            None => {
                threads.remove(at);
            }
        }
    });
}

/// Removes the threads of a process that was killed. To be called after [`bury`].
pub fn remove_threads(pid: u32) {
    let (gone, left) = THREADS.with_borrow_mut(|threads| {
        std::mem::take(threads).into_iter().partition::<Vec<_>, _>(|thread| thread.pid == pid)
    });
    THREADS.set(left);
    drop(gone);
}
