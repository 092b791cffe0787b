//! Merges the frames of all shards' workers into frames of one fleet on this host.

use std::sync::Arc;

use joulebus_bus::{SendError, Writer, clock, process_id};
use joulebus_config::Config;
use joulebus_wire::{
    Budgets, Diagnostics, Forecasts, Outlooks, Place, PlanStateHeader, PlanStates,
};

use crate::protocol::carried::Carried;
use crate::protocol::merge::{Continued, Merge, Merged, Origin};
use crate::protocol::receiver::Accepted;
use crate::protocol::shards::Shards;
use crate::protocol::shift::shift;
use crate::worker_ports::{PassError, WorkerPorts, header_here};

/// Periods after which a worker's forecasts are stale.
const STALE_PERIODS: u64 = 2;

/// The newest frames of the shards, and the state of the merged worker.
pub(crate) struct ShardMerger {
    shards: Arc<Shards>,
    /// Maximum number of rows of a frame.
    capacity: usize,
    /// A worker's frame comes every n-th tick.
    every: u32,
    /// Period of the ticks by this host's config, which all hosts share. A worker's false period
    /// would hold up the others.
    period_ns: u64,
    run: u64,
    tick: u64,
    counters: Vec<Continued>,
    forecasts: Merge<Forecasts>,
    diagnostics: Merge<Diagnostics>,
    budgets: Merge<Budgets>,
    plan_states: Merge<PlanStates>,
    outlooks: Merge<Outlooks>,
    /// Shards that compute plans with other settings or models, as last logged.
    differ: Vec<bool>,
}

impl ShardMerger {
    pub(crate) fn new(shards: &Arc<Shards>, config: &Config, every: u32) -> Self {
        let count = shards.all().len();
        Self {
            shards: Arc::clone(shards),
            capacity: config.limits().capacity,
            every,
            period_ns: config.tick_period_ns(),
            run: clock::monotonic_ns(),
            tick: 0,
            counters: (0..count).map(|_| Continued::default()).collect(),
            forecasts: Merge::new(count),
            diagnostics: Merge::new(count),
            budgets: Merge::new(count),
            plan_states: Merge::new(count),
            outlooks: Merge::new(count),
            differ: vec![false; count],
        }
    }

    /// Takes a frame of a shard's worker. Rows of robots of other shards are dropped.
    pub(crate) fn put(&mut self, shard: usize, accepted: &Accepted<'_>) -> Result<(), PassError> {
        let shards = &self.shards;
        let is_own = |robot| shards.of_robot(robot) == Some(shard);
        let every = self.every;
        match accepted.frame.service {
            Carried::FORECASTS => {
                let mut header = header_here::<Forecasts>(accepted, every)?;
                self.counters[shard].add(&mut header);
                put(&mut self.forecasts, (shard, header), accepted, is_own);
            }
            Carried::DIAGNOSTICS => {
                let header = header_here::<Diagnostics>(accepted, every)?;
                put(&mut self.diagnostics, (shard, header), accepted, is_own);
            }
            Carried::BUDGETS => {
                let header = header_here::<Budgets>(accepted, every)?;
                put(&mut self.budgets, (shard, header), accepted, is_own);
            }
            Carried::PLAN_STATES => {
                let header = header_here::<PlanStates>(accepted, every)?;
                put(&mut self.plan_states, (shard, header), accepted, is_own);
            }
            Carried::OUTLOOKS => {
                let header = header_here::<Outlooks>(accepted, every)?;
                put(&mut self.outlooks, (shard, header), accepted, is_own);
            }
            // Services of a single worker are not requested.
            _ => {}
        }
        Ok(())
    }

