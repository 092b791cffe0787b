//! Channels: services of shared memory that carry frames, each a header and rows.
//!
//! A channel is declared once, here or in another crate. Ports, captures, links and simulations
//! follow from the declaration.

use crate::{
    Acknowledgement, AcknowledgementHeader, Budget, BudgetHeader, Diagnostic, DiagnosticHeader,
    Forecast, ForecastHeader, MAX_ACKNOWLEDGED, MAX_RECORD_WORDS, Outlook, OutlookHeader,
    PlanState, PlanStateHeader, QueriesHeader, Row, Sample, SampleHeader, Service, StateHeader,
    TakenFrame, TickHeader, tick_flag,
};

/// A service of shared memory through which frames go.
pub trait Channel: std::fmt::Debug + Copy + Send + Sync + 'static {
    /// Its service, which also names its topic in a capture.
    const SERVICE: Service;
    /// Name of a frame's message in a capture, without the package. A row has its
    /// [`crate::StructLayout::name`].
    const MESSAGE: &'static str;
    /// The senders and readers.
    const FLOW: Flow;
    /// The meaning of its rows.
    const ROWS: FrameRows;
    /// The ticks that send a frame, if it is [sent in ticks](SentIn).
    const SENT_IN: SentIn = SentIn::Every;
    /// The header of a frame.
    type Header: FrameHeader;
    /// A row of a frame.
    type Row: Row;

    /// The robot of a row. `None` where rows are not of [`FrameRows::Robots`].
    #[must_use]
    fn robot(row: &Self::Row) -> Option<u32> {
        let id = bytemuck::bytes_of(row).first_chunk();
        id.filter(|_| Self::ROWS == FrameRows::Robots).map(|id| u32::from_ne_bytes(*id))
    }
}

/// The senders and readers of a channel, which size its service.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Flow {
    /// Sources send. The worker and recorders read.
    Sources,
    /// The worker sends. Planners and recorders read.
    Planners {
        /// Frames that a planner can keep beside the newest.
        kept: usize,
        /// Frames that a reader which comes later receives.
        history: usize,
        /// True if the worker computes and sends them only while somebody reads them.
        on_demand: bool,
    },
    /// The worker sends. Recorders read, and views if `views`.
    Recorders {
        /// Frames queued for a recorder.
        queued: usize,
        /// Frames that a reader which comes later receives.
        history: usize,
        /// True if planners and views have places, as in [`Flow::Planners`].
        views: bool,
    },
}

impl Flow {
    /// True if frames are sent only while somebody reads them.
    pub const fn is_on_demand(self) -> bool {
        matches!(self, Self::Planners { on_demand: true, .. })
    }
}

/// The ticks that send a frame, by the [`crate::tick_flag`] in their journal.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SentIn {
    /// All.
    Every,
    /// Those without this flag: a tick that is short of time leaves the frame out.
    Without(u32),
    /// Those with this flag: the frame is sent while somebody reads it.
    With(u32),
}

impl SentIn {
    /// True if a tick with these flags sends the frame.
    pub const fn is_in(self, flags: u32) -> bool {
        match self {
            Self::Every => true,
            Self::Without(flag) => flags & flag == 0,
            Self::With(flag) => flags & flag != 0,
        }
    }

    /// The flag to set in a tick that is short of time, if it `sheds`, and whose frame somebody
    /// reads, if it `is_read`.
    pub const fn flag(self, sheds: bool, is_read: bool) -> u32 {
        match self {
            Self::Without(flag) if sheds => flag,
            Self::With(flag) if is_read => flag,
            Self::Every | Self::Without(_) | Self::With(_) => 0,
        }
    }
}

/// The meaning of a frame's rows, which bounds their number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FrameRows {
    /// One of each robot, which begins with the robot's id.
    Robots,
    /// One of each frame that a tick took.
    Taken,
    /// Bytes of a piece of a keyframe.
    Bytes,
    /// Others, at most so many.
    UpTo(usize),
}

/// Total order of the frames of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct FrameOrder {
    /// The run of the worker, or of the source.
    pub run: u64,
    /// The tick within it, the number of the source's frame, or else the time of sending.
    pub number: u64,
}

/// The header of a frame. It begins with [`crate::SCHEMA_VERSION`].
pub trait FrameHeader: Row {
    /// Version of its payloads.
    fn schema(&self) -> u32;

    /// Its order: that of a later frame is greater.
    fn order(&self) -> FrameOrder;

    /// Gives the frame another order, as sent by process `pid`.
    fn set_order(&mut self, pid: u32, order: FrameOrder);

    /// When the frame was sent, monotonic ns. `None` where that is not stated.
    fn sent_ns(&self) -> Option<u64>;

    /// When the frame was sent, Unix ns. `None` where that is not stated.
    fn sent_unix_ns(&self) -> Option<u64>;

    /// States when the frame is sent, monotonic ns and Unix ns, where it states that.
    fn set_sent(&mut self, sent_ns: u64, sent_unix_ns: u64);

    /// The period at which frames follow each other, ns, where it is stated.
    fn period_ns(&mut self) -> Option<&mut u64>;
}

/// Is called with every channel by [`each_channel`].
pub trait ForEachChannel {
    /// Takes a channel.
    fn channel<C: Channel>(&mut self);
}

