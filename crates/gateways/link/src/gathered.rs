//! What the workers of all shards write, as one fleet's on this host.

use std::sync::Arc;

use joulebus_bus::{SendError, Writer, clock, process_id};
use joulebus_config::Config;
use joulebus_wire::{Budgets, Diagnostics, Forecasts, Place, PlanStateHeader, PlanStates};

use crate::outlets::{Outlets, PassError, header_here};
use crate::protocol::carried::Carried;
use crate::protocol::merge::{Continued, Merge, Merged, Own};
use crate::protocol::receiver::Accepted;
use crate::protocol::shards::Shards;
use crate::protocol::shift::shift;

/// Periods after which a worker's forecasts are stale.
const STALE_PERIODS: u64 = 2;

/// The newest frames of the shards.
pub(crate) struct Gathered {
    shards: Arc<Shards>,
    /// Rows of a frame at most.
    capacity: usize,
    /// Every how many ticks of a worker its frame comes.
    every: u32,
    /// Period of the ticks, that of all hosts' config: a false one of a worker would hold up the others.
    period_ns: u64,
    run: u64,
    tick: u64,
    counters: Vec<Continued>,
    forecasts: Merge<Forecasts>,
    diagnostics: Merge<Diagnostics>,
    budgets: Merge<Budgets>,
    plan_states: Merge<PlanStates>,
    /// Shards whose plans are made with other settings or models, as told last.
    differ: Vec<bool>,
}

impl Gathered {
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
            differ: vec![false; count],
        }
    }

    /// Takes a frame of a shard's worker. Rows of robots that are not the shard's are left out.
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
            // Of one worker: not asked for.
            _ => {}
        }
        Ok(())
    }

    /// Writes what is due. `speaks`: the shards whose worker is heard.
    pub(crate) fn write(
        &mut self,
        outlets: &mut Outlets,
        speaks: &[bool],
    ) -> Result<(), SendError> {
        let now_ns = clock::monotonic_ns();
        let is_heard = self.is_heard(speaks, now_ns);
        let at = (now_ns, self.period_ns, self.every);
        if self.forecasts.is_due((speaks, &is_heard), at) {
            let own = self.own(self.tick + 1);
            let merge = &mut self.forecasts;
            if send(
                merge,
                &mut outlets.forecasts,
                (&is_heard, own),
                (now_ns, self.capacity),
            )? {
                self.tick += 1;
                outlets.wake_planners();
            }
        }
        if self.tick == 0 {
            return Ok(());
        }
        let (own, with) = (self.own(self.tick), (now_ns, self.capacity));
        if self.diagnostics.is_due((speaks, &is_heard), at) {
            let heard = (is_heard.as_slice(), own);
            send(&mut self.diagnostics, &mut outlets.diagnostics, heard, with)?;
        }
        if self.budgets.is_due((speaks, &is_heard), at) {
            let heard = (is_heard.as_slice(), own);
            send(&mut self.budgets, &mut outlets.budgets, heard, with)?;
        }
        if self.plan_states.is_due((speaks, &is_heard), at) {
            let agree = self.agree(&is_heard, now_ns);
            let heard = (agree.as_slice(), own);
            send(&mut self.plan_states, &mut outlets.plan_states, heard, with)?;
        }
        Ok(())
    }

    fn own(&self, tick: u64) -> Own {
        Own {
            pid: process_id(),
            place: Place {
                run: self.run,
                number: tick,
            },
        }
    }

    /// The shards whose forecasts are not stale.
    fn is_heard(&self, speaks: &[bool], now_ns: u64) -> Vec<bool> {
        let header = |shard: usize| self.forecasts.header(shard);
        let is_new =
            |shard| header(shard).is_some_and(|it| is_fresh(it.sent_ns, it.period_ns, now_ns));
        let shards = speaks.iter().enumerate();
        shards
            .map(|(shard, speaks)| *speaks && is_new(shard))
            .collect()
    }

    /// Of these, the shards with new plan states, computed with the settings and models of the first: a planner computes with
    /// one set.
    fn agree(&mut self, is_heard: &[bool], now_ns: u64) -> Vec<bool> {
        let header = |shard: usize| self.plan_states.header(shard);
        let is_new =
            |shard| header(shard).is_some_and(|it| is_fresh(it.sent_ns, it.period_ns, now_ns));
        let heard = is_heard.iter().enumerate();
        let is_heard: Vec<bool> = heard
            .map(|(shard, heard)| *heard && is_new(shard))
            .collect();
        let by =
            |header: &PlanStateHeader| (header.settings_hash, header.model_hash, header.models);
        let of = |shard: usize| self.plan_states.header(shard).map(by);
        let first = (0..is_heard.len()).find(|shard| is_heard[*shard] && of(*shard).is_some());
        let first = first.and_then(of);
        let agree = |shard: usize| is_heard[shard] && of(shard) == first;
        let agree: Vec<bool> = (0..is_heard.len()).map(agree).collect();
        for (shard, differed) in self.differ.iter_mut().enumerate() {
            let differs = is_heard[shard] && !agree[shard];
            if differs && !*differed {
                let name = &self.shards.all()[shard].name;
                tracing::warn!(
                    "shard {name} computes with other settings or models: nobody plans for its robots; use one config"
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

/// Takes a shard's frame: the rows that the shard speaks for, with the times of this host.
fn put<C: Merged>(
    merge: &mut Merge<C>,
    (shard, header): (usize, C::Header),
    accepted: &Accepted<'_>,
    is_own: impl Fn(u32) -> bool,
) {
    let rows = accepted.frame.elements::<C::Row>();
    let rows = rows
        .filter(|row| C::robot(row).is_some_and(&is_own))
        .map(|mut row| {
            shift(&mut row, accepted.offset_ns);
            row
        });
    merge.put(shard, header, rows, clock::monotonic_ns());
}

/// Writes a frame; false if there is none.
fn send<C: Merged>(
    merge: &mut Merge<C>,
    writer: &mut Writer<C>,
    (is_heard, own): (&[bool], Own),
    (now_ns, capacity): (u64, usize),
) -> Result<bool, SendError> {
    let mut loan = writer.loan_to_fill(merge.len().min(capacity))?;
    let mut to = loan.payload_mut().iter_mut();
    let header = merge.write(is_heard, own, now_ns, |row| {
        // Shards have more robots than this host has room for: those of the last ones are left out.
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
