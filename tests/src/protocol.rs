//! Messages between the probe and the tests, one JSON value per line. Floats are sent as bits.

use std::collections::BTreeMap;

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, DropCounts, DropReason, Forecast,
    ForecastHeader, Quality, Sample,
};
use serde::{Deserialize, Serialize};

/// A [`Sample`] as bits.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct SampleLine(u32, u32, u64, u64, u64, [u32; 7], u32);

impl From<Sample> for SampleLine {
    fn from(sample: Sample) -> Self {
        let values = [
            sample.v_mps,
            sample.omega_radps,
            sample.power_w,
            sample.voltage_v,
            sample.current_a,
            sample.soc,
            sample.return_j,
        ];
        let (robot, flags, seq) = (sample.robot, sample.flags, sample.seq);
        let (stamp_ns, measured_ns) = (sample.stamp_ns, sample.measured_ns);
        let bits = values.map(f32::to_bits);
        Self(robot, flags, seq, stamp_ns, measured_ns, bits, sample.reserved)
    }
}

impl From<SampleLine> for Sample {
    fn from(line: SampleLine) -> Self {
        let SampleLine(robot, flags, seq, stamp_ns, measured_ns, bits, reserved) = line;
        let [v_mps, omega_radps, power_w, voltage_v, current_a, soc, return_j] =
            bits.map(f32::from_bits);
        Self {
            robot,
            flags,
            seq,
            stamp_ns,
            measured_ns,
            v_mps,
            omega_radps,
            power_w,
            voltage_v,
            current_a,
            soc,
            return_j,
            reserved,
        }
    }
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
    /// Its samples.
    pub samples: Vec<SampleLine>,
    /// Forged header values.
    pub forge: Forge,
}

/// A message from a source.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub enum SourceLine {
    /// It has joined.
    Ready {
        /// When this run began, monotonic ns.
        source_epoch: u64,
    },
    /// It has sent the frames asked for.
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
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub enum ReaderLine {
    /// It has joined.
    Ready,
    /// It holds a frame and does not release it.
    Holds,
    /// A frame of forecasts.
    Forecasts(ForecastFrame),
    /// A frame of diagnostics.
    Diagnostics(DiagnosticFrame),
    /// A frame of budgets.
    Budgets(BudgetFrame),
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

/// A frame of forecasts.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct ForecastFrame {
    /// When it was read, monotonic ns.
    pub read_ns: u64,
    /// Pid of the worker.
    pub pid: u32,
    /// Run of the worker.
    pub worker_epoch: u64,
    /// Tick.
    pub tick: u64,
    /// From the start of the tick to the sending of the frame, ns.
    pub tick_ns: u64,
    /// Ticks skipped so far.
    pub ticks_skipped: u64,
    /// Samples accepted so far.
    pub accepted: u64,
    /// Samples dropped so far, by reason.
    pub dropped: BTreeMap<String, u64>,
    /// Its robots.
    pub robots: Vec<ForecastLine>,
}

impl ForecastFrame {
    /// Converts a frame.
    pub fn new(header: &ForecastHeader, robots: &[Forecast], read_ns: u64) -> Self {
        Self {
            read_ns,
            pid: header.pid,
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            tick_ns: header.sent_ns.saturating_sub(header.compute_start_ns),
            ticks_skipped: header.ticks_skipped,
            accepted: header.samples_accepted,
            dropped: by_name(&header.samples_dropped),
            robots: robots.iter().map(ForecastLine::new).collect(),
        }
    }

    /// The line of a robot.
    pub fn robot(&self, robot: u32) -> Option<&ForecastLine> {
        self.robots.iter().find(|line| line.robot == robot)
    }

    /// Samples dropped so far for `reason`.
    pub fn dropped(&self, reason: DropReason) -> u64 {
        self.dropped.get(reason.name()).copied().unwrap_or(0)
    }

    /// Samples accepted and dropped so far.
    pub fn accounted(&self) -> u64 {
        self.accepted + self.dropped.values().sum::<u64>()
    }
}

/// A robot's forecast.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct ForecastLine {
    /// The robot.
    pub robot: u32,
    /// Quality and its detail, as in shared memory.
    pub code: (u16, u16),
    /// Number of the sample that it answers.
    pub seq: u64,
    /// Stamp of that sample, ns.
    pub stamp_ns: u64,
    /// Run of its source.
    pub source_epoch: u64,
    /// Generation of its slot.
    pub generation: u32,
    /// Forecast, lower end, upper end, last reading: bits.
    pub bits: [u32; 4],
    /// Flags.
    pub flags: u32,
}

