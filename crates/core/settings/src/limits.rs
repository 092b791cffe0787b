//! Limits of a fleet's services, and the resulting size of each.

use joulebus_wire::{Flow, FrameRows};

use crate::bounds;

/// Limits of a fleet's services. Every process of the fleet must use the same: the first to open a
/// service fixes them, and a later one that differs gets an error with both.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Robots: the longest frame that can be sent. At least 1, as all of these. At most
    /// [`bounds::CAPACITY`].
    pub capacity: usize,
    /// Processes that may publish samples at once. At most [`bounds::MAX_SOURCES`].
    pub max_sources: usize,
    /// Processes that may read forecasts at once. At most [`bounds::MAX_PLANNERS`].
    pub max_planners: usize,
    /// Frames of samples queued for the worker, per source. Older ones are overwritten. At most
    /// [`bounds::BUFFER_FRAMES`].
    pub sample_frames: usize,
    /// Frames of forecasts, diagnostics and budgets queued for a reader. At most 64.
    pub forecast_frames: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            capacity: 1_000,
            max_sources: 8,
            max_planners: 8,
            sample_frames: 8,
            forecast_frames: 2,
        }
    }
}

/// Spare ports of a service: a killed process holds its ports until the cleanup, and its successor
/// may start earlier.
const SPARE: usize = 2;
/// Questions of a client that can be in transfer.
pub const ACTIVE_QUERIES: usize = 1;
/// Maximum number of clients that ask the worker, beside operators.
const MAX_QUERY_CLIENTS: usize = 16;
/// Operators that can acknowledge alarms at once, whoever else asks.
const OPERATORS: usize = 2;
/// The thread that answers questions waits as a planner does.
const ANSWERING: usize = 1;
/// Readers in the worker's own process: the checkpointer, and a thread that answers questions or
/// (of diagnostics) logs alarms.
const OF_WORKER: usize = 2;
/// Recorders that a fleet can have at once.
const RECORDERS: usize = 2;
/// Links that a host can have at once.
const LINKS: usize = 1;
/// Others that read samples and the journal, such as the demo's view.
const OTHERS: usize = 2;
/// Maximum number of frames that a journal lists, whatever the limits: 160 KiB.
const MAX_LISTED: usize = 4_096;

/// Bytes per robot in a piece of a keyframe: a robot takes about 350.
const STATE_BYTES_PER_ROBOT: usize = 512;
const STATE_PIECE_BYTES: (usize, usize) = (4 * 1024, 64 * 1024);

impl Limits {
    /// The limits, if all are in their ranges.
    ///
    /// # Errors
    /// [`LimitsError`] states the first that is not.
    pub fn checked(self) -> Result<Self, LimitsError> {
        for (name, found, max) in [
            ("capacity", self.capacity, *bounds::CAPACITY.end()),
            ("max_sources", self.max_sources, *bounds::MAX_SOURCES.end()),
            ("max_planners", self.max_planners, *bounds::MAX_PLANNERS.end()),
            ("sample_frames", self.sample_frames, *bounds::BUFFER_FRAMES.end()),
            ("forecast_frames", self.forecast_frames, 64),
        ] {
            let max = max as usize;
            if found < 1 || found > max {
                return Err(LimitsError { name, found, max });
            }
        }
        Ok(self)
    }

    /// Text stored in each service for comparison by other processes.
    pub fn describe(&self) -> String {
        format!(
            "capacity={} max_sources={} max_planners={} sample_frames={} forecast_frames={}",
            self.capacity,
            self.max_sources,
            self.max_planners,
            self.sample_frames,
            self.forecast_frames
        )
    }

    /// Processes that can be members at once.
    pub const fn nodes(&self) -> usize {
        2 * (self.max_sources + self.max_planners + SPARE)
    }

    /// Frames of samples that a tick's journal can list: all that can be queued when a tick begins,
    /// up to 4,096.
    pub const fn listed_frames(&self) -> usize {
        let waiting = self.max_sources * self.sample_frames;
        if waiting < MAX_LISTED { waiting } else { MAX_LISTED }
    }

