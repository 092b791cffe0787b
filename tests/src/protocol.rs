//! Messages between the probe and the tests, one JSON value per line. Structs of shared memory are
//! sent as their words, so that no bit is lost.

use std::ops::Deref;

use bytemuck::AnyBitPattern;
use joulebus_wire::{
    Budgets, Channel, Diagnostics, DropReason, Forecast, ForecastHeader, Forecasts, Sample,
};
use serde::{Deserialize, Deserializer, Serialize, Serializer};

fn words<T: bytemuck::NoUninit>(rows: &[T]) -> &[u32] {
    bytemuck::cast_slice(rows)
}

fn rows<T: AnyBitPattern>(words: &[u32]) -> Vec<T> {
    let rows = bytemuck::cast_slice(words).chunks_exact(size_of::<T>());
    rows.map(bytemuck::pod_read_unaligned).collect()
}

/// Forged values of a frame's header.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Forge {
    /// Version of the payloads.
    pub schema: Option<u32>,
    /// Samples sent before this frame.
    pub samples_before: Option<u64>,
    /// When this run of the source began, monotonic ns.
    pub source_epoch: Option<u64>,
}

/// A frame to send.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct FrameLine {
    samples: Vec<u32>,
    pub forge: Forge,
}

impl FrameLine {
    /// A frame of these samples.
    pub fn new(samples: &[Sample], forge: Forge) -> Self {
        Self { samples: words(samples).to_vec(), forge }
    }

    pub fn samples(&self) -> Vec<Sample> {
        rows(&self.samples)
    }
}

/// A message from a source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum SourceLine {
    /// The source has joined.
    Ready {
        /// When this run began, monotonic ns.
        source_epoch: u64,
    },
    /// The source has sent the frames asked for.
    Sent {
        /// Number of readers of the last one.
        readers: usize,
        /// Samples sent so far.
        samples: u64,
    },
    /// A frame could not be sent.
    Failed(String),
}

/// A message from a planner or recorder.
#[derive(Debug, Clone, Serialize, Deserialize)]
#[allow(clippy::large_enum_variant)] // It is sent as text at once.
pub enum ReaderLine {
    /// The planner has joined.
    Ready,
    /// A frame of forecasts.
    Forecasts(FrameRead<Forecasts>),
    /// A frame of diagnostics.
    Diagnostics(FrameRead<Diagnostics>),
    /// A frame of budgets.
    Budgets(FrameRead<Budgets>),
    /// The process that sent the last frame is gone.
    Gone {
        /// Its pid.
        pid: u32,
        /// Time of the detection, monotonic ns.
        at_ns: u64,
    },
    /// The worker has announced its shutdown.
    Ended,
    /// A frame of samples, and the number of samples that differ from what a source wrote.
    Samples {
        /// Pid of the source.
        pid: u32,
        /// Samples in it.
        samples: usize,
        /// Number of these that are torn.
        torn: usize,
    },
    /// A frame that the consumer library returned to a planner.
    Given {
        /// Run of the worker.
        worker_epoch: u64,
        /// Tick.
        tick: u64,
        /// Ticks skipped before it.
        ticks_missed: u64,
        /// True if it is the first of another run.
        restarted: bool,
        /// Number of gaps so far.
        gaps: u64,
        /// Robots in it.
        robots: usize,
        /// Samples that the worker has accepted so far.
        accepted: u64,
    },
    /// The consumer library reports that the worker is gone.
    WorkerGone {
        /// Kind of its end.
        end: String,
        /// Time of the detection, monotonic ns.
        at_ns: u64,
    },
    /// The consumer library reports that the newest frame is too old.
    Stale {
        /// Its age, ns.
        age_ns: u64,
    },
    /// A frame could not be read.
    Failed(String),
}

/// A frame that a planner has read. It dereferences to its header.
#[derive(Debug, Clone)]
pub struct FrameRead<C: Channel> {
    /// When it was read, monotonic ns.
    pub read_ns: u64,
    header: C::Header,
    pub robots: Vec<C::Row>,
}

impl<C: Channel> FrameRead<C> {
    pub fn new(header: &C::Header, robots: &[C::Row], read_ns: u64) -> Self {
        Self { read_ns, header: *header, robots: robots.to_vec() }
    }

    /// The row of a robot.
    pub fn robot(&self, robot: u32) -> Option<&C::Row> {
        self.robots.iter().find(|row| C::robot(row) == Some(robot))
    }
}

impl<C: Channel> Deref for FrameRead<C> {
    type Target = C::Header;

    fn deref(&self) -> &C::Header {
        &self.header
    }
}

impl<C: Channel> Serialize for FrameRead<C> {
    fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
        (self.read_ns, words(&[self.header]), words(&self.robots)).serialize(to)
    }
}

impl<'de, C: Channel> Deserialize<'de> for FrameRead<C> {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        let (read_ns, header, robots) = <(u64, Vec<u32>, Vec<u32>)>::deserialize(from)?;
        let header = rows(&header).first().copied().unwrap_or_default();
        Ok(Self { read_ns, header, robots: rows(&robots) })
    }
}

/// Samples accepted and dropped so far.
pub fn accounted(header: &ForecastHeader) -> u64 {
    header.samples_accepted + header.samples_dropped.total()
}

/// An answer: quality code and detail, and the bits of forecast, interval and reading.
pub type Answer = ((u16, u16), [u32; 4]);

/// The answer of a forecast.
pub fn answer(forecast: &Forecast) -> Answer {
    let watts = [forecast.power_w, forecast.lo_w, forecast.hi_w, forecast.reading_w];
    ((forecast.quality, forecast.quality_detail), watts.map(f32::to_bits))
}

/// True if the diagnostics name a refusal of a robot's samples by this process.
pub fn names(
    diagnostics: &FrameRead<Diagnostics>,
    robot: u32,
    reason: DropReason,
    pid: u32,
) -> bool {
    diagnostics
        .refusals()
        .any(|refusal| (refusal.robot, refusal.reason(), refusal.pid) == (robot, Some(reason), pid))
}

/// A line of a client that asks about plans.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum AskerLine {
    /// The first answer has arrived, or the first after a failure.
    Asking,
    /// A question was not answered.
    Failed {
        /// Name of the error, or of the reason.
        name: String,
        /// From asking to the error, ns.
        after_ns: u64,
    },
    /// A question that must be refused.
    Refused {
        /// Reason that is expected.
        expected: String,
        /// Reason that was found.
        found: String,
    },
    /// The client ends.
    Done {
        /// Questions answered.
        answered: u64,
    },
}
