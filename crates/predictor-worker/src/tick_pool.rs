//! The threads that share a tick.
//!
//! The thread that creates the pool belongs to it, so that a tick starts without waiting for
//! another thread, and this thread runs every part that no other has begun by then: waking a thread
//! takes as long as the forecasts of some hundred robots.

use std::cell::OnceCell;
use std::sync::{Arc, Mutex};

use joulebus_bus::{Scheduling, ThreadsApart, clock, schedule_thread};
use joulebus_fleet::{Batch, Outputs, SecondaryOutputs, Shard, Stage};
use joulebus_wire::Forecast;
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Minimum number of robots per part.
const MIN_ROBOTS: usize = 256;
/// Robots from which the second pass is shared, in multiples of those for forecasts. Until then the
/// other processors are left to the planners that the forecasts have woken.
const ACCOUNTS_FROM: usize = 8;
/// Parts per thread, so that a thread that wakes late still finds work.
const PARTS: usize = 8;

/// The pool with the scratch memory of each thread.
#[derive(Debug)]
pub struct TickPool {
    scratch: Vec<Mutex<ThreadScratch>>,
    /// The other threads, unless each has a CPU by the config. `None` if there is none.
    apart: Option<Arc<ThreadsApart>>,
    /// Minimum number of robots of a parallel tick.
    from: usize,
}

/// A pass over the robots of a shard. Outputs that it does not write are empty.
type Pass = fn(&mut Shard<'_>, &mut Batch, Outputs<'_>, &mut dyn FnMut(Stage));

/// Scratch memory of one thread: a model's batch, and times.
#[derive(Debug, Default)]
struct ThreadScratch {
    batch: Batch,
    spent: StageTimes,
}

/// A thread that shares a tick could not be started.
#[derive(Debug, thiserror::Error)]
#[error("the threads of the tick (`worker.threads` in the config): {0}")]
pub struct TickPoolError(ThreadPoolBuildError);

/// Time spent in each stage of the tick, over all threads, ns.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct StageTimes(pub [u64; Stage::ALL.len()]);

thread_local! {
    /// The pool of this thread. A thread cannot leave its pool: the pool lasts as long as the
    /// thread, and later tick pools of the thread use it.
    static POOL: OnceCell<(ThreadPool, Arc<ThreadsApart>)> = const { OnceCell::new() };
}

fn pool(
    threads: usize,
    scheduling: Scheduling,
    apart: Arc<ThreadsApart>,
) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .use_current_thread()
        .thread_name(|place| format!("joulebus-tick-{place}"))
        .start_handler(move |place| {
            if let Err(refused) = schedule_thread(&scheduling, place) {
                tracing::warn!("{refused}");
            }
            // Not of place 0, which is the calling thread's.
            apart.join(place);
        })
        .build()
}

impl TickPool {
    /// A pool of `threads` threads, the calling one included. Ticks of `from` robots or more are
    /// parallel. `scheduling` is applied to the other threads. The calling thread's is left to the
    /// caller.
    ///
    /// # Errors
    /// [`TickPoolError`]: a thread could not be started.
    pub fn new(
        threads: usize,
        from: usize,
        scheduling: &Scheduling,
    ) -> Result<Self, TickPoolError> {
        let threads = match rayon::current_thread_index() {
            _ if threads <= 1 => 1,
            Some(_) => threads.min(rayon::current_num_threads()),
            None => {
                let count = if scheduling.cpus.is_empty() { threads } else { 0 };
                let apart = Arc::new(ThreadsApart::new(count));
                let pool =
                    pool(threads, scheduling.clone(), apart.clone()).map_err(TickPoolError)?;
                POOL.with(|of_thread| of_thread.set((pool, apart)).ok());
                threads
            }
        };
        let apart = POOL.with(|of_thread| of_thread.get().map(|(_, apart)| Arc::clone(apart)));
        Ok(Self { scratch: (0..threads).map(|_| Mutex::default()).collect(), apart, from })
    }