    /// Writes the merged frames that are due. `has_worker` are the shards with a living leader.
    pub(crate) fn write(
        &mut self,
        worker_ports: &mut WorkerPorts,
        has_worker: &[bool],
    ) -> Result<(), SendError> {
        let now_ns = clock::monotonic_ns();
        let is_live = self.live_shards(has_worker, now_ns);
        let at = (now_ns, self.period_ns, self.every);
        if self.forecasts.is_due((has_worker, &is_live), at) {
            let own = self.own(self.tick + 1);
            let merge = &mut self.forecasts;
            if send(merge, &mut worker_ports.forecasts, (&is_live, own), (now_ns, self.capacity))? {
                self.tick += 1;
                worker_ports.wake_planners();
            }
        }
        if self.tick == 0 {
            return Ok(());
        }
        let (own, with) = (self.own(self.tick), (now_ns, self.capacity));
        if self.diagnostics.is_due((has_worker, &is_live), at) {
            let live = (is_live.as_slice(), own);
            send(&mut self.diagnostics, &mut worker_ports.diagnostics, live, with)?;
        }
        if self.budgets.is_due((has_worker, &is_live), at) {
            let live = (is_live.as_slice(), own);
            send(&mut self.budgets, &mut worker_ports.budgets, live, with)?;
        }
        if self.outlooks.is_due((has_worker, &is_live), at) {
            let live = (is_live.as_slice(), own);
            send(&mut self.outlooks, &mut worker_ports.outlooks, live, with)?;
        }
        if self.plan_states.is_due((has_worker, &is_live), at) {
            let agree = self.agree(&is_live, now_ns);
            let live = (agree.as_slice(), own);
            send(&mut self.plan_states, &mut worker_ports.plan_states, live, with)?;
        }
        Ok(())
    }

    fn own(&self, tick: u64) -> Origin {
        Origin { pid: process_id(), place: Place { run: self.run, number: tick } }
    }

    /// The shards whose forecasts are fresh.
    fn live_shards(&self, has_worker: &[bool], now_ns: u64) -> Vec<bool> {
        let header = |shard: usize| self.forecasts.header(shard);
        let is_new =
            |shard| header(shard).is_some_and(|it| is_fresh(it.sent_ns, it.period_ns, now_ns));
        let shards = has_worker.iter().enumerate();
        shards.map(|(shard, has_worker)| *has_worker && is_new(shard)).collect()
    }

    /// The fresh shards with new plan states that agree with the first of them in settings and
    /// models, because a planner computes with one set.
    fn agree(&mut self, is_live: &[bool], now_ns: u64) -> Vec<bool> {
        let header = |shard: usize| self.plan_states.header(shard);
        let is_new =
            |shard| header(shard).is_some_and(|it| is_fresh(it.sent_ns, it.period_ns, now_ns));
        let live = is_live.iter().enumerate();
        let is_live: Vec<bool> = live.map(|(shard, live)| *live && is_new(shard)).collect();
        let by =
            |header: &PlanStateHeader| (header.settings_hash, header.model_hash, header.models);
        let of = |shard: usize| self.plan_states.header(shard).map(by);
        let first = (0..is_live.len()).find(|shard| is_live[*shard] && of(*shard).is_some());
        let first = first.and_then(of);
        let agree = |shard: usize| is_live[shard] && of(shard) == first;
        let agree: Vec<bool> = (0..is_live.len()).map(agree).collect();
        for (shard, differed) in self.differ.iter_mut().enumerate() {
            let differs = is_live[shard] && !agree[shard];
            if differs && !*differed {
                let name = &self.shards.all()[shard].name;
                tracing::warn!(
                    "shard {name} computes with other settings or models: nobody plans for its \
                        robots. Use one config"
                );
            }
            *differed = differs;
        }
        agree
    }
}

const fn is_fresh(sent_ns: u64, period_ns: u64, now_ns: u64) -> bool {
    now_ns.saturating_sub(sent_ns) <= period_ns.saturating_mul(STALE_PERIODS)
}

/// Takes a shard's frame: the rows of the shard's robots, with the times of this host.
fn put<C: Merged>(
    merge: &mut Merge<C>,
    (shard, header): (usize, C::Header),
    accepted: &Accepted<'_>,
    is_own: impl Fn(u32) -> bool,
) {
    let rows = accepted.frame.elements::<C::Row>();
    let rows = rows.filter(|row| C::robot(row).is_some_and(&is_own)).map(|mut row| {
        shift(&mut row, accepted.offset_ns);
        row
    });
    merge.put(shard, header, rows, clock::monotonic_ns());
}

/// Writes a frame. Returns false if there is none.
fn send<C: Merged>(
    merge: &mut Merge<C>,
    writer: &mut Writer<C>,
    (is_live, own): (&[bool], Origin),
    (now_ns, capacity): (u64, usize),
) -> Result<bool, SendError> {
    let mut loan = writer.loan_to_fill(merge.len().min(capacity))?;
    let mut to = loan.payload_mut().iter_mut();
    let header = merge.write(is_live, own, now_ns, |row| {
        // If the shards have more robots than this host has room for, the last ones are dropped.
        if let Some(to) = to.next() {
            *to = row;
        }
    });
    let Some(header) = header else {
        return Ok(false);
    };
    *loan.header_mut() = header;
    loan.send()?;
    Ok(true)
}
