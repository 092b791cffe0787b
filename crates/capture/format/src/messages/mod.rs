//! Messages of a capture: the frames in shared memory.

mod codec;
mod convert;
mod descriptors;
mod frame;
mod query;
mod table;
#[cfg(test)]
mod equal;
#[rustfmt::skip]
#[allow(dead_code, unreachable_pub, clippy::all, reason = "generated")]
mod proto;
pub(crate) mod wire_fields;

use std::sync::Arc;

use joulebus_wire::{
    Budget, BudgetHeader, Diagnostic, DiagnosticHeader, Forecast, ForecastHeader, PlanState,
    PlanStateHeader, Sample, SampleHeader, StateHeader, TakenFrame, TickHeader,
};
use prost::Message as _;

pub use codec::OutOfRange;
use convert::{from_proto, to_proto};
pub use query::Query;

/// Contents of a message.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    /// A frame of samples.
    Samples(SampleHeader, Vec<Sample>),
    /// A tick's forecasts.
    Forecasts(ForecastHeader, Vec<Forecast>),
    /// A tick's diagnostics.
    Diagnostics(DiagnosticHeader, Vec<Diagnostic>),
    /// A tick's budgets.
    Budgets(BudgetHeader, Vec<Budget>),
    /// What plans start from, as of a tick.
    PlanStates(PlanStateHeader, Vec<PlanState>),
    /// A tick's journal.
    Ticks(TickHeader, Vec<TakenFrame>),
    /// A piece of a keyframe.
    State(StateHeader, Vec<u8>),
    /// A question about plans, and its answer.
    Query(Query),
    /// One robot's sample, repeated for plots.
    RobotSample(Sample),
    /// One robot's forecast, repeated for plots.
    RobotForecast(Forecast),
    /// One robot's diagnostics, repeated for plots.
    RobotDiagnostic(Diagnostic),
    /// One robot's budget, repeated for plots.
    RobotBudget(Budget),
    /// A message of another program.
    Other {
        /// Name of its schema; empty if it has none.
        schema: Arc<str>,
        /// Its bytes.
        data: Vec<u8>,
    },
}

/// Kind of a channel's messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum MessageKind {
    /// [`Message::Samples`].
    Samples,
    /// [`Message::Forecasts`].
    Forecasts,
    /// [`Message::Diagnostics`].
    Diagnostics,
    /// [`Message::Budgets`].
    Budgets,
    /// [`Message::PlanStates`].
    PlanStates,
    /// [`Message::Ticks`].
    Ticks,
    /// [`Message::State`].
    State,
    /// [`Message::Query`].
    Queries,
    /// [`Message::RobotSample`].
    RobotSample,
    /// [`Message::RobotForecast`].
    RobotForecast,
    /// [`Message::RobotDiagnostic`].
    RobotDiagnostic,
    /// [`Message::RobotBudget`].
    RobotBudget,
}

impl MessageKind {
    /// All kinds; first those with one channel for the whole fleet.
    pub const ALL: [Self; 12] = [
        Self::Samples,
        Self::Forecasts,
        Self::Diagnostics,
        Self::Budgets,
        Self::PlanStates,
        Self::Ticks,
        Self::State,
        Self::Queries,
        Self::RobotSample,
        Self::RobotForecast,
        Self::RobotDiagnostic,
        Self::RobotBudget,
    ];

    /// Kinds recorded with one channel per fleet.
    pub const OF_FLEET: [Self; 8] = [
        Self::Samples,
        Self::Forecasts,
        Self::Diagnostics,
        Self::Budgets,
        Self::PlanStates,
        Self::Ticks,
        Self::State,
        Self::Queries,
    ];