macro_rules! channels {
    ($($(#[doc = $doc:literal])*
    $name:ident: $service:literal, $header:ident { $($part:tt)* }, $row:ty, $flow:expr, $rows:expr
        $(, $sent_in:expr)?;)*) => {$(
        $(#[doc = $doc])*
        #[derive(Debug, Clone, Copy)]
        pub struct $name;

        impl Channel for $name {
            const SERVICE: Service = Service::named($service);
            const MESSAGE: &'static str = stringify!($name);
            const FLOW: Flow = $flow;
            const ROWS: FrameRows = $rows;
            $(const SENT_IN: SentIn = $sent_in;)?
            type Header = $header;
            type Row = $row;
        }

        $crate::frame_header!($header { $($part)* });
    )*

        /// Calls `each` with all channels of joulebus, causes before effects.
        pub fn each_channel(each: &mut impl ForEachChannel) {
            $(each.channel::<$name>();)*
        }
    };
}

/// Implements [`FrameHeader`] from the fields of the order, and of times and period if there are
/// any:
/// `frame_header!(Header { order: run, number; sent: sent_ns, sent_unix_ns; period: period_ns; })`.
#[macro_export]
macro_rules! frame_header {
    ($header:ident {
        order: $run:ident, $number:ident;
        $(sent: $sent:ident $(, $unix:ident)?;)?
        $(period: $period:ident;)?
    }) => {
        impl $crate::FrameHeader for $header {
            fn schema(&self) -> u32 {
                self.schema
            }

            fn order(&self) -> $crate::FrameOrder {
                $crate::FrameOrder { run: self.$run, number: self.$number }
            }

            fn set_order(&mut self, pid: u32, order: $crate::FrameOrder) {
                (self.pid, self.$run, self.$number) = (pid, order.run, order.number);
            }

            fn sent_ns(&self) -> Option<u64> {
                $crate::frame_header!(@or None $(Some(self.$sent))?)
            }

            fn sent_unix_ns(&self) -> Option<u64> {
                $crate::frame_header!(@or None $($(Some(self.$unix))?)?)
            }

            fn set_sent(&mut self, _sent_ns: u64, _sent_unix_ns: u64) {
                $(self.$sent = _sent_ns; $(self.$unix = _sent_unix_ns;)?)?
            }

            fn period_ns(&mut self) -> Option<&mut u64> {
                $crate::frame_header!(@or None $(Some(&mut self.$period))?)
            }
        }
    };
    (@or $none:ident) => { $none };
    (@or $none:ident $some:expr) => { $some };
}

channels! {
    /// Samples of the robots, from their controllers.
    Samples: "samples", SampleHeader { order: source_epoch, frame_seq; sent: sent_ns, sent_unix_ns; },
        Sample, Flow::Sources, FrameRows::Robots;
    /// Forecasts, of every tick. A planner can keep two frames beside the newest: one in its loop's
    /// variable while it waits for the next, and one more.
    Forecasts: "forecasts", ForecastHeader {
            order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; period: period_ns;
        }, Forecast, Flow::Planners { kept: 2, history: 0, on_demand: false }, FrameRows::Robots;
    /// Diagnostics, of every tick.
    Diagnostics: "diagnostics", DiagnosticHeader { order: worker_epoch, tick; },
        Diagnostic, Flow::Planners { kept: 0, history: 0, on_demand: false }, FrameRows::Robots,
        SentIn::Without(tick_flag::NO_DIAGNOSTICS);
    /// Budgets: planners need the newest at once, and recorders read all.
    Budgets: "budgets", BudgetHeader { order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; },
        Budget, Flow::Planners { kept: 0, history: 1, on_demand: false }, FrameRows::Robots;
    /// The state that plans start from: sent while somebody reads it.
    PlanStates: "plan_states", PlanStateHeader {
            order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; period: period_ns;
        }, PlanState, Flow::Planners { kept: 0, history: 1, on_demand: true }, FrameRows::Robots,
        SentIn::With(tick_flag::PLAN_STATES);
    /// The energy that robots will draw if they go on as they do: sent while somebody reads it.
    Outlooks: "outlooks", OutlookHeader {
            order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; period: period_ns;
        }, Outlook, Flow::Planners { kept: 0, history: 1, on_demand: true }, FrameRows::Robots,
        SentIn::With(tick_flag::OUTLOOKS);
    /// The worker's journal: a second of it is queued at 30 Hz.
    Ticks: "ticks", TickHeader { order: worker_epoch, tick; sent: sent_ns; },
        TakenFrame, Flow::Recorders { queued: 32, history: 0, views: false }, FrameRows::Taken;
    /// Keyframes, in pieces: a reader empties the queue at every tick.
    State: "state", StateHeader { order: worker_epoch, tick; sent: sent_ns, sent_unix_ns; },
        u8, Flow::Recorders { queued: 8, history: 0, views: false }, FrameRows::Bytes;
    /// Records of questions and answers: a reader that comes later needs the newest counts.
    Queries: "queries", QueriesHeader { order: begun_ns, sent_ns; sent: sent_ns; },
        u64, Flow::Recorders { queued: 6, history: 1, views: true }, FrameRows::UpTo(MAX_RECORD_WORDS);
    /// All alarms that are acknowledged: a reader that comes later needs the newest at once.
    Acknowledgements: "acknowledgements", AcknowledgementHeader {
            order: server_epoch, number; sent: sent_ns, sent_unix_ns;
        }, Acknowledgement, Flow::Planners { kept: 0, history: 1, on_demand: false }, FrameRows::UpTo(MAX_ACKNOWLEDGED);
}