    /// The size of a channel's service.
    #[must_use]
    pub const fn shape(&self, flow: Flow) -> Shape {
        match flow {
            Flow::Sources => Shape {
                publishers: self.max_sources + SPARE,
                // The worker, and recorders.
                subscribers: 1 + RECORDERS + LINKS + OTHERS,
                buffer: self.sample_frames,
                borrowed: 1,
                history: 0,
            },
            Flow::Planners { kept, history, .. } => Shape {
                publishers: 1 + SPARE,
                subscribers: self.max_planners + OF_WORKER + RECORDERS + LINKS + SPARE,
                buffer: self.forecast_frames,
                // The newest is received while the previous one is held.
                borrowed: 2 + kept,
                history,
            },
            Flow::Recorders { queued, history, .. } => Shape {
                publishers: 1 + SPARE,
                subscribers: self.open_places(flow) + RECORDERS + LINKS,
                buffer: queued,
                borrowed: 1,
                history,
            },
        }
    }

    /// Readers of a channel that planners and views may have: the worker, recorders and links find
    /// their places whatever others do.
    #[must_use]
    pub const fn open_places(&self, flow: Flow) -> usize {
        match flow {
            Flow::Planners { .. } | Flow::Recorders { views: true, .. } => {
                self.max_planners + SPARE
            }
            Flow::Sources | Flow::Recorders { views: false, .. } => OTHERS,
        }
    }

    /// Maximum number of rows of a frame.
    #[must_use]
    pub fn rows(&self, rows: FrameRows) -> usize {
        match rows {
            FrameRows::Robots => self.capacity,
            FrameRows::Taken => self.listed_frames(),
            FrameRows::Bytes => self.state_piece_bytes(),
            FrameRows::UpTo(rows) => rows,
        }
    }

    /// Clients that can ask the worker at once, but for operators: these find their places whatever
    /// others do.
    pub const fn open_query_clients(&self) -> usize {
        let wanted = self.max_planners + SPARE;
        if wanted < MAX_QUERY_CLIENTS { wanted } else { MAX_QUERY_CLIENTS }
    }

    /// Clients that can ask the worker at once.
    pub const fn query_clients(&self) -> usize {
        self.open_query_clients() + OPERATORS
    }

    /// Questions that can be in transfer at once.
    pub const fn queries_in_transfer(&self) -> usize {
        self.query_clients() * ACTIVE_QUERIES
    }

    /// Listeners and notifiers of the event that wakes clients. Swapped, those of the worker's.
    pub const fn query_events(&self) -> (usize, usize) {
        (self.query_clients(), 1 + SPARE)
    }

    fn state_piece_bytes(&self) -> usize {
        let (least, most) = STATE_PIECE_BYTES;
        self.capacity.saturating_mul(STATE_BYTES_PER_ROBOT).clamp(least, most)
    }

    /// Listeners and notifiers of the sources' event.
    pub const fn arrivals(&self) -> (usize, usize) {
        (1 + SPARE, self.max_sources + SPARE)
    }

    /// Listeners and notifiers of the worker's event.
    pub const fn wake(&self) -> (usize, usize) {
        (self.max_planners + ANSWERING + LINKS + SPARE, 1 + SPARE)
    }
}

/// The size of one publish-subscribe service.
#[derive(Debug, Clone, Copy)]
pub struct Shape {
    /// Ports that write.
    pub publishers: usize,
    /// Ports that read.
    pub subscribers: usize,
    /// Frames queued for a port that reads.
    pub buffer: usize,
    /// Frames that a port can hold at once.
    pub borrowed: usize,
    /// Frames that a port which comes later receives.
    pub history: usize,
}

impl Shape {
    /// Frames for which one publisher allocates memory, as iceoryx2 counts them with one loan.
    pub const fn frames(&self) -> usize {
        self.subscribers * (self.buffer + self.borrowed) + self.history + 1
    }
}

/// A limit outside its range.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{name} = {found}: allowed are 1 to {max}")]
#[allow(missing_docs)] // The messages name the fields.
pub struct LimitsError {
    pub name: &'static str,
    pub found: usize,
    pub max: usize,
}
