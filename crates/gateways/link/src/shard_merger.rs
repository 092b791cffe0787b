//! Merges the frames of all shards' workers into frames of one fleet on this host.

use std::sync::Arc;

use joulebus_bus::{SendError, clock, process_id};
use joulebus_config::Config;
use joulebus_wire::FrameOrder;

use crate::output_port::{AnyOutputPort as _, MergeRound, PassError};
use crate::protocol::carried::Carried;
use crate::protocol::merge::Origin;
use crate::protocol::receiver::Accepted;
use crate::protocol::shards::Shards;
use crate::worker_ports::WorkerPorts;

/// The state of the merged worker. The ports have the newest frames of the shards.
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
}

impl ShardMerger {
    pub(crate) fn new(shards: &Arc<Shards>, config: &Config, every: u32) -> Self {
        Self {
            shards: Arc::clone(shards),
            capacity: config.limits().capacity,
            every,
            period_ns: config.tick_period_ns(),
            run: clock::monotonic_ns(),
            tick: 0,
        }
    }

    /// Takes a frame of a shard's worker. Rows of robots of other shards are dropped.
    pub(crate) fn put(
        &mut self,
        ports: &mut WorkerPorts,
        shard: usize,
        accepted: &Accepted<'_>,
    ) -> Result<(), PassError> {
        let (service, of) = (accepted.frame.service, (&*self.shards, shard));
        if service == Carried::FORECASTS {
            return ports.forecasts.put(accepted, self.every, of);
        }
        // Services of a single worker are not requested.
        let port = ports.behind.iter_mut().find(|port| port.service() == service);
        port.map_or(Ok(()), |port| port.put(accepted, self.every, of))
    }

    /// Writes the merged frames that are due. `has_worker` are the shards with a living leader.
    pub(crate) fn write(
        &mut self,
        ports: &mut WorkerPorts,
        has_worker: &[bool],
    ) -> Result<(), SendError> {
        let now_ns = clock::monotonic_ns();
        let live = has_worker.iter().enumerate();
        let live = live.map(|(shard, has)| *has && ports.forecasts.is_fresh(shard, now_ns));
        let is_live: Vec<bool> = live.collect();
        let own =
            |number| Origin { pid: process_id(), order: FrameOrder { run: self.run, number } };
        let mut round = MergeRound {
            shards: &self.shards,
            has_worker,
            is_live: &is_live,
            now_ns,
            period_ns: self.period_ns,
            every: self.every,
            capacity: self.capacity,
            own: own(self.tick + 1),
        };
        if ports.forecasts.write(&round)? {
            self.tick += 1;
            ports.wake_planners();
        }
        if self.tick == 0 {
            return Ok(());
        }
        round.own = own(self.tick);
        ports.behind.iter_mut().try_for_each(|port| port.write(&round).map(drop))
    }
}