    /// The last component of the topic.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Samples => "samples",
            Self::Forecasts => "forecasts",
            Self::Diagnostics => "diagnostics",
            Self::Budgets => "budgets",
            Self::PlanStates => "plan_states",
            Self::Ticks => "ticks",
            Self::State => "state",
            Self::Queries => "queries",
            Self::RobotSample => "sample",
            Self::RobotForecast => "forecast",
            Self::RobotDiagnostic => "diagnostic",
            Self::RobotBudget => "budget",
        }
    }

    /// The name of the schema.
    #[must_use]
    pub const fn schema(self) -> &'static str {
        match self {
            Self::Samples => "joulebus.Samples",
            Self::Forecasts => "joulebus.Forecasts",
            Self::Diagnostics => "joulebus.Diagnostics",
            Self::Budgets => "joulebus.Budgets",
            Self::PlanStates => "joulebus.PlanStates",
            Self::Ticks => "joulebus.Ticks",
            Self::State => "joulebus.State",
            Self::Queries => "joulebus.Query",
            Self::RobotSample => "joulebus.Sample",
            Self::RobotForecast => "joulebus.Forecast",
            Self::RobotDiagnostic => "joulebus.Diagnostic",
            Self::RobotBudget => "joulebus.Budget",
        }
    }

    /// The protobuf file set that describes the messages: the schema's data.
    #[must_use]
    pub fn descriptors(self) -> Vec<u8> {
        descriptors::descriptors(self.schema())
    }

    /// The kind with this schema.
    #[must_use]
    pub fn of_schema(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.schema() == name)
    }

    /// The channel's topic; `robot` is used only by kinds of single robots.
    #[must_use]
    pub fn topic(self, fleet: &str, robot: u32) -> String {
        let name = self.name();
        match self {
            Self::RobotSample | Self::RobotForecast | Self::RobotDiagnostic | Self::RobotBudget => {
                format!("joulebus/{fleet}/robot/{robot}/{name}")
            }
            _ => format!("joulebus/{fleet}/{name}"),
        }
    }
}

impl Message {
    /// Its kind; `None` for messages of other programs.
    #[must_use]
    pub const fn kind(&self) -> Option<MessageKind> {
        Some(match self {
            Self::Samples(..) => MessageKind::Samples,
            Self::Forecasts(..) => MessageKind::Forecasts,
            Self::Diagnostics(..) => MessageKind::Diagnostics,
            Self::Budgets(..) => MessageKind::Budgets,
            Self::PlanStates(..) => MessageKind::PlanStates,
            Self::Ticks(..) => MessageKind::Ticks,
            Self::State(..) => MessageKind::State,
            Self::Query(_) => MessageKind::Queries,
            Self::RobotSample(_) => MessageKind::RobotSample,
            Self::RobotForecast(_) => MessageKind::RobotForecast,
            Self::RobotDiagnostic(_) => MessageKind::RobotDiagnostic,
            Self::RobotBudget(_) => MessageKind::RobotBudget,
            Self::Other { .. } => return None,
        })
    }

    /// Its robot, if it concerns a single one.
    #[must_use]
    pub const fn robot(&self) -> Option<u32> {
        match self {
            Self::RobotSample(row) => Some(row.robot),
            Self::RobotForecast(row) => Some(row.robot),
            Self::RobotDiagnostic(row) => Some(row.robot),
            Self::RobotBudget(row) => Some(row.robot),
            _ => None,
        }
    }

    /// Send time, monotonic ns, if it has one. Diagnostics and single robots do not.
    #[must_use]
    pub const fn sent_ns(&self) -> Option<u64> {
        match self {
            Self::Samples(header, _) => Some(header.sent_ns),
            Self::Forecasts(header, _) => Some(header.sent_ns),
            Self::Budgets(header, _) => Some(header.sent_ns),
            Self::PlanStates(header, _) => Some(header.sent_ns),
            Self::Ticks(header, _) => Some(header.sent_ns),
            Self::State(header, _) => Some(header.sent_ns),
            Self::Query(query) => Some(query.record.answer.sent_ns),
            _ => None,
        }
    }

