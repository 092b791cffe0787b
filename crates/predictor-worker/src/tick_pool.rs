//! The threads that share a tick.
//!
//! The thread that makes the crew is one of them, so that a tick begins without waiting for
//! another thread, and what no other has begun by then it does itself: waking a thread takes
//! longer than the tick of a thousand robots.

use std::cell::Cell;
use std::sync::Mutex;

use joulebus_bus::{Scheduling, clock};
use joulebus_fleet::{Batch, Outputs, Shard, Stage};
use joulebus_wire::{Budget, Diagnostic, Forecast};
use rayon::{ThreadPool, ThreadPoolBuildError, ThreadPoolBuilder};

/// Robots that a thread takes at a time, at least: two tiles.
const LEAST: usize = 1024;
/// Parts for each thread, so that one that comes late finds something to do.
const PARTS: usize = 8;

/// The threads, and what each needs.
#[derive(Debug)]
pub struct TickPool {
    seats: Vec<Mutex<ThreadScratch>>,
    /// Robots from which on a tick is shared.
    from: usize,
}

/// One thread's own.
#[derive(Debug, Default)]
struct ThreadScratch {
    batch: Batch,
    spent: StageTimes,
}

/// Time spent in each stage of the tick, over all threads, ns.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct StageTimes(pub [u64; Stage::ALL.len()]);

thread_local! {
    /// The pool that the thread belongs to. A thread cannot leave its pool: this one lasts as long
    /// as the thread, and the next crew of the thread works with it.
    static POOL: Cell<Option<ThreadPool>> = const { Cell::new(None) };
}

fn pool(threads: usize, scheduling: Scheduling) -> Result<ThreadPool, ThreadPoolBuildError> {
    ThreadPoolBuilder::new()
        .num_threads(threads)
        .use_current_thread()
        .thread_name(|place| format!("joulebus-tick-{place}"))
        .start_handler(move |place| {
            if let Err(refused) = scheduling.apply_to_thread(place) {
                tracing::warn!("{refused}");
            }
        })
        .build()
}

impl TickPool {
    /// A crew of `threads` threads, the calling one among them; from `from` robots on they share a
    /// tick. `scheduling` is asked for by the others: whoever calls has had it, or does without.
    ///
    /// # Errors
    /// A thread could not be started.
    pub fn assemble(
        threads: usize,
        from: usize,
        scheduling: &Scheduling,
    ) -> Result<Self, ThreadPoolBuildError> {
        let threads = match rayon::current_thread_index() {
            _ if threads <= 1 => 1,
            Some(_) => threads.min(rayon::current_num_threads()),
            None => {
                let pool = pool(threads, scheduling.clone())?;
                POOL.with(|of_thread| of_thread.set(Some(pool)));
                threads
            }
        };
        Ok(Self {
            seats: (0..threads).map(|_| Mutex::default()).collect(),
            from,
        })
    }

    /// Whether a tick of so many robots is shared.
    #[must_use]
    pub fn shares(&self, robots: usize) -> bool {
        self.seats.len() > 1 && robots >= self.from
    }

    /// Ticks all robots, on all threads if there are enough robots.
    pub fn run(&self, shard: Shard<'_>, outputs: Outputs<'_>) {
        let robots = shard.len();
        if self.shares(robots) {
            let part = robots.div_ceil(PARTS * self.seats.len()).max(LEAST);
            self.divide(shard, outputs, part);
        } else {
            self.part(shard, outputs);
        }
    }

    /// The first half of a tick, on the calling thread.
    pub(crate) fn forecast(&self, shard: &mut Shard<'_>, forecasts: &mut [Forecast]) {
        self.on_seat(|batch, on| shard.forecast(batch, forecasts, on));
    }

    /// The second half of a tick, on the calling thread.
    pub(crate) fn account(
        &self,
        shard: &mut Shard<'_>,
        diagnostics: &mut [Diagnostic],
        budgets: &mut [Budget],
    ) {
        self.on_seat(|batch, on| shard.account(batch, diagnostics, budgets, on));
    }

    /// Time spent so far in each stage of [`Stage::ALL`], over all threads, ns.
    #[must_use]
    pub fn spent_ns(&self) -> [u64; Stage::ALL.len()] {
        self.spent().0
    }

    /// Time spent so far.
    pub(crate) fn spent(&self) -> StageTimes {
        let mut sum = StageTimes::default();
        for seat in &self.seats {
            let seat = seat
                .lock()
                .unwrap_or_else(std::sync::PoisonError::into_inner);
            for (sum, spent) in sum.0.iter_mut().zip(seat.spent.0) {
                *sum += spent;
            }
        }
        sum
    }

    fn divide(&self, shard: Shard<'_>, outputs: Outputs<'_>, part: usize) {
        let robots = shard.len();
        if robots <= part {
            self.part(shard, outputs);
            return;
        }
        let (first, second) = shard.split_at(robots / 2);
        let (to_first, to_second) = outputs.split_at(first.len());
        rayon::join(
            || self.divide(first, to_first, part),
            || self.divide(second, to_second, part),
        );
    }

    fn part(&self, mut shard: Shard<'_>, outputs: Outputs<'_>) {
        self.on_seat(|batch, on| shard.run(batch, outputs, on));
    }

    /// Works with what belongs to the calling thread; its lock is never waited for.
    fn on_seat(&self, work: impl FnOnce(&mut Batch, &mut dyn FnMut(Stage))) {
        let place = rayon::current_thread_index().unwrap_or(0);
        let seat = &self.seats[place % self.seats.len()];
        // Scratch and sums: whatever a panic has left there does no harm.
        let mut seat = seat
            .lock()
            .unwrap_or_else(std::sync::PoisonError::into_inner);
        let ThreadScratch { batch, spent } = &mut *seat;
        let mut since_ns = clock::monotonic_ns();
        work(batch, &mut |stage| {
            let now_ns = clock::monotonic_ns();
            spent.0[stage as usize] += now_ns.saturating_sub(since_ns);
            since_ns = now_ns;
        });
    }
}