    /// True if a tick of that many robots is parallel.
    #[must_use]
    pub fn shares(&self, robots: usize) -> bool {
        self.shares_from(self.from, robots)
    }

    fn shares_from(&self, from: usize, robots: usize) -> bool {
        self.scratch.len() > 1 && robots >= from
    }

    /// Wakes a thread that will share a tick of that many robots. Waking takes some 100 µs, and the
    /// thread looks for work some 20 µs before it sleeps again. So call it that long before.
    pub fn wake(&self, robots: usize) {
        if self.shares(robots) {
            self.keep_apart();
            rayon::join(|| (), || ());
        }
    }

    fn keep_apart(&self) {
        if let Some(apart) = &self.apart {
            apart.keep_off();
        }
    }

    /// Ticks all robots in one pass, on all threads if there are enough robots.
    pub fn run(&self, shard: Shard<'_>, outputs: Outputs<'_>) {
        self.pass(shard, outputs, self.from, |shard, batch, outputs, on| {
            shard.run(batch, outputs, on);
        });
    }

    /// The first of two passes of a tick.
    pub fn forecast(&self, shard: Shard<'_>, forecasts: &mut [Forecast]) {
        let outputs = Outputs { forecasts, ..Outputs::default() };
        self.pass(shard, outputs, self.from, |shard, batch, outputs, on| {
            shard.forecast(batch, outputs.forecasts, on);
        });
    }

    /// The second pass.
    pub fn account(&self, shard: Shard<'_>, secondary: SecondaryOutputs<'_>) {
        let outputs = Outputs { secondary, ..Outputs::default() };
        let from = self.from.saturating_mul(ACCOUNTS_FROM);
        self.pass(shard, outputs, from, |shard, batch, outputs, on| {
            shard.account(batch, outputs.secondary, on);
        });
    }

    fn pass(&self, shard: Shard<'_>, outputs: Outputs<'_>, from: usize, work: Pass) {
        let robots = shard.len();
        let part = match self.shares_from(from, robots) {
            true => {
                self.keep_apart();
                robots.div_ceil(PARTS * self.scratch.len()).max(MIN_ROBOTS)
            }
            false => robots,
        };
        self.divide(shard, outputs, part, work);
    }

    /// Time spent so far in each stage of [`Stage::ALL`], over all threads, ns.
    pub fn spent_ns(&self) -> [u64; Stage::ALL.len()] {
        self.spent().0
    }

    /// Time spent so far.
    pub(crate) fn spent(&self) -> StageTimes {
        let mut sum = StageTimes::default();
        for scratch in &self.scratch {
            let scratch = scratch.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
            for (sum, spent) in sum.0.iter_mut().zip(scratch.spent.0) {
                *sum += spent;
            }
        }
        sum
    }

    fn divide(&self, mut shard: Shard<'_>, outputs: Outputs<'_>, part: usize, work: Pass) {
        let robots = shard.len();
        if robots <= part {
            self.with_scratch(|batch, on| work(&mut shard, batch, outputs, on));
            return;
        }
        let (first, second) = shard.split_at(robots / 2);
        let (to_first, to_second) = outputs.split_at(first.len());
        rayon::join(
            || self.divide(first, to_first, part, work),
            || self.divide(second, to_second, part, work),
        );
    }

    /// Runs `work` with the scratch of the calling thread. Its lock is never contended.
    fn with_scratch(&self, work: impl FnOnce(&mut Batch, &mut dyn FnMut(Stage))) {
        let place = rayon::current_thread_index().unwrap_or(0);
        let scratch = &self.scratch[place % self.scratch.len()];
        // Scratch and sums: the state left by a panic is harmless.
        let mut scratch = scratch.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        let ThreadScratch { batch, spent } = &mut *scratch;
        let mut since_ns = clock::monotonic_ns();
        work(batch, &mut |stage| {
            let now_ns = clock::monotonic_ns();
            spent.0[stage as usize] += now_ns.saturating_sub(since_ns);
            since_ns = now_ns;
        });
    }
}