impl ForecastLine {
    fn new(forecast: &Forecast) -> Self {
        let watts = [forecast.power_w, forecast.lo_w, forecast.hi_w, forecast.reading_w];
        Self {
            robot: forecast.robot,
            code: (forecast.quality, forecast.quality_detail),
            seq: forecast.sample_seq,
            stamp_ns: forecast.stamp_ns,
            source_epoch: forecast.source_epoch,
            generation: forecast.generation,
            bits: watts.map(f32::to_bits),
            flags: forecast.flags,
        }
    }

    /// Its quality.
    pub const fn quality(&self) -> Quality {
        Quality::decode(self.code.0, self.code.1)
    }
}

/// A frame of diagnostics.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct DiagnosticFrame {
    /// Run of the worker.
    pub worker_epoch: u64,
    /// Tick.
    pub tick: u64,
    /// Robots refused recently.
    pub refused: Vec<RefusalLine>,
    /// Its robots.
    pub robots: Vec<DiagnosticLine>,
}

impl DiagnosticFrame {
    /// Converts a frame.
    pub fn new(header: &DiagnosticHeader, robots: &[Diagnostic]) -> Self {
        let refused = header.refusals().map(|refusal| RefusalLine {
            robot: refusal.robot,
            reason: refusal.reason().map_or("", DropReason::name).to_owned(),
            pid: refusal.pid,
            count: refusal.count,
        });
        Self {
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            refused: refused.collect(),
            robots: robots.iter().map(DiagnosticLine::new).collect(),
        }
    }

    /// The line of a robot.
    pub fn robot(&self, robot: u32) -> Option<&DiagnosticLine> {
        self.robots.iter().find(|line| line.robot == robot)
    }
}

/// A robot that was refused.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RefusalLine {
    /// The robot.
    pub robot: u32,
    /// Reason.
    pub reason: String,
    /// Pid of the source.
    pub pid: u32,
    /// Number of samples.
    pub count: u32,
}

/// A robot's diagnostics.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct DiagnosticLine {
    /// The robot.
    pub robot: u32,
    /// Number of the newest sample accepted.
    pub seq: u64,
    /// Level.
    pub level: u16,
    /// All alarms.
    pub alarms: u32,
    /// Residual: bits.
    pub residual: u32,
    /// Residuals scored.
    pub scored: u64,
    /// Samples refused.
    pub refused: u64,
}

impl DiagnosticLine {
    const fn new(diagnostic: &Diagnostic) -> Self {
        Self {
            robot: diagnostic.robot,
            seq: diagnostic.sample_seq,
            level: diagnostic.level,
            alarms: diagnostic.alarms,
            residual: diagnostic.residual_w.to_bits(),
            scored: diagnostic.scored,
            refused: diagnostic.refused,
        }
    }
}

/// A frame of budgets.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct BudgetFrame {
    /// Run of the worker.
    pub worker_epoch: u64,
    /// Tick.
    pub tick: u64,
    /// Its robots.
    pub robots: Vec<BudgetLine>,
}

impl BudgetFrame {
    /// Converts a frame.
    pub fn new(header: &BudgetHeader, robots: &[Budget]) -> Self {
        Self {
            worker_epoch: header.worker_epoch,
            tick: header.tick,
            robots: robots.iter().map(BudgetLine::new).collect(),
        }
    }

    /// The line of a robot.
    pub fn robot(&self, robot: u32) -> Option<&BudgetLine> {
        self.robots.iter().find(|line| line.robot == robot)
    }
}

/// A robot's ledger.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct BudgetLine {
    /// The robot.
    pub robot: u32,
    /// Energy drawn, µJ.
    pub drawn_uj: i64,
    /// Remainder below one µJ, µW·ns · 2.
    pub drawn_remainder: i64,
    /// Metered time, ns.
    pub metered_ns: u64,
    /// Unmetered time, ns.
    pub unmetered_ns: u64,
    /// Stamp of the newest sample, ns.
    pub stamp_ns: u64,
}

impl BudgetLine {
    const fn new(budget: &Budget) -> Self {
        Self {
            robot: budget.robot,
            drawn_uj: budget.drawn_uj,
            drawn_remainder: budget.drawn_remainder,
            metered_ns: budget.metered_ns,
            unmetered_ns: budget.unmetered_ns,
            stamp_ns: budget.stamp_ns,
        }
    }

    /// Energy drawn in µW·ns · 2, exact.
    pub fn drawn_exact(&self) -> i128 {
        i128::from(self.drawn_uj) * 2_000_000_000 + i128::from(self.drawn_remainder)
    }
}

fn by_name(drops: &DropCounts) -> BTreeMap<String, u64> {
    drops.iter().map(|(reason, count)| (reason.name().to_owned(), count)).collect()
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
        /// Why it must be.
        expected: String,
        /// Why it was.
        found: String,
    },
    /// It ends.
    Done {
        /// Questions answered.
        answered: u64,
    },
}