    /// Appends its protobuf encoding.
    pub fn encode(&self, out: &mut Vec<u8>) {
        // Writing to a vector cannot fail.
        let _ = match self {
            Self::Samples(header, rows) => proto::Samples {
                samples: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::Forecasts(header, rows) => proto::Forecasts {
                forecasts: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::Diagnostics(header, rows) => proto::Diagnostics {
                diagnostics: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::Budgets(header, rows) => proto::Budgets {
                budgets: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::PlanStates(header, rows) => proto::PlanStates {
                plan_states: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::Ticks(header, rows) => proto::Ticks {
                frames: to_proto(rows),
                ..header.into()
            }
            .encode(out),
            Self::State(header, bytes) => proto::State {
                bytes: bytes.clone(),
                ..header.into()
            }
            .encode(out),
            Self::Query(query) => query.to_proto().encode(out),
            Self::RobotSample(row) => proto::Sample::from(row).encode(out),
            Self::RobotForecast(row) => proto::Forecast::from(row).encode(out),
            Self::RobotDiagnostic(row) => proto::Diagnostic::from(row).encode(out),
            Self::RobotBudget(row) => proto::Budget::from(row).encode(out),
            Self::Other { data, .. } => {
                out.extend_from_slice(data);
                Ok(())
            }
        };
    }

    /// Decodes a message from protobuf.
    ///
    /// # Errors
    /// The bytes are not a message of this kind, or a number exceeds its field.
    pub fn decode(kind: MessageKind, data: &[u8]) -> Result<Self, DecodeError> {
        // The rows of an answer are within the answer.
        let depth = u32::from(kind == MessageKind::Queries);
        let found = wire_fields::inner(data, depth);
        if found > MOST_ROWS {
            return Err(DecodeError::TooManyRows { found });
        }
        Ok(match kind {
            MessageKind::Samples => {
                let read: proto::Samples = parse(data)?;
                Self::Samples((&read).try_into()?, from_proto(&read.samples)?)
            }
            MessageKind::Forecasts => {
                let read: proto::Forecasts = parse(data)?;
                Self::Forecasts((&read).try_into()?, from_proto(&read.forecasts)?)
            }
            MessageKind::Diagnostics => {
                let read: proto::Diagnostics = parse(data)?;
                Self::Diagnostics((&read).try_into()?, from_proto(&read.diagnostics)?)
            }
            MessageKind::Budgets => {
                let read: proto::Budgets = parse(data)?;
                Self::Budgets((&read).try_into()?, from_proto(&read.budgets)?)
            }
            MessageKind::PlanStates => {
                let read: proto::PlanStates = parse(data)?;
                Self::PlanStates((&read).try_into()?, from_proto(&read.plan_states)?)
            }
            MessageKind::Ticks => {
                let read: proto::Ticks = parse(data)?;
                Self::Ticks((&read).try_into()?, from_proto(&read.frames)?)
            }
            MessageKind::State => {
                let read: proto::State = parse(data)?;
                Self::State((&read).try_into()?, read.bytes)
            }
            MessageKind::Queries => Self::Query(Query::of_proto(parse(data)?)?),
            MessageKind::RobotSample => {
                Self::RobotSample((&parse::<proto::Sample>(data)?).try_into()?)
            }
            MessageKind::RobotForecast => {
                Self::RobotForecast((&parse::<proto::Forecast>(data)?).try_into()?)
            }
            MessageKind::RobotDiagnostic => {
                Self::RobotDiagnostic((&parse::<proto::Diagnostic>(data)?).try_into()?)
            }
            MessageKind::RobotBudget => {
                Self::RobotBudget((&parse::<proto::Budget>(data)?).try_into()?)
            }
        })
    }
}

fn parse<P: prost::Message + Default>(data: &[u8]) -> Result<P, DecodeError> {
    P::decode(data).map_err(|error| DecodeError::Protobuf {
        reason: error.to_string(),
    })
}

/// Maximum number of rows in a message: more than a fleet may have robots. An empty row takes three bytes in a file, and
/// hundreds in memory.
const MOST_ROWS: usize = 1 << 20;

/// Errors of decoding a message.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DecodeError {
    /// It has more rows than a fleet may have robots.
    #[error("{found} rows; allowed are {MOST_ROWS}, more than the robots of any fleet")]
    TooManyRows {
        /// Its rows.
        found: usize,
    },
    /// Not protobuf, or not of this kind.
    #[error("{reason}")]
    Protobuf {
        /// The decoder's error.
        reason: String,
    },
    /// A number that exceeds its field.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
}

impl From<codec::Fault> for DecodeError {
    fn from(fault: codec::Fault) -> Self {
        Self::Protobuf {
            reason: fault.to_string(),
        }
    }
}

/// A message with its topic and times.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Topic of its channel: `joulebus/<fleet>/<service>`.
    pub topic: Arc<str>,
    /// The fleet; empty for messages of other programs.
    pub fleet: Arc<str>,
    /// When the recorder received it, Unix ns.
    pub log_time_ns: u64,
    /// When it was sent, Unix ns.
    pub publish_time_ns: u64,
    /// Its sequence number in the channel, from 0; continues over split files and wraps after 2^32.
    pub sequence: u32,
    /// Its contents.
    pub message: Message,
}
