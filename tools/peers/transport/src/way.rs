//! The interface of the transports, and those implemented by joulebus' benchmarks.

use std::io::Read as _;
use std::process::Child;

use anyhow::{Context as _, bail};
use joulebus_bench::Spread;
use joulebus_bench::latency::{broker, raw};

/// A transport from a source to a sink, through a relay process.
pub trait Way {
    /// Sends a frame that was due at `due_ns`, monotonic; 0 ends the measurement.
    fn send(&mut self, due_ns: u64) -> anyhow::Result<()>;

    /// Waits until the sink has received one more frame.
    fn acknowledged(&mut self) -> anyhow::Result<()>;

    /// Ends the processes; returns the distribution from due to received.
    fn finish(self: Box<Self>) -> anyhow::Result<Spread>;
}

impl Way for raw::RawHops {
    fn send(&mut self, due_ns: u64) -> anyhow::Result<()> {
        Self::send(self, due_ns)
    }

    fn acknowledged(&mut self) -> anyhow::Result<()> {
        Self::acknowledged(self)
    }

    fn finish(self: Box<Self>) -> anyhow::Result<Spread> {
        Self::finish(*self)
    }
}

/// Through joulebus' worker.
pub struct Joulebus {
    /// The way.
    pub way: broker::Broker,
    /// Frames sent.
    pub frames: u64,
}

impl Way for Joulebus {
    fn send(&mut self, due_ns: u64) -> anyhow::Result<()> {
        self.frames += 1;
        self.way.send(due_ns, self.frames)
    }

    fn acknowledged(&mut self) -> anyhow::Result<()> {
        bail!("the worker ticks at its rate, not at the rate of the frames")
    }

    fn finish(self: Box<Self>) -> anyhow::Result<Spread> {
        Ok(self.way.finish()?.end_to_end_us)
    }
}

/// Waits for one byte of a child's output.
pub fn await_byte(child: &mut Child) -> anyhow::Result<()> {
    let output = child.stdout.as_mut().context("no output of the sink")?;
    Ok(output.read_exact(&mut [0])?)
}
